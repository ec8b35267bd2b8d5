#pragma once

#include <chrono>
#include <cstdint>
#include <optional>

#include "app/simulation/world.h"

namespace tagdock {

/// Which frame of a simulated camera has arrived by now, where time is not the machine's: frame k is exposed at k
/// periods and a half, is lost or arrives after its latency.
class FrameSchedule {
 public:
  struct Arrival {
    std::uint64_t number = 0;
    std::chrono::nanoseconds exposed{0};  ///< mid-exposure
    std::chrono::nanoseconds arrived{0};
    std::uint64_t lost_before = 0;         ///< frames that never arrived since the one handed out last
    std::uint64_t overwritten_before = 0;  ///< frames that arrived, but were older than this one
  };

  /// @param dies_at  from when on nothing is exposed; zero: never
  explicit FrameSchedule(std::chrono::nanoseconds dies_at = std::chrono::nanoseconds{0}) : dies_at_(dies_at) {}

  /// The newest frame that arrived and was not handed out yet.
  std::optional<Arrival> newest(const World& world, std::chrono::nanoseconds now) {
    const std::chrono::nanoseconds period = world.frame_period();
    const auto exposed_at = [&](std::uint64_t k) { return static_cast<std::int64_t>(k) * period + period / 2; };
    std::optional<Arrival> found;
    std::uint64_t overwritten = 0;
    for (std::uint64_t k = next_; exposed_at(k) <= now; ++k) {
      if (dies_at_.count() > 0 && exposed_at(k) >= dies_at_) break;
      if (world.is_lost(k)) continue;
      const std::chrono::nanoseconds arrived = exposed_at(k) + world.latency_of(k);
      if (arrived > now) break;
      if (found) ++overwritten;
      found = Arrival{k, exposed_at(k), arrived, 0, 0};
    }
    if (!found) return std::nullopt;
    for (std::uint64_t k = next_; k < found->number; ++k)
      if (world.is_lost(k)) ++found->lost_before;
    found->overwritten_before = overwritten;
    next_ = found->number + 1;
    return found;
  }

 private:
  std::chrono::nanoseconds dies_at_;
  std::uint64_t next_ = 0;
};

}  // namespace tagdock
