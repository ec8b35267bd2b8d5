#pragma once

#include <chrono>
#include <vector>

#include "planning/pose2.h"

namespace tagdock {

/// Source: notes on docking, 7.2 and 7.3.
struct LineLawConfig {
  double length = 0.20;  ///< L of the double pole at 1/L [m]
  /// Heading lag K of the castors [m]: the robot's heading is that of its wheels less K times the curvature. With
  /// theta' = -(2/L + K/L^2) theta - y/L^2 and y' = theta - K theta', both poles stay at 1/L whatever K is.
  double lag = 0.0;
  double slow_length = 0.60;        ///< L once swinging was seen [m]
  double max_curvature = 1.5;       ///< 1/m
  double max_turn_rate = 0.4;       ///< rad/s
  double turning_speed = 0.03;      ///< m/s; the turn rate does not sink with a speed below this
  double max_speed = 0.15;          ///< m/s
  double slow_speed = 0.08;         ///< m/s, once swinging was seen
  double end_speed = 0.02;          ///< m/s, at the goal
  double speed_per_distance = 0.8;  ///< 1/s
  double braking = 0.05;            ///< m/s^2
  double acceleration = 0.12;       ///< m/s^2
  double deceleration = 0.2;        ///< m/s^2
  double response_time = 0.18;      ///< s; dead time and lag of the drive, runs out after a stop
  double stop_distance = 0.0001;    ///< m, predicted rest at which the robot is stopped
  double min_heading = 0.0524;      ///< rad; 3 degrees, always allowed
  double max_heading = 0.314;       ///< rad; 18 degrees
  double view_margin = 0.0524;      ///< rad; 3 degrees between the board's edge and the border of the image
  double min_view_distance = 0.4;   ///< m
};

/// The line to follow: through the docking pose, along its heading.
struct LineTarget {
  Pose2 T_station_goal;        ///< of the axle
  double camera_ahead = 0.35;  ///< m
  double half_view = 0.48;     ///< rad, half the horizontal field of view
  double board_width = 0.6;    ///< m, board and clearance
};

/// Largest heading against the line that keeps the whole board in view.
/// @param bare  without the lower limit: below `min_heading` such a dock should be refused when it is planned
double heading_limit(const LineTarget& target, double camera_distance, const LineLawConfig& config, bool bare = false);

struct LineCommand {
  Twist2 command;
  double remaining = 0.0;  ///< m, to the goal; in reverse to the end of the back-off
  double lateral = 0.0;    ///< m, left of the line
  double heading = 0.0;    ///< rad, against the line
  bool reached = false;    ///< the command is zero and stays so
};

/// One cycle of the line law, forward: takes out lateral and heading error over the remaining way, so that over the
/// driven distance s, y'' + (2/L) y' + y/L^2 = 0. With castors that lag (LineLawConfig::lag) the heading given here is
/// that of the wheels.
/// @param T_station_base  of the axle
/// @param last            command of the cycle before, from which the speed ramps
/// @param wheel_speed     as measured [m/s]
/// @param slow            swinging was seen: longer L, lower speed
LineCommand follow_line(const LineTarget& target, const Pose2& T_station_base, const Twist2& last, double wheel_speed,
                        std::chrono::nanoseconds step, bool slow, const LineLawConfig& config);

/// The same in reverse, away from the board.
/// @param camera_distance  of the camera point before the board at which to stop [m]
LineCommand back_along_line(const LineTarget& target, const Pose2& T_station_base, double camera_distance,
                            const Twist2& last, double wheel_speed, std::chrono::nanoseconds step,
                            const LineLawConfig& config);

/// Lateral error that the law leaves after a distance (linear): (y0 + (y0' + y0/L) s) exp(-s/L), where y0' is the
/// heading, or with castors that lag theta + K ((2/L + K/L^2) theta + y/L^2).
double lateral_left(double lateral, double heading, double distance, double length, double lag = 0.0);

/// Sees swinging: three sign changes of the heading error, each beyond `threshold`, within `window` of travel.
struct SwingWatch {
  int sign = 0;
  std::vector<double> changes;  ///< distances at which the sign changed, within the window

  bool operator==(const SwingWatch&) const = default;
};
struct SwingConfig {
  double threshold = 0.0087;  ///< rad; 0.5 degrees
  double window = 1.0;        ///< m
  int changes = 3;
};
SwingWatch watch(const SwingWatch& before, double travelled, double heading_error, const SwingConfig& config);
bool swings(const SwingWatch& now, const SwingConfig& config);

}  // namespace tagdock
