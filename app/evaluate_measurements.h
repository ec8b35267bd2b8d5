#pragma once

#include "app/verbs.h"

namespace tagdock {

/// The measurements below `tagdock evaluate`: corner-errors, accuracy-map, tracked.
void add_measurements(CLI::App& evaluate, Action& action);

}  // namespace tagdock
