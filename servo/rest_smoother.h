#pragma once

#include <optional>
#include <span>
#include <vector>

#include <Eigen/Core>

#include "calibration/rig.h"
#include "calibration/target.h"
#include "detection/tag_pose.h"
#include "planning/pose2.h"
#include "servo/pose_filter.h"

namespace tagdock {

/// The corners of one tag in one frame.
struct CornersSeen {
  int id = 0;
  Corners corners_px;
  double variance_px2 = 0.0;  ///< claimed, mean of the eight coordinates
};

/// What one frame said while the robot came to rest.
struct RestSighting {
  PlanarSighting planar;
  Pose2 T_odom_base;  ///< at image time
  std::vector<CornersSeen> tags;
};

/// @param planar       what the filter made of it
/// @param T_odom_base  at image time
RestSighting rest_sighting(const PlanarSighting& planar, const BoardSighting& seen, const Pose2& T_odom_base);

struct RestSmootherConfig {
  /// What survey and lens model leave at a corner, the same in every frame [px, 1 sigma]: 0.2 mm of a tag's place at
  /// 1 m and a focal length of 1230 px. It decides the corners' weights, which must not change from docking to docking.
  double lasting_px = 0.25;
  double least_noise_px = 0.01;  ///< a claimed sigma below this weighs as this
  // How the chassis shakes from frame to frame:
  double sigma_roll = 0.00175;  ///< rad
  double sigma_pitch = 0.0035;  ///< rad
  double sigma_height = 0.002;  ///< m
  double outlier = 5.0;         ///< sigmas of a tag's corners from which they count less (Huber)
  int iterations = 20;
};

/// Where the robot rests.
struct SmoothedRest {
  Pose2 T_station_base;  ///< at the odometry reading that was asked for
  /// [x y yaw] of the base in the station frame, m and rad: from what scatters from frame to frame, as measured.
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  /// What independent lasting errors of 1 px in every corner coordinate make of it.
  Eigen::Matrix3d covariance_per_px2 = Eigen::Matrix3d::Zero();
  double scatter_px = 0.0;  ///< of a corner coordinate, from frame to frame
  double lasting_px = 0.0;  ///< rms of what stays at the corners over all frames
  double chi2 = 0.0;        ///< scatter against the claimed variance; about 1
};

/// One pose from all frames of a standstill at once, by least squares over the raw corners (Ceres): the pose, how the
/// chassis shook in each frame, and what stays wrong at each corner. Odometry links the frames, so that a robot which
/// still rolls out is placed where it ends. Huber's loss for each tag and frame.
/// Source: notes on docking, 8 (fixed-lag least squares), where the poses of a standstill are one.
/// @param T_odom_base  where the answer is wanted
/// @param start        T_station_base there, from the filter or an average
/// @return  none with fewer than two frames, without corners that fit the start, or where it does not converge
std::optional<SmoothedRest> smooth_rest(std::span<const RestSighting> sightings, const Pose2& T_odom_base,
                                        const Pose2& start, const Rig& rig, const Board& board,
                                        const RestSmootherConfig& config);

}  // namespace tagdock
