#pragma once

#include <chrono>
#include <deque>
#include <optional>
#include <string>
#include <variant>

#include "app/robots/ros2/messages.h"
#include "servo/robot.h"

namespace tagdock {

/// The robot's clock to session time, learnt from arrivals alone. A message arrives at its stamp, plus the offset of
/// the clocks, plus a delay that is never negative and now and then small: the smallest offset of the last ten seconds
/// counts. Unlike the camera's ClockMap it does not follow a clock that is set: that is a reason to stop.
class StampMap {
 public:
  /// @return session time of the stamp, never after `arrival`; none when the stamp is further ahead of the arrivals
  ///         before than any delay explains
  std::optional<std::chrono::nanoseconds> arrived(std::chrono::nanoseconds stamp, std::chrono::nanoseconds arrival);

  /// The robot's clock at a session time; none before the first arrival.
  [[nodiscard]] std::optional<std::chrono::nanoseconds> stamp_of(std::chrono::nanoseconds session_time) const;

 private:
  struct Offset {
    std::chrono::nanoseconds arrival;
    std::chrono::nanoseconds offset;
  };
  std::deque<Offset> smallest_;  ///< rising in both: the front is the smallest of the window
};

/// The same reading once more.
struct Repeated {};
/// Not to be driven on; the sentence is for a person.
struct Refused {
  std::string sentence;
};

/// nav_msgs/Odometry to our Odometry: what a message claims is checked before a number of it is used. What is left to
/// `odometry_fault` of servo passes through: numbers that are not finite, jumps, and time that runs backwards.
class OdometryReader {
 public:
  /// @param arrival  session time at which the message came
  std::variant<Odometry, Repeated, Refused> read(const ros2::OdometryMessage& message,
                                                 std::chrono::nanoseconds arrival);

  /// Session time as a stamp of the robot's clock; of this machine's wall clock before the first message.
  [[nodiscard]] const StampMap& stamps() const { return stamps_; }

 private:
  StampMap stamps_;
  std::optional<ros2::OdometryMessage> before_;
  std::optional<double> yaw_;                           ///< of `before_`, unwrapped
  std::optional<std::chrono::nanoseconds> same_since_;  ///< stamp since which nothing but the stamp changed
  int same_ = 0;
};

std::chrono::nanoseconds nanoseconds_of(const ros2::Time& time);
ros2::Time time_of(std::chrono::nanoseconds since_epoch);

}  // namespace tagdock
