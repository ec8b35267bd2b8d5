#pragma once

#include <optional>

#include <Eigen/Geometry>

#include "planning/pose2.h"

namespace tagdock {

/// The board's middle as the camera sees it.
struct MarkerView {
  double x = 0.0;      ///< tangent of the bearing, right of the lens positive (ViSP's x)
  double depth = 0.0;  ///< Z along the lens [m]
};

/// The view of the board's middle at the height of the lens.
/// @return none if it is not finite or not in front of the camera
std::optional<MarkerView> marker_view(const Eigen::Isometry3d& T_base_camera,
                                      const Eigen::Isometry3d& T_camera_station);

enum class Centering {
  turn_only,      ///< bearing by turning in place
  turn_and_drive  ///< bearing and range
};

struct MarkerCenteringConfig {
  double gain = 0.6;           ///< 1/s, lambda of the control law for driving
  double turn_gain = 1.2;      ///< 1/s, lambda for turning in place
  double max_speed = 0.15;     ///< m/s
  double max_reverse = 0.10;   ///< m/s
  double max_turn_rate = 0.3;  ///< rad/s
};

/// ViSP's visual servoing of a unicycle with an eye in hand: features (x, log(Z/Z*)), 6x2 robot Jacobian
/// (vpServo, EYEINHAND_L_cVe_eJe; ViSP's example servoPioneerPoint2DDepth).
/// Lateral error and heading at the end are whatever the entry left.
/// @param desired_depth  Z*, > 0 [m]
/// @return               none for a view or depth that is not finite or not positive (ViSP does not check), or when
/// ViSP
///                       finds no law
std::optional<Twist2> center_marker(const MarkerView& view, double desired_depth,
                                    const Eigen::Isometry3d& T_base_camera, Centering mode,
                                    const MarkerCenteringConfig& config);

}  // namespace tagdock
