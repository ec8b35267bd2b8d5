#include "app/cameras/in_process.h"

#include <cmath>
#include <deque>
#include <limits>

#include "app/simulation/frame_schedule.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;

class InProcessCamera final : public Camera {
 public:
  InProcessCamera(std::shared_ptr<SharedWorld> world, const SimulationFaults& faults, double gain_db)
      : world_(std::move(world)),
        dies_at_(std::llround(1e9 * faults.camera_dies_at_s)),
        schedule_(dies_at_),
        set_{{nanoseconds(std::numeric_limits<std::int64_t>::min()), first_exposure_us(), gain_db}} {}

  std::optional<CameraFrame> newest(nanoseconds now) override {
    const std::lock_guard lock(world_->mutex);
    World& world = world_->world;
    world.advance(now);
    now_ = now;
    const std::optional<FrameSchedule::Arrival> arrival = schedule_.newest(world, now);
    if (!arrival) return std::nullopt;
    health_.overwritten += arrival->overwritten_before;
    health_.lost += arrival->lost_before;
    ++health_.received;
    CameraFrame frame;
    frame.lost_before = arrival->lost_before;
    while (set_.size() > 1 && set_[1].since <= arrival->exposed) set_.pop_front();
    const Setting& set = set_.front();
    TimedExposure timed = world.exposure_at(arrival->exposed);
    const double changed = set.exposure_us * std::pow(10.0, set.gain_db / 20.0) / first_exposure_us();
    constexpr double rounding = 0.01;  // as in LiveWorld
    if (std::abs(changed - 1.0) > rounding) timed.exposure.light *= changed;
    frame.frame = {world.renderer().render(timed.exposure, timed.noise_seed).gray, arrival->exposed, arrival->number};
    frame.arrived = arrival->arrived;
    frame.camera_time = arrival->exposed;
    frame.exposure_us = set.exposure_us;
    frame.gain = set.gain_db;
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
    settings.exposure_us = set_.back().exposure_us;
    settings.gain = set_.back().gain_db;
    return settings;
  }

  void adjust(double exposure_us, double gain) override { set_.push_back({now_, exposure_us, gain}); }

 private:
  struct Setting {
    nanoseconds since;  ///< for frames exposed from then on
    double exposure_us;
    double gain_db;
  };

  [[nodiscard]] double first_exposure_us() const { return 1e6 * world_->world.scenario().camera.exposure; }
  [[nodiscard]] bool died(nanoseconds time) const { return dies_at_.count() > 0 && time >= dies_at_; }

  std::shared_ptr<SharedWorld> world_;
  nanoseconds dies_at_;
  FrameSchedule schedule_;
  std::deque<Setting> set_;  ///< the one of the newest frame, and those after it
  nanoseconds now_{0};
  nanoseconds last_{0};
  CameraHealth health_;
};

}  // namespace

std::unique_ptr<Camera> in_process_camera(std::shared_ptr<SharedWorld> world, const SimulationFaults& faults,
                                          double gain_db) {
  return std::make_unique<InProcessCamera>(std::move(world), faults, gain_db);
}

}  // namespace tagdock
