#include "planning/docking_plan.h"

#include <algorithm>
#include <cstdio>
#include <limits>

namespace tagdock {
namespace {

// Range in which lengths and their squares stay far from overflow and rounding is far below what a robot can tell:
// a factor 1e12 around a metre, and ramps between a millionth and a million radii.
constexpr double largest_number = 1e12;
constexpr double smallest_limit = 1e-12;
constexpr double largest_heading = 1e9;  // rad; more whole turns than that are a mistake

constexpr double step_floor = 1e-3;  // m; a board cannot leave the image unseen in less

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.4g", value);
  return text;
}

TurnLimits scaled(const TurnLimits& limits, double factor) {
  // The same turn at another size: curvature goes with 1/size, sharpness with its square.
  return {limits.max_curvature * factor, limits.max_sharpness * factor * factor};
}

/// What one query needs again and again.
struct Planner {
  const Pose2& start;
  const Pose2& goal;
  const DockingPlanConfig& config;
  Pose2 seen = goal_seen_from(start, goal);
  double resolution = pose_resolution(start, goal);

  [[nodiscard]] TurnShape shape(const TurnLimits& limits) const {
    return TurnShape(limits, config.arcs ? arc_steps(limits, config.arc_wish) : 0);
  }
  [[nodiscard]] std::optional<ForwardPath> shortest(const TurnShape& turn, bool thorough) const {
    return ForwardFamily(seen, turn, config.straights, resolution).shortest(thorough);
  }
  /// Smallest factor on the limits that is enough: the softest turns whose path is not longer than `allowed`.
  [[nodiscard]] double softest(const TurnShape& full, double allowed) const {
    double soft = 0.0;
    double hard = 1.0;
    // Ten halvings: a thousandth of the limits, below what a controller can tell.
    for (int i = 0; i < 10; ++i) {
      const double middle = 0.5 * (soft + hard);
      const std::optional<ForwardPath> path = shortest(full.scaled(middle), false);
      (path && path->length <= allowed ? hard : soft) = middle;
    }
    return hard;
  }
};

/// Does a changed question have a path?
bool drivable(const Pose2& start, const Pose2& goal, const TurnShape& turn, const Straights& straights) {
  return ForwardFamily(goal_seen_from(start, goal), turn, straights, pose_resolution(start, goal))
      .shortest()
      .has_value();
}

std::string cure_of_no_room(const Planner& planner) {
  // Each single change is tried by bisection on its size; what works with the smallest share of change comes first.
  const auto smallest = [](double none, double most, const auto& works) -> std::optional<double> {
    if (!works(most)) return std::nullopt;
    double bad = none;
    double good = most;
    for (int i = 0; i < 11; ++i) {  // a two-thousandth of the range
      const double middle = 0.5 * (bad + good);
      (works(middle) ? good : bad) = middle;
    }
    return good;
  };
  std::vector<std::string> cures;
  const TurnLimits limits = planner.config.limits;
  const TurnShape turn = planner.shape(limits);
  const Straights& straights = planner.config.straights;
  if (const auto factor = smallest(1.0, 4.0, [&](double f) {
        return drivable(planner.start, planner.goal, planner.shape({limits.max_curvature, limits.max_sharpness * f}),
                        straights);
      }))
    cures.push_back("raise the sharpness from " + number(limits.max_sharpness) + " to " +
                    number(limits.max_sharpness * *factor) + " 1/m2");
  if (const auto factor = smallest(
          1.0, 4.0, [&](double f) { return drivable(planner.start, planner.goal, turn.scaled(f), straights); }))
    cures.push_back("raise curvature to " + number(limits.max_curvature * *factor) + " 1/m and sharpness to " +
                    number(limits.max_sharpness * *factor * *factor) + " 1/m2");
  const double radius = std::max(1.0 / limits.max_curvature, 1.0 / std::sqrt(limits.max_sharpness));
  if (planner.config.straights.final > 0.0) {
    if (const auto cut = smallest(0.0, planner.config.straights.final, [&](double by) {
          return drivable(planner.start, planner.goal, turn, {straights.initial, std::max(0.0, straights.final - by)});
        }))
      cures.push_back("shorten the final straight to " + number(std::max(0.0, planner.config.straights.final - *cut)) +
                      " m");
  }
  if (const auto back = smallest(0.0, 8.0 * radius, [&](double by) {
        return drivable(planner.start * Pose2{-by, 0.0, 0.0}, planner.goal, turn, straights);
      }))
    cures.push_back("start " + number(*back) + " m further back");
  if (const auto near = smallest(0.0, 4.0 * radius, [&](double by) {
        return drivable(planner.start, planner.goal * Pose2{by, 0.0, 0.0}, turn, straights);
      }))
    cures.push_back("move the approach point " + number(*near) + " m towards the board");
  std::string text;
  for (const std::string& cure : cures) text += (text.empty() ? "" : ", or ") + cure;
  return text;
}

PlanRefusal no_room(const Planner& planner) {
  const TurnLimits& limits = planner.config.limits;
  PlanRefusal refusal;
  refusal.reason = NoPlan::no_room;
  refusal.sentence = "no forward path without a loop reaches a goal " + number(planner.seen.x) + " m ahead, " +
                     number(planner.seen.y) + " m to the left and turned by " + number(degrees(planner.seen.yaw)) +
                     " deg with curvature up to " + number(limits.max_curvature) + " 1/m, sharpness up to " +
                     number(limits.max_sharpness) + " 1/m2 and a final straight of " +
                     number(planner.config.straights.final) + " m";
  if (planner.config.find_cures) refusal.cure = cure_of_no_room(planner);
  return refusal;
}

/// The wishes beyond geometry: view and keep-out.
bool acceptable(const DockingPlanConfig& config, const Path& path, double& bearing) {
  if (config.view && !keeps_view(path, *config.view, bearing)) return false;
  return keeps_clear(path, config.keep_out);
}

// Every heading of the middle straight at several softnesses is a path; the cheapest that is acceptable is taken.
std::optional<Path> acceptable_path(const Planner& planner, double softest, double shortest, DockingPlan& plan) {
  constexpr int softnesses = 5;
  constexpr int headings = 48;
  double best = std::numeric_limits<double>::infinity();
  const std::optional<ViewWish>& view = planner.config.view;
  const double limit = view ? 0.5 * view->horizontal_view - view->margin : 0.0;
  std::optional<Path> chosen;
  Path path;
  for (int i = 0; i < softnesses; ++i) {
    const double factor = softest + (1.0 - softest) * i / (softnesses - 1);
    const TurnLimits limits = scaled(planner.config.limits, factor);
    const TurnShape turn = planner.shape(limits);
    const ForwardFamily family(planner.seen, turn, planner.config.straights, planner.resolution);
    for (int j = -headings; j <= headings; ++j) {
      const std::optional<ForwardPath> forward = family.at(0.5 * std::numbers::pi * j / headings);
      if (!forward) continue;
      // A tenth of the shortest way is what full sharpness may be worth; a guess, to be settled by dockings.
      const double cost = forward->length + 0.1 * factor * shortest;
      if (cost >= best) continue;
      // The board is lost at an end of the middle straight more often than not: those two poses are looked at first.
      const double chord = turn.chord(forward->first);
      const Pose2 turned{forward->initial + chord * std::cos(0.5 * forward->first),
                         chord * std::sin(0.5 * forward->first), forward->first};
      const Pose2 before_second = turned * Pose2{forward->middle, 0.0, 0.0};
      if (view && (board_bearing(planner.start * before_second, *view) > limit ||
                   board_bearing(planner.start * turned, *view) > limit))
        continue;
      write_path(planner.start, *forward, turn, path);
      double bearing = 0.0;
      if (!acceptable(planner.config, path, bearing)) continue;
      best = cost;
      chosen = path;
      plan.largest_bearing = bearing;
      plan.sharpness = limits.max_sharpness;
    }
  }
  return chosen;
}

/// The smallest view of a lens that would keep the board in the image, margin included [rad], from the ends of the
/// segments of a coarse choice of paths: a path that needs less may exist, one that needs more was found.
double smallest_view(const Planner& planner) {
  const ViewWish& view = *planner.config.view;
  constexpr int headings = 24;
  double least = std::numbers::pi;
  const TurnShape turn = planner.shape(planner.config.limits);
  const ForwardFamily family(planner.seen, turn, planner.config.straights, planner.resolution);
  Path path;
  for (int j = -headings; j <= headings; ++j) {
    const std::optional<ForwardPath> forward = family.at(0.5 * std::numbers::pi * j / headings);
    if (!forward) continue;
    write_path(planner.start, *forward, turn, path);
    double largest = board_bearing(path.start, view);
    Pose2 at = path.start;
    for (const Segment& segment : path.segments) {
      at = pose_along(at, segment, segment.length);
      largest = std::max(largest, board_bearing(at, view));
      if (largest > least) break;
    }
    least = std::min(least, largest);
  }
  return 2.0 * (least + view.margin);
}

PlanRefusal out_of_view(const Planner& planner) {
  const ViewWish& view = *planner.config.view;
  PlanRefusal refusal;
  refusal.reason = NoPlan::tag_out_of_view;
  const double at_goal = 2.0 * (board_bearing(planner.goal, view) + view.margin);
  const double at_start = 2.0 * (board_bearing(planner.start, view) + view.margin);
  const double has = view.horizontal_view;
  const auto need = [&](const char* where, double angle) {
    refusal.sentence = std::string("the board does not fit into the image ") + where +
                       ": it needs a horizontal view of " + number(degrees(angle)) +
                       " deg with the margin, the lens has " + number(degrees(has)) + " deg";
  };
  if (at_start > has) {
    need("at the start", at_start);
    refusal.cure = "turn the robot towards the board before it starts";
  } else if (at_goal > has) {
    need("at the goal", at_goal);
    refusal.cure = "end further away from the board, or use a narrower board";
  } else {
    const double least = smallest_view(planner);
    if (least > has) {
      need("on the way", least);
      refusal.cure = "a lens of about " + number(degrees(least)) + " deg, or a start nearer to the board's axis";
    } else {
      refusal.sentence = "every path within the limits loses the board on the way, or leaves its range of " +
                         number(view.min_range) + " to " + number(view.max_range) + " m";
      refusal.cure = "a start nearer to the board's axis";
    }
  }
  return refusal;
}

std::vector<Candidate> rated(const Planner& planner) {
  const DockingPlanConfig& config = planner.config;
  const Pose2 before_run_in = planner.goal * Pose2{-config.straights.final, 0.0, 0.0};
  std::vector<Candidate> candidates;
  for (const ReedsSheppWord& found : reeds_shepp_words(planner.start, before_run_in, config.limits.max_curvature)) {
    Candidate candidate{found, "forward, but its curvature jumps by " + number(config.limits.max_curvature) + " 1/m"};
    double largest = 0.0;
    if (const int changes = found.cusps(); changes > 0)
      candidate.verdict = std::to_string(changes) + (changes == 1 ? " direction change" : " direction changes");
    else if (found.length > 0.0 && found.lengths[0] + found.lengths[1] + found.lengths[2] < 0.0)
      candidate.verdict = "driven in reverse";
    else if (config.view && !keeps_view(found.path(planner.start, config.limits.max_curvature), *config.view, largest))
      candidate.verdict = "loses the tag";
    candidates.push_back(candidate);
  }
  return candidates;
}

DockingPlan measured(const Planner& planner, DockingPlan plan) {
  plan.length = length(plan.path);
  for (const Segment& segment : plan.path.segments)
    plan.peak_curvature =
        std::max({plan.peak_curvature, std::abs(segment.curvature), std::abs(segment.end_curvature())});
  if (planner.config.list_candidates) plan.candidates = rated(planner);
  return plan;
}

}  // namespace

std::string_view word(NoPlan reason) {
  switch (reason) {
    case NoPlan::not_finite:
      return "not_finite";
    case NoPlan::too_large:
      return "too_large";
    case NoPlan::bad_limit:
      return "bad_limit";
    case NoPlan::no_room:
      return "no_room";
    case NoPlan::tag_out_of_view:
      return "tag_out_of_view";
    case NoPlan::keep_out:
      return "keep_out";
    case NoPlan::not_exact:
      return "not_exact";
  }
  return "not_exact";
}

std::optional<PlanRefusal> refuse_input(const Pose2& start, const Pose2& goal, const TurnLimits& limits) {
  if (!is_finite(start)) return PlanRefusal{NoPlan::not_finite, "the start pose is not finite", ""};
  if (!is_finite(goal)) return PlanRefusal{NoPlan::not_finite, "the goal pose is not finite", ""};
  if (!std::isfinite(limits.max_curvature) || !std::isfinite(limits.max_sharpness))
    return PlanRefusal{NoPlan::not_finite, "the limits of curvature and sharpness must be finite", ""};
  for (const Pose2& pose : {start, goal}) {
    if (std::max(std::abs(pose.x), std::abs(pose.y)) > largest_number || std::abs(pose.yaw) > largest_heading)
      return PlanRefusal{NoPlan::too_large,
                         "a pose is farther than " + number(largest_number) + " m or turned by more than " +
                             number(largest_heading) + " rad",
                         ""};
  }
  for (const double limit : {limits.max_curvature, limits.max_sharpness}) {
    if (!(limit > 0.0) || !std::isnormal(limit))
      return PlanRefusal{NoPlan::bad_limit,
                         "a limit of curvature or sharpness is " + number(limit) + "; it must be a positive number",
                         ""};
    if (limit > largest_number || limit < smallest_limit)
      return PlanRefusal{NoPlan::too_large,
                         "a limit of curvature or sharpness is " + number(limit) + "; it must lie between " +
                             number(smallest_limit) + " and " + number(largest_number),
                         ""};
  }
  return std::nullopt;
}

bool already_there(const Pose2& start, const Pose2& goal) {
  const double resolution = pose_resolution(start, goal);
  return std::abs(goal.x - start.x) <= resolution && std::abs(goal.y - start.y) <= resolution &&
         std::abs(heading_difference(start.yaw, goal.yaw)) <=
             std::numeric_limits<double>::epsilon() * (4.0 + std::abs(start.yaw) + std::abs(goal.yaw));
}

double board_bearing(const Pose2& T_station_base, const ViewWish& view) {
  const Pose2 camera = between(view.T_station_board, T_station_base * Pose2{view.camera_ahead, 0.0, 0.0});
  const double c = std::cos(camera.yaw);
  const double s = std::sin(camera.yaw);
  const double x = camera.x;
  const double y = camera.y;
  double largest = 0.0;
  for (const double edge : {-view.board_half_width, view.board_half_width}) {
    const double ahead = -x * c + (edge - y) * s;
    const double left = x * s + (edge - y) * c;
    largest = std::max(largest, std::abs(std::atan2(left, ahead)));
  }
  return largest;
}

bool keeps_view(const Path& path, const ViewWish& view, double& largest) {
  const double limit = 0.5 * view.horizontal_view - view.margin;
  largest = 0.0;
  Pose2 at = path.start;
  for (const Segment& segment : path.segments) {
    const double span = std::abs(segment.length);
    const double curvature = std::max(std::abs(segment.curvature), std::abs(segment.end_curvature()));
    double driven = 0.0;
    for (;;) {
      const Pose2 pose = pose_along(at, segment, std::copysign(driven, segment.length));
      const Pose2 camera = between(view.T_station_board, pose * Pose2{view.camera_ahead, 0.0, 0.0});
      const double range = std::hypot(camera.x, camera.y);
      const double bearing = board_bearing(pose, view);
      largest = std::max(largest, bearing);
      if (bearing > limit || range < view.min_range || range > view.max_range) return false;
      if (driven >= span) break;
      // The bearing changes by no more than the heading plus the camera's own sideways motion over the distance.
      const double speed = std::sqrt(1.0 + curvature * curvature * view.camera_ahead * view.camera_ahead);
      const double nearest = std::max(std::abs(camera.x), 0.05);
      const double rate = curvature + 2.0 * speed / nearest;
      const double room = std::min(limit - bearing, 0.5);
      const double gap = std::min(range - view.min_range, view.max_range - range) / speed;
      driven = std::min(span, driven + std::max(step_floor, std::min(room / rate, gap)));
    }
    at = pose_along(at, segment, segment.length);
  }
  return true;
}

DockingPlanResult plan_docking(const Pose2& start, const Pose2& goal, const DockingPlanConfig& config) {
  if (std::optional<PlanRefusal> refusal = refuse_input(start, goal, config.limits)) return *refusal;
  for (const double straight : {config.straights.initial, config.straights.final}) {
    if (!(straight >= 0.0) || straight > largest_number)
      return PlanRefusal{NoPlan::bad_limit, "a straight is " + number(straight) + " m; it must be zero or more", ""};
  }
  if (already_there(start, goal)) return AlreadyThere{};

  const Planner planner{start, goal, config};
  const TurnShape full = planner.shape(config.limits);
  const std::optional<ForwardPath> shortest = planner.shortest(full, true);
  if (!shortest) return no_room(planner);

  DockingPlan plan;
  plan.shortest = shortest->length;
  plan.sharpness = config.limits.max_sharpness;
  write_path(start, *shortest, full, plan.path);
  double softest = 1.0;
  if (config.softness > 0.0) {
    softest = planner.softest(full, (1.0 + config.softness) * shortest->length);
    const TurnShape soft = planner.shape(scaled(config.limits, softest));  // larger turns may ask for more arcs
    if (const std::optional<ForwardPath> chosen = planner.shortest(soft, false)) {
      write_path(start, *chosen, soft, plan.path);
      plan.sharpness = soft.limits().max_sharpness;
    }
  }
  if (!acceptable(config, plan.path, plan.largest_bearing)) {
    std::optional<Path> other = acceptable_path(planner, softest, shortest->length, plan);
    if (!other && config.view) {
      // Which of the two wishes is it?
      DockingPlanConfig view_only = config;
      view_only.keep_out.polygons.clear();
      if (config.keep_out.polygons.empty() ||
          !acceptable_path(Planner{start, goal, view_only}, softest, shortest->length, plan))
        return out_of_view(planner);
    }
    if (!other)
      return PlanRefusal{NoPlan::keep_out,
                         "every path within the limits comes nearer than " + number(config.keep_out.margin) +
                             " m to what must not be touched",
                         "start nearer to the board's axis or further back, or make room"};
    plan.path = std::move(*other);
  }
  return measured(planner, std::move(plan));
}

DockingPlanResult plan_manoeuvre(const Pose2& start, const Pose2& goal, const DockingPlanConfig& config,
                                 Driving driving) {
  if (std::optional<PlanRefusal> refusal = refuse_input(start, goal, config.limits)) return *refusal;
  if (already_there(start, goal)) return AlreadyThere{};
  const Planner planner{start, goal, config};
  const TurnShape turn = planner.shape(config.limits);
  const std::optional<Manoeuvre> found = shortest_manoeuvre(planner.seen, turn, driving, planner.resolution);
  if (!found)
    return PlanRefusal{NoPlan::not_exact, "every manoeuvre to this goal is spoilt by rounding at this scale", ""};
  DockingPlan plan;
  plan.shortest = found->length;
  plan.sharpness = config.limits.max_sharpness;
  write_path(start, *found, turn, plan.path);
  return measured(planner, std::move(plan));
}

}  // namespace tagdock
