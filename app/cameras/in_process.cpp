#include "app/cameras/in_process.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;

class InProcessCamera final : public Camera {
 public:
  InProcessCamera(std::shared_ptr<SharedWorld> world, const SimulationFaults& faults)
      : world_(std::move(world)), faults_(faults) {}

  std::optional<CameraFrame> newest(nanoseconds now) override {
    const std::lock_guard lock(world_->mutex);
    World& world = world_->world;
    world.advance(now);
    now_ = now;
    const nanoseconds period = world.frame_period();
    // Frame k is exposed at k periods and a half; the newest that has arrived is looked for.
    std::optional<std::uint64_t> newest;
    for (std::uint64_t k = next_; exposed_at(k, period) <= now; ++k) {
      if (died(exposed_at(k, period)) || world.is_lost(k)) continue;
      if (exposed_at(k, period) + world.latency_of(k) > now) break;
      if (newest) ++health_.overwritten;
      newest = k;
    }
    if (!newest) return std::nullopt;
    CameraFrame frame;
    frame.lost_before = 0;
    for (std::uint64_t k = next_; k < *newest; ++k)
      if (world.is_lost(k)) ++frame.lost_before;
    health_.lost += frame.lost_before;
    next_ = *newest + 1;
    ++health_.received;
    const nanoseconds time = exposed_at(*newest, period);
    frame.frame = {world.render(time).gray, time, *newest};
    frame.arrived = time + world.latency_of(*newest);
    frame.camera_time = time;
    frame.exposure_us = 1e6 * world.scenario().camera.exposure;
    last_ = frame.arrived;
    return frame;
  }

  [[nodiscard]] CameraHealth health() const override {
    CameraHealth health = health_;
    health.state = "streaming";
    // As the GigE client: no frame for 250 ms beyond the usual.
    if (died(now_) && now_ - last_ > std::chrono::milliseconds(250)) {
      health.state = "lost";
      health.reason = "the simulated camera has died, as the simulation's faults asked";
    }
    return health;
  }

  [[nodiscard]] CameraSettings actual() const override {
    const CameraModel& camera = world_->world.rig().camera;
    CameraSettings settings;
    settings.identity = "simulated camera, in-process";
    settings.sensor_width = settings.width = camera.width;
    settings.sensor_height = settings.height = camera.height;
    settings.frame_rate = world_->world.scenario().camera.frame_rate;
    settings.exposure_us = 1e6 * world_->world.scenario().camera.exposure;
    return settings;
  }

 private:
  static nanoseconds exposed_at(std::uint64_t k, nanoseconds period) {
    return static_cast<std::int64_t>(k) * period + period / 2;
  }
  [[nodiscard]] bool died(nanoseconds time) const {
    return faults_.camera_dies_at_s > 0.0 && std::chrono::duration<double>(time).count() >= faults_.camera_dies_at_s;
  }

  std::shared_ptr<SharedWorld> world_;
  SimulationFaults faults_;
  std::uint64_t next_ = 0;
  nanoseconds now_{0};
  nanoseconds last_{0};
  CameraHealth health_;
};

}  // namespace

std::unique_ptr<Camera> in_process_camera(std::shared_ptr<SharedWorld> world, const SimulationFaults& faults) {
  return std::make_unique<InProcessCamera>(std::move(world), faults);
}

}  // namespace tagdock
