#pragma once

#include <string>
#include <vector>

#include "planning/docking_plan.h"

namespace tagdock {

/// What the picture shows besides the plan.
struct PlanScene {
  Pose2 start;               ///< of the axle
  Pose2 goal;                ///< of the axle
  Pose2 board;               ///< foot of the board, x into the wall, same frame
  TurnLimits limits;         ///< drawn as lines in the diagram of curvature
  ViewWish view;             ///< camera place and view, board size
  double robot_ahead = 0.4;  ///< outline of the robot before the axle [m]
  double robot_behind = 0.4;
  double robot_width = 0.6;
  std::string title;
  std::vector<Polygon> keep_out;
};

/// A plan (or why there is none) as an SVG picture: the way from above with the Reeds-Shepp words thin behind it and
/// the robot's outline along it, curvature over length, and the bearing of the board's edges over length.
std::string plan_picture(const DockingPlanResult& result, const PlanScene& scene);

}  // namespace tagdock
