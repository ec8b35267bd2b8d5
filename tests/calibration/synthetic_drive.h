#pragma once

#include <cstdint>

#include "calibration/hand_eye.h"

namespace tagdock::testing {

/// A robot that drives before a board, with known truth: pinhole arithmetic and noise, no images.
struct Drive {
  enum class Way {
    arc,       ///< stops 1.2 to 1.8 m from the board, 27 to 60 degrees to both sides, aimed to 15 degrees
    wide,      ///< near and far, headings over the whole field of view, in no order
    sweep,     ///< as a technician should drive: on arcs from side to side of the board, a step from stop to stop
    zigzag,    ///< the same, two headings at each place, with long legs between near and far: what wheels need
    straight,  ///< towards the board without any turn
    spin       ///< turns on the spot
  };
  enum class Sees { tag, grid };  ///< one tag of 0.2 m, or a grid of 6 x 6 tags of 88 mm

  Way way = Way::arc;
  Sees sees = Sees::tag;
  int stops = 13;
  int frames = 1;  ///< taken at each stop
  bool by_wheels = false;
  bool surveyed = false;  ///< the board, in the tracker's frame
  bool height_by_tape = false;
  double corner_noise_px = 0.1;
  double tracker_noise_m = 0.0002;
  double tracker_noise_rad = 0.00035;  ///< 0.02 degrees
  double wheel_noise = 0.003;          ///< rad per square root of rad
  double outliers = 0.0;               ///< share of corners that are off by 3 to 20 px
  bool leave_out_frontal = false;
  double camera_error = 0.0;  ///< of the intrinsics, over half a pixel; known to the problem as their covariance
  std::uint64_t seed = 1;
};

struct DriveTruth {
  Eigen::Isometry3d T_base_camera = Eigen::Isometry3d::Identity();
  OdometryModel odometry;
};

struct DriveData {
  HandEyeProblem problem;
  DriveTruth truth;
};

DriveData drive(const Drive& how);

/// What a result is wrong by.
struct HandEyeError {
  double xy = 0.0;        ///< m, in the floor plane
  double rotation = 0.0;  ///< rad
  double radius = 0.0;    ///< largest relative error of the two wheels
  double track = 0.0;     ///< relative
};

HandEyeError error_of(const HandEyeResult& result, const DriveTruth& truth);

}  // namespace tagdock::testing
