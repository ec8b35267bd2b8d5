#pragma once

#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "calibration/intrinsics.h"
#include "detection/target_finder.h"

namespace tagdock {

/// One picture's view of the board, ready for `calibrate_intrinsics`.
CalibrationView view_of(const std::string& name, const TargetView& seen);

/// What a folder of pictures gave.
struct ImageViews {
  int width = 0;
  int height = 0;
  std::vector<CalibrationView> views;   ///< in the order of the names; pictures that cannot be read are not among them
  std::vector<std::string> unreadable;  ///< sentences
  std::vector<std::filesystem::path> files;  ///< of the views
  std::vector<TargetView> seen;              ///< of the views
};

/// Finds the board in all pictures of a folder (PNG, JPEG, PGM, TIFF, BMP), on as many threads as the machine has
/// cores; corners as `TargetFinder::find_coarsely` gives them. Throws Failure(usage): no folder, no picture in it,
/// pictures of different sizes.
ImageViews find_in_folder(const std::filesystem::path& folder, const CalibrationTarget& target);

/// The corners of the same pictures again, through the lens. Throws Failure(usage) when a picture has gone meanwhile.
ImageViews refine_in_folder(const ImageViews& found, const CalibrationTarget& target, const CameraModel& camera);

/// A camera from pictures of a board: the lens from quick corners, then corners through the lens, then the camera.
/// Throws as `find_in_folder`, and Failure(calibration_refused) when no picture shows the board.
struct FolderCalibration {
  ImageViews views;
  IntrinsicsResult result;
};
FolderCalibration calibrate_from_folder(const std::filesystem::path& folder, const CalibrationTarget& target,
                                        const IntrinsicsConfig& config);

}  // namespace tagdock
