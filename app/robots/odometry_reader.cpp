#include "app/robots/odometry_reader.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

namespace tagdock {
namespace {

using std::chrono::nanoseconds;

constexpr nanoseconds window = std::chrono::seconds(10);
/// A stamp that far ahead of all arrivals before is another clock. Smaller steps are late packets in the first seconds
/// (measured for the camera: up to 50 ms on a loaded machine).
constexpr nanoseconds ahead = std::chrono::milliseconds(100);
constexpr std::size_t longest_name = 256;  // letters of a frame's name
constexpr double unit_slack = 0.01;        // of a quaternion's length
constexpr double steepest = 0.94;          // cosine of 20 degrees: a robot on a floor does not lean more
constexpr double farthest = 1e5;           // m; beyond, a metre is no longer exact to micrometres
constexpr double sideways = 0.05;          // m/s that a differential drive cannot have
// Frozen: the same numbers for so long, although they say that the robot moves.
constexpr nanoseconds frozen_for = std::chrono::milliseconds(120);
constexpr int frozen_readings = 4;
constexpr double moving = 0.01;  // m/s or rad/s

template <typename... Values>
std::string sentence(const char* format, Values... values) {
  std::array<char, 300> text{};
  std::snprintf(text.data(), text.size(), format, values...);
  return text.data();
}

bool finite(const ros2::Quaternion& q) {
  return std::isfinite(q.x) && std::isfinite(q.y) && std::isfinite(q.z) && std::isfinite(q.w);
}

std::optional<std::string> wrong(const ros2::OdometryMessage& message) {
  if (message.header.stamp.nanosec >= 1000000000U || message.header.stamp.sec < 0)
    return sentence("odometry has the stamp %d s %u ns, which is no time", message.header.stamp.sec,
                    message.header.stamp.nanosec);
  if (message.header.stamp == ros2::Time{})
    return std::string("odometry carries no time stamp; the robot's driver must stamp its messages");
  if (message.header.frame_id.size() > longest_name || message.child_frame_id.size() > longest_name)
    return std::string("odometry names a frame with more than 256 letters");
  const ros2::Quaternion& q = message.pose.orientation;
  const double squared = q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w;
  if (finite(q) && !(std::abs(std::sqrt(squared) - 1.0) < unit_slack))
    return sentence("odometry's orientation is no unit quaternion, its length is %g", std::sqrt(squared));
  if (finite(q) && 1.0 - 2.0 * (q.x * q.x + q.y * q.y) / squared < steepest)
    return std::string("odometry says that the robot leans by more than 20 degrees");
  const ros2::Vector3& place = message.pose.position;
  if (std::abs(place.x) > farthest || std::abs(place.y) > farthest)
    if (std::isfinite(place.x) && std::isfinite(place.y))
      return sentence("odometry is at %g, %g m, too far from its origin to be exact", place.x, place.y);
  if (std::isfinite(message.twist.linear.y) && std::abs(message.twist.linear.y) > sideways)
    return sentence("odometry drives sideways at %.2f m/s; tagdock docks robots with a differential drive",
                    message.twist.linear.y);
  return std::nullopt;
}

}  // namespace

nanoseconds nanoseconds_of(const ros2::Time& time) {
  return std::chrono::seconds(time.sec) + nanoseconds(time.nanosec);
}

ros2::Time time_of(nanoseconds since_epoch) {
  const auto seconds = std::chrono::floor<std::chrono::seconds>(since_epoch);
  return {static_cast<std::int32_t>(seconds.count()), static_cast<std::uint32_t>((since_epoch - seconds).count())};
}

std::optional<nanoseconds> StampMap::arrived(nanoseconds stamp, nanoseconds arrival) {
  const nanoseconds offset = arrival - stamp;
  if (!smallest_.empty() && offset < smallest_.front().offset - ahead) return std::nullopt;
  while (!smallest_.empty() && smallest_.back().offset >= offset) smallest_.pop_back();
  smallest_.push_back({arrival, offset});
  while (smallest_.front().arrival + window < arrival) smallest_.pop_front();
  return stamp + smallest_.front().offset;
}

std::optional<nanoseconds> StampMap::stamp_of(nanoseconds session_time) const {
  if (smallest_.empty()) return std::nullopt;
  return session_time - smallest_.front().offset;
}

std::variant<Odometry, Repeated, Refused> OdometryReader::read(const ros2::OdometryMessage& message,
                                                               nanoseconds arrival) {
  if (std::optional<std::string> why = wrong(message)) return Refused{*why};
  if (before_ && message == *before_) return Repeated{};

  const nanoseconds stamp = nanoseconds_of(message.header.stamp);
  const std::optional<nanoseconds> time = stamps_.arrived(stamp, arrival);
  if (!time) return Refused{"the robot's clock jumped ahead while it was docking; it must not be set now"};

  const bool same = before_ && before_->pose == message.pose && before_->twist == message.twist;
  const double speed = std::max(std::abs(message.twist.linear.x), std::abs(message.twist.angular.z));
  if (!same || speed < moving) {
    same_since_.reset();
    same_ = 0;
  } else {
    if (!same_since_) same_since_ = nanoseconds_of(before_->header.stamp);
    if (++same_ >= frozen_readings && stamp - *same_since_ > frozen_for)
      return Refused{sentence("odometry is frozen: the pose has not changed for %.0f ms at %.2f m/s",
                              static_cast<double>((stamp - *same_since_).count()) / 1e6, message.twist.linear.x)};
  }
  before_ = message;

  const ros2::Quaternion& q = message.pose.orientation;
  const double wrapped = std::atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z));
  const double yaw = yaw_ && std::isfinite(wrapped) ? *yaw_ + wrap_angle(wrapped - *yaw_) : wrapped;
  if (std::isfinite(yaw)) yaw_ = yaw;
  return Odometry{*time,
                  {message.pose.position.x, message.pose.position.y, yaw},
                  {message.twist.linear.x, message.twist.angular.z}};
}

}  // namespace tagdock
