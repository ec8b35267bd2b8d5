#include "app/robots/ros2.h"

#include <algorithm>
#include <atomic>
#include <cmath>
#include <cstdio>
#include <deque>
#include <map>
#include <mutex>
#include <optional>
#include <sstream>
#include <stdexcept>
#include <thread>
#include <variant>

#include "app/crash_stop.h"
#include "app/failure.h"
#include "app/robots/odometry_reader.h"

namespace tagdock {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using std::chrono::steady_clock;

constexpr nanoseconds watch_period = milliseconds(10);
constexpr nanoseconds look_period = milliseconds(100);      // for others on our topics
constexpr nanoseconds command_timeout = milliseconds(200);  // of our own loop
constexpr nanoseconds repeat_period = milliseconds(50);     // of zeros after a fault
constexpr double slow_share = 0.5;
constexpr double slow_recovery = 0.5;  // 1/s, back to full speed
constexpr int depth = 50;              // odometry messages kept between two looks: a second's worth

nanoseconds wall_clock() { return std::chrono::system_clock::now().time_since_epoch(); }

std::string joined(const std::vector<ros2::Endpoint>& endpoints) {
  std::string text;
  for (const ros2::Endpoint& endpoint : endpoints)
    text += (text.empty() ? "" : " and ") + endpoint.who + " (" + endpoint.type + ")";
  return text;
}

bool has_type(const std::vector<ros2::Endpoint>& endpoints, const std::string& type) {
  return std::any_of(endpoints.begin(), endpoints.end(), [&](const auto& one) { return one.type == type; });
}

class CommandPublisher {
 public:
  CommandPublisher(ros2::Link& link, const std::string& name, bool stamped, std::string frame)
      : frame_(std::move(frame)) {
    if (stamped)
      publisher_ = link.publisher<ros2::TwistStamped>(name);
    else
      publisher_ = link.publisher<ros2::Twist>(name);
  }
  void write(const Twist2& command) const noexcept {
    ros2::Twist twist;
    twist.linear.x = command.linear;
    twist.angular.z = command.angular;
    if (const auto* plain = std::get_if<ros2::Publisher<ros2::Twist>>(&publisher_)) plain->write(twist);
    // diff_drive_controller refuses stamps that are older than its time-out: our wall clock must agree with the
    // robot's.
    if (const auto* stamped = std::get_if<ros2::Publisher<ros2::TwistStamped>>(&publisher_))
      stamped->write({{time_of(wall_clock()), frame_}, twist});
  }
  void flush(nanoseconds at_most) const noexcept {
    std::visit([&](const auto& one) { one.flush(at_most); }, publisher_);
  }
  [[nodiscard]] int matched() const noexcept {
    return std::visit([](const auto& one) { return one.matched(); }, publisher_);
  }

 private:
  std::string frame_;
  std::variant<ros2::Publisher<ros2::Twist>, ros2::Publisher<ros2::TwistStamped>> publisher_;
};

/// An obstacle input. Inputs are events: what was said last holds. One that was there and went away counts as true.
class ObstacleInput {
 public:
  ObstacleInput(ros2::Link& link, const std::string& name)
      : reliable_(link.subscription<ros2::Bool>(name, ros2::Delivery::reliable, 10)),
        best_effort_(link.subscription<ros2::Bool>(name, ros2::Delivery::best_effort, 10)) {}

  bool read() {
    for (const ros2::Bool& one : best_effort_.take()) state_ = one.data;
    for (const ros2::Bool& one : reliable_.take()) state_ = one.data;
    const bool there = best_effort_.matched() > 0;
    was_there_ = was_there_ || there;
    return state_ || (was_there_ && !there);
  }

 private:
  ros2::Subscription<ros2::Bool> reliable_;
  ros2::Subscription<ros2::Bool> best_effort_;
  bool state_ = false;
  bool was_there_ = false;
};

class TopicRobot final : public Robot {
 public:
  TopicRobot(std::shared_ptr<ros2::Link> link, const Ros2Config& config, const OdometryLimits& limits,
             steady_clock::time_point start, bool stamped)
      : link_(std::move(link)),
        limits_(limits),
        start_(start),
        cmd_vel_(topic(config, config.topics.cmd_vel)),
        odom_(topic(config, config.topics.odom)),
        commands_(*link_, cmd_vel_, stamped, config.base_frame),
        odometry_(link_->subscription<ros2::OdometryMessage>(odom_, ros2::Delivery::best_effort, depth)),
        stop_input_(*link_, topic(config, config.topics.obstacle_stop)),
        slow_input_(*link_, topic(config, config.topics.obstacle_slow)),
        crash_stop_([this] {
          if (!armed_) return;
          commands_.write({});
          commands_.flush(milliseconds(50));
        }),
        thread_([this] { listen(); }) {
    health_.name = "ROS 2 domain " + std::to_string(domain_of(config)) + " on " + config.interface + ", " + cmd_vel_ +
                   (stamped ? " (TwistStamped)" : " (Twist)");
  }
  ~TopicRobot() override {
    if (armed_) TopicRobot::stop();
    ending_ = true;
    thread_.join();
  }

  std::vector<Odometry> read() override {
    const std::lock_guard lock(mutex_);
    if (!reading_ && readings_.size() > 1) readings_.erase(readings_.begin(), readings_.end() - 1);
    reading_ = true;
    if (readings_.empty() && !fault_.empty()) throw std::runtime_error(fault_);
    std::vector<Odometry> all(readings_.begin(), readings_.end());
    readings_.clear();
    return all;
  }

  void drive(const Twist2& command) override {
    const std::lock_guard lock(mutex_);
    const nanoseconds time = now();
    armed_ = true;
    const double since = driven_ ? std::chrono::duration<double>(time - *driven_).count() : 0.0;
    share_ = health_.obstacle_slow ? slow_share : std::min(1.0, share_ + slow_recovery * std::max(0.0, since));
    driven_ = time;
    ++health_.commands;
    const bool hold = !fault_.empty() || health_.obstacle_stop || !is_finite(command);
    last_ = hold ? Twist2{} : Twist2{share_ * command.linear, share_ * command.angular};
    commands_.write(last_);
  }

  void stop() noexcept override {
    try {
      const std::lock_guard lock(mutex_);
      last_ = {};
      // Best-effort readers may lose one.
      for (int i = 0; i < 3; ++i) commands_.write({});
    } catch (...) {  // the robot's own time-out stops it
    }
    commands_.flush(milliseconds(100));
  }

  [[nodiscard]] bool wants_hold() const override {
    const std::lock_guard lock(mutex_);
    return health_.obstacle_stop;
  }

  [[nodiscard]] int subscribers() const { return commands_.matched(); }
  [[nodiscard]] int odometers() const { return odometry_.matched(); }

  [[nodiscard]] RobotLinkHealth health() const {
    const std::lock_guard lock(mutex_);
    RobotLinkHealth health = health_;
    health.fault = fault_;
    return health;
  }

  [[nodiscard]] ros2::Time stamp(nanoseconds session_time) const {
    const std::lock_guard lock(mutex_);
    const auto stamp = reader_.stamps().stamp_of(session_time);
    return time_of(stamp ? *stamp : wall_clock() - (now() - session_time));
  }

 private:
  [[nodiscard]] nanoseconds now() const { return steady_clock::now() - start_; }

  // To be called with the lock held.
  void latch(const std::string& sentence) {
    if (!fault_.empty()) return;
    fault_ = sentence;
    last_ = {};
    repeated_ = now();
    if (armed_) commands_.write({});
  }

  void listen() {
    nanoseconds looked{0};
    while (!ending_) {
      link_->wait(watch_period);
      const nanoseconds arrival = now();
      const std::vector<ros2::OdometryMessage> messages = odometry_.take();
      const bool obstacle = stop_input_.read();
      const bool slow = slow_input_.read();
      std::string rivals;
      if (arrival - looked > look_period) {
        looked = arrival;
        rivals = rival_sentence();
      }
      const std::lock_guard lock(mutex_);
      for (const ros2::OdometryMessage& message : messages) take(message, arrival);
      if (obstacle && !health_.obstacle_stop && armed_) {
        last_ = {};
        commands_.write({});
      }
      health_.obstacle_stop = obstacle;
      health_.obstacle_slow = slow;
      if (!rivals.empty()) latch(rivals);
      watch(arrival);
    }
  }

  void take(const ros2::OdometryMessage& message, nanoseconds arrival) {
    if (!fault_.empty()) return;  // what comes after a fault is not driven on
    const auto read = reader_.read(message, arrival);
    if (const Refused* refused = std::get_if<Refused>(&read)) return latch(refused->sentence);
    if (arrived_ && armed_) health_.largest_gap = std::max(health_.largest_gap, arrival - *arrived_);
    arrived_ = arrival;
    const Odometry* reading = std::get_if<Odometry>(&read);
    if (reading == nullptr) return;
    ++health_.readings;
    // The docking finds the same fault in the same readings and names it; here it only must not take its time.
    if (const std::optional<Reason> fault = odometry_fault(before_, *reading, limits_)) latch(fault->sentence);
    before_ = *reading;
    readings_.push_back(*reading);
    // Before the first read only the newest is of use; later nobody waits that long.
    while (readings_.size() > (reading_ ? 1000U : 1U)) readings_.pop_front();
  }

  void watch(nanoseconds time) {
    // When this machine stalled, what the robot sent meanwhile is still on its way to us: it gets two periods to come
    // in before the robot is called silent. Zero does not wait for that.
    if (time - watched_ > 3 * watch_period) settled_ = time + 2 * watch_period;
    watched_ = time;
    if (!armed_) return;
    // Seen at the latest one period later, and then zero still leaves in time.
    if (arrived_ && time - *arrived_ > limits_.max_silence - 2 * watch_period) {
      char text[96];
      std::snprintf(text, sizeof text, "the robot has been silent on %s for %.0f ms", odom_.c_str(),
                    static_cast<double>((time - *arrived_).count()) / 1e6);
      if (time >= settled_) latch(text);
      if (last_ != Twist2{}) {
        last_ = {};
        commands_.write({});
      }
    }
    if (driven_ && last_ != Twist2{} && time - *driven_ > command_timeout) {
      last_ = {};
      ++health_.starved;
      commands_.write({});
    }
    if (!fault_.empty() && time - repeated_ > repeat_period) {
      repeated_ = time;
      commands_.write({});
    }
  }

  [[nodiscard]] std::string rival_sentence() const {
    if (const auto others = link_->publishers_of(cmd_vel_); !others.empty())
      return joined(others) + " publishes " + cmd_vel_ + ", too; only one may drive the robot: end it or remap it";
    if (const auto others = link_->publishers_of(odom_); others.size() > 1)
      return std::to_string(others.size()) + " processes publish " + odom_ + ": " + joined(others) +
             "; only one can be right";
    return {};
  }

  std::shared_ptr<ros2::Link> link_;
  OdometryLimits limits_;
  steady_clock::time_point start_;
  std::string cmd_vel_;
  std::string odom_;
  CommandPublisher commands_;
  ros2::Subscription<ros2::OdometryMessage> odometry_;
  ObstacleInput stop_input_;  // of the thread, with the reader below
  ObstacleInput slow_input_;

  mutable std::mutex mutex_;
  OdometryReader reader_;
  std::optional<Odometry> before_;
  std::optional<nanoseconds> arrived_;
  std::deque<Odometry> readings_;
  bool reading_ = false;
  std::optional<nanoseconds> driven_;
  Twist2 last_;
  double share_ = 1.0;
  std::string fault_;
  nanoseconds repeated_{0};
  nanoseconds watched_{0};
  nanoseconds settled_{0};
  RobotLinkHealth health_;

  std::atomic<bool> armed_{false};  // a command was sent
  std::atomic<bool> ending_{false};
  CrashStop crash_stop_;
  std::thread thread_;
};

// Why the robot cannot be taken over, as long as it cannot.
std::string missing(const ros2::Link& link, const Ros2Config& config, const std::string& cmd_vel,
                    const std::string& odom) {
  const auto drivers = link.publishers_of(cmd_vel);
  if (!drivers.empty())
    return joined(drivers) + " publishes " + cmd_vel + " already; only one may drive the robot: end it or remap it";
  const auto odometers = link.publishers_of(odom);
  const auto listeners = link.subscribers_of(cmd_vel);
  const std::string odometry = ros2::type_name<ros2::OdometryMessage>();
  const std::string plain = ros2::type_name<ros2::Twist>();
  const std::string stamped = ros2::type_name<ros2::TwistStamped>();
  if (odometers.empty() && listeners.empty())
    return "nobody publishes " + odom + " and nobody subscribes " + cmd_vel +
           "; is the robot switched on, and are domain, interface and namespace right?";
  if (odometers.empty()) return "nobody publishes " + odom + ", although " + joined(listeners) + " takes commands";
  if (odometers.size() > 1)
    return std::to_string(odometers.size()) + " processes publish " + odom + ": " + joined(odometers) +
           "; only one can be right";
  if (!has_type(odometers, odometry)) return joined(odometers) + " publishes " + odom + ", but not as " + odometry;
  if (listeners.empty()) return "nobody subscribes " + cmd_vel + ", although " + joined(odometers) + " sends odometry";
  const bool takes_plain = has_type(listeners, plain) && config.cmd_vel_type != "TwistStamped";
  const bool takes_stamped = has_type(listeners, stamped) && config.cmd_vel_type != "Twist";
  if (!takes_plain && !takes_stamped)
    return joined(listeners) + " subscribes " + cmd_vel + ", but not as ros2.cmd_vel_type = " + config.cmd_vel_type +
           " asks for";
  return {};
}

// The topics by the names that remapping rules use.
std::map<std::string, std::string Ros2Topics::*> topic_names() {
  return {{"cmd_vel", &Ros2Topics::cmd_vel},
          {"odom", &Ros2Topics::odom},
          {"obstacle_stop", &Ros2Topics::obstacle_stop},
          {"obstacle_slow", &Ros2Topics::obstacle_slow},
          {"detected_dock_pose", &Ros2Topics::detected_dock_pose},
          {"detections", &Ros2Topics::detections},
          {"docking_path", &Ros2Topics::path},
          {"docking_status", &Ros2Topics::status},
          {"diagnostics", &Ros2Topics::diagnostics},
          {"ground_truth", &Ros2Topics::ground_truth}};
}

}  // namespace

int domain_of(const Ros2Config& config) { return config.domain >= 0 ? config.domain : ros2::domain_of_environment(); }

ros2::LinkConfig link_config(const Ros2Config& config, const std::string& process) {
  ros2::LinkConfig link;
  link.domain = domain_of(config);
  link.interface = config.interface;
  link.process = process;
  std::istringstream peers(config.peers);
  for (std::string peer; peers >> peer;) link.peers.push_back(peer);
  return link;
}

std::string topic(const Ros2Config& config, const std::string& name) {
  return ros2::full_name(config.name_space, name);
}

void remap(Ros2Config& config, const std::string& rule) {
  const auto at = rule.find(":=");
  const auto names = topic_names();
  std::string known;
  for (const auto& [name, member] : names) known += " " + name;
  if (at == std::string::npos)
    throw Failure(ExitCode::usage, "--remap " + rule + ": it must be NAME:=TOPIC, where NAME is one of" + known);
  std::string from = rule.substr(0, at);
  if (from.starts_with('/')) from.erase(0, 1);
  const auto found = names.find(from);
  if (found == names.end())
    throw Failure(ExitCode::usage, "--remap " + rule + ": " + from + " is no topic of tagdock; these are:" + known);
  config.topics.*(found->second) = rule.substr(at + 2);
  (void)topic(config, config.topics.*(found->second));
}

Ros2Robot open_ros2(const Ros2Config& config, const OdometryLimits& limits, steady_clock::time_point start) {
  const std::string cmd_vel = topic(config, config.topics.cmd_vel);
  const std::string odom = topic(config, config.topics.odom);
  auto link = std::make_shared<ros2::Link>(link_config(config, "tagdock dock"));
  const auto deadline =
      steady_clock::now() + std::chrono::duration_cast<nanoseconds>(std::chrono::duration<double>(config.wait_s));
  const std::string where = "ROS 2 domain " + std::to_string(domain_of(config)) + " on " + config.interface + ": ";
  const auto wait_while = [&](const auto& problem) {
    for (std::string why = problem(); !why.empty(); why = problem()) {
      if (steady_clock::now() > deadline) throw Failure(ExitCode::robot_link, where + why);
      std::this_thread::sleep_for(milliseconds(20));
    }
  };
  wait_while([&] { return missing(*link, config, cmd_vel, odom); });

  const bool stamped =
      config.cmd_vel_type == "TwistStamped" ||
      (config.cmd_vel_type == "auto" && has_type(link->subscribers_of(cmd_vel), ros2::type_name<ros2::TwistStamped>()));
  auto robot = std::make_unique<TopicRobot>(link, config, limits, start, stamped);
  wait_while([&]() -> std::string {
    if (robot->subscribers() == 0) return "the subscriber of " + cmd_vel + " does not take what we offer (its QoS)";
    if (robot->odometers() == 0) return "the publisher of " + odom + " does not give what we ask for (its QoS)";
    return {};
  });
  TopicRobot* const one = robot.get();
  return {std::move(robot), link, [one](nanoseconds time) { return one->stamp(time); },
          [one] { return one->health(); }};
}

Ros2Look look_for_ros2(const Ros2Config& config, nanoseconds wait, nanoseconds listen) {
  const std::string cmd_vel = topic(config, config.topics.cmd_vel);
  const std::string odom = topic(config, config.topics.odom);
  ros2::Link link(link_config(config, "tagdock doctor"));
  Ros2Look look;
  for (const auto deadline = steady_clock::now() + wait;;) {
    look.missing = missing(link, config, cmd_vel, odom);
    if (look.missing.empty() || steady_clock::now() > deadline) break;
    std::this_thread::sleep_for(milliseconds(20));
  }
  if (!look.missing.empty()) return look;
  const auto odometry = link.subscription<ros2::OdometryMessage>(odom, ros2::Delivery::best_effort, depth);
  const auto begin = steady_clock::now();
  std::optional<steady_clock::time_point> last;
  while (steady_clock::now() - begin < listen) {
    link.wait(watch_period);
    const std::size_t came = odometry.take().size();
    if (came == 0) continue;
    const auto now = steady_clock::now();
    if (last) look.largest_gap = std::max<nanoseconds>(look.largest_gap, now - *last);
    last = now;
    look.readings += came;
  }
  return look;
}

}  // namespace tagdock
