#pragma once

#include <optional>
#include <vector>

#include "planning/path.h"

namespace tagdock {

/// What a differential drive can do, as its wheels see it.
struct WheelLimits {
  double speed = 0.3;               ///< of the axle's middle [m/s]
  double wheel_speed = 0.4;         ///< of each wheel's rim [m/s]
  double wheel_acceleration = 0.5;  ///< of each wheel's rim [m/s^2]
  double wheel_jerk = 5.0;          ///< of each wheel's rim [m/s^3]; a guess: full acceleration within 0.1 s
  double track_width = 0.6;         ///< between the wheels [m]
  double period = 0.02;             ///< of the controller [s]
  /// Speed shrinks with what remains to the end: v^2 <= 2 approach_deceleration * remaining [m/s^2].
  double approach_deceleration = 0.05;

  bool operator==(const WheelLimits&) const = default;
};

/// Speed along one segment: from entry to cruise, cruise, from cruise to exit. Both changes begin and end without
/// acceleration: jerk, constant acceleration, jerk.
struct SegmentTiming {
  double entry = 0.0;         ///< m/s, >= 0 whatever the direction
  double cruise = 0.0;        ///< m/s
  double exit = 0.0;          ///< m/s
  double acceleration = 0.0;  ///< m/s^2, largest of the change to cruise
  double deceleration = 0.0;  ///< m/s^2, largest of the change to exit
  double jerk = 0.0;          ///< m/s^3, of both changes
  int periods = 0;            ///< duration in whole control periods

  bool operator==(const SegmentTiming&) const = default;
};

/// When to be where on a path: one timing a segment.
struct TimeLaw {
  std::vector<SegmentTiming> segments;
  double period = 0.0;  ///< s

  [[nodiscard]] double duration() const;  ///< s
};

/// A time law from standstill to standstill in which every segment takes a whole number of control periods, the cruise
/// speed being lowered by what that needs: the geometry stays, so the end pose stays exact.
/// Half of the wheels' acceleration is for changing speed and turning in, half for the jumps of curvature between arcs,
/// of which one may fall into any period: a command changes by no more than wheel_acceleration * period.
/// Half of the wheels' jerk is for changing speed, half for the jumps of sharpness between clothoids, over one period.
/// The jumps of curvature between arcs are held by the acceleration alone: within a period a wheel follows them as it
/// can. The robot stands at every change of direction.
/// @return  none if a segment is too short to be driven in whole periods, or a limit is not a positive number
std::optional<TimeLaw> time_law(const Path& path, const WheelLimits& limits);

/// Speed and turning rate at a time since the start of the path [s]; zero outside.
Twist2 twist_at(const Path& path, const TimeLaw& law, double time);

}  // namespace tagdock
