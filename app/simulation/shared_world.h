#pragma once

#include <mutex>

#include "app/simulation/faults.h"
#include "app/simulation/world.h"

namespace tagdock {

/// The simulated world between the threads that let it go on: whoever touches the world holds the lock.
struct SharedWorld {
  SharedWorld(const Scenario& scenario, const Rig& calibrated, const Board& surveyed, std::uint64_t seed)
      : world(scenario, calibrated, surveyed, seed) {}
  std::mutex mutex;
  World world;
};

}  // namespace tagdock
