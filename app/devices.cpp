#include "app/devices.h"

#include <cmath>
#include <iostream>
#include <thread>

#include "app/cameras/in_process.h"
#include "app/cameras/open_camera.h"
#include "app/failure.h"
#include "app/priority.h"
#include "app/robots/docking_topics.h"
#include "app/robots/ros2.h"
#include "app/robots/simulated.h"
#include "app/simulation/live_world.h"
#include "app/simulation/untouched.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;
using std::chrono::steady_clock;

class MachineClock final : public SessionClock {
 public:
  explicit MachineClock(steady_clock::time_point start) : start_(start) {}
  [[nodiscard]] nanoseconds now() const override { return steady_clock::now() - start_; }
  void sleep_until(nanoseconds time) override { std::this_thread::sleep_until(start_ + time); }

 private:
  steady_clock::time_point start_;
};

// Time that passes only when the loop sleeps; a factor holds it back for people who watch.
class LoopClock final : public SessionClock {
 public:
  explicit LoopClock(double speedup) : speedup_(speedup), start_(steady_clock::now()) {}
  [[nodiscard]] nanoseconds now() const override { return now_; }
  void sleep_until(nanoseconds time) override {
    now_ = std::max(now_, time);
    if (speedup_ > 0.0)
      std::this_thread::sleep_until(
          start_ + std::chrono::duration_cast<nanoseconds>(
                       std::chrono::duration<double, std::nano>(static_cast<double>(now_.count()) / speedup_)));
  }

 private:
  double speedup_;
  steady_clock::time_point start_;
  nanoseconds now_{0};
};

// A camera together with what must live as long as it does.
class CameraOfLiveWorld final : public Camera {
 public:
  CameraOfLiveWorld(std::unique_ptr<LiveWorld> world, std::unique_ptr<Camera> camera)
      : world_(std::move(world)), camera_(std::move(camera)) {}
  std::optional<CameraFrame> newest(nanoseconds now) override { return camera_->newest(now); }
  [[nodiscard]] CameraHealth health() const override { return camera_->health(); }
  [[nodiscard]] CameraSettings actual() const override { return camera_->actual(); }
  void adjust(double exposure_us, double gain) override { camera_->adjust(exposure_us, gain); }
  void trigger() override { camera_->trigger(); }

 private:
  std::unique_ptr<LiveWorld> world_;
  std::unique_ptr<Camera> camera_;  // goes first
};

GigeSettings gige_settings(const Config& config) {
  GigeSettings settings;
  settings.frame_rate = config.camera.frame_rate;
  settings.exposure_us = config.camera.exposure_us;
  settings.gain = config.camera.gain;
  settings.width = config.rig.camera.width;
  settings.height = config.rig.camera.height;
  settings.pixel_format = config.camera.pixel_format;
  settings.ptp = config.camera.ptp;
  settings.chunks = config.camera.chunks;
  settings.waiting = [](const std::string& sentence) { std::cerr << "camera: " << sentence << std::endl; };
  settings.receive_buffer = static_cast<std::size_t>(config.camera.receive_buffer);
  settings.declared_latency = nanoseconds(static_cast<std::int64_t>(std::llround(config.camera.latency_ms * 1e6)));
  return settings;
}

// The camera model of what is sent.
CameraModel model_of_frames(const CameraModel& camera, const CameraSettings& actual) {
  if (actual.width == 0 || actual.height == 0) return camera;
  return camera_of_part(camera, actual.binning, actual.offset_x, actual.offset_y, actual.width, actual.height);
}

std::shared_ptr<SharedWorld> make_world(const Config& config, const DeviceOptions& options) {
  Scenario scenario = config.simulation.scenario.empty() ? Scenario{} : read_scenario(config.simulation.scenario);
  // The simulated sensor obeys the settings, as a real one would.
  scenario.camera.frame_rate = config.camera.frame_rate;
  scenario.camera.exposure = 1e-6 * config.camera.exposure_us;
  if (options.untouched) scenario = untouched(scenario);
  if (config.docking.errand == Errand::undock) {
    const Pose2& dock = config.docking.dock_pose;
    StartScenario& start = scenario.start;
    start = {};
    start.range = std::hypot(dock.x, dock.y);
    start.bearing = std::atan2(-dock.y, -dock.x);
    start.heading = dock.yaw - start.bearing;
    start.range_sigma = start.bearing_sigma = start.bearing_spread = start.heading_sigma = start.heading_spread = 0.0;
  }
  Board board = config.board;
  if (config.simulation.faults.no_board) board.tags.clear();
  return std::make_shared<SharedWorld>(scenario, config.rig, board, options.seed);
}

}  // namespace

Devices open_devices(const Config& config, const DeviceOptions& options) {
  const CameraArgument argument = parse_camera_argument(config.camera.source);
  const bool simulated_camera = std::holds_alternative<tagdock::SimulatedCamera>(argument);
  if (options.speedup && !(simulated_camera && config.robot == "sim"))
    throw Failure(ExitCode::usage, "--speedup is for simulations only; a real camera or robot sets its own time");
  // Measured with nine others waiting for two cores: without, one docking in three ended because a thread of ours came
  // 200 ms late.
  if (config.robot == "ros2") (void)prefer_this_thread();
  Devices devices;
  devices.robot_name = config.robot;
  devices.camera_model = config.rig.camera;
  std::shared_ptr<SharedWorld> world;
  if (simulated_camera || config.robot == "sim") world = make_world(config, options);
  const steady_clock::time_point start = steady_clock::now();
  if (options.speedup)
    devices.clock = std::make_unique<LoopClock>(*options.speedup);
  else
    devices.clock = std::make_unique<MachineClock>(start);
  const auto now = [clock = devices.clock.get()] { return clock->now(); };

  if (simulated_camera && options.speedup) {
    devices.camera = in_process_camera(world, config.simulation.faults, config.camera.gain);
    devices.camera_name = "simulated, in-process";
  } else if (simulated_camera) {
    const std::string address = "127.0.0.1";
    GigeServerSettings served;
    served.address = address;
    auto live = std::make_unique<LiveWorld>(world, config.simulation.faults, start, served);
    GigeSettings settings = gige_settings(config);
    settings.address = address;
    auto camera = open_gige(settings, start);
    devices.camera = std::make_unique<CameraOfLiveWorld>(std::move(live), std::move(camera));
    devices.camera_name = "simulated, over GigE Vision at " + address;
  } else {
    GigeSettings settings = gige_settings(config);
    if (options.whole_sensor) settings.width = settings.height = 0;
    devices.camera = open_camera(argument, settings, config.camera.frame_rate, start);
    devices.camera_name = config.camera.source;
  }
  const CameraSettings actual = devices.camera->actual();
  devices.notes = actual.notes;
  const CameraModel& calibrated = config.rig.camera;
  const bool another_camera = options.whole_sensor && (actual.width * actual.binning != calibrated.width ||
                                                       actual.height * actual.binning != calibrated.height);
  devices.camera_model = another_camera ? calibrated : model_of_frames(calibrated, actual);
  devices.binning = actual.binning;

  if (config.robot == "sim") {
    devices.robot = simulated_robot(world, config.simulation.faults, now);
    devices.true_camera_point = [world, now] {
      const std::lock_guard lock(world->mutex);
      world->world.advance(now());
      return world->world.T_station_camera_point();
    };
    devices.true_docking_error = [world, now](const Pose2& docking_pose) {
      const std::lock_guard lock(world->mutex);
      world->world.advance(now());
      return world->world.docking_error(docking_pose);
    };
  } else if (config.robot == "ros2") {
    Ros2Robot ros2 = open_ros2(config.ros2, config.docking.gate.odometry, start);
    devices.robot_name = ros2.health().name;
    devices.tell_others = [topics = std::make_shared<DockingTopics>(ros2, config.ros2, config.board.family)](
                              const auto& inputs, const auto& outputs, const auto& docker, const auto& camera) {
      topics->cycle(inputs, outputs, docker, camera);
    };
    devices.robot = std::move(ros2.robot);
  } else {
    devices.robot = standing_robot(now);
  }
  return devices;
}

}  // namespace tagdock
