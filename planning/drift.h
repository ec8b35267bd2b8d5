#pragma once

#include <Eigen/Core>

#include "planning/path.h"

namespace tagdock {

/// How odometry drifts: independent errors that add up as variance per metre driven and per radian turned.
/// The defaults are a guess for a clean floor; calibrated dockings replace them.
struct OdometryDrift {
  double along = 0.003;                ///< m per root metre, in the driving direction
  double across = 0.001;               ///< m per root metre, sideways
  double heading = radians(0.15);      ///< rad per root metre
  double heading_turn = radians(0.5);  ///< rad per root radian of turning

  bool operator==(const OdometryDrift&) const = default;
};

/// Covariance of the pose after driving a path by odometry alone: [x y yaw], m and rad, in the frame of the path.
/// First order: an error of heading on the way turns the rest of the path about the place where it arose.
/// @param at_start  covariance of the start pose in the same order and frame
Eigen::Matrix3d covariance_at_end(const Path& path, const Eigen::Matrix3d& at_start, const OdometryDrift& drift);

}  // namespace tagdock
