#pragma once

#include <vector>

#include <Eigen/Core>

#include "calibration/camera_model.h"

namespace tagdock {

/// A value over the image, on a regular grid of pixels from corner to corner, row by row.
struct ImageMap {
  int columns = 0;
  int rows = 0;
  std::vector<Eigen::Vector2d> pixels;
  std::vector<Eigen::Vector2d> values;  ///< px
  [[nodiscard]] double largest() const;
  [[nodiscard]] double rms() const;  ///< of the vectors' lengths
};

/// The grid that maps are made on.
std::vector<Eigen::Vector2d> image_grid(int width, int height, int columns, int rows);

/// Where `other` sees what `camera` sees at each pixel, far away, after the best turn between the two: how much two
/// calibrations of one camera differ, whatever their parameters (as mrcal-show-projection-diff at infinity).
ImageMap projection_difference(const CameraModel& camera, const CameraModel& other, int columns = 24, int rows = 18);

}  // namespace tagdock
