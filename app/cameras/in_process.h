#pragma once

#include <memory>

#include "app/camera.h"
#include "app/simulation/shared_world.h"

namespace tagdock {

/// The simulated camera without a network: a frame is rendered when the loop asks for it, for the moment at which it
/// was exposed, and only if it has arrived by then. For simulations whose time is made by the loop.
std::unique_ptr<Camera> in_process_camera(std::shared_ptr<SharedWorld> world, const SimulationFaults& faults);

}  // namespace tagdock
