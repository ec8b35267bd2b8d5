#pragma once

#include <vector>

#include <Eigen/Geometry>

#include "calibration/camera_model.h"

namespace tagdock {

/// A known point of a board and where it was seen.
struct SeenPoint {
  int id = 0;
  Eigen::Vector3d point_board = Eigen::Vector3d::Zero();  ///< m
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();        ///< as seen (distorted)
  double sigma_px = 0.1;                                  ///< of each coordinate
  /// Where the corner of a free-standing square goes when the square grows by a pixel on each side [px]: by ink, or by
  /// what a fit of blurred edges is off. Zero where squares touch: there both edges cross, and neither moves.
  Eigen::Vector2d outward = Eigen::Vector2d::Zero();
};

/// The poses T_camera_board that explain seen points, the better first; a flat board has up to two. Unweighted: start
/// values for what follows, no covariance.
/// Method: infinitesimal plane-based pose (Collins and Bartoli) for flat boards, SQPnP (Terzakis and Lourakis) for
/// others, both from OpenCV; then Levenberg-Marquardt.
/// @param points  at least four, not on one line
/// @return        none if there are too few points or no pose lies before the camera
std::vector<Eigen::Isometry3d> board_poses(const std::vector<SeenPoint>& points, const CameraModel& camera);

/// Root of the mean square over all coordinates of what the pose leaves [px].
double reprojection_rms(const std::vector<SeenPoint>& points, const CameraModel& camera,
                        const Eigen::Isometry3d& T_camera_board);

}  // namespace tagdock
