#pragma once

#include <cmath>
#include <numbers>

namespace tagdock {

/// An angle brought to (-pi, pi].
inline double wrap_angle(double angle) {
  if (angle > -std::numbers::pi && angle <= std::numbers::pi) return angle;  // what std::remainder gives, too
  const double wrapped = std::remainder(angle, 2.0 * std::numbers::pi);
  return wrapped <= -std::numbers::pi ? wrapped + 2.0 * std::numbers::pi : wrapped;
}

inline constexpr double radians(double degrees) { return degrees * std::numbers::pi / 180.0; }
inline constexpr double degrees(double radians) { return radians * 180.0 / std::numbers::pi; }

/// A pose in the plane; as `T_a_b` it maps coordinates in b to coordinates in a.
struct Pose2 {
  double x = 0.0;    ///< m
  double y = 0.0;    ///< m
  double yaw = 0.0;  ///< rad, counter-clockwise; not wrapped by composition, so whole turns can be told apart

  bool operator==(const Pose2&) const = default;
};

/// A planar velocity in the robot's own frame.
struct Twist2 {
  double linear = 0.0;   ///< m/s, forward
  double angular = 0.0;  ///< rad/s, positive turns left

  bool operator==(const Twist2&) const = default;
};

/// T_a_c = T_a_b * T_b_c
inline Pose2 operator*(const Pose2& T_a_b, const Pose2& T_b_c) {
  const double c = std::cos(T_a_b.yaw);
  const double s = std::sin(T_a_b.yaw);
  return {T_a_b.x + c * T_b_c.x - s * T_b_c.y, T_a_b.y + s * T_b_c.x + c * T_b_c.y, T_a_b.yaw + T_b_c.yaw};
}

/// T_b_a from T_a_b
inline Pose2 inverse(const Pose2& T_a_b) {
  const double c = std::cos(T_a_b.yaw);
  const double s = std::sin(T_a_b.yaw);
  return {-c * T_a_b.x - s * T_a_b.y, s * T_a_b.x - c * T_a_b.y, -T_a_b.yaw};
}

/// T_b_c from T_a_b and T_a_c
inline Pose2 between(const Pose2& T_a_b, const Pose2& T_a_c) {
  // inverse(T_a_b) * T_a_c to the last bit, with one sine and cosine for both
  const Pose2 T_b_a = inverse(T_a_b);
  const double c = std::cos(T_a_b.yaw);
  const double s = -std::sin(T_a_b.yaw);
  return {T_b_a.x + c * T_a_c.x - s * T_a_c.y, T_b_a.y + s * T_a_c.x + c * T_a_c.y, T_b_a.yaw + T_a_c.yaw};
}

inline bool is_finite(const Pose2& pose) {
  return std::isfinite(pose.x) && std::isfinite(pose.y) && std::isfinite(pose.yaw);
}
inline bool is_finite(const Twist2& twist) { return std::isfinite(twist.linear) && std::isfinite(twist.angular); }

}  // namespace tagdock
