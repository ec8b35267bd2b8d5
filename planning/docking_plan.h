#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "planning/arc_approximation.h"
#include "planning/clothoid.h"
#include "planning/keep_out.h"
#include "planning/manoeuvre.h"
#include "planning/reeds_shepp.h"

namespace tagdock {

/// What the camera must keep in view on the whole way.
struct ViewWish {
  Pose2 T_station_board;                   ///< foot of the board, x into the wall: by definition the station's origin
  double horizontal_view = radians(55.0);  ///< full angle of the lens [rad]
  double margin = radians(1.0);            ///< kept free at both sides of the image [rad]
  double camera_ahead = 0.35;              ///< camera before the axle, looking forward [m]
  double board_half_width = 0.2;           ///< farthest tag corner from the board's centre [m]
  double min_range = 0.0;                  ///< camera to board centre [m]
  double max_range = 8.0;                  ///< [m]

  bool operator==(const ViewWish&) const = default;
};

struct DockingPlanConfig {
  TurnLimits limits;
  Straights straights{0.0, 0.3};  ///< castors are aligned when the robot comes out of the last turn
  bool arcs = true;               ///< constant-curvature output; otherwise clothoids
  ArcWish arc_wish{5, 0.0, 0.0};  ///< only with arcs
  double softness = 0.05;        ///< how much longer than the shortest a softer path may be, as a fraction; 0: shortest
  std::optional<ViewWish> view;  ///< keep the board in view; none: not asked for
  KeepOut keep_out;              ///< what the robot must not touch; empty: nothing
  bool find_cures = true;        ///< work out what would make a refused question drivable; costs most of a refusal
  bool list_candidates = true;   ///< give every Reeds-Shepp word with the reason why it was not taken

  bool operator==(const DockingPlanConfig&) const = default;
};

/// Why there is no plan.
enum class NoPlan {
  not_finite,       ///< a pose or a limit is NaN or infinite
  too_large,        ///< a pose or limit is outside of what can be computed exactly
  bad_limit,        ///< a limit is zero, negative or denormal
  no_room,          ///< no path within the limits without a loop
  tag_out_of_view,  ///< every path within the limits loses the board
  keep_out,         ///< every path within the limits (and the view) comes too near to what must not be touched
  not_exact         ///< numerically too close to singular to hit the goal to rounding
};
/// The status word of `tagdock plan`, for example "no_room".
std::string_view word(NoPlan reason);

struct PlanRefusal {
  NoPlan reason = NoPlan::no_room;
  std::string sentence;  ///< which limit, by how much, for a person
  std::string cure;      ///< the smallest change that makes it drivable; empty if none of those tried does
};

/// Start and goal are the same pose to rounding: nothing to drive.
struct AlreadyThere {};

/// A Reeds-Shepp word with the reason why it is not driven.
struct Candidate {
  ReedsSheppWord word;
  std::string verdict;  ///< "forward only, would do with curvature jumps" or why not
};

struct DockingPlan {
  Path path;
  double length = 0.0;           ///< [m]
  double shortest = 0.0;         ///< length of the shortest path within the limits [m]
  double peak_curvature = 0.0;   ///< [1/m]
  double sharpness = 0.0;        ///< of the ramps, before they become arcs [1/m^2]
  double largest_bearing = 0.0;  ///< farthest board edge from the optical axis on the way [rad]; 0 without a view wish
  std::vector<Candidate> candidates;
};

using DockingPlanResult = std::variant<DockingPlan, AlreadyThere, PlanRefusal>;

/// A forward path for docking: straight, turn, straight, turn, straight, curvature zero at both ends, exact at the
/// goal. The softest (least sharpness and curvature) whose length stays within (1 + softness) of the shortest, that
/// keeps the board in view if asked to; or why there is none, and what would help.
/// @param start, goal  poses of the axle (base) in the station frame
DockingPlanResult plan_docking(const Pose2& start, const Pose2& goal, const DockingPlanConfig& config);

/// A manoeuvre between any two poses: loops and, with Driving::both, direction changes as they come. Straights,
/// softness and view of the configuration do not apply; `shortest` is its own length.
DockingPlanResult plan_manoeuvre(const Pose2& start, const Pose2& goal, const DockingPlanConfig& config,
                                 Driving driving);

/// Poses and limits checked before anything is computed; none if they are fine.
std::optional<PlanRefusal> refuse_input(const Pose2& start, const Pose2& goal, const TurnLimits& limits);

/// Start and goal cannot be told apart, to the rounding of their coordinates.
bool already_there(const Pose2& start, const Pose2& goal);

/// Bearing of the board's edge that is farther from the optical axis [rad], for a robot at T_station_base; above half
/// the view, the board is not whole in the image. Behind the camera counts as pi.
double board_bearing(const Pose2& T_station_base, const ViewWish& view);

/// Does the board stay in view along a path? Checked in steps that the bearing cannot outrun, down to 1 mm.
/// @param largest  receives the largest bearing met [rad]
bool keeps_view(const Path& path, const ViewWish& view, double& largest);

}  // namespace tagdock
