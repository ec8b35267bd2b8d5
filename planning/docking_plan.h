#pragma once

#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "planning/arc_approximation.h"
#include "planning/board_view.h"
#include "planning/clothoid.h"
#include "planning/keep_out.h"
#include "planning/manoeuvre.h"
#include "planning/reeds_shepp.h"

namespace tagdock {

struct DockingPlanConfig {
  TurnLimits limits;
  Straights straights{0.0, 0.3};  ///< castors are aligned when the robot comes out of the last turn
  bool arcs = true;               ///< constant-curvature output; otherwise clothoids
  ArcWish arc_wish{5, 0.0, 0.0};  ///< only with arcs
  double softness = 0.05;        ///< how much longer than the shortest a softer path may be, as a fraction; 0: shortest
  std::optional<ViewWish> view;  ///< keep the board in view; none: not asked for
  KeepOut keep_out;              ///< what the robot must not touch; empty: nothing
  bool find_cures = true;        ///< work out by how much a question is refused and what would make it drivable;
                                 ///< costs most of a refusal
  bool list_candidates = true;   ///< give every Reeds-Shepp word with the reason why it was not taken
  bool reverse = false;          ///< drive the whole path backwards: leave a dock, or dock with the back
  /// Only with arcs: every segment a whole multiple of about this length [m], the way driven in one control period at
  /// constant speed; 0: not asked for.
  double period_length = 0.0;

  bool operator==(const DockingPlanConfig&) const = default;
};

/// Why there is no plan.
enum class NoPlan {
  not_finite,       ///< a pose or a limit is NaN or infinite
  too_large,        ///< a pose or limit is outside of what can be computed exactly
  bad_limit,        ///< a limit is zero, negative or denormal, or a wish makes no sense
  no_room,          ///< no path within the limits without a loop
  tag_out_of_view,  ///< every path within the limits loses the board
  keep_out,         ///< every path within the limits (and the view) comes too near to what must not be touched
  not_exact,        ///< numerically too close to singular to hit the goal to rounding
  bad_incidence     ///< where yaw is measured, no tag is seen between the angles that are good for it
};
/// The status word of `tagdock plan`, for example "no_room".
std::string_view word(NoPlan reason);

/// A Reeds-Shepp word with the reason why it is not driven.
struct Candidate {
  ReedsSheppWord word;
  bool solved = false;  ///< does the word connect the poses at all? Otherwise it has no lengths.
  /// Why it is not driven, for example "2 direction changes, 5 segments, curvature jumps by 1.25 1/m".
  std::string verdict;
};

struct PlanRefusal {
  NoPlan reason = NoPlan::no_room;
  std::string sentence;               ///< which limit, by how much, for a person
  std::string cure;                   ///< the smallest change that makes it drivable; empty if none of those tried does
  std::vector<Candidate> candidates;  ///< as of a plan; empty where the question itself is wrong
};

/// Start and goal are the same pose to rounding: nothing to drive.
struct AlreadyThere {};

struct DockingPlan {
  Path path;
  double length = 0.0;           ///< [m]
  double shortest = 0.0;         ///< length of the shortest path within the limits [m]
  double peak_curvature = 0.0;   ///< [1/m]
  double sharpness = 0.0;        ///< of the ramps, before they become arcs [1/m^2]
  double largest_bearing = 0.0;  ///< farthest board edge from the optical axis on the way [rad]; 0 without a view wish
  double period_length = 0.0;    ///< of which every segment is a whole multiple [m]; 0: not asked for
  std::vector<Candidate> candidates;  ///< all 48, those that connect the poses first, by length
};

using DockingPlanResult = std::variant<DockingPlan, AlreadyThere, PlanRefusal>;

/// Plans again and again into the same memory: after the first answers nothing is allocated, unless candidates or cures
/// are asked for.
class DockingPlanner {
 public:
  DockingPlanner();
  /// As plan_docking. The result stays until the next question.
  const DockingPlanResult& plan(const Pose2& start, const Pose2& goal, const DockingPlanConfig& config);
  /// As plan_manoeuvre.
  const DockingPlanResult& manoeuvre(const Pose2& start, const Pose2& goal, const DockingPlanConfig& config,
                                     Driving driving);
  /// Hand the last result out.
  DockingPlanResult take() { return std::move(result_); }

 private:
  DockingPlan& fresh_plan();
  PlanRefusal& fresh_refusal();
  void recycle();

  DockingPlanResult result_ = AlreadyThere{};
  // Memory of earlier answers.
  Path spare_path_;
  Path scratch_;
  std::string spare_sentence_;
  std::string spare_cure_;
};

/// A forward path for docking: straight, turn, straight, turn, straight, curvature zero at both ends, exact at the
/// goal. The softest (least sharpness and curvature) whose length stays within (1 + softness) of the shortest, with one
/// turn instead of two where that is hardly sharper, that keeps the board in view, its tags well seen and its distance
/// from what must not be touched if asked to; or why there is none, and what would help. With `reverse` the same paths,
/// driven backwards.
/// @param start, goal  poses of the axle (base) in the station frame
DockingPlanResult plan_docking(const Pose2& start, const Pose2& goal, const DockingPlanConfig& config);

/// A manoeuvre between any two poses: loops and, with Driving::both, direction changes as they come. Straights,
/// softness and view of the configuration do not apply; `shortest` is its own length.
DockingPlanResult plan_manoeuvre(const Pose2& start, const Pose2& goal, const DockingPlanConfig& config,
                                 Driving driving);

/// Poses and limits checked before anything is computed; none if they are fine.
std::optional<PlanRefusal> refuse_input(const Pose2& start, const Pose2& goal, const TurnLimits& limits);

/// Wishes checked before anything is computed; none if they are fine.
std::optional<PlanRefusal> refuse_wishes(const DockingPlanConfig& config);

/// Start and goal cannot be told apart, to the rounding of their coordinates.
bool already_there(const Pose2& start, const Pose2& goal);

}  // namespace tagdock
