#pragma once

#include <Eigen/Geometry>

#include "calibration/camera_model.h"

namespace tagdock {

/// Wheel odometry of a differential drive.
struct OdometryModel {
  double r_left = 0.1;   ///< wheel radius [m]
  double r_right = 0.1;  ///< wheel radius [m]
  double track = 0.6;    ///< distance of the wheels' contact points [m]

  bool operator==(const OdometryModel&) const = default;
};

/// What our instruments are: the one result of calibration that the rest consumes.
struct Rig {
  CameraModel camera;
  Eigen::Isometry3d T_base_camera = Eigen::Isometry3d::Identity();
  OdometryModel odometry;
};

/// T_base_camera of a camera that looks straight ahead and level.
/// @param ahead, height  place of the lens before the axle and above the floor [m]
Eigen::Isometry3d level_camera(double ahead, double height);

/// The rig of the simulated robot: 1280x1024 pixels of 4.8 um behind a 5.9 mm lens (horizontal view 55 degrees) with
/// slight barrel distortion, 0.35 m ahead of the axle and 0.35 m above the floor.
Rig default_rig();

}  // namespace tagdock
