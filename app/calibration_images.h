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
};

/// Finds the board in all pictures of a folder (PNG, JPEG, PGM, TIFF, BMP), on as many threads as the machine has
/// cores. Throws Failure(usage): no folder, no picture in it, pictures of different sizes.
ImageViews find_in_folder(const std::filesystem::path& folder, const CalibrationTarget& target,
                          const std::optional<CameraModel>& camera = std::nullopt);

}  // namespace tagdock
