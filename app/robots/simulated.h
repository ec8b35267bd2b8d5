#pragma once

#include <functional>
#include <memory>

#include "app/simulation/shared_world.h"
#include "servo/robot.h"

namespace tagdock {

/// The simulated robot behind the interface that every robot has.
/// @param now  session time
std::unique_ptr<Robot> simulated_robot(std::shared_ptr<SharedWorld> world, const SimulationFaults& faults,
                                       std::function<std::chrono::nanoseconds()> now);

/// A robot that stands still and ignores commands: to see what a docking would do.
std::unique_ptr<Robot> standing_robot(std::function<std::chrono::nanoseconds()> now);

}  // namespace tagdock
