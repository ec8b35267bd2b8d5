// Verb: robot-sim. The simulated robot as a process of its own, driven by ROS 2 topics as a real one is.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <fstream>
#include <iostream>
#include <limits>
#include <memory>
#include <optional>
#include <thread>
#include <variant>

#include <nlohmann/json.hpp>

#include "app/config.h"
#include "app/failure.h"
#include "app/option_checks.h"
#include "app/priority.h"
#include "app/robots/odometry_reader.h"
#include "app/robots/ros2.h"
#include "app/ros2_options.h"
#include "app/simulation/live_world.h"
#include "app/simulation/scenario.h"
#include "app/stop_signal.h"
#include "app/verbs.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;
using std::chrono::steady_clock;

struct RobotSimOptions {
  std::string config;
  std::string scenario;
  std::uint64_t seed = 1;
  std::optional<int> domain;
  std::string name_space;
  std::vector<std::string> remaps;
  std::string cmd_vel_type;
  double command_timeout_ms = 0.0;
  double odometry_rate = 50.0;
  std::string camera;
  std::vector<std::string> faults;
  std::string log;
  double seconds = 0.0;
  bool json = false;
};

// What a drive takes, as diff_drive_controller limits it; more is a mistake of the sender.
constexpr double fastest = 1.0;       // m/s
constexpr double fastest_turn = 2.0;  // rad/s
constexpr double other_axes = 1e-6;   // m/s, rad/s: a differential drive has none

const std::array<const char*, 7> fault_words = {"nan", "jump", "reset", "freeze", "backwards", "ahead", "silent"};

/// What goes wrong with odometry from a time on.
struct OdometryFault {
  double after_s = 0.0;
  std::string what;
};

OdometryFault parse_odometry_fault(const std::string& text) {
  OdometryFault fault;
  char word[32] = {};
  char rest = 0;
  const bool read = std::sscanf(text.c_str(), "%lf %31s %c", &fault.after_s, word, &rest) == 2;
  fault.what = word;
  const bool known = std::find(fault_words.begin(), fault_words.end(), fault.what) != fault_words.end();
  if (!read || !known || !(fault.after_s >= 0.0)) {
    std::string all;
    for (const char* one : fault_words) all += std::string(" ") + one;
    throw Failure(ExitCode::usage, "--fault \"" + text + "\": it must be \"AFTER_S WHAT\", where WHAT is one of" + all);
  }
  return fault;
}

ros2::OdometryMessage message_of(const Pose2& pose, const Twist2& velocity, nanoseconds stamp, const std::string& frame,
                                 const std::string& child) {
  ros2::OdometryMessage message;
  message.header = {time_of(stamp), frame};
  message.child_frame_id = child;
  message.pose.position = {pose.x, pose.y, 0.0};
  message.pose.orientation = {0.0, 0.0, std::sin(0.5 * pose.yaw), std::cos(0.5 * pose.yaw)};
  message.twist.linear.x = velocity.linear;
  message.twist.angular.z = velocity.angular;
  // As diff_drive_controller's example configurations have it: we do not know better.
  for (std::size_t i = 0; i < 6; ++i) message.pose_covariance[7 * i] = message.twist_covariance[7 * i] = 1e-3;
  return message;
}

GigeServerSettings served_at(const std::string& address) {
  GigeServerSettings settings;
  settings.address = address;
  return settings;
}

class RobotServer {
 public:
  RobotServer(const RobotSimOptions& options, const Config& config, std::shared_ptr<SharedWorld> world)
      : options_(options),
        config_(config.ros2),
        dock_pose_(config.docking.dock_pose),
        world_(std::move(world)),
        link_(link_config(config.ros2, "tagdock robot-sim")),
        odometry_(link_.publisher<ros2::OdometryMessage>(topic(config_, config_.topics.odom))),
        truth_(link_.publisher<ros2::OdometryMessage>(topic(config_, config_.topics.ground_truth))),
        timeout_(std::llround(1e9 * world_->world.scenario().drive.command_timeout)) {
    const std::string name = topic(config_, config_.topics.cmd_vel);
    if (config_.cmd_vel_type == "Twist")
      commands_ = link_.subscription<ros2::Twist>(name, ros2::Delivery::best_effort, 10);
    else
      commands_ = link_.subscription<ros2::TwistStamped>(name, ros2::Delivery::best_effort, 10);
    for (const std::string& text : options.faults) faults_.push_back(parse_odometry_fault(text));
    if (!options.log.empty()) {
      log_.open(options.log);
      if (!log_) throw Failure(ExitCode::usage, "--log " + options.log + ": cannot be written");
      log_ << "monotonic_ns,commands,command_linear,command_angular,wheel_linear,wheel_angular,x,y,yaw\n";
    }
  }

  void run(steady_clock::time_point start) {
    const StopSignal stop_signal;
    if (!options_.camera.empty())
      (void)world_->world.renderer();  // takes its time; the robot must not stand still for it
    if (!options_.camera.empty())
      camera_ = std::make_unique<LiveWorld>(world_, SimulationFaults{}, start, served_at(options_.camera));
    // Wall clock at the start of the session: stamps never step back, whatever happens to the wall clock later.
    wall_start_ = std::chrono::system_clock::now().time_since_epoch() - (steady_clock::now() - start);
    // JSON has stdout for itself.
    (options_.json ? std::cerr : std::cout)
        << "robot on ROS 2 domain " << domain_of(config_) << ", " << config_.interface << ": takes "
        << topic(config_, config_.topics.cmd_vel) << ", gives " << topic(config_, config_.topics.odom) << std::endl;
    nanoseconds next{0};
    while (!stop_signal.requested()) {
      next += RobotPhysics::step;
      // Commands count from their arrival, so waiting for one ends the wait for the next step, too.
      for (nanoseconds now = steady_clock::now() - start; now < next; now = steady_clock::now() - start) {
        link_.wait(next - now);
        take_commands(steady_clock::now() - start);
      }
      const nanoseconds now = steady_clock::now() - start;
      largest_step_ = std::max(largest_step_, now - stepped_);
      stepped_ = now;
      if (options_.seconds > 0.0 && std::chrono::duration<double>(now).count() > options_.seconds) break;
      publish(now);
    }
  }

  void report(std::ostream& out) {
    const std::lock_guard lock(world_->mutex);
    const Pose2 error = world_->world.docking_error(dock_pose_);
    const RobotTruth& truth = world_->world.truth();
    const nlohmann::ordered_json json = {
        {"schema", "tagdock-robot-sim/1"},
        {"seed", options_.seed},
        {"error_true", {{"x", error.x}, {"y", error.y}, {"yaw", error.yaw}}},
        {"wheels", {{"linear", truth.wheels.linear}, {"angular", truth.wheels.angular}}},
        {"travelled_m", truth.travelled},
        {"commands", taken_},
        {"refused", refused_},
        {"timeouts", timeouts_},
        {"odometry", published_},
        {"largest_step_ms", static_cast<double>(largest_step_.count()) / 1e6}};
    out << (options_.json ? json.dump() : json.dump(2)) << std::endl;
  }

 private:
  void take_commands(nanoseconds now) {
    if (const auto* plain = std::get_if<ros2::Subscription<ros2::Twist>>(&commands_)) {
      for (const ros2::Twist& twist : plain->take()) take(twist, now);
    } else if (const auto* stamped = std::get_if<ros2::Subscription<ros2::TwistStamped>>(&commands_)) {
      for (const ros2::TwistStamped& one : stamped->take()) {
        // diff_drive_controller takes a stamp of zero for now; here nothing passes that may be old.
        const nanoseconds age = wall_start_ + now - nanoseconds_of(one.header.stamp);
        if (age > timeout_ || age < -timeout_)
          refuse("its stamp differs from the robot's clock by more than the command time-out");
        else
          take(one.twist, now);
      }
    }
  }

  void take(const ros2::Twist& twist, nanoseconds now) {
    const Twist2 wanted{twist.linear.x, twist.angular.z};
    for (const double other : {twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.y})
      if (!(std::abs(other) <= other_axes)) return refuse("a differential drive cannot move like that");
    if (!(std::abs(wanted.linear) <= fastest && std::abs(wanted.angular) <= fastest_turn))
      return refuse("the drive cannot turn so fast, or it is no number");
    ++taken_;
    last_ = wanted;
    last_time_ = now;
    const std::lock_guard lock(world_->mutex);
    world_->world.advance(now);
    world_->world.command(wanted, now);
  }

  // A refused command does not count as a sign of life either: the drive's time-out goes on.
  void refuse(const char* why) {
    if (refused_++ == 0) std::cerr << "robot-sim: a command is ignored: " << why << "\n";
  }

  void publish(nanoseconds now) {
    RobotTruth truth;
    Odometry odometry;
    {
      const std::lock_guard lock(world_->mutex);
      world_->world.advance(now);
      truth = world_->world.truth();
      odometry = world_->world.odometry();
    }
    truth_.write(
        message_of(truth.T_station_base, truth.motion, wall_start_ + truth.time, "station", config_.base_frame));
    const bool silent = last_time_ && now - *last_time_ > timeout_;
    if (silent && !timed_out_ && last_ != Twist2{}) {
      ++timeouts_;
      std::cerr << "robot-sim: no command for " << timeout_.count() / 1000000 << " ms while driving: stopped\n";
    }
    timed_out_ = silent;
    if (now >= next_odometry_) {
      next_odometry_ = std::max(next_odometry_ + nanoseconds(std::llround(1e9 / options_.odometry_rate)), now);
      publish_odometry(odometry);
    }
    if (log_.is_open()) {
      const Twist2 command = silent ? Twist2{} : last_;
      char line[320];
      std::snprintf(line, sizeof line, "%lld,%llu,%.6g,%.6g,%.6g,%.6g,%.9g,%.9g,%.9g\n",
                    static_cast<long long>(steady_clock::now().time_since_epoch().count()),
                    static_cast<unsigned long long>(taken_), command.linear, command.angular, truth.wheels.linear,
                    truth.wheels.angular, truth.T_station_base.x, truth.T_station_base.y, truth.T_station_base.yaw);
      log_ << line;
    }
  }

  void publish_odometry(Odometry odometry) {
    const double seconds = std::chrono::duration<double>(odometry.time).count();
    nanoseconds stamp = wall_start_ + odometry.time;
    for (const OdometryFault& fault : faults_) {
      if (seconds < fault.after_s) continue;
      if (fault.what == "silent") return;
      if (fault.what == "nan") odometry.T_odom_base.x = std::numeric_limits<double>::quiet_NaN();
      if (fault.what == "jump") odometry.T_odom_base.y += 0.5;
      if (fault.what == "reset") {
        if (!reset_) reset_ = odometry.T_odom_base;
        odometry.T_odom_base = between(*reset_, odometry.T_odom_base);
      }
      if (fault.what == "freeze") {
        if (!frozen_) frozen_ = odometry;
        odometry = *frozen_;
      }
      if (fault.what == "backwards") stamp -= std::chrono::seconds(1);
      if (fault.what == "ahead") stamp += std::chrono::hours(1);
    }
    ++published_;
    odometry_.write(message_of(odometry.T_odom_base, odometry.velocity, stamp, config_.odom_frame, config_.base_frame));
  }

  const RobotSimOptions& options_;
  Ros2Config config_;
  Pose2 dock_pose_;
  std::shared_ptr<SharedWorld> world_;
  ros2::Link link_;
  ros2::Publisher<ros2::OdometryMessage> odometry_;
  ros2::Publisher<ros2::OdometryMessage> truth_;
  std::variant<std::monostate, ros2::Subscription<ros2::Twist>, ros2::Subscription<ros2::TwistStamped>> commands_;
  nanoseconds timeout_;
  std::unique_ptr<LiveWorld> camera_;
  std::vector<OdometryFault> faults_;
  std::ofstream log_;
  nanoseconds wall_start_{0};
  nanoseconds next_odometry_{0};
  nanoseconds stepped_{0};
  nanoseconds largest_step_{0};  ///< between two steps that should be 5 ms apart: how the machine stalled
  Twist2 last_;
  std::optional<nanoseconds> last_time_;
  std::optional<Pose2> reset_;
  std::optional<Odometry> frozen_;
  bool timed_out_ = false;
  std::uint64_t taken_ = 0;
  std::uint64_t refused_ = 0;
  std::uint64_t timeouts_ = 0;
  std::uint64_t published_ = 0;
};

int robot_sim(const RobotSimOptions& options) {
  Config config = options.config.empty() ? Config{} : read_config(options.config);
  if (options.domain) config.ros2.domain = *options.domain;
  if (!options.name_space.empty()) config.ros2.name_space = options.name_space;
  if (!options.cmd_vel_type.empty()) config.ros2.cmd_vel_type = options.cmd_vel_type;
  for (const std::string& rule : options.remaps) remap(config.ros2, rule);
  if (!(options.odometry_rate >= 1.0 && options.odometry_rate <= 200.0))
    throw Failure(ExitCode::usage, "--odometry-rate must be between 1 and 200 messages a second");
  if (!(options.command_timeout_ms >= 0.0 && options.command_timeout_ms <= 10000.0))
    throw Failure(ExitCode::usage, "--command-timeout-ms must be between 0 (the scenario's) and 10000");
  const std::string file = options.scenario.empty() ? config.simulation.scenario : options.scenario;
  Scenario scenario = file.empty() ? Scenario{} : read_scenario(file);
  scenario.camera.frame_rate = config.camera.frame_rate;
  scenario.camera.exposure = 1e-6 * config.camera.exposure_us;
  if (options.command_timeout_ms > 0.0) scenario.drive.command_timeout = 1e-3 * options.command_timeout_ms;
  auto world = std::make_shared<SharedWorld>(scenario, config.rig, config.board, options.seed);
  (void)prefer_this_thread();
  RobotServer server(options, config, world);
  server.run(steady_clock::now());
  server.report(std::cout);
  return static_cast<int>(ExitCode::done);
}

}  // namespace

void add_robot_sim(CLI::App& program, Action& action) {
  auto options = std::make_shared<RobotSimOptions>();
  CLI::App* verb = program.add_subcommand(
      "robot-sim", "The simulated robot as a process of its own, driven by ROS 2 topics as a real one.");
  verb->add_option("--config", options->config, "configuration (YAML): rig, board, docking pose, topics");
  verb->add_option("--scenario", options->scenario, "the world (YAML, see data/scenarios)");
  verb->add_option("--seed", options->seed, "seed of start pose, slip and noise; as evaluate's")->capture_default_str();
  add_ros2_options(*verb, options->domain, options->name_space, options->remaps);
  verb->add_option("--cmd-vel-type", options->cmd_vel_type, "Twist or TwistStamped; the latter without")
      ->check(CLI::IsMember({"Twist", "TwistStamped"}));
  verb->add_option("--command-timeout-ms", options->command_timeout_ms,
                   "the drive stops that long after the last command; 0 is the scenario's (200; diff_drive_controller "
                   "has 500)");
  verb->add_option("--odometry-rate", options->odometry_rate, "messages a second")->capture_default_str();
  verb->add_option("--camera", options->camera, "show the world through a GigE Vision camera at this 127.x.y.z, too");
  verb->add_option("--fault", options->faults,
                   "\"AFTER_S WHAT\": odometry from then on; nan jump reset freeze backwards ahead silent")
      ->allow_extra_args(false);
  verb->add_option("--log", options->log, "write what the drive does, every 5 ms, as CSV");
  verb->add_option("--seconds", options->seconds, "end after this time; 0 never")
      ->check(not_negative())
      ->capture_default_str();
  verb->add_flag("--json", options->json, "the report at the end in one line");
  verb->footer(
      "Topics: cmd_vel in, odom out, and for camera-sim --world dds the true place on /simulation/ground_truth.\n"
      "Ends on Ctrl-C with a report on stdout: true error against the docking pose, commands, time-outs.\n"
      "Example:\n  tagdock robot-sim --seed 3 --camera 127.0.0.1 &\n"
      "  tagdock dock --robot ros2 --camera gige:127.0.0.1\nExit codes: 0 done, 2 usage, 3 camera, 5 ROS 2 link.");
  verb->callback([options, &action] { action = [options] { return robot_sim(*options); }; });
}

}  // namespace tagdock
