// A program beside the tests of the ROS 2 link.
//   ros2_peer drive DOMAIN SPEED [abort|segfault|throw AFTER_S]   drives the robot there until a fault or a signal
//   ros2_peer echo DOMAIN                                         answers each Twist with an Odometry of the same speed
//   ros2_peer obstacle DOMAIN AFTER_S HOLD_S                      something is in the way for a while; then it is not
//   ros2_peer spoil DOMAIN COUNT SEED                             sends an old command, spoiled in as many ways
//   ros2_peer payloads DOMAIN                                     prints messages as JSON fields and as bytes
//   ros2_peer decode DOMAIN                                       lines "type hex" in, JSON fields out
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <functional>
#include <iostream>
#include <sstream>
#include <thread>

#include <nlohmann/json.hpp>

#include "app/robots/odometry_reader.h"
#include "app/robots/ros2.h"
#include "app/robots/ros2/codec.h"
#include "ros2_raw.h"

using namespace tagdock;
using namespace tagdock::ros2;
using nlohmann::json;
using std::chrono::milliseconds;
using std::chrono::steady_clock;

namespace {

int drive(int domain, double speed, const std::string& end, double after) {
  Ros2Config config;
  config.domain = domain;
  const auto start = steady_clock::now();
  const Ros2Robot robot = open_ros2(config, OdometryLimits{}, start);
  std::cout << "driving" << std::endl;
  for (auto next = steady_clock::now();; next += milliseconds(20)) {
    std::this_thread::sleep_until(next);
    try {
      (void)robot.robot->read();
    } catch (const std::runtime_error& error) {
      robot.robot->stop();
      std::cout << "fault: " << error.what() << std::endl;
      return 5;
    }
    robot.robot->drive({speed, 0.0});
    if (end.empty() || std::chrono::duration<double>(steady_clock::now() - start).count() < after) continue;
    if (end == "abort") std::abort();
    if (end == "segfault") std::raise(SIGSEGV);
    if (end == "throw") std::thread([] { throw std::runtime_error("nobody catches this"); }).join();
  }
}

int echo(int domain) {
  Ros2Config config;
  config.domain = domain;
  Link link(link_config(config, "echo"));
  const auto commands = link.subscription<Twist>("/cmd_vel", Delivery::best_effort, 10);
  const auto odometry = link.publisher<OdometryMessage>("/odom");
  std::cout << "echoing" << std::endl;
  while (true) {
    link.wait(milliseconds(100));
    for (const Twist& twist : commands.take()) {
      OdometryMessage message;
      message.header.stamp = time_of(std::chrono::system_clock::now().time_since_epoch());
      message.twist = twist;
      odometry.write(message);
    }
  }
}

int obstacle(int domain, double after, double hold) {
  Ros2Config config;
  config.domain = domain;
  Link link(link_config(config, "obstacle"));
  const auto stop = link.publisher<Bool>("/obstacle_stop");
  const auto wait = [](double seconds) { std::this_thread::sleep_for(std::chrono::duration<double>(seconds)); };
  stop.write({false});
  wait(after);
  stop.write({true});
  wait(hold);
  stop.write({false});
  wait(1000.0);  // who goes away counts as being in the way
  return 0;
}

template <class Message>
test::Bytes bytes_of(Link& link, const test::RawParticipant& raw, const std::string& topic, const Message& message) {
  const auto publisher = link.publisher<Message>(topic);
  test::RawReader reader(raw, topic, Codec<Message>::descriptor());
  while (publisher.matched() == 0) std::this_thread::sleep_for(milliseconds(5));
  publisher.write(message);
  std::vector<test::Bytes> taken;
  for (int i = 0; i < 200 && taken.empty(); ++i) {
    std::this_thread::sleep_for(milliseconds(5));
    taken = reader.take();
  }
  if (taken.empty()) throw std::runtime_error(topic + " did not arrive");
  return taken.front();
}

int spoil(int domain, int count, unsigned seed) {
  Ros2Config config;
  config.domain = domain;
  Link link(link_config(config, "spoiler"));
  const test::RawParticipant raw(domain);
  TwistStamped command{{{1700000000, 0}, "base_link"}, {}};
  command.twist.linear.x = 0.2;
  test::Bytes good = bytes_of(link, raw, "/spoiler", command);
  good.erase(good.begin(), good.begin() + 4);
  test::RawWriter writer(raw, "/cmd_vel", Codec<TwistStamped>::descriptor().m_typename);
  while (writer.matched(good.size()) == 0) std::this_thread::sleep_for(milliseconds(5));
  std::mt19937 random(seed);
  for (int i = 0; i < count; ++i) {
    test::Bytes bytes = good;
    test::spoil(bytes, random);
    writer.write(bytes);
    if (i % 5 == 4) std::this_thread::sleep_for(std::chrono::microseconds(200));  // the robot keeps ten
  }
  std::this_thread::sleep_for(milliseconds(500));
  std::cout << "sent " << count << std::endl;
  return 0;
}

// ------------------------------------------------------------------------------------------------ fields as JSON

json fields(const ros2::Header& h) {
  return {{"stamp", {{"sec", h.stamp.sec}, {"nanosec", h.stamp.nanosec}}}, {"frame_id", h.frame_id}};
}
json fields(const Vector3& v) { return {{"x", v.x}, {"y", v.y}, {"z", v.z}}; }
json fields(const Twist& t) { return {{"linear", fields(t.linear)}, {"angular", fields(t.angular)}}; }
json fields(const Pose& p) {
  return {{"position", fields(p.position)},
          {"orientation",
           {{"x", p.orientation.x}, {"y", p.orientation.y}, {"z", p.orientation.z}, {"w", p.orientation.w}}}};
}
json fields(const Bool& b) { return {{"data", b.data}}; }
json fields(const String& s) { return {{"data", s.data}}; }
json fields(const TwistStamped& t) { return {{"header", fields(t.header)}, {"twist", fields(t.twist)}}; }
json fields(const PoseStamped& p) { return {{"header", fields(p.header)}, {"pose", fields(p.pose)}}; }
json fields(const OdometryMessage& o) {
  return {{"header", fields(o.header)},
          {"child_frame_id", o.child_frame_id},
          {"pose", {{"pose", fields(o.pose)}, {"covariance", o.pose_covariance}}},
          {"twist", {{"twist", fields(o.twist)}, {"covariance", o.twist_covariance}}}};
}
json fields(const PathMessage& p) {
  json poses = json::array();
  for (const PoseStamped& pose : p.poses) poses.push_back(fields(pose));
  return {{"header", fields(p.header)}, {"poses", poses}};
}
json fields(const DiagnosticArray& d) {
  json all = json::array();
  for (const DiagnosticStatus& status : d.status) {
    json values = json::array();
    for (const KeyValue& value : status.values) values.push_back({{"key", value.key}, {"value", value.value}});
    all.push_back({{"level", status.level},
                   {"name", status.name},
                   {"message", status.message},
                   {"hardware_id", status.hardware_id},
                   {"values", values}});
  }
  return {{"header", fields(d.header)}, {"status", all}};
}
json fields(const ImagePoint& p) { return {{"x", p.x}, {"y", p.y}}; }
json fields(const AprilTagDetectionArray& a) {
  json all = json::array();
  for (const AprilTagDetection& tag : a.detections) {
    json corners = json::array();
    for (const ImagePoint& corner : tag.corners) corners.push_back(fields(corner));
    all.push_back({{"family", tag.family},
                   {"id", tag.id},
                   {"hamming", tag.hamming},
                   {"goodness", tag.goodness},
                   {"decision_margin", tag.decision_margin},
                   {"centre", fields(tag.centre)},
                   {"corners", corners},
                   {"homography", tag.homography}});
  }
  return {{"header", fields(a.header)}, {"detections", all}};
}

// ------------------------------------------------------------------------------------------------------ examples

// Values that a decoder can only have right by having every offset right: no two alike, strings of awkward lengths.
struct Examples {
  double next = 0.0;
  double number() { return next += 1.0625; }
  ros2::Header header(const std::string& frame) { return {{1234567 + static_cast<int>(number()), 987654321U}, frame}; }
  Vector3 vector() { return {number(), -number(), number()}; }
  Twist twist() { return {vector(), vector()}; }
  Pose pose() { return {vector(), {number(), number(), -number(), number()}}; }
};

OdometryMessage odometry(Examples& some) {
  OdometryMessage message{some.header("odom"), "base_link", some.pose(), {}, some.twist(), {}};
  for (double& value : message.pose_covariance) value = some.number();
  for (double& value : message.twist_covariance) value = some.number();
  return message;
}

AprilTagDetection detection(Examples& some) {
  AprilTagDetection tag;
  tag.family = "tag36h11";
  tag.id = static_cast<int>(some.number());
  tag.hamming = 2;
  tag.goodness = 0.5F;
  tag.decision_margin = 77.25F;
  tag.centre = {some.number(), some.number()};
  for (ImagePoint& corner : tag.corners) corner = {some.number(), some.number()};
  for (double& value : tag.homography) value = some.number();
  return tag;
}

std::string hex(const test::Bytes& bytes) {
  std::string text;
  for (const unsigned char byte : bytes) {
    text += "0123456789abcdef"[byte >> 4];
    text += "0123456789abcdef"[byte & 15];
  }
  return text;
}

template <class Message>
void show(Link& link, const test::RawParticipant& raw, const std::string& name, const Message& message) {
  const test::Bytes bytes = bytes_of(link, raw, "/" + name, message);
  std::cout << json{{"type", type_name<Message>()}, {"cdr", hex(bytes)}, {"fields", fields(message)}}.dump()
            << std::endl;
}

int payloads(int domain) {
  Ros2Config config;
  config.domain = domain;
  Link link(link_config(config, "payloads"));
  const test::RawParticipant raw(domain);
  Examples some;
  show(link, raw, "bool", Bool{true});
  show(link, raw, "string", String{"seven c"});
  show(link, raw, "string0", String{""});
  show(link, raw, "twist", some.twist());
  show(link, raw, "twist_stamped", TwistStamped{some.header("base_link"), some.twist()});
  show(link, raw, "pose", PoseStamped{some.header("map"), some.pose()});
  show(link, raw, "odom", odometry(some));
  show(
      link, raw, "path",
      PathMessage{some.header("odom"),
                  {{some.header("a"), some.pose()}, {some.header("bc"), some.pose()}, {some.header(""), some.pose()}}});
  show(link, raw, "path0", PathMessage{some.header("odometry frame"), {}});
  show(link, raw, "diagnostics",
       DiagnosticArray{some.header(""),
                       {{DiagnosticStatus::warn, "tagdock: camera", "slow", "", {{"frames", "12"}, {"", "x"}}},
                        {DiagnosticStatus::stale, "n", "", "h", {}}}});
  show(link, raw, "detections", AprilTagDetectionArray{some.header("camera"), {detection(some), detection(some)}});
  return 0;
}

template <class Message>
std::optional<json> decoded(Link& link, const test::RawParticipant& raw, const test::Bytes& bytes, int number) {
  const std::string topic = "/decode" + std::to_string(number);
  const auto subscription = link.subscription<Message>(topic, Delivery::reliable, 10);
  test::RawWriter writer(raw, topic, Codec<Message>::descriptor().m_typename);
  const test::Bytes payload(bytes.begin() + 4, bytes.end());
  while (writer.matched(payload.size()) == 0) std::this_thread::sleep_for(milliseconds(5));
  writer.write(payload);
  for (int i = 0; i < 200; ++i) {
    std::this_thread::sleep_for(milliseconds(5));
    if (const auto taken = subscription.take(); !taken.empty()) return fields(taken.front());
  }
  return std::nullopt;
}

int decode(int domain) {
  Ros2Config config;
  config.domain = domain;
  Link link(link_config(config, "decode"));
  const test::RawParticipant raw(domain);
  int number = 0;
  std::string type;
  std::string text;
  while (std::cin >> type >> text) {
    test::Bytes bytes;
    for (std::size_t i = 0; i + 1 < text.size(); i += 2)
      bytes.push_back(static_cast<unsigned char>(std::stoi(text.substr(i, 2), nullptr, 16)));
    std::optional<json> result;
    ++number;
    if (type == type_name<Bool>()) result = decoded<Bool>(link, raw, bytes, number);
    if (type == type_name<String>()) result = decoded<String>(link, raw, bytes, number);
    if (type == type_name<Twist>()) result = decoded<Twist>(link, raw, bytes, number);
    if (type == type_name<TwistStamped>()) result = decoded<TwistStamped>(link, raw, bytes, number);
    if (type == type_name<PoseStamped>()) result = decoded<PoseStamped>(link, raw, bytes, number);
    if (type == type_name<OdometryMessage>()) result = decoded<OdometryMessage>(link, raw, bytes, number);
    if (type == type_name<PathMessage>()) result = decoded<PathMessage>(link, raw, bytes, number);
    if (type == type_name<DiagnosticArray>()) result = decoded<DiagnosticArray>(link, raw, bytes, number);
    if (type == type_name<AprilTagDetectionArray>()) result = decoded<AprilTagDetectionArray>(link, raw, bytes, number);
    std::cout << (result ? result->dump() : std::string("null")) << std::endl;
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  const std::vector<std::string> words(argv + 1, argv + argc);
  try {
    if (words.size() >= 3 && words[0] == "drive")
      return drive(std::stoi(words[1]), std::stod(words[2]), words.size() > 3 ? words[3] : "",
                   words.size() > 4 ? std::stod(words[4]) : 1.0);
    if (words.size() == 2 && words[0] == "echo") return echo(std::stoi(words[1]));
    if (words.size() == 4 && words[0] == "obstacle")
      return obstacle(std::stoi(words[1]), std::stod(words[2]), std::stod(words[3]));
    if (words.size() == 4 && words[0] == "spoil")
      return spoil(std::stoi(words[1]), std::stoi(words[2]), static_cast<unsigned>(std::stoul(words[3])));
    if (words.size() == 2 && words[0] == "payloads") return payloads(std::stoi(words[1]));
    if (words.size() == 2 && words[0] == "decode") return decode(std::stoi(words[1]));
  } catch (const std::exception& error) {
    std::cout << "ended: " << error.what() << std::endl;
    return 5;
  }
  std::cerr << "see the first lines of ros2_peer.cpp\n";
  return 2;
}
