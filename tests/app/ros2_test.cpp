// The robot over ROS 2 topics: a base that speaks them on another participant, and fails on demand.
#include "app/robots/ros2.h"

#include <atomic>
#include <cmath>
#include <cstdlib>
#include <deque>
#include <functional>
#include <limits>
#include <mutex>
#include <net/if.h>
#include <netinet/in.h>
#include <random>
#include <sys/socket.h>
#include <thread>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>

#include "app/config.h"
#include "app/failure.h"
#include "app/robots/docking_topics.h"
#include "app/robots/odometry_reader.h"
#include "app/robots/ros2/codec.h"
#include "tests/fakes/process.h"
#include "tests/fakes/ros2_raw.h"

using namespace tagdock;
using Catch::Matchers::Contains;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using std::chrono::seconds;
using std::chrono::steady_clock;

namespace {

// Every case has a domain of its own, so that what one leaves behind meets nobody.
int next_domain() {
  static int domain = 50;
  return domain++;
}

Ros2Config config_of(int domain) {
  Ros2Config config;
  config.domain = domain;
  config.wait_s = 20.0;  // a loaded machine under a sanitizer
  return config;
}

// A machine that stalls for 200 ms, as those that run tests do, must not end what is not about silence; how soon
// silence stops the robot is measured by ros2_cut.
OdometryLimits patient() {
  OdometryLimits limits;
  limits.max_silence = seconds(2);
  return limits;
}

ros2::OdometryMessage good_odometry(nanoseconds stamp, double x = 0.0, double speed = 0.0) {
  ros2::OdometryMessage message;
  message.header = {time_of(stamp), "odom"};
  message.child_frame_id = "base_link";
  message.pose.position.x = x;
  message.twist.linear.x = speed;
  return message;
}

nanoseconds wall() { return std::chrono::system_clock::now().time_since_epoch(); }

template <class Condition>
bool soon(const Condition& condition, seconds at_most = seconds(20)) {
  const auto deadline = steady_clock::now() + at_most;
  while (!condition()) {
    if (steady_clock::now() > deadline) return false;
    std::this_thread::sleep_for(milliseconds(5));
  }
  return true;
}

// A base that does what it is told at once, with odometry 50 times a second; `spoil` may change or withhold a message.
class FakeBase {
 public:
  using Spoil = std::function<bool(ros2::OdometryMessage&)>;

  explicit FakeBase(int domain)
      : link_(ros2::LinkConfig{domain, "lo", {}, "fake base"}),
        commands_(link_.subscription<ros2::Twist>("/cmd_vel", ros2::Delivery::best_effort, 100)),
        odometry_(link_.publisher<ros2::OdometryMessage>("/odom")),
        thread_([this] { run(); }) {}
  ~FakeBase() {
    ending_ = true;
    thread_.join();
  }

  void spoil(Spoil how) {
    const std::lock_guard lock(mutex_);
    spoil_ = std::move(how);
  }
  std::vector<double> speeds() const {
    const std::lock_guard lock(mutex_);
    return speeds_;
  }
  double speed() const {
    const std::lock_guard lock(mutex_);
    return speed_;
  }
  ros2::Link& link() { return link_; }

 private:
  void run() {
    double x = 0.0;
    for (auto next = steady_clock::now(); !ending_; next += milliseconds(20)) {
      std::this_thread::sleep_until(next);
      const std::lock_guard lock(mutex_);
      for (const ros2::Twist& twist : commands_.take()) {
        speed_ = twist.linear.x;
        speeds_.push_back(speed_);
      }
      x += 0.02 * speed_;
      ros2::OdometryMessage message = good_odometry(wall(), x, speed_);
      if (!spoil_ || spoil_(message)) odometry_.write(message);
    }
  }

  ros2::Link link_;
  ros2::Subscription<ros2::Twist> commands_;
  ros2::Publisher<ros2::OdometryMessage> odometry_;
  mutable std::mutex mutex_;
  Spoil spoil_;
  std::vector<double> speeds_;
  double speed_ = 0.0;
  std::atomic<bool> ending_{false};
  std::thread thread_;
};

// Drives on until `until` says enough; gives what read() threw, if it did.
std::string drive_until(Robot& robot, double speed, const std::function<bool()>& until) {
  for (int i = 0; i < 1000 && !until(); ++i) {
    try {
      (void)robot.read();
    } catch (const std::runtime_error& error) {
      return error.what();
    }
    robot.drive({speed, 0.0});
    std::this_thread::sleep_for(milliseconds(20));
  }
  return {};
}

}  // namespace

TEST_CASE("topic names follow ROS 2: namespace, absolute names, and refusals that tell the rule") {
  CHECK(ros2::full_name("", "odom") == "/odom");
  CHECK(ros2::full_name("robot1", "odom") == "/robot1/odom");
  CHECK(ros2::full_name("/robot1", "base/odom") == "/robot1/base/odom");
  CHECK(ros2::full_name("/robot1", "/odom") == "/odom");
  for (const char* bad : {"", "/", "a b", "1a", "a//b", "a/", "a__b", "a/2b", "\xc3\xa4"})
    CHECK_THROWS_AS(ros2::full_name("", bad), Failure);
  Ros2Config config;
  remap(config, "odom:=/base/odom");
  remap(config, "/cmd_vel:=mux/docking");
  config.name_space = "r";
  CHECK(topic(config, config.topics.odom) == "/base/odom");
  CHECK(topic(config, config.topics.cmd_vel) == "/r/mux/docking");
  CHECK_THROWS_WITH(remap(config, "scan:=/s"), Contains("scan") && Contains("cmd_vel"));
  CHECK_THROWS_AS(remap(config, "odom=/s"), Failure);
  CHECK_THROWS_AS(remap(config, "odom:=/s p"), Failure);
}

TEST_CASE("ROS_DOMAIN_ID is honoured, and refused when it is no domain") {
  ::setenv("ROS_DOMAIN_ID", "17", 1);
  CHECK(domain_of(Ros2Config{}) == 17);
  CHECK(domain_of(config_of(3)) == 3);
  for (const char* bad : {"x", "-1", "102", "7 ", "1e1"}) {
    ::setenv("ROS_DOMAIN_ID", bad, 1);
    CHECK_THROWS_WITH(domain_of(Ros2Config{}), Contains("ROS_DOMAIN_ID") && Contains("0 and 101"));
  }
  ::unsetenv("ROS_DOMAIN_ID");
  CHECK(domain_of(Ros2Config{}) == 0);
}

TEST_CASE("an interface that is not there is refused with those that are") {
  Ros2Config config = config_of(next_domain());
  config.interface = "wlan7";
  CHECK_THROWS_WITH(ros2::Link(link_config(config, "test")), Contains("wlan7") && Contains(" lo"));
  config.interface = "lo";
  config.peers = "127.0.0.1 <evil/>";
  CHECK_THROWS_WITH(ros2::Link(link_config(config, "test")), Contains("<evil/>"));
}

TEST_CASE("odometry is read in session time, unwrapped, and repeated readings are told apart") {
  OdometryReader reader;
  const nanoseconds epoch = seconds(1700000000);
  const double yaws[] = {3.0, 3.1, -3.1, -3.0};
  double last = 0.0;
  for (int i = 0; i < 4; ++i) {
    ros2::OdometryMessage message = good_odometry(epoch + i * milliseconds(20), 0.1 * i, 0.2);
    message.pose.orientation = {0.0, 0.0, std::sin(0.5 * yaws[i]), std::cos(0.5 * yaws[i])};
    const nanoseconds arrival = seconds(5) + i * milliseconds(20) + (i == 2 ? milliseconds(15) : milliseconds(2));
    const auto read = reader.read(message, arrival);
    REQUIRE(std::holds_alternative<Odometry>(read));
    const Odometry odometry = std::get<Odometry>(read);
    // The late third message keeps the time at which it was stamped.
    CHECK(odometry.time == seconds(5) + i * milliseconds(20) + milliseconds(2));
    CHECK(odometry.velocity.linear == 0.2);
    if (i > 0) CHECK(odometry.T_odom_base.yaw > last);
    last = odometry.T_odom_base.yaw;
    CHECK(std::holds_alternative<Repeated>(reader.read(message, arrival + milliseconds(1))));
  }
  CHECK(last == Approx(2.0 * 3.14159265358979 - 3.0));
  CHECK(*reader.stamps().stamp_of(seconds(5) + milliseconds(2)) == epoch);
}

TEST_CASE("odometry that claims what cannot be is refused with a sentence") {
  const nanoseconds epoch = seconds(1700000000);
  const auto refused = [&](const std::function<void(ros2::OdometryMessage&)>& spoil) {
    OdometryReader reader;
    ros2::OdometryMessage message = good_odometry(epoch);
    spoil(message);
    const auto read = reader.read(message, seconds(1));
    const Refused* why = std::get_if<Refused>(&read);
    return why == nullptr ? std::string() : why->sentence;
  };
  CHECK(refused([](auto&) {}).empty());
  CHECK_THAT(refused([](auto& m) { m.header.stamp = {}; }), Contains("stamp"));
  CHECK_THAT(refused([](auto& m) { m.header.stamp.nanosec = 1000000000U; }), Contains("stamp"));
  CHECK_THAT(refused([](auto& m) { m.pose.orientation.w = 0.5; }), Contains("quaternion"));
  CHECK_THAT(refused([](auto& m) {
               m.pose.orientation = {};
               m.pose.orientation.w = 0.0;
             }),
             Contains("quaternion"));
  CHECK_THAT(refused([](auto& m) { m.pose.orientation = {0.5, 0.0, 0.0, std::sqrt(0.75)}; }), Contains("leans"));
  CHECK_THAT(refused([](auto& m) { m.pose.position.x = 1e9; }), Contains("too far"));
  CHECK_THAT(refused([](auto& m) { m.twist.linear.y = 0.2; }), Contains("sideways"));
  CHECK_THAT(refused([](auto& m) { m.child_frame_id = std::string(300, 'x'); }), Contains("256"));
  // Not finite: passes, so that the docking names it as for every other robot.
  CHECK(refused([](auto& m) { m.pose.position.x = std::nan(""); }).empty());
}

TEST_CASE("frozen odometry and a clock that jumps ahead are found; standing still is not frozen") {
  const nanoseconds epoch = seconds(1700000000);
  const auto first_refusal = [&](double speed, nanoseconds extra) {
    OdometryReader reader;
    for (int i = 0; i < 100; ++i) {
      const nanoseconds time = i * milliseconds(20);
      const auto read =
          reader.read(good_odometry(epoch + time + (i == 50 ? extra : nanoseconds(0)), 1.0, speed), seconds(1) + time);
      if (const Refused* why = std::get_if<Refused>(&read)) return std::pair(i, why->sentence);
    }
    return std::pair(-1, std::string());
  };
  CHECK(first_refusal(0.0, nanoseconds(0)).first == -1);
  const auto frozen = first_refusal(0.2, nanoseconds(0));
  CHECK(frozen.first == 7);  // 20 ms each: more than 120 ms of the same
  CHECK_THAT(frozen.second, Contains("frozen"));
  const auto ahead = first_refusal(0.0, std::chrono::hours(1));
  CHECK(ahead.first == 50);
  CHECK_THAT(ahead.second, Contains("jumped ahead"));
}

TEST_CASE("who drives a robot that is not there is told what is missing", "[link]") {
  Ros2Config config = config_of(next_domain());
  config.wait_s = 0.5;
  const auto start = steady_clock::now();
  try {
    (void)open_ros2(config, patient(), start);
    FAIL("there is no robot");
  } catch (const Failure& failure) {
    CHECK(failure.code() == ExitCode::robot_link);
    CHECK_THAT(failure.what(), Contains("/odom") && Contains("/cmd_vel") && Contains("domain"));
  }
  ros2::Link other(ros2::LinkConfig{config.domain, "lo", {}, "half a robot"});
  const auto odometry = other.publisher<ros2::OdometryMessage>("/odom");
  config.wait_s = 2.0;
  CHECK_THROWS_WITH((void)open_ros2(config, patient(), start), Contains("nobody subscribes /cmd_vel"));
  const auto wrong = other.subscription<ros2::Bool>("/cmd_vel", ros2::Delivery::reliable, 1);
  CHECK_THROWS_WITH((void)open_ros2(config, patient(), start),
                    Contains("std_msgs/msg/Bool") && Contains("cmd_vel_type"));
}

TEST_CASE("nothing is sent before the first command, then commands, and zero at the end", "[link]") {
  const int domain = next_domain();
  FakeBase base(domain);
  {
    Ros2Robot robot = open_ros2(config_of(domain), patient(), steady_clock::now());
    CHECK_THAT(robot.health().name, Contains("(Twist)"));
    std::this_thread::sleep_for(milliseconds(200));
    (void)robot.robot->read();
    CHECK(base.speeds().empty());
    CHECK(drive_until(*robot.robot, 0.1, [&] { return base.speeds().size() > 20; }).empty());
    CHECK(base.speed() == 0.1);
    CHECK(soon([&] {
      const auto readings = robot.robot->read();
      return !readings.empty() && readings.back().T_odom_base.x > 0.0;
    }));
  }
  CHECK(soon([&] { return base.speed() == 0.0; }));
  CHECK(base.speeds().back() == 0.0);
}

TEST_CASE("TwistStamped is sent to who subscribes that", "[link]") {
  const int domain = next_domain();
  ros2::Link other(ros2::LinkConfig{domain, "lo", {}, "stamped base"});
  const auto odometry = other.publisher<ros2::OdometryMessage>("/odom");
  const auto commands = other.subscription<ros2::TwistStamped>("/cmd_vel", ros2::Delivery::reliable, 10);
  Ros2Robot robot = open_ros2(config_of(domain), patient(), steady_clock::now());
  robot.robot->drive({0.1, -0.2});
  std::vector<ros2::TwistStamped> taken;
  CHECK(soon([&] { return !(taken = commands.take()).empty(); }));
  CHECK(taken.front().twist.linear.x == 0.1);
  CHECK(taken.front().twist.angular.z == -0.2);
  CHECK(taken.front().header.frame_id == "base_link");
  CHECK(wall() - nanoseconds_of(taken.front().header.stamp) < seconds(60));
  Ros2Config plain = config_of(domain);
  plain.cmd_vel_type = "Twist";
  plain.wait_s = 0.5;
  CHECK_THROWS_AS((void)open_ros2(plain, patient(), steady_clock::now()), Failure);
}

TEST_CASE("whatever is wrong with odometry stops the robot for good, without waiting for the loop", "[link]") {
  struct Fault {
    const char* name;
    FakeBase::Spoil spoil;
    const char* sentence;
  };
  const nanoseconds hour = std::chrono::hours(1);
  const Fault fault = GENERATE_COPY(values<Fault>({
      {"silent", [](auto&) { return false; }, "silent"},
      {"nan", [](auto& m) { return m.pose.position.x = std::nan(""), true; }, "not a finite number"},
      {"infinite", [](auto& m) { return m.twist.angular.z = INFINITY, true; }, "not a finite number"},
      {"jump", [](auto& m) { return m.pose.position.y += 0.5, true; }, "jumped"},
      {"reset", [](auto& m) { return m.pose.position.x = -1.0, true; }, "jumped"},
      {"backwards", [](auto& m) { return m.header.stamp.sec -= 1, true; }, "backwards"},
      {"frozen",
       [x = -1.0](auto& m) mutable { return m.pose.position.x = (x < 0.0 ? x = m.pose.position.x : x), true; },
       "frozen"},
      {"ahead", [hour](auto& m) { return m.header.stamp = time_of(wall() + hour), true; }, "ahead"},
      {"quaternion", [](auto& m) { return m.pose.orientation.w = 2.0, true; }, "quaternion"},
  }));
  CAPTURE(fault.name);
  const int domain = next_domain();
  FakeBase base(domain);
  Ros2Robot robot = open_ros2(config_of(domain), patient(), steady_clock::now());
  REQUIRE(drive_until(*robot.robot, 0.1, [&] { return base.speeds().size() > 10; }).empty());
  base.spoil(fault.spoil);
  // The loop goes on driving, blind to everything: the link alone has to stop the robot.
  CHECK(soon([&] {
    robot.robot->drive({0.1, 0.0});
    std::this_thread::sleep_for(milliseconds(20));
    return !robot.health().fault.empty();
  }));
  CHECK_THAT(robot.health().fault, Contains(fault.sentence));
  CHECK(soon([&] { return base.speed() == 0.0; }));
  base.spoil({});
  const std::size_t before = base.speeds().size();
  for (int i = 0; i < 20; ++i) {
    robot.robot->drive({0.1, 0.0});
    std::this_thread::sleep_for(milliseconds(5));
  }
  CHECK(soon([&] { return base.speeds().size() > before + 5; }));
  const auto speeds = base.speeds();
  CHECK(std::all_of(speeds.begin() + static_cast<std::ptrdiff_t>(before), speeds.end(),
                    [](double speed) { return speed == 0.0; }));
  CHECK_THROWS_AS(
      [&] {
        for (int i = 0; i < 3; ++i) (void)robot.robot->read();
      }(),
      std::runtime_error);
}

TEST_CASE("a loop that comes to a halt stops the robot, and may go on", "[link]") {
  const int domain = next_domain();
  FakeBase base(domain);
  Ros2Robot robot = open_ros2(config_of(domain), patient(), steady_clock::now());
  REQUIRE(drive_until(*robot.robot, 0.1, [&] { return base.speed() == 0.1; }).empty());
  CHECK(soon([&] { return base.speed() == 0.0; }));
  CHECK(robot.health().starved >= 1);
  CHECK(robot.health().fault.empty());
  CHECK(drive_until(*robot.robot, 0.1, [&] { return base.speed() == 0.1; }).empty());
}

TEST_CASE("a second process that publishes commands or odometry is reported and stops the robot", "[link]") {
  const int domain = next_domain();
  FakeBase base(domain);
  SECTION("commands, before the start") {
    ros2::Link other(ros2::LinkConfig{domain, "lo", {}, "teleop"});
    const auto rival = other.publisher<ros2::Twist>("/cmd_vel");
    Ros2Config config = config_of(domain);
    config.wait_s = 1.0;
    CHECK_THROWS_WITH((void)open_ros2(config, patient(), steady_clock::now()),
                      Contains("/cmd_vel already") && Contains("ros2_test") && Contains("geometry_msgs/msg/Twist"));
  }
  SECTION("commands, also of another type, while driving") {
    Ros2Robot robot = open_ros2(config_of(domain), patient(), steady_clock::now());
    REQUIRE(drive_until(*robot.robot, 0.1, [&] { return base.speed() == 0.1; }).empty());
    ros2::Link other(ros2::LinkConfig{domain, "lo", {}, "teleop"});
    const auto rival = other.publisher<ros2::TwistStamped>("/cmd_vel");
    const std::string fault = drive_until(*robot.robot, 0.1, [] { return false; });
    CHECK_THAT(fault, Contains("/cmd_vel, too") && Contains("geometry_msgs/msg/TwistStamped"));
    CHECK(soon([&] { return base.speed() == 0.0; }));
  }
  SECTION("odometry") {
    Ros2Robot robot = open_ros2(config_of(domain), patient(), steady_clock::now());
    REQUIRE(drive_until(*robot.robot, 0.1, [&] { return base.speed() == 0.1; }).empty());
    ros2::Link other(ros2::LinkConfig{domain, "lo", {}, "second odometer"});
    const auto rival = other.publisher<ros2::OdometryMessage>("/odom");
    CHECK_THAT(drive_until(*robot.robot, 0.1, [] { return false; }), Contains("2 processes publish /odom"));
    CHECK(soon([&] { return base.speed() == 0.0; }));
  }
}

TEST_CASE("obstacles hold the robot or halve its speed; an input that went away holds", "[link]") {
  const int domain = next_domain();
  FakeBase base(domain);
  Ros2Robot robot = open_ros2(config_of(domain), patient(), steady_clock::now());
  auto other = std::make_unique<ros2::Link>(ros2::LinkConfig{domain, "lo", {}, "scanner"});
  auto stop = std::make_unique<ros2::Publisher<ros2::Bool>>(other->publisher<ros2::Bool>("/obstacle_stop"));
  const auto slow = base.link().publisher<ros2::Bool>("/obstacle_slow");
  REQUIRE(soon([&] { return stop->matched() > 0 && slow.matched() > 0; }));
  const auto drives = [&](double speed) {
    return drive_until(*robot.robot, 0.1, [&] { return base.speed() == speed; }).empty() && base.speed() == speed;
  };
  REQUIRE(drives(0.1));
  stop->write({true});
  CHECK(drives(0.0));
  CHECK(robot.robot->wants_hold());
  stop->write({false});
  CHECK(drives(0.1));
  CHECK(!robot.robot->wants_hold());
  slow.write({true});
  CHECK(drives(0.05));
  slow.write({false});
  CHECK(drives(0.1));
  stop.reset();
  other.reset();
  CHECK(drives(0.0));
  CHECK(robot.robot->wants_hold());
  CHECK(robot.health().fault.empty());
}

TEST_CASE("a program that crashes sends zero first", "[link]") {
  const std::string end = GENERATE(as<std::string>(), "abort", "segfault", "throw");
  CAPTURE(end);
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
  if (end == "segfault") return;  // the sanitizer ends the program before its handlers run
#endif
  const int domain = next_domain();
  FakeBase base(domain);
  Process peer({ROS2_PEER, "drive", std::to_string(domain), "0.1", end, "1.0"});
  REQUIRE(peer.line() == "driving");
  CHECK(soon([&] { return base.speed() == 0.1; }));
  // The base has no time-out of its own: only a command can have set it to zero.
  CHECK(soon([&] { return base.speed() == 0.0; }));
}

TEST_CASE("detections keep AprilTag's order of corners and their homography meets them") {
  BoardSighting sighting;
  RefinedTag tag;
  tag.id = 5;
  tag.corners_px = {Eigen::Vector2d{100, 50}, Eigen::Vector2d{205, 60}, Eigen::Vector2d{200, 160},
                    Eigen::Vector2d{98, 148}};
  sighting.tags = {tag};
  const auto array = detections(sighting, "tag36h11", {1, 2}, "camera");
  REQUIRE(array.detections.size() == 1);
  const ros2::AprilTagDetection& one = array.detections.front();
  CHECK(one.corners[0] == ros2::ImagePoint{98, 148});
  CHECK(one.corners[2] == ros2::ImagePoint{205, 60});
  const double square[4][2] = {{-1, 1}, {1, 1}, {1, -1}, {-1, -1}};
  for (int i = 0; i < 4; ++i) {
    const auto& h = one.homography;
    const double w = h[6] * square[i][0] + h[7] * square[i][1] + h[8];
    CHECK((h[0] * square[i][0] + h[1] * square[i][1] + h[2]) / w == Approx(one.corners[i].x));
    CHECK((h[3] * square[i][0] + h[4] * square[i][1] + h[5]) / w == Approx(one.corners[i].y));
  }
}

TEST_CASE("the dock pose and the path are told in the frames of REP-105") {
  PlanarSighting seen;
  seen.T_station_base = {-3.0, 0.2, 0.1};
  const Pose2 goal{-1.35, 0.0, 0.0};
  const ros2::PoseStamped pose = detected_dock_pose(seen, goal, {7, 8}, "base_link");
  const double yaw = 2.0 * std::atan2(pose.pose.orientation.z, pose.pose.orientation.w);
  const Pose2 there = seen.T_station_base * Pose2{pose.pose.position.x, pose.pose.position.y, yaw};
  CHECK(there.x == Approx(goal.x));
  CHECK(there.y == Approx(goal.y).margin(1e-12));
  CHECK(there.yaw == Approx(goal.yaw).margin(1e-12));
  CHECK(pose.header.frame_id == "base_link");
  const Path path{{1.0, 2.0, 0.0}, {{1.0, 0.0, 0.0}}};
  const ros2::PathMessage message = path_message(path, {10.0, 0.0, 0.0}, {7, 8}, "odom");
  CHECK(message.poses.size() == 21);
  CHECK(message.poses.front().pose.position == ros2::Vector3{11.0, 2.0, 0.0});
  CHECK(message.poses.back().pose.position.x == Approx(12.0));
}

TEST_CASE("status and diagnostics say what the docking, the camera and the link are at", "[link]") {
  const int domain = next_domain();
  FakeBase base(domain);
  const auto status = base.link().subscription<ros2::String>("/docking_status", ros2::Delivery::reliable, 100);
  const auto diagnostics =
      base.link().subscription<ros2::DiagnosticArray>("/diagnostics", ros2::Delivery::reliable, 100);
  const Ros2Robot robot = open_ros2(config_of(domain), patient(), steady_clock::now());
  const Config config = parse_config(to_yaml(Config{}), "(the default)");
  DockingTopics topics(robot, config_of(domain), "tag36h11");
  DockingLoop loop(config);
  CameraHealth camera;
  camera.state = "streaming";
  camera.received = 123;
  camera.lost = 4;
  DockingLoop::Inputs inputs;
  std::vector<nlohmann::json> states;
  std::vector<ros2::DiagnosticArray> arrays;
  const auto cycle = [&] {
    inputs.now += milliseconds(20);
    inputs.odometry = {{inputs.now, {}, {}}};
    topics.cycle(inputs, loop.cycle(inputs), loop.docker(), camera);
    std::this_thread::sleep_for(milliseconds(2));
    for (const ros2::String& one : status.take()) states.push_back(nlohmann::json::parse(one.data));
    for (ros2::DiagnosticArray& one : diagnostics.take()) arrays.push_back(std::move(one));
  };
  inputs.now = seconds(2);
  for (int i = 0; i < 3000 && (states.empty() || arrays.empty()); ++i) cycle();
  REQUIRE_FALSE(states.empty());
  REQUIRE_FALSE(arrays.empty());
  const nlohmann::json first = states.front();
  CHECK(first["schema"] == "tagdock-status/1");
  CHECK(first["phase"] == "acquiring");
  CHECK(first["over"] == false);
  CHECK(first["attempts"] == 1);
  CHECK(first["reason"].is_null());
  CHECK(first["T_station_base"].is_null());
  CHECK(first["command"]["linear"].is_number());
  const auto named = [](const ros2::DiagnosticArray& array, const std::string& name) {
    const auto found = std::find_if(array.status.begin(), array.status.end(),
                                    [&](const ros2::DiagnosticStatus& one) { return one.name == name; });
    REQUIRE(found != array.status.end());
    return *found;
  };
  const auto value = [](const ros2::DiagnosticStatus& one, const std::string& key) {
    for (const ros2::KeyValue& pair : one.values)
      if (pair.key == key) return pair.value;
    return std::string("(no such key)");
  };
  const ros2::DiagnosticStatus eye = named(arrays.front(), "tagdock: camera");
  CHECK(eye.level == ros2::DiagnosticStatus::ok);
  CHECK(eye.message == "streaming");
  CHECK(value(eye, "frames") == "123");
  CHECK(value(eye, "lost") == "4");
  CHECK(named(arrays.front(), "tagdock: docking").message == "acquiring");
  CHECK(value(named(arrays.front(), "tagdock: robot link"), "obstacle_stop") == "false");

  // The camera goes, then the robot: each is told as an error, in its own words.
  camera.state = "lost";
  camera.reason = "the camera sends no frames and does not answer";
  inputs.camera = CameraState::lost;
  inputs.camera_sentence = camera.reason;
  inputs.robot_linked = false;
  inputs.robot_sentence = "the robot has been silent";
  for (int i = 0; i < 3000 && !(states.back()["over"] == true && arrays.back().status.front().level == 2); ++i) cycle();
  CHECK(states.back()["phase"] == "stopped");
  CHECK_THAT(states.back()["reason"]["sentence"].get<std::string>(), Contains("the robot has been silent"));
  CHECK_FALSE(states.back()["reason"]["cause"].get<std::string>().empty());
  CHECK(states.back()["command"]["linear"] == 0.0);
  const ros2::DiagnosticStatus docking = named(arrays.back(), "tagdock: docking");
  CHECK(docking.level == ros2::DiagnosticStatus::error);
  CHECK(docking.message == states.back()["reason"]["sentence"]);
  CHECK(named(arrays.back(), "tagdock: camera").level == ros2::DiagnosticStatus::error);
  CHECK(named(arrays.back(), "tagdock: camera").message == camera.reason);
}

TEST_CASE("no socket of the link takes packets from another interface", "[link]") {
  const ros2::Link link(ros2::LinkConfig{next_domain(), "lo", {}, "alone"});
  int open_to_all = 0;
  for (int handle = 3; handle < 256; ++handle) {
    int type = 0;
    socklen_t size = sizeof type;
    if (::getsockopt(handle, SOL_SOCKET, SO_TYPE, &type, &size) != 0 || type != SOCK_DGRAM) continue;
    sockaddr_in here{};
    size = sizeof here;
    if (::getsockname(handle, reinterpret_cast<sockaddr*>(&here), &size) != 0 || here.sin_family != AF_INET) continue;
    if (here.sin_port == 0 || ntohl(here.sin_addr.s_addr) >> 24 == 127) continue;
    ++open_to_all;
    char device[IFNAMSIZ] = {};
    size = sizeof device;
    CHECK(::getsockopt(handle, SOL_SOCKET, SO_BINDTODEVICE, device, &size) == 0);
    CHECK(std::string(device) == "lo");
  }
  // If Cyclone comes to bind them itself, this test and what it tests are to be taken out.
  CHECK(open_to_all >= 2);
}

// ----------------------------------------------------------------------------------------------- mutated payloads

namespace {

constexpr unsigned seed = 20260731;

test::Bytes captured(ros2::Link& link, const test::RawParticipant& raw, const ros2::OdometryMessage& message) {
  const auto publisher = link.publisher<ros2::OdometryMessage>("/captured");
  test::RawReader reader(raw, "/captured", ros2::Codec<ros2::OdometryMessage>::descriptor());
  REQUIRE(soon([&] { return publisher.matched() > 0; }));
  publisher.write(message);
  std::vector<test::Bytes> taken;
  REQUIRE(soon([&] { return !(taken = reader.take()).empty(); }));
  return {taken.front().begin() + 4, taken.front().end()};
}

bool can_follow(const Odometry& reading) {
  const Odometry still{reading.time - milliseconds(20), {}, {}};
  return !odometry_fault(still, reading, OdometryLimits{});
}

}  // namespace

TEST_CASE("of a hundred thousand spoiled odometry payloads none crashes, and none that is used says what cannot be") {
  const int domain = next_domain();
  ros2::Link link(ros2::LinkConfig{domain, "lo", {}, "reader"});
  const test::RawParticipant raw(domain);
  const test::Bytes good = captured(link, raw, good_odometry(seconds(1700000000), 0.001, 0.1));
  const auto subscription = link.subscription<ros2::OdometryMessage>("/spoiled", ros2::Delivery::reliable, 200);
  test::RawWriter writer(raw, "/spoiled", ros2::Codec<ros2::OdometryMessage>::descriptor().m_typename);
  REQUIRE(soon([&] { return writer.matched(good.size()) > 0; }));
  std::mt19937 random(seed);
  constexpr int payloads = 100000;
  int arrived = 0;
  int refused = 0;
  int used = 0;
  for (int i = 0; i < payloads; ++i) {
    test::Bytes bytes = good;
    test::spoil(bytes, random);
    writer.write(bytes);
    if (i % 50 != 49) continue;
    for (const ros2::OdometryMessage& message : subscription.take()) {
      ++arrived;
      OdometryReader reader;
      const auto read = reader.read(message, seconds(10));
      const Odometry* odometry = std::get_if<Odometry>(&read);
      if (odometry == nullptr || !can_follow(*odometry)) {
        ++refused;
        continue;
      }
      ++used;
      // What is used lies where a robot can be 20 ms later, with finite numbers.
      const OdometryLimits limits;
      const bool possible = is_finite(odometry->T_odom_base) && is_finite(odometry->velocity) &&
                            std::hypot(odometry->T_odom_base.x, odometry->T_odom_base.y) <
                                1.5 * limits.max_speed * 0.02 + limits.jump_distance + 1e-9 &&
                            odometry->time <= seconds(10);
      if (!possible) FAIL("payload " << i << " of seed " << seed);
    }
  }
  CHECK(arrived > payloads / 3);
  CHECK(refused > payloads / 100);
  CHECK(used > payloads / 100);
  WARN(payloads << " payloads: " << payloads - arrived << " dropped as no such message, " << refused
                << " refused for what they say, " << used
                << " usable (their changes were small or in fields not used)");
}

TEST_CASE("a robot that stands is not moved by ten thousand spoiled payloads on all its topics", "[link]") {
  const int domain = next_domain();
  FakeBase base(domain);
  Ros2Robot robot = open_ros2(config_of(domain), patient(), steady_clock::now());
  const test::RawParticipant raw(domain);
  const test::Bytes good = captured(base.link(), raw, good_odometry(wall(), 0.0, 0.0));
  test::RawWriter odometry(raw, "/odom", ros2::Codec<ros2::OdometryMessage>::descriptor().m_typename);
  test::RawWriter stop(raw, "/obstacle_stop", ros2::Codec<ros2::Bool>::descriptor().m_typename);
  test::RawWriter slow(raw, "/obstacle_slow", ros2::Codec<ros2::Bool>::descriptor().m_typename);
  REQUIRE(soon([&] { return odometry.matched(good.size()) > 0 && stop.matched(1) > 0 && slow.matched(1) > 0; }));
  std::mt19937 random(seed + 1);
  robot.robot->drive({0.0, 0.0});
  for (int i = 0; i < 10000; ++i) {
    test::Bytes bytes = good;
    test::spoil(bytes, random);
    odometry.write(bytes);
    const test::Bytes bit{static_cast<unsigned char>(random())};
    (random() % 2 == 0 ? stop : slow).write(bit);
    if (i % 100 == 0) robot.robot->drive({0.0, 0.0});
  }
  CHECK(soon([&] { return !robot.health().fault.empty(); }));  // at the latest, two processes publish odometry
  robot.robot->drive({0.1, 0.0});
  CHECK(soon([&] { return base.speeds().size() > 100; }));
  const auto speeds = base.speeds();
  CHECK(std::all_of(speeds.begin(), speeds.end(), [](double speed) { return speed == 0.0; }));
}
