#include "app/simulation/live_world.h"

#include <cmath>

namespace tagdock {
namespace {

using std::chrono::nanoseconds;

// The camera's clock began at another time than the session: nothing may take the one for the other.
constexpr nanoseconds camera_clock_ahead = std::chrono::seconds(1000);

GigeServerSettings server_settings(const World& world, GigeServerSettings settings) {
  settings.width = world.rig().camera.width;
  settings.height = world.rig().camera.height;
  settings.exposure_us = 1e6 * world.scenario().camera.exposure;
  settings.frame_rate = world.scenario().camera.frame_rate;
  return settings;
}

}  // namespace

LiveWorld::LiveWorld(std::shared_ptr<SharedWorld> world, const SimulationFaults& faults,
                     std::chrono::steady_clock::time_point session_start, const GigeServerSettings& served)
    : world_(std::move(world)),
      faults_(faults),
      session_start_(session_start),
      first_exposure_us_(1e6 * world_->world.scenario().camera.exposure),
      server_(server_settings(world_->world, served)),
      exposing_([this] { expose(); }),
      sending_([this] { put_on_the_wire(); }) {}

LiveWorld::~LiveWorld() {
  {
    const std::lock_guard lock(mutex_);
    ending_ = true;
    changed_.notify_all();
  }
  exposing_.join();
  sending_.join();
}

nanoseconds LiveWorld::now() const { return std::chrono::steady_clock::now() - session_start_; }

void LiveWorld::expose() {
  std::uint64_t taken = 0;
  nanoseconds next = now() + std::chrono::milliseconds(20);
  while (true) {
    {
      // Half an exposure later its whole motion has happened.
      std::unique_lock lock(mutex_);
      const auto due = session_start_ + next + std::chrono::milliseconds(5);
      if (changed_.wait_until(lock, due, [this] { return ending_; })) return;
    }
    const nanoseconds middle = next;
    TimedExposure exposure;
    nanoseconds period{0};
    nanoseconds latency{0};
    bool lost = false;
    const Renderer* renderer = nullptr;
    {
      const std::lock_guard lock(world_->mutex);
      World& world = world_->world;
      world.advance(now());
      exposure = world.exposure_at(middle);
      period = world.frame_period();
      latency = world.latency_of(taken);
      lost = world.is_lost(taken);
      renderer = &world.renderer();
    }
    // What a client changes while it streams brightens or darkens the picture, as it does on a sensor; the motion in it
    // stays that of the exposure at the beginning.
    const ServedSettings client = server_.client();
    const double changed = client.exposure_us * std::pow(10.0, client.gain / 20.0) / first_exposure_us_;
    constexpr double rounding = 0.01;
    if (std::abs(changed - 1.0) > rounding) exposure.exposure.light *= changed;
    const std::uint64_t number = taken++;
    if (!lost) {
      ServedFrame frame{renderer->render(exposure.exposure, exposure.noise_seed).gray, number,
                        middle + camera_clock_ahead, client.exposure_us, client.gain};
      const std::lock_guard lock(mutex_);
      pending_.push_back({std::move(frame), middle + latency});
      changed_.notify_all();
    }
    next += period;
    // A machine that renders slower than the frame rate takes fewer frames; it does not fall behind.
    while (next + period < now()) next += period;
  }
}

void LiveWorld::put_on_the_wire() {
  std::unique_lock lock(mutex_);
  while (true) {
    changed_.wait(lock, [this] { return ending_ || !pending_.empty(); });
    if (ending_) return;
    const nanoseconds due = pending_.front().due;
    if (changed_.wait_until(lock, session_start_ + due, [this] { return ending_; })) return;
    const Pending pending = std::move(pending_.front());
    pending_.pop_front();
    lock.unlock();
    if (faults_.camera_dies_at_s > 0.0 && std::chrono::duration<double>(now()).count() >= faults_.camera_dies_at_s) {
      server_.stop();
      return;
    }
    server_.publish(pending.frame);
    lock.lock();
  }
}

}  // namespace tagdock
