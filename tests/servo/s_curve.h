#pragma once

#include <array>
#include <cmath>
#include <string>
#include <variant>
#include <vector>

#include "planning/path.h"

namespace tagdock::test {

// Clothoid, arc, clothoid that turn by an angle (notes on docking, 4.7): the curvature rises over at most `ramp` to at
// most `max_curvature`.
inline void add_turn(std::vector<Segment>& segments, double angle, double max_curvature = 1.0 / 0.97,
                     double ramp = 0.4) {
  const double size = std::abs(angle);
  const double sign = angle < 0.0 ? -1.0 : 1.0;
  if (size < 1e-12) return;
  const double full = max_curvature * ramp;  // turned by the two full ramps
  const double peak = size < full ? max_curvature * std::sqrt(size / full) : max_curvature;
  const double length = ramp * peak / max_curvature;
  segments.push_back({length, 0.0, sign * peak / length});
  if (size > full) segments.push_back({(size - full) / max_curvature, sign * max_curvature, 0.0});
  segments.push_back({length, sign * peak, -sign * peak / length});
}

// A path that turns, goes straight and turns back: the tests' own planner, so that servo is tested without
// docking_plan.
inline std::variant<Path, std::string> s_curve(const Pose2& from, const Pose2& to) {
  const Pose2 T_to_from = between(to, from);
  const auto path_for = [&](double heading, double straight) {
    Path path{T_to_from, {}};
    add_turn(path.segments, heading - T_to_from.yaw);
    path.segments.push_back({straight, 0.0, 0.0});
    add_turn(path.segments, -heading);
    return path;
  };
  const double side = T_to_from.y > 0.0 ? -1.0 : 1.0;
  for (const double start : {0.05, 0.15, 0.3, 0.5, 0.7, 0.9, 1.1}) {
    double heading = side * start;
    double straight = 0.5;
    for (int i = 0; i < 40; ++i) {
      const Pose2 end = end_pose(path_for(heading, straight));
      if (std::hypot(end.x, end.y) < 1e-10) {
        if (straight < 0.0 || std::abs(heading) > 1.35) break;
        Path path = path_for(heading, straight);
        path.start = from;
        return path;
      }
      constexpr double h = 1e-6;
      const Pose2 by_heading = end_pose(path_for(heading + h, straight));
      const Pose2 by_straight = end_pose(path_for(heading, straight + h));
      const double a = (by_heading.x - end.x) / h;
      const double b = (by_straight.x - end.x) / h;
      const double c = (by_heading.y - end.y) / h;
      const double d = (by_straight.y - end.y) / h;
      const double determinant = a * d - b * c;
      if (std::abs(determinant) < 1e-12) break;
      heading -= (d * end.x - b * end.y) / determinant;
      straight -= (a * end.y - c * end.x) / determinant;
      if (!(std::abs(heading) < 3.0) || !(std::abs(straight) < 20.0)) break;
    }
  }
  return "no turn, straight and turn reach the entry";
}

}  // namespace tagdock::test
