#pragma once

#include <memory>

#include "app/camera.h"
#include "app/simulation/shared_world.h"

namespace tagdock {

/// The simulated camera without a network: a frame is rendered when the loop asks for it, for the moment at which it
/// was exposed, and only if it has arrived by then. For simulations whose time is made by the loop.
/// Exposure and gain that are asked for brighten or darken the frames exposed from then on; the motion in them stays
/// that of the scenario's exposure, as in LiveWorld.
/// @param gain_db  at the beginning
std::unique_ptr<Camera> in_process_camera(std::shared_ptr<SharedWorld> world, const SimulationFaults& faults,
                                          double gain_db = 0.0);

}  // namespace tagdock
