#pragma once

#include <algorithm>
#include <array>
#include <optional>
#include <utility>

#include "planning/docking_plan.h"

/// What docking_plan.cpp and plan_refusal.cpp share: the paths of one question, and which of them fulfil its wishes.
namespace tagdock {

/// The same turn at another size: curvature goes with 1/size, sharpness with its square.
TurnLimits scaled_limits(const TurnLimits& limits, double factor);

/// A pose in the frame of the start, forward for backward.
Pose2 mirrored_pose(const Pose2& pose);

/// What one query needs again and again.
struct PlanQuestion {
  const Pose2& start;
  const Pose2& goal;
  const DockingPlanConfig& config;
  Path& scratch;
  bool reverse = config.reverse;
  Pose2 seen = reverse ? mirrored_pose(goal_seen_from(start, goal)) : goal_seen_from(start, goal);
  double resolution = pose_resolution(start, goal);

  [[nodiscard]] TurnShape shape(const TurnLimits& limits) const {
    return TurnShape(limits, config.arcs ? arc_steps(limits, config.arc_wish) : 0);
  }
  [[nodiscard]] ForwardFamily family(const TurnShape& turn) const {
    return ForwardFamily(seen, turn, config.straights, resolution);
  }
  [[nodiscard]] std::optional<ForwardPath> shortest(const TurnShape& turn, bool thorough) const {
    return family(turn).shortest(thorough);
  }
  /// A pose of the forward path as the robot passes it.
  [[nodiscard]] Pose2 placed(const Pose2& on_path) const {
    return start * (reverse ? mirrored_pose(on_path) : on_path);
  }

  /// Segments of a forward path, in whole periods if asked for; false if those cannot be had.
  [[nodiscard]] bool write(const ForwardPath& forward, const TurnShape& turn, Path& path, double& period) const;
};

/// The softest turns whose path is not longer than allowed.
struct SoftestTurns {
  double factor = 1.0;  ///< on the limits of curvature; on those of sharpness its square
  std::optional<ForwardPath> path;
};

SoftestTurns softest_turns(const PlanQuestion& question, const TurnShape& full, const ForwardPath& shortest,
                           double allowed);

/// The wishes beyond geometry, in the order in which they are checked.
enum class PlanWish { periods, view, incidence, keep_out, none };

/// The first wish that a path does not fulfil.
PlanWish unfulfilled_wish(const DockingPlanConfig& config, const Path& path, double& bearing);

constexpr int most_plan_softnesses = 5;
constexpr int most_plan_headings = 48;

/// Every heading of the middle straight at several softnesses is a path: visited by rising cost, until one is taken.
/// @param visit  gets the path, its turn and its cost; true takes it
template <class Visit>
bool visit_paths(const PlanQuestion& question, double soft, double shortest, int softnesses, int headings,
                 const Visit& visit) {
  struct Option {
    double cost;
    short softness, heading;
  };
  std::array<Option, static_cast<std::size_t>(most_plan_softnesses * (2 * most_plan_headings + 1))> options;
  std::array<std::optional<TurnShape>, static_cast<std::size_t>(most_plan_softnesses)> turns;
  std::size_t count = 0;
  const auto angle = [headings](int heading) { return 0.5 * std::numbers::pi * heading / headings; };
  for (int i = 0; i < softnesses; ++i) {
    const double factor = softnesses > 1 ? soft + (1.0 - soft) * i / (softnesses - 1) : 1.0;
    auto& turn = turns[static_cast<std::size_t>(i)];
    turn.emplace(question.shape(scaled_limits(question.config.limits, factor)));
    const ForwardFamily family = question.family(*turn);
    for (int j = -headings; j <= headings; ++j) {
      // A tenth of the shortest way is what full sharpness may be worth; a guess, to be settled by dockings.
      if (const std::optional<ForwardPath> path = family.at(angle(j)))
        options[count++] = {path->length + 0.1 * factor * shortest, static_cast<short>(i), static_cast<short>(j)};
    }
  }
  std::sort(
      options.begin(), options.begin() + static_cast<std::ptrdiff_t>(count), [](const Option& a, const Option& b) {
        return a.cost != b.cost ? a.cost < b.cost : std::pair(a.softness, a.heading) < std::pair(b.softness, b.heading);
      });
  for (std::size_t k = 0; k < count; ++k) {
    const TurnShape& turn = *turns[static_cast<std::size_t>(options[k].softness)];
    const std::optional<ForwardPath> path = question.family(turn).at(angle(options[k].heading));
    if (path && visit(*path, turn)) return true;
  }
  return false;
}

/// The wish that hinders, if no path of the question fulfils all; PlanWish::none if there is one, which `plan`
/// receives.
PlanWish acceptable_path(const PlanQuestion& question, double soft, double shortest, int softnesses, int headings,
                         DockingPlan& plan);

}  // namespace tagdock
