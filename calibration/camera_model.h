#pragma once

#include <optional>

#include <Eigen/Core>

namespace tagdock {

/// Pinhole with radial and tangential distortion as in OpenCV and ROS (`plumb_bob`, and `rational_polynomial` when
/// k4..k6 are not zero). The centre of the top-left pixel is (0, 0).
struct CameraModel {
  int width = 0;                                  ///< px
  int height = 0;                                 ///< px
  double fx = 0.0, fy = 0.0, cx = 0.0, cy = 0.0;  ///< px
  double k1 = 0.0, k2 = 0.0, p1 = 0.0, p2 = 0.0, k3 = 0.0, k4 = 0.0, k5 = 0.0, k6 = 0.0;

  bool operator==(const CameraModel&) const = default;
};

/// A pixel with its derivative by the point that was projected.
struct Projection {
  Eigen::Vector2d pixel;
  Eigen::Matrix<double, 2, 3> by_point;  ///< d(px)/d(point in the camera frame) [px/m]
};

/// Bends a point of the ideal image plane (x/z, y/z) as the lens does.
Eigen::Vector2d distort(const CameraModel& camera, const Eigen::Vector2d& ideal);

/// The inverse of `distort` by Newton's method to 1e-12.
/// @return none where the lens model folds over, so that no ideal point belongs to it
std::optional<Eigen::Vector2d> undistort(const CameraModel& camera, const Eigen::Vector2d& distorted);

/// The pixel that sees a point.
/// @param point_camera  in the camera frame [m], z > 0
Eigen::Vector2d project(const CameraModel& camera, const Eigen::Vector3d& point_camera);
Projection project_with_jacobian(const CameraModel& camera, const Eigen::Vector3d& point_camera);

/// Where the line of sight of a pixel meets the plane z = 1 of the camera frame; none as in `undistort`.
std::optional<Eigen::Vector2d> unproject(const CameraModel& camera, const Eigen::Vector2d& pixel);

/// The model of a part of the picture whose pixels are the mean of `binning` x `binning` pixels each. The centre of
/// such a pixel lies between the centres that it covers: u = (u_sensor + 0.5) / binning - 0.5 - offset_x.
/// @param offset_x, offset_y, width, height  of the part [binned px]
CameraModel camera_of_part(const CameraModel& camera, int binning, int offset_x, int offset_y, int width, int height);

/// Horizontal field of view between the outer pixel centres on the row of the principal point [rad], without
/// distortion.
double horizontal_view(const CameraModel& camera);

/// Throws std::invalid_argument that names the value which no camera can have (size, focal length, NaN).
void check(const CameraModel& camera);

}  // namespace tagdock
