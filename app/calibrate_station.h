#pragma once

#include "app/verbs.h"

namespace tagdock {

/// Adds the wizard and the station's steps (station, teach, check) to `calibrate`.
void add_calibrate_station(CLI::App& verb, Action& action);

}  // namespace tagdock
