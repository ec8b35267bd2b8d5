#pragma once

#include <optional>
#include <string>

#include "planning/docking_plan.h"
#include "planning/time_law.h"

namespace tagdock {

/// What the picture shows besides the plan.
struct PlanScene {
  Pose2 start;        ///< of the axle
  Pose2 goal;         ///< of the axle
  Pose2 board;        ///< foot of the board, x into the wall, same frame
  TurnLimits limits;  ///< drawn as lines in the diagram of curvature
  ViewWish view;      ///< camera place and view, board size
  KeepOut keep_out;   ///< polygons and the robot's outline
  std::string title;
  std::optional<TimeLaw> law;  ///< speeds along the way, if it can be driven
};

/// A plan (or why there is none) as an SVG picture: the way from above with the Reeds-Shepp words thin behind it and
/// what the robot sweeps along it; curvature, the bearing of the board's edges and speed over length.
std::string plan_picture(const DockingPlanResult& result, const PlanScene& scene);

}  // namespace tagdock
