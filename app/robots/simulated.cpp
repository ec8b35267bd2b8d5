#include "app/robots/simulated.h"

#include <limits>

namespace tagdock {
namespace {

using std::chrono::nanoseconds;

class SimulatedRobot final : public Robot {
 public:
  SimulatedRobot(std::shared_ptr<SharedWorld> world, const SimulationFaults& faults, std::function<nanoseconds()> now)
      : world_(std::move(world)), faults_(faults), now_(std::move(now)) {}

  std::vector<Odometry> read() override {
    const nanoseconds now = now_();
    Odometry odometry;
    {
      const std::lock_guard lock(world_->mutex);
      world_->world.advance(now);
      odometry = world_->world.odometry();
    }
    if (odometry.time == last_) return {};
    last_ = odometry.time;
    if (faults_.odometry_nan_at_s > 0.0 && std::chrono::duration<double>(now).count() >= faults_.odometry_nan_at_s)
      odometry.T_odom_base.x = std::numeric_limits<double>::quiet_NaN();
    return {odometry};
  }

  void drive(const Twist2& command) override {
    const nanoseconds now = now_();
    const std::lock_guard lock(world_->mutex);
    world_->world.advance(now);
    world_->world.command(command, now);
  }

  void stop() noexcept override {
    try {
      drive({});
    } catch (...) {  // the drive's own time-out stops it
    }
  }

 private:
  std::shared_ptr<SharedWorld> world_;
  SimulationFaults faults_;
  std::function<nanoseconds()> now_;
  nanoseconds last_{-1};
};

class StandingRobot final : public Robot {
 public:
  explicit StandingRobot(std::function<nanoseconds()> now) : now_(std::move(now)) {}
  std::vector<Odometry> read() override { return {{now_(), {}, {}}}; }
  void drive(const Twist2&) override {}
  void stop() noexcept override {}

 private:
  std::function<nanoseconds()> now_;
};

}  // namespace

std::unique_ptr<Robot> simulated_robot(std::shared_ptr<SharedWorld> world, const SimulationFaults& faults,
                                       std::function<nanoseconds()> now) {
  return std::make_unique<SimulatedRobot>(std::move(world), faults, std::move(now));
}

std::unique_ptr<Robot> standing_robot(std::function<nanoseconds()> now) {
  return std::make_unique<StandingRobot>(std::move(now));
}

}  // namespace tagdock
