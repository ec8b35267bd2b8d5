#pragma once

#include <atomic>
#include <chrono>
#include <memory>
#include <thread>

#include "app/robots/ros2.h"
#include "app/simulation/shared_world.h"

namespace tagdock {

/// Puts the robot of a world where another process (robot-sim) says that it truly is: the camera of one simulation, the
/// robot of another, and nothing between them but a topic. Both take the same scenario and seed, on one machine.
class ToldPlace {
 public:
  /// @param start  when the session of the world began
  /// Throws Failure as ros2::Link does.
  ToldPlace(std::shared_ptr<SharedWorld> world, const Ros2Config& config, std::chrono::steady_clock::time_point start);
  ~ToldPlace();
  ToldPlace(const ToldPlace&) = delete;
  ToldPlace& operator=(const ToldPlace&) = delete;

  /// Waits until somebody says where the robot is. Throws Failure(robot_link) when nobody does.
  void wait(std::chrono::nanoseconds at_most) const;

 private:
  void listen(std::chrono::nanoseconds wall_start);

  std::shared_ptr<SharedWorld> world_;
  ros2::Link link_;
  std::string topic_;
  ros2::Subscription<ros2::OdometryMessage> truth_;
  std::atomic<bool> told_{false};
  std::atomic<bool> ending_{false};
  std::thread thread_;
};

}  // namespace tagdock
