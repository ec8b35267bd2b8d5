#pragma once

#include "planning/turn.h"

namespace tagdock {

/// How finely ramps are cut into arcs: the largest of what each wish needs.
struct ArcWish {
  int steps = 0;                ///< arcs per ramp; 0: decided by the other two
  double deviation = 0.0;       ///< largest lateral distance from the clothoid path [m]; 0: no wish
  double curvature_step = 0.0;  ///< largest jump of curvature between segments [1/m]; 0: no wish

  bool operator==(const ArcWish&) const = default;
};

/// Lateral deviation of one staircase ramp from its clothoid [m], to leading order in the ramp's turn:
/// sharpness h^3 (sqrt(3)/216 + 1/144), h the length of a step: swing inside a step and what the late start leaves.
double ramp_deviation(const TurnLimits& limits, int steps);

/// Arcs per ramp that fulfil a wish, between 1 and 1000. A path has up to four ramps and its turns shift a little to
/// hit the goal, so the deviation is shared out: each ramp may take half of it.
int arc_steps(const TurnLimits& limits, const ArcWish& wish);

/// Largest distance of the points of one path from another path with the same ends [m], by sampling both.
/// @param spacing  of the samples along the paths [m], > 0
double largest_deviation(const Path& path, const Path& reference, double spacing);

}  // namespace tagdock
