#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

namespace tagdock::ros2 {

/// The ROS 2 messages that tagdock speaks, as values; field for field those of the interface packages. On the wire they
/// are what ros2_messages.idl says.

struct Time {
  std::int32_t sec = 0;
  std::uint32_t nanosec = 0;
  bool operator==(const Time&) const = default;
};
struct Header {
  Time stamp;
  std::string frame_id;
  bool operator==(const Header&) const = default;
};

struct Bool {
  bool data = false;
  bool operator==(const Bool&) const = default;
};
struct String {
  std::string data;
  bool operator==(const String&) const = default;
};

struct Vector3 {
  double x = 0.0, y = 0.0, z = 0.0;
  bool operator==(const Vector3&) const = default;
};
struct Quaternion {
  double x = 0.0, y = 0.0, z = 0.0, w = 1.0;
  bool operator==(const Quaternion&) const = default;
};
struct Pose {
  Vector3 position;
  Quaternion orientation;
  bool operator==(const Pose&) const = default;
};
struct PoseStamped {
  Header header;
  Pose pose;
  bool operator==(const PoseStamped&) const = default;
};
struct Twist {
  Vector3 linear;
  Vector3 angular;
  bool operator==(const Twist&) const = default;
};
struct TwistStamped {
  Header header;
  Twist twist;
  bool operator==(const TwistStamped&) const = default;
};
/// Covariances are row-major 6x6: x, y, z, about x, about y, about z.
struct OdometryMessage {
  Header header;
  std::string child_frame_id;
  Pose pose;
  std::array<double, 36> pose_covariance{};
  Twist twist;
  std::array<double, 36> twist_covariance{};
  bool operator==(const OdometryMessage&) const = default;
};
struct PathMessage {
  Header header;
  std::vector<PoseStamped> poses;
  bool operator==(const PathMessage&) const = default;
};

struct KeyValue {
  std::string key;
  std::string value;
  bool operator==(const KeyValue&) const = default;
};
struct DiagnosticStatus {
  enum Level : std::uint8_t { ok = 0, warn = 1, error = 2, stale = 3 };
  std::uint8_t level = ok;
  std::string name;
  std::string message;
  std::string hardware_id;
  std::vector<KeyValue> values;
  bool operator==(const DiagnosticStatus&) const = default;
};
struct DiagnosticArray {
  Header header;
  std::vector<DiagnosticStatus> status;
  bool operator==(const DiagnosticArray&) const = default;
};

struct ImagePoint {
  double x = 0.0, y = 0.0;
  bool operator==(const ImagePoint&) const = default;
};
struct AprilTagDetection {
  std::string family;
  std::int32_t id = 0;
  std::int32_t hamming = 0;
  float goodness = 0.0F;
  float decision_margin = 0.0F;
  ImagePoint centre;
  std::array<ImagePoint, 4> corners{};
  std::array<double, 9> homography{};
  bool operator==(const AprilTagDetection&) const = default;
};
struct AprilTagDetectionArray {
  Header header;
  std::vector<AprilTagDetection> detections;
  bool operator==(const AprilTagDetectionArray&) const = default;
};

}  // namespace tagdock::ros2
