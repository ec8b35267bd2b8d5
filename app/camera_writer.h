#pragma once

#include <string>

#include "calibration/camera_model.h"
#include "calibration/poorer_lens.h"

namespace tagdock {

/// A camera in another program's format, and what the format cannot hold.
struct CameraText {
  std::string text;
  CameraModel held;  ///< as a reader of the file gets it
  Loss loss;         ///< against the camera given
};

/// @param format  ros, opencv, kalibr, mrcal, visp or tagdock
/// Throws Failure(usage) with the formats.
CameraText camera_text(const CameraModel& camera, const std::string& format);

/// What a file of that format is called after its name: ".ros.yaml", ".xml", ...
std::string camera_extension(const std::string& format);

}  // namespace tagdock
