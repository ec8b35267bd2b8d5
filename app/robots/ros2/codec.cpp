#include "app/robots/ros2/codec.h"

#include <algorithm>

namespace tagdock::ros2 {
namespace {

// Cyclone reads samples through pointers that are not const, and does not write to them.
char* text(const std::string& from) { return const_cast<char*>(from.c_str()); }
std::string text(const char* from) { return from == nullptr ? std::string() : std::string(from); }

void put(const Header& from, std_msgs_msg_dds__Header_& to) {
  to.stamp.sec = from.stamp.sec;
  to.stamp.nanosec = from.stamp.nanosec;
  to.frame_id = text(from.frame_id);
}
Header got(const std_msgs_msg_dds__Header_& from) {
  return {{from.stamp.sec, from.stamp.nanosec}, text(from.frame_id)};
}

void put(const Twist& from, geometry_msgs_msg_dds__Twist_& to) {
  to.linear = {from.linear.x, from.linear.y, from.linear.z};
  to.angular = {from.angular.x, from.angular.y, from.angular.z};
}
Twist got(const geometry_msgs_msg_dds__Twist_& from) {
  return {{from.linear.x, from.linear.y, from.linear.z}, {from.angular.x, from.angular.y, from.angular.z}};
}

void put(const Pose& from, geometry_msgs_msg_dds__Pose_& to) {
  to.position = {from.position.x, from.position.y, from.position.z};
  to.orientation = {from.orientation.x, from.orientation.y, from.orientation.z, from.orientation.w};
}
Pose got(const geometry_msgs_msg_dds__Pose_& from) {
  return {{from.position.x, from.position.y, from.position.z},
          {from.orientation.x, from.orientation.y, from.orientation.z, from.orientation.w}};
}

void put(const PoseStamped& from, geometry_msgs_msg_dds__PoseStamped_& to) {
  put(from.header, to.header);
  put(from.pose, to.pose);
}
PoseStamped got(const geometry_msgs_msg_dds__PoseStamped_& from) { return {got(from.header), got(from.pose)}; }

// Room for the elements of a sequence, owned by the encoded message.
template <class Wire, class Sequence>
auto* room(Encoded<Wire>& owner, Sequence& sequence, std::size_t count) {
  using Element = std::remove_pointer_t<decltype(sequence._buffer)>;
  owner.arrays.emplace_back(std::max<std::size_t>(1, count) * sizeof(Element));
  auto* elements = reinterpret_cast<Element*>(owner.arrays.back().data());
  sequence._maximum = sequence._length = static_cast<std::uint32_t>(count);
  sequence._buffer = elements;
  sequence._release = false;
  return elements;
}

}  // namespace

void Codec<Bool>::encode(const Bool& from, Encoded<Wire>& to) { to.wire.data = from.data; }
Bool Codec<Bool>::decode(const Wire& from) { return {from.data}; }

void Codec<String>::encode(const String& from, Encoded<Wire>& to) { to.wire.data = text(from.data); }
String Codec<String>::decode(const Wire& from) { return {text(from.data)}; }

void Codec<Twist>::encode(const Twist& from, Encoded<Wire>& to) { put(from, to.wire); }
Twist Codec<Twist>::decode(const Wire& from) { return got(from); }

void Codec<TwistStamped>::encode(const TwistStamped& from, Encoded<Wire>& to) {
  put(from.header, to.wire.header);
  put(from.twist, to.wire.twist);
}
TwistStamped Codec<TwistStamped>::decode(const Wire& from) { return {got(from.header), got(from.twist)}; }

void Codec<PoseStamped>::encode(const PoseStamped& from, Encoded<Wire>& to) { put(from, to.wire); }
PoseStamped Codec<PoseStamped>::decode(const Wire& from) { return got(from); }

void Codec<OdometryMessage>::encode(const OdometryMessage& from, Encoded<Wire>& to) {
  put(from.header, to.wire.header);
  to.wire.child_frame_id = text(from.child_frame_id);
  put(from.pose, to.wire.pose.pose);
  put(from.twist, to.wire.twist.twist);
  std::copy(from.pose_covariance.begin(), from.pose_covariance.end(), to.wire.pose.covariance);
  std::copy(from.twist_covariance.begin(), from.twist_covariance.end(), to.wire.twist.covariance);
}
OdometryMessage Codec<OdometryMessage>::decode(const Wire& from) {
  OdometryMessage to;
  to.header = got(from.header);
  to.child_frame_id = text(from.child_frame_id);
  to.pose = got(from.pose.pose);
  to.twist = got(from.twist.twist);
  std::copy_n(from.pose.covariance, to.pose_covariance.size(), to.pose_covariance.begin());
  std::copy_n(from.twist.covariance, to.twist_covariance.size(), to.twist_covariance.begin());
  return to;
}

void Codec<PathMessage>::encode(const PathMessage& from, Encoded<Wire>& to) {
  put(from.header, to.wire.header);
  auto* poses = room(to, to.wire.poses, from.poses.size());
  for (std::size_t i = 0; i < from.poses.size(); ++i) put(from.poses[i], poses[i]);
}
PathMessage Codec<PathMessage>::decode(const Wire& from) {
  PathMessage to{got(from.header), {}};
  for (std::uint32_t i = 0; i < from.poses._length; ++i) to.poses.push_back(got(from.poses._buffer[i]));
  return to;
}

void Codec<DiagnosticArray>::encode(const DiagnosticArray& from, Encoded<Wire>& to) {
  put(from.header, to.wire.header);
  auto* all = room(to, to.wire.status, from.status.size());
  for (std::size_t i = 0; i < from.status.size(); ++i) {
    const DiagnosticStatus& status = from.status[i];
    all[i].level = status.level;
    all[i].name = text(status.name);
    all[i].message = text(status.message);
    all[i].hardware_id = text(status.hardware_id);
    auto* values = room(to, all[i].values, status.values.size());
    for (std::size_t j = 0; j < status.values.size(); ++j)
      values[j] = {text(status.values[j].key), text(status.values[j].value)};
  }
}
DiagnosticArray Codec<DiagnosticArray>::decode(const Wire& from) {
  DiagnosticArray to{got(from.header), {}};
  for (std::uint32_t i = 0; i < from.status._length; ++i) {
    const auto& status = from.status._buffer[i];
    DiagnosticStatus one{status.level, text(status.name), text(status.message), text(status.hardware_id), {}};
    for (std::uint32_t j = 0; j < status.values._length; ++j)
      one.values.push_back({text(status.values._buffer[j].key), text(status.values._buffer[j].value)});
    to.status.push_back(std::move(one));
  }
  return to;
}

void Codec<AprilTagDetectionArray>::encode(const AprilTagDetectionArray& from, Encoded<Wire>& to) {
  put(from.header, to.wire.header);
  auto* all = room(to, to.wire.detections, from.detections.size());
  for (std::size_t i = 0; i < from.detections.size(); ++i) {
    const AprilTagDetection& tag = from.detections[i];
    all[i].family = text(tag.family);
    all[i].id = tag.id;
    all[i].hamming = tag.hamming;
    all[i].goodness = tag.goodness;
    all[i].decision_margin = tag.decision_margin;
    all[i].centre = {tag.centre.x, tag.centre.y};
    for (std::size_t k = 0; k < 4; ++k) all[i].corners[k] = {tag.corners[k].x, tag.corners[k].y};
    std::copy(tag.homography.begin(), tag.homography.end(), all[i].homography);
  }
}
AprilTagDetectionArray Codec<AprilTagDetectionArray>::decode(const Wire& from) {
  AprilTagDetectionArray to{got(from.header), {}};
  for (std::uint32_t i = 0; i < from.detections._length; ++i) {
    const auto& tag = from.detections._buffer[i];
    AprilTagDetection one;
    one.family = text(tag.family);
    one.id = tag.id;
    one.hamming = tag.hamming;
    one.goodness = tag.goodness;
    one.decision_margin = tag.decision_margin;
    one.centre = {tag.centre.x, tag.centre.y};
    for (std::size_t k = 0; k < 4; ++k) one.corners[k] = {tag.corners[k].x, tag.corners[k].y};
    std::copy_n(tag.homography, one.homography.size(), one.homography.begin());
    to.detections.push_back(std::move(one));
  }
  return to;
}

}  // namespace tagdock::ros2
