#include "planning/plan_refusal.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdarg>
#include <cstdio>
#include <limits>
#include <vector>

namespace tagdock {
namespace {

// Range in which lengths and their squares stay far from overflow and rounding is far below what a robot can tell:
// a factor 1e12 around a metre, and ramps between a millionth and a million radii.
constexpr double largest_number = 1e12;
constexpr double smallest_limit = 1e-12;
constexpr double largest_heading = 1e9;  // rad; more whole turns than that are a mistake

constexpr double infinity = std::numeric_limits<double>::infinity();

/// Four digits, never less than the value: a change that is read off a refusal is large enough.
std::string four_digits_up(double value) {
  const double unit = std::pow(10.0, std::floor(std::log10(std::max(std::abs(value), 1e-300))) - 3.0);
  return four_digits(std::ceil(value / unit) * unit);
}

// ---- What would help.

/// A change of the question with which it can be answered.
struct Cure {
  double effort = 0.0;  ///< in shares of the turning radius or of the limits: what orders unlike changes
  std::string sentence;
};

/// Collects the smallest change of each kind that works.
class Cures {
 public:
  /// @param works     is the question with a change of this size answered? Sizes from 0 to `most`; the second argument
  ///                  asks to look closely, which costs more where the answer is no
  /// @param describe  the change in words
  template <class Works, class Describe>
  void look(double most, double unit, const Works& works, const Describe& describe) {
    // Larger changes need not work where smaller ones do: the first that works, then bisection below it.
    double bad = 0.0;
    for (double good = most / 32.0; good <= most * 1.0001; bad = good, good *= 2.0) {
      if (!works(good, false)) continue;
      for (int i = 0; i < 6; ++i) {
        const double middle = 0.5 * (bad + good);
        (works(middle, true) ? good : bad) = middle;
      }
      found_.push_back({good / unit, describe(good)});
      return;
    }
  }
  [[nodiscard]] bool empty() const { return found_.empty(); }
  void add(double effort, std::string sentence) { found_.push_back({effort, std::move(sentence)}); }

  [[nodiscard]] std::string text() {
    std::stable_sort(found_.begin(), found_.end(), [](const Cure& a, const Cure& b) { return a.effort < b.effort; });
    std::string text;
    for (const Cure& cure : found_) text += (text.empty() ? "" : ", or ") + cure.sentence;
    return text;
  }

 private:
  std::vector<Cure> found_;
};

double turning_radius(const TurnLimits& limits) {
  return std::max(1.0 / limits.max_curvature, 1.0 / std::sqrt(limits.max_sharpness));
}

/// Changes of limits and poses that are tried whatever hinders.
/// @param works  is a changed question answered?
template <class Works>
void look_for_changes(Cures& cures, const PlanQuestion& question, const Works& works) {
  const DockingPlanConfig& config = question.config;
  const TurnLimits& limits = config.limits;
  const double radius = turning_radius(limits);
  const double way = question.reverse ? -1.0 : 1.0;
  const auto changed = [&](const TurnLimits& new_limits, double straight, const Pose2& start, const Pose2& goal,
                           bool closely) {
    DockingPlanConfig other = config;
    other.limits = new_limits;
    other.straights.final = straight;
    return works(PlanQuestion{start, goal, other, question.scratch}, closely);
  };
  const double straight = config.straights.final;
  cures.look(
      3.0, 1.0,
      [&](double by, bool closely) {
        return changed({limits.max_curvature, limits.max_sharpness * (1.0 + by)}, straight, question.start,
                       question.goal, closely);
      },
      [&](double by) {
        return "raise the sharpness from " + four_digits(limits.max_sharpness) + " to " +
               four_digits_up(limits.max_sharpness * (1.0 + by)) + " 1/m2";
      });
  cures.look(
      3.0, 1.0,
      [&](double by, bool closely) {
        return changed(scaled_limits(limits, 1.0 + by), straight, question.start, question.goal, closely);
      },
      [&](double by) {
        return "raise curvature from " + four_digits(limits.max_curvature) + " to " +
               four_digits_up(limits.max_curvature * (1.0 + by)) + " 1/m and sharpness from " +
               four_digits(limits.max_sharpness) + " to " +
               four_digits_up(limits.max_sharpness * (1.0 + by) * (1.0 + by)) + " 1/m2";
      });
  if (straight > 0.0)
    cures.look(
        straight, radius,
        [&](double by, bool closely) {
          return changed(limits, std::max(0.0, straight - by), question.start, question.goal, closely);
        },
        [&](double by) {
          return "shorten the final straight from " + four_digits(straight) + " by " + four_digits_up(by) + " m";
        });
  cures.look(
      8.0 * radius, radius,
      [&](double by, bool closely) {
        return changed(limits, straight, question.start * Pose2{-way * by, 0.0, 0.0}, question.goal, closely);
      },
      [&](double by) { return "start " + four_digits_up(by) + " m further back"; });
  const Pose2 from_goal = between(question.goal, question.start);
  const double aside = std::abs(from_goal.y);
  if (aside > 1e-3 * radius)
    cures.look(
        aside, radius,
        [&](double by, bool closely) {
          const Pose2 nearer{from_goal.x, from_goal.y - std::copysign(by, from_goal.y), from_goal.yaw};
          return changed(limits, straight, question.goal * nearer, question.goal, closely);
        },
        [&](double by) { return "start " + four_digits_up(by) + " m nearer to the goal's axis"; });
  cures.look(
      4.0 * radius, radius,
      [&](double by, bool closely) {
        return changed(limits, straight, question.start, question.goal * Pose2{way * by, 0.0, 0.0}, closely);
      },
      [&](double by) { return "move the approach point " + four_digits_up(by) + " m further ahead"; });
}

/// Is there a path for a changed question that fulfils every wish? Looked for coarsely.
bool answered(const PlanQuestion& question) {
  const DockingPlanConfig& config = question.config;
  if (config.view && (!in_view(question.start, *config.view) || !in_view(question.goal, *config.view))) return false;
  DockingPlan plan;
  return acceptable_path(question, 1.0, 0.0, 1, 16, plan) == PlanWish::none;
}

/// The smallest view of a lens that would keep the board in the image, margin included [rad], from the ends of the
/// segments of a coarse choice of paths: a path that needs less may exist, one that needs more was found.
double smallest_view(const PlanQuestion& question) {
  const ViewWish& view = *question.config.view;
  constexpr int headings = 24;
  double least = std::numbers::pi;
  const TurnShape turn = question.shape(question.config.limits);
  const ForwardFamily family = question.family(turn);
  Path& path = question.scratch;
  for (int j = -headings; j <= headings; ++j) {
    const std::optional<ForwardPath> forward = family.at(0.5 * std::numbers::pi * j / headings);
    double period = 0.0;
    if (!forward || !question.write(*forward, turn, path, period)) continue;
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

/// In words, for every reason of this kind, unless the cause lies in a pose that no change of the path can mend.
void look_for_cures(const PlanQuestion& question, PlanRefusal& refusal) {
  if (!question.config.find_cures) return;
  Cures cures;
  look_for_changes(cures, question, [](const PlanQuestion& other, bool) { return answered(other); });
  const std::string text = cures.text();
  if (!text.empty()) refusal.cure += (refusal.cure.empty() ? "" : ", or ") + text;
}

/// The board is not in the image, or out of range, at a pose that is given: true if that is so, and said.
bool out_of_view_at(const Pose2& pose, const char* where, const char* cure, const ViewWish& view,
                    PlanRefusal& refusal) {
  if (in_view(pose, view)) return false;
  refusal.reason = NoPlan::tag_out_of_view;
  const double needs = 2.0 * (board_bearing(pose, view) + view.margin);
  const Pose2 camera = between(view.T_station_board, pose * Pose2{view.camera_ahead, 0.0, 0.0});
  const double range = std::hypot(camera.x, camera.y);
  if (needs > view.horizontal_view) {
    if (needs < std::numbers::pi)
      write_sentence(
          refusal.sentence,
          "the board does not fit into the image %s: it needs a horizontal view of %.4g deg with the margin, the lens "
          "has %.4g deg",
          where, degrees(needs), degrees(view.horizontal_view));
    else
      write_sentence(refusal.sentence,
                     "the board does not fit into the image %s: its edge is %.4g deg off the optical axis", where,
                     degrees(board_bearing(pose, view)));
    refusal.cure.assign(cure);
  } else {
    const bool near = range < view.min_range;
    write_sentence(refusal.sentence, "the board is %.4g m from the camera %s; it must be %s %.4g m", range, where,
                   near ? "at least" : "at most", near ? view.min_range : view.max_range);
    write_sentence(refusal.cure, "%s %.4g m", near ? "stand further away by" : "stand nearer by",
                   std::abs(range - (near ? view.min_range : view.max_range)));
  }
  return true;
}

bool bad_incidence_at(const Pose2& pose, const char* where, const ViewWish& view, PlanRefusal& refusal) {
  const double fault = incidence_fault(pose, view);
  if (!(fault > 0.0)) return false;
  refusal.reason = NoPlan::bad_incidence;
  double nearest = infinity;
  std::size_t best = 0;
  for (std::size_t i = 0; i < view.tags.size(); ++i) {
    const double angle = incidence(pose, view, view.tags[i]);
    const double off = std::max(view.least_incidence - angle, angle - view.most_incidence);
    if (off < nearest) {
      nearest = off;
      best = i;
    }
  }
  const double angle = incidence(pose, view, view.tags[best]);
  write_sentence(
      refusal.sentence,
      "no tag is seen between %.4g and %.4g deg off its normal %s, where yaw is measured: the best, tag %zu, is seen "
      "at %.4g deg, %.4g deg %s",
      degrees(view.least_incidence), degrees(view.most_incidence), where, best + 1, degrees(angle), degrees(nearest),
      angle < view.least_incidence ? "too head-on" : "too flat");
  write_sentence(refusal.cure, "turn a tag of the board by %.4g deg about the vertical, or measure elsewhere",
                 degrees(nearest));
  return true;
}

}  // namespace

void write_sentence(std::string& into, const char* pattern, ...) {
  char text[longest_sentence];
  va_list arguments;
  va_start(arguments, pattern);
  const int count = std::vsnprintf(text, sizeof text, pattern, arguments);
  va_end(arguments);
  into.assign(text, static_cast<std::size_t>(std::clamp(count, 0, static_cast<int>(sizeof text) - 1)));
}

std::string four_digits(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.4g", value);
  return text;
}

// ---- Refusals: which limit, by how much, and what would help.

void refuse_no_room(const PlanQuestion& question, const TurnShape& full, PlanRefusal& refusal) {
  const TurnLimits& limits = question.config.limits;
  refusal.reason = NoPlan::no_room;
  const Pose2 goal = goal_seen_from(question.start, question.goal);
  const double lacking = question.family(full).lacking();
  char by[80] = "";
  if (lacking > 0.0 && lacking < largest_number)
    std::snprintf(by, sizeof by, ": the best path lacks %.4g m of straight", lacking);
  write_sentence(
      refusal.sentence,
      "no path%s without a loop reaches a goal %.4g m ahead, %.4g m to the left and turned by %.4g deg with curvature "
      "up to %.4g 1/m, sharpness up to %.4g 1/m2, an initial straight of %.4g m and a final straight of %.4g m%s",
      question.reverse ? " in reverse" : "", goal.x, goal.y, degrees(goal.yaw), limits.max_curvature,
      limits.max_sharpness, question.config.straights.initial, question.config.straights.final, by);
  if (!question.config.find_cures) return;
  Cures cures;
  look_for_changes(cures, question, [](const PlanQuestion& other, bool closely) {
    return other.shortest(other.shape(other.config.limits), closely).has_value();
  });
  // Where no small change helps, a change of direction does.
  if (cures.empty()) {
    if (const auto both = shortest_manoeuvre(goal, full, Driving::both, question.resolution))
      cures.add(0.0, "allow direction changes: a manoeuvre of " + four_digits_up(both->length) + " m exists");
  }
  refusal.cure = cures.text();
}

bool refuse_hopeless(const PlanQuestion& question, PlanRefusal& refusal) {
  if (!question.config.view) return false;
  const ViewWish& view = *question.config.view;
  if (out_of_view_at(question.start, "at the start", "turn the robot towards the board before it starts", view,
                     refusal) ||
      out_of_view_at(question.goal, "at the goal", "end further away from the board, or use a narrower board", view,
                     refusal))
    return true;
  return (view.measured_at_start && bad_incidence_at(question.start, "at the start", view, refusal)) ||
         (view.measured_over_last >= 0.0 && bad_incidence_at(question.goal, "at the goal", view, refusal));
}

void refuse_out_of_view(const PlanQuestion& question, PlanRefusal& refusal) {
  const ViewWish& view = *question.config.view;
  refusal.reason = NoPlan::tag_out_of_view;
  refusal.cure.clear();
  if (!question.config.find_cures) {
    write_sentence(refusal.sentence,
                   "every path within the limits loses the board on the way, or leaves its range of %.4g to "
                   "%.4g m",
                   view.min_range, view.max_range);
    return;
  }
  const double least = smallest_view(question);
  if (least > view.horizontal_view && least < std::numbers::pi) {
    write_sentence(
        refusal.sentence,
        "the board does not fit into the image on the way: it needs a horizontal view of %.4g deg with the margin, the "
        "lens has %.4g deg",
        degrees(least), degrees(view.horizontal_view));
    write_sentence(refusal.cure, "a lens of about %s deg", four_digits_up(degrees(least)).c_str());
  } else {
    write_sentence(refusal.sentence,
                   "every path within the limits loses the board on the way, or leaves its range of %.4g to "
                   "%.4g m",
                   view.min_range, view.max_range);
  }
  look_for_cures(question, refusal);
}

void refuse_too_near(const PlanQuestion& question, PlanRefusal& refusal) {
  const KeepOut& keep_out = question.config.keep_out;
  refusal.reason = NoPlan::keep_out;
  refusal.cure.clear();
  if (!question.config.find_cures) {
    write_sentence(refusal.sentence,
                   "every path within the limits comes nearer than %.4g m to what must not be touched",
                   keep_out.margin);
    return;
  }
  // The path that keeps farthest away, looked for coarsely.
  Nearest best{-1.0, 0.0, 0};
  double period = 0.0;
  visit_paths(question, 1.0, 0.0, 1, 16, [&](const ForwardPath& forward, const TurnShape& turn) {
    if (!question.write(forward, turn, question.scratch, period)) return false;
    double bearing = 0.0;
    if (question.config.view && !keeps_view(question.scratch, *question.config.view, bearing)) return false;
    const Nearest nearest = nearest_approach(question.scratch, keep_out, 0.05);
    if (nearest.room > best.room) best = nearest;
    return false;
  });
  write_sentence(
      refusal.sentence,
      "every path within the limits comes nearer than %.4g m to what must not be touched: the best one found keeps "
      "%.4g m from polygon %zu, %.4g m after the start; %.4g m are missing",
      keep_out.margin, std::max(0.0, best.room), best.polygon + 1, best.driven,
      keep_out.margin - std::max(0.0, best.room));
  look_for_cures(question, refusal);
  if (refusal.cure.empty())
    write_sentence(refusal.cure, "%s", best.room > 0.0 ? "a smaller margin, or more room" : "more room beside the way");
}

void refuse_bad_incidence(const PlanQuestion& question, PlanRefusal& refusal) {
  const ViewWish& view = *question.config.view;
  refusal.reason = NoPlan::bad_incidence;
  write_sentence(
      refusal.sentence,
      "on every path within the limits that keeps the board in view, no tag is seen between %.4g and %.4g deg off its "
      "normal somewhere on the last %.4g m, where yaw is measured",
      degrees(view.least_incidence), degrees(view.most_incidence), view.measured_over_last);
  look_for_cures(question, refusal);
}

void refuse_no_whole_periods(const PlanQuestion& question, PlanRefusal& refusal) {
  refusal.reason = NoPlan::not_exact;
  write_sentence(
      refusal.sentence,
      "no path within the limits can be cut into segments that are whole multiples of %.4g m without more curvature "
      "than "
      "%.4g 1/m",
      question.config.period_length, question.config.limits.max_curvature);
  write_sentence(refusal.cure, "a shorter period or a lower speed, or more curvature");
}

// ---- Questions that are wrong themselves.

bool input_fine(const Pose2& start, const Pose2& goal, const TurnLimits& limits, PlanRefusal& refusal) {
  const auto refuse = [&](NoPlan reason) -> std::string& {
    refusal.reason = reason;
    refusal.cure.clear();
    return refusal.sentence;
  };
  for (const auto& [pose, name] : {std::pair{&start, "start"}, std::pair{&goal, "goal"}}) {
    if (is_finite(*pose)) continue;
    write_sentence(refuse(NoPlan::not_finite), "the %s pose is %g, %g, %g; its numbers must be finite", name, pose->x,
                   pose->y, pose->yaw);
    return false;
  }
  const std::array<std::pair<double, const char*>, 2> both = {
      {{limits.max_curvature, "curvature"}, {limits.max_sharpness, "sharpness"}}};
  for (const auto& [limit, name] : both) {
    if (std::isfinite(limit)) continue;
    write_sentence(refuse(NoPlan::not_finite), "the limit of %s is %g; it must be finite", name, limit);
    return false;
  }
  for (const auto& [pose, name] : {std::pair{&start, "start"}, std::pair{&goal, "goal"}}) {
    if (std::max(std::abs(pose->x), std::abs(pose->y)) <= largest_number && std::abs(pose->yaw) <= largest_heading)
      continue;
    write_sentence(refuse(NoPlan::too_large),
                   "the %s pose is %g, %g, %g; places must be within %g m, headings within %g rad", name, pose->x,
                   pose->y, pose->yaw, largest_number, largest_heading);
    return false;
  }
  for (const auto& [limit, name] : both) {
    if (limit > 0.0 && std::isnormal(limit)) continue;
    write_sentence(refuse(NoPlan::bad_limit), "the limit of %s is %g; it must be a positive number", name, limit);
    return false;
  }
  for (const auto& [limit, name] : both) {
    if (limit <= largest_number && limit >= smallest_limit) continue;
    write_sentence(refuse(NoPlan::too_large), "the limit of %s is %g; it must lie between %g and %g", name, limit,
                   smallest_limit, largest_number);
    return false;
  }
  return true;
}

bool wishes_fine(const DockingPlanConfig& config, PlanRefusal& refusal) {
  const auto refuse = [&](const char* name, double value, const char* right) {
    refusal.reason = std::isnan(value) ? NoPlan::not_finite : NoPlan::bad_limit;
    refusal.cure.clear();
    write_sentence(refusal.sentence, "%s is %g; it must be %s", name, value, right);
    return false;
  };
  const auto length_fine = [](double value) { return value >= 0.0 && value <= largest_number; };
  const std::array<std::pair<double, const char*>, 6> lengths = {
      {{config.straights.initial, "the initial straight"},
       {config.straights.final, "the final straight"},
       {config.softness, "the softness"},
       {config.period_length, "the length of a period"},
       {config.arc_wish.deviation, "the deviation of arcs"},
       {config.arc_wish.curvature_step, "the curvature step of arcs"}}};
  for (const auto& [value, name] : lengths)
    if (!length_fine(value)) return refuse(name, value, "a number from 0 to 1e12");
  if (config.view) {
    const ViewWish& view = *config.view;
    if (!(view.horizontal_view > 0.0 && view.horizontal_view < std::numbers::pi))
      return refuse("the horizontal view", view.horizontal_view, "above 0 and below pi rad");
    if (!(view.margin >= 0.0 && view.margin < 0.5 * view.horizontal_view))
      return refuse("the margin of the view", view.margin, "0 or more and below half the view");
    if (!is_finite(view.T_station_board))
      return refuse("a number of the board's place", std::numeric_limits<double>::quiet_NaN(), "finite");
    const std::array<std::pair<double, const char*>, 5> places = {{{std::abs(view.camera_ahead), "the camera's place"},
                                                                   {std::abs(view.camera_yaw), "the camera's yaw"},
                                                                   {view.board_half_width, "half the board's width"},
                                                                   {view.min_range, "the least range"},
                                                                   {view.max_range, "the largest range"}}};
    for (const auto& [value, name] : places)
      if (!length_fine(value)) return refuse(name, value, "a number from 0 to 1e12");
    if (!(view.least_incidence >= 0.0 && view.least_incidence <= view.most_incidence))
      return refuse("the least incidence", view.least_incidence, "0 or more and not above the largest");
    if (!(view.most_incidence <= 0.5 * std::numbers::pi))
      return refuse("the largest incidence", view.most_incidence, "at most pi/2 rad");
    if (!std::isfinite(view.measured_over_last))
      return refuse("the way over which yaw is measured", view.measured_over_last, "finite");
    for (const Pose2& tag : view.tags)
      if (!is_finite(tag))
        return refuse("a number of a tag's place", std::numeric_limits<double>::quiet_NaN(), "finite");
  }
  const KeepOut& keep_out = config.keep_out;
  const std::array<std::pair<double, const char*>, 6> sizes = {{{keep_out.footprint.ahead, "the footprint ahead"},
                                                                {keep_out.footprint.behind, "the footprint behind"},
                                                                {keep_out.footprint.width, "the footprint's width"},
                                                                {keep_out.margin, "the margin around the footprint"},
                                                                {keep_out.contact_within, "the way of contact"},
                                                                {keep_out.contact_until, "the way of contact"}}};
  for (const auto& [value, name] : sizes)
    if (!length_fine(value)) return refuse(name, value, "a number from 0 to 1e12");
  for (const Polygon& polygon : keep_out.polygons) {
    if (polygon.size() < 3)
      return refuse("the number of corners of a polygon", static_cast<double>(polygon.size()), "3 or more");
    for (const Corner& corner : polygon)
      for (const double value : {corner.x, corner.y})
        if (!std::isfinite(value)) return refuse("a polygon's corner", value, "finite");
  }
  return true;
}

}  // namespace tagdock
