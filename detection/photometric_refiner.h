#pragma once

#include <optional>
#include <string>

#include <opencv2/core.hpp>

#include "calibration/camera_model.h"
#include "detection/refined_tag.h"
#include "detection/tag_detector.h"

namespace tagdock {

struct PhotometricConfig {
  int max_iterations = 60;
};

/// Fits the whole decoded tag - every black and white edge, tied by one homography - to the grey values.
/// Source: notes on detection, section 8. Terms that a clean image does not need (ink bleed, tone curve, saturation,
/// robust weights) are switched on by evidence in the image, never by the caller.
/// @param family  of the tag, which tells the pattern of `coarse.id`
/// @param camera  if given, the lens is modelled; corners come back distorted, as seen
Refinement refine_photometric(const cv::Mat1b& gray, const std::string& family, const TagDetection& coarse,
                              const PhotometricConfig& config, const std::optional<CameraModel>& camera = std::nullopt);

}  // namespace tagdock
