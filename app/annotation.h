#pragma once

#include <optional>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "calibration/camera_model.h"
#include "calibration/target.h"

namespace tagdock {

/// What is drawn of one tag.
struct DrawnTag {
  int id = 0;
  Corners corners_px;
  std::optional<Eigen::Isometry3d> T_camera_tag;  ///< with it the tag's axes are drawn, each half a side long
  double size = 0.0;                              ///< side of the black square [m]
  /// [x0 y0 .. y3], px^2; none if zero.
  Eigen::Matrix<double, 8, 8> covariance_px2 = Eigen::Matrix<double, 8, 8>::Zero();
};

/// The picture in colour with outline, id, corners as crosses (the first one ringed), axes (x red, y green, z blue,
/// into the wall), and at each corner, magnified as a line of words at the foot says, its one-sigma ellipse (green) and
/// its residual against the pose (magenta).
/// @param camera  needed for axes only
cv::Mat3b annotated(const cv::Mat1b& gray, const std::vector<DrawnTag>& tags, const std::optional<CameraModel>& camera);

}  // namespace tagdock
