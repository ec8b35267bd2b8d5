#pragma once

#include <optional>
#include <vector>

#include <Eigen/Core>

#include "planning/pose2.h"

namespace tagdock {

/// How wrong the pose is that one frame tells (root mean square, of the camera point and heading), by where the board
/// is seen from: distance and angle decide it, and the place in the image (Abawi et al. 2004, Abbas et al. 2019).
struct SensorErrors {
  struct Sigma {
    double along = 0.0;    ///< the line of sight [m]
    double across = 0.0;   ///< [m]
    double heading = 0.0;  ///< [rad]

    bool operator==(const Sigma&) const = default;
  };

  std::vector<double> distances;  ///< lens to the board's centre [m], rising
  std::vector<double> bearings;   ///< of the lens off the board's normal [rad], rising from 0
  std::vector<double> places;     ///< of the board's centre in the image, share of the half width, rising from 0
  /// By place, then bearing, then distance; none where the board was not seen.
  std::vector<std::optional<Sigma>> cells;

  /// Between the cells by line; the same to both sides. Nearer than the nearest distance it is the nearest one's.
  /// @return none beyond what was measured, and beside a cell in which the board was not seen
  [[nodiscard]] std::optional<Sigma> at(double distance, double bearing, double place) const;

  bool operator==(const SensorErrors&) const = default;
};

/// The same for a camera somewhere before the board: covariance of [x y yaw] in the station frame, m and rad.
/// @param T_station_camera  the lens on the floor plan, yaw along its line of sight
/// @param half_view         half the horizontal field of view [rad]
/// @return                  none as in `at`, and where the board is not in view
std::optional<Eigen::Matrix3d> lens_covariance(const SensorErrors& errors, const Pose2& T_station_camera,
                                               double half_view);

}  // namespace tagdock
