#pragma once

#include <optional>

#include "planning/clothoid.h"

namespace tagdock {

/// Recut a path of arcs and straights, in place, so that every segment is a whole multiple of one length: driven at
/// constant speed, every segment then takes whole control periods. Lengths are rounded first, the sum of their errors
/// carried on; then Newton steps of least norm on the curvatures of the arcs and on the common length bring the end
/// back to the goal, to rounding. Straights stay straight, and no arc gets more curvature than allowed: one that would
/// is held there and the others take its part.
/// @param path           lines and arcs that end at `goal`
/// @param most           wanted length of a period [m], speed times period, > 0; a little less may come out
/// @param max_curvature  [1/m]
/// @param straights      least first and last straight [m]; they are rounded up
/// @return               the length of a period [m]; none if some curvature would be too large or the path is too short
///                       to be cut so: `path` is then of no use
std::optional<double> cut_to_whole_periods(Path& path, const Pose2& goal, double most, double max_curvature,
                                           const Straights& straights);

}  // namespace tagdock
