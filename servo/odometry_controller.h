#pragma once

#include <chrono>
#include <optional>

#include "planning/path.h"
#include "planning/pose2.h"
#include "servo/castors.h"

namespace tagdock {

/// How many whole steps a segment is cut into: down is the paper's.
enum class StepRounding { down, nearest };

/// Control period that cuts a segment into whole steps, close to the nominal period.
/// After Richter et al., eq. (6). Printed there, the first branch is `floor(i) - dt`, which is no rate;
/// from the text we take it as floor(i) steps in the segment's time. The "very short dt" that keeps the time from being
/// exceeded by one more step is the rounding up to a whole nanosecond here: after n periods the time is t_s or less
/// than n ns past it, so no further step begins.
/// @param segment_time  time to drive the segment, > 0
/// @param nominal       wanted period, > 0
/// @return              segment_time / n, with n = floor(segment_time / nominal), at least 1
std::chrono::nanoseconds control_period(std::chrono::nanoseconds segment_time, std::chrono::nanoseconds nominal,
                                        StepRounding rounding = StepRounding::down);

struct OdometryControllerConfig {
  /// The paper's damping a: share of a deviation that one control cycle of `nominal_period` takes back. 0.075 is what
  /// the paper found; 0.2 oscillates with a dead time above 0.15 s.
  double damping = 0.075;
  std::chrono::nanoseconds nominal_period = std::chrono::milliseconds(20);
  double lateral_length = 0.5;  ///< a lateral deviation counts as a heading error over this length [m]
  double along_share = 0.5;     ///< of the damping, for the deviation along the path
  double max_speed = 0.20;      ///< m/s
  double acceleration = 0.20;   ///< m/s^2
  double deceleration = 0.15;   ///< m/s^2, of the reference's own speed
  double braking = 0.12;        ///< m/s^2, plans the stop at the end
  double max_command = 0.25;    ///< m/s, reference plus correction
  double max_turn_rate = 0.5;   ///< rad/s
  double end_speed = 0.0;       ///< m/s, kept in the last `end_length`, where another law takes over
  double end_length = 0.02;     ///< m
  double arrival = 0.0008;      ///< m, along the path
  std::chrono::nanoseconds rest = std::chrono::milliseconds(500);  ///< standing at the end before it counts as done
  /// The reference waits for a robot that is farther behind than `wait_from`, and stands at `wait_at` [m]. Dead time
  /// and lag alone make 0.03 m at 0.2 m/s.
  double wait_from = 0.06;
  double wait_at = 0.12;
  /// Castors that hold the heading back; the wheels are steered ahead of the path by as much. Forward paths only; the
  /// pose given to `follow` then has the heading that the wheels drove. 0 is a robot without.
  double castor_scrub = 0.0;  ///< rad/m
  double steer_ahead = 0.07;  ///< m by which a turn is steered early: castors and drive take their time
  CastorConfig castors;
};

/// What following a path remembers from one cycle to the next.
struct FollowState {
  double reference = 0.0;              ///< distance of the reference along the path [m]
  double reference_speed = 0.0;        ///< m/s
  double wanted = 0.0;                 ///< linear part of the last command, before the gate [m/s]
  std::chrono::nanoseconds rested{0};  ///< how long the end has been held

  bool operator==(const FollowState&) const = default;
};

struct FollowStep {
  FollowState next;
  Twist2 command;
  Pose2 deviation;         ///< of the robot in the frame of the reference point: along, left, heading
  double remaining = 0.0;  ///< from the reference to the end [m]
  bool arrived = false;
};

/// One cycle of following a path: the reference runs along it, and deviations of the robot are applied directly
/// proportional to the velocities (paper, 3.2; notes on docking, 4.7). A robot that is held or slowed is waited for.
/// @param path    in any frame, without a change of direction
/// @param pose    of the robot in the frame of the path, by dead reckoning or by the filter
/// @param step    since the last cycle, > 0
/// @param passed  linear part of what the gate let through of the last command [m/s]; none: all of it
FollowStep follow(const Path& path, const FollowState& state, const Pose2& pose, std::chrono::nanoseconds step,
                  const OdometryControllerConfig& config, std::optional<double> passed = std::nullopt);

/// Time that the reference takes for a distance from standstill.
std::chrono::nanoseconds travel_time(double distance, const OdometryControllerConfig& config);

}  // namespace tagdock
