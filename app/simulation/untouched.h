#pragma once

#include "app/simulation/scenario.h"

namespace tagdock {

/// The same world before somebody moves the dock, knocks the camera or breaks anything, as the robot is taught in it.
inline Scenario untouched(Scenario scenario) {
  scenario.residuals.camera_bump = 0.0;
  scenario.station.moved = {};
  scenario.station.sunk = scenario.station.lean = 0.0;
  scenario.faults = {};
  return scenario;
}

}  // namespace tagdock
