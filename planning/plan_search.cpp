#include "planning/plan_search.h"

#include <cmath>

#include "planning/whole_periods.h"

namespace tagdock {

TurnLimits scaled_limits(const TurnLimits& limits, double factor) {
  return {limits.max_curvature * factor, limits.max_sharpness * factor * factor};
}

Pose2 mirrored_pose(const Pose2& pose) { return {-pose.x, pose.y, -pose.yaw}; }

bool PlanQuestion::write(const ForwardPath& forward, const TurnShape& turn, Path& path, double& period) const {
  write_path(start, forward, turn, path, reverse ? -1 : 1);
  period = 0.0;
  if (!(config.period_length > 0.0) || path.segments.empty()) return true;
  const std::optional<double> cut =
      cut_to_whole_periods(path, goal, config.period_length, config.limits.max_curvature, config.straights);
  period = cut.value_or(0.0);
  return cut.has_value();
}

SoftestTurns softest_turns(const PlanQuestion& question, const TurnShape& full, const ForwardPath& shortest,
                           double allowed) {
  SoftestTurns best{1.0, shortest};
  double soft = 0.0;
  // Ten halvings: a thousandth of the limits, below what a controller can tell.
  for (int i = 0; i < 10; ++i) {
    const double middle = 0.5 * (soft + best.factor);
    const std::optional<ForwardPath> path = question.shortest(full.scaled(middle), false);
    if (path && path->length <= allowed)
      best = {middle, path};
    else
      soft = middle;
  }
  if (best.path->first == 0.0 || best.path->second == 0.0) return best;
  // Half as many segments are worth turns that are a quarter sharper; a guess, to be settled by dockings.
  const double sharpest = std::min(1.0, 1.25 * best.factor);
  for (const double heading : {0.0, question.seen.yaw}) {
    const auto one_turn = [&](double factor) {
      const TurnShape turn = full.scaled(factor);
      std::optional<ForwardPath> path = question.family(turn).at(heading);
      if (path && path->length > allowed) path.reset();
      return path;
    };
    std::optional<ForwardPath> path = one_turn(sharpest);
    if (!path) continue;
    double low = best.factor;
    double high = sharpest;
    for (int i = 0; i < 6; ++i) {
      const double middle = 0.5 * (low + high);
      const std::optional<ForwardPath> softer = one_turn(middle);
      (softer ? high : low) = middle;
      if (softer) path = softer;
    }
    return {high, path};
  }
  return best;
}

PlanWish unfulfilled_wish(const DockingPlanConfig& config, const Path& path, double& bearing) {
  if (config.view) {
    if (!keeps_view(path, *config.view, bearing)) return PlanWish::view;
    if (incidence_fault(path, *config.view) > 0.0) return PlanWish::incidence;
  }
  return keeps_clear(path, config.keep_out) ? PlanWish::none : PlanWish::keep_out;
}

PlanWish acceptable_path(const PlanQuestion& question, double soft, double shortest, int softnesses, int headings,
                         DockingPlan& plan) {
  const DockingPlanConfig& config = question.config;
  PlanWish farthest = PlanWish::periods;
  visit_paths(question, soft, shortest, softnesses, headings, [&](const ForwardPath& forward, const TurnShape& turn) {
    if (config.view) {
      // The board is lost at an end of the middle straight more often than not: those two poses are looked at first.
      const double chord = turn.chord(forward.first);
      const Pose2 turned{forward.initial + chord * std::cos(0.5 * forward.first), chord * std::sin(0.5 * forward.first),
                         forward.first};
      if (!in_view(question.placed(turned * Pose2{forward.middle, 0.0, 0.0}), *config.view) ||
          !in_view(question.placed(turned), *config.view)) {
        farthest = std::max(farthest, PlanWish::view);
        return false;
      }
    }
    if (!question.write(forward, turn, question.scratch, plan.period_length)) return false;
    farthest = std::max(farthest, unfulfilled_wish(config, question.scratch, plan.largest_bearing));
    if (farthest != PlanWish::none) return false;
    std::swap(plan.path, question.scratch);
    plan.sharpness = turn.limits().max_sharpness;
    return true;
  });
  return farthest;
}

}  // namespace tagdock
