#pragma once

#include <chrono>
#include <optional>
#include <vector>

#include "planning/pose2.h"

namespace tagdock {

/// One reading of the robot's own odometry.
struct Odometry {
  std::chrono::nanoseconds time{0};  ///< since the session began
  Pose2 T_odom_base;
  Twist2 velocity;  ///< of the base, as the wheels turn

  bool operator==(const Odometry&) const = default;
};

/// A mobile base with a differential drive. Every driver implements this one header.
/// Called from the loop thread only; a driver that has threads of its own hands readings over behind this interface.
class Robot {
 public:
  virtual ~Robot() = default;

  /// Odometry readings that arrived since the last call, oldest first.
  /// Throws std::runtime_error with a sentence when the link is broken.
  virtual std::vector<Odometry> read() = 0;

  /// Sends a velocity. The robot must stop by itself when no command follows within its own time-out (<= 200 ms).
  virtual void drive(const Twist2& command) = 0;

  /// Zero velocity now; never throws.
  virtual void stop() noexcept = 0;

  /// Whether something at the robot asks it to wait (an obstacle, a protective field): the docking pauses while it
  /// does.
  [[nodiscard]] virtual bool wants_hold() const { return false; }
};

}  // namespace tagdock
