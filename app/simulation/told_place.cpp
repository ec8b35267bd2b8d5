#include "app/simulation/told_place.h"

#include <cmath>

#include "app/failure.h"
#include "app/robots/odometry_reader.h"

namespace tagdock {

using std::chrono::nanoseconds;
using std::chrono::steady_clock;

ToldPlace::ToldPlace(std::shared_ptr<SharedWorld> world, const Ros2Config& config, steady_clock::time_point start)
    : world_(std::move(world)),
      link_(link_config(config, "tagdock camera-sim")),
      topic_(topic(config, config.topics.ground_truth)),
      truth_(link_.subscription<ros2::OdometryMessage>(topic_, ros2::Delivery::best_effort, 50)) {
  // Both processes take their stamps from the wall clock of one machine, so the offset needs no learning.
  const nanoseconds wall_start = std::chrono::system_clock::now().time_since_epoch() - (steady_clock::now() - start);
  thread_ = std::thread([this, wall_start] { listen(wall_start); });
}

ToldPlace::~ToldPlace() {
  ending_ = true;
  thread_.join();
}

void ToldPlace::wait(nanoseconds at_most) const {
  const auto deadline = steady_clock::now() + at_most;
  while (!told_) {
    if (steady_clock::now() > deadline)
      throw Failure(ExitCode::robot_link,
                    "nobody publishes " + topic_ + "; start tagdock robot-sim with the same domain, scenario and seed");
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
  }
}

void ToldPlace::listen(nanoseconds wall_start) {
  while (!ending_) {
    link_.wait(std::chrono::milliseconds(50));
    for (const ros2::OdometryMessage& message : truth_.take()) {
      const ros2::Quaternion& q = message.pose.orientation;
      const Pose2 T_station_base{message.pose.position.x, message.pose.position.y, 2.0 * std::atan2(q.z, q.w)};
      if (!is_finite(T_station_base)) continue;
      const std::lock_guard lock(world_->mutex);
      world_->world.place(nanoseconds_of(message.header.stamp) - wall_start, T_station_base);
      told_ = true;
    }
  }
}

}  // namespace tagdock
