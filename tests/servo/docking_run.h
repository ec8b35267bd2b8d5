#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "planar_world.h"
#include "s_curve.h"

namespace tagdock::test {

// Robot whose camera point stands at a range and bearing from the board and looks at it.
inline Pose2 start_pose(const Rig& rig, double range, double bearing, double heading_error = 0.0) {
  const Pose2 camera{-range * std::cos(bearing), -range * std::sin(bearing), bearing + heading_error};
  return camera * inverse(camera_point(rig));
}

struct Outcome {
  Phase phase;
  Pose2 true_error;                 // of the camera point against the docking pose
  std::vector<std::string> phases;  // in the order in which they were entered
  std::vector<std::string> events;
  std::vector<Twist2> commands;
  nanoseconds time{0};
  Pose2 rest;  // how far the robot still moved after the end
};

// Called before every tick: may change what the world says.
using Fault = std::function<void(Tick&, PlanarWorld&, const Docker&)>;

inline DockingConfig test_config() {
  DockingConfig config;
  config.planner = s_curve;
  return config;
}

inline Outcome run_docking(PlanarWorld& world, const Rig& rig, const DockingConfig& config, const WorldConfig& physics,
                           const Fault& fault = {}, nanoseconds limit = std::chrono::seconds(200)) {
  constexpr nanoseconds step = milliseconds(20);
  Docker docker(rig, config);
  Outcome outcome;
  outcome.phases.emplace_back(name(docker.phase()));
  struct Pending {
    nanoseconds arrives;
    nanoseconds stamp;
    Sighting sighting;
  };
  std::deque<Pending> pending;
  nanoseconds next_frame{0};
  while (world.time() < limit) {
    Tick tick;
    tick.now = world.time();
    tick.odometry.push_back({world.time(), world.odometry(), world.velocity()});
    if (world.time() >= next_frame) {
      pending.push_back({world.time() + physics.latency, world.time(), world.look()});
      next_frame += physics.frame_period;
    }
    while (!pending.empty() && pending.front().arrives <= tick.now) {
      tick.sighting = pending.front().sighting;
      tick.frame_time = pending.front().stamp;
      pending.pop_front();
    }
    if (fault) fault(tick, world, docker);
    const TickResult result = docker.tick(tick);
    for (const Event& event : result.events) {
      std::array<char, 32> time{};
      std::snprintf(time.data(), time.size(), "%8.2fs ", seconds(event.time));
      outcome.events.push_back(time.data() + event.text);
    }
    if (result.phase_changed) outcome.phases.emplace_back(name(docker.phase()));
    outcome.commands.push_back(result.command);
    if (result.over) break;
    world.drive(result.command, step);
  }
  outcome.phase = docker.phase();
  outcome.time = world.time();
  const Pose2 point = world.pose() * camera_point(rig);
  outcome.true_error = {point.x - config.dock_pose.x, point.y - config.dock_pose.y,
                        wrap_angle(point.yaw - config.dock_pose.yaw)};
  const Pose2 before = world.pose();
  for (int i = 0; i < 100; ++i) world.drive({}, step);
  outcome.rest = between(before, world.pose());
  return outcome;
}

}  // namespace tagdock::test
