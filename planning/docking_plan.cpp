#include "planning/docking_plan.h"

#include <algorithm>
#include <cstdarg>
#include <cstdio>
#include <limits>

#include "planning/whole_periods.h"

namespace tagdock {
namespace {

// Range in which lengths and their squares stay far from overflow and rounding is far below what a robot can tell:
// a factor 1e12 around a metre, and ramps between a millionth and a million radii.
constexpr double largest_number = 1e12;
constexpr double smallest_limit = 1e-12;
constexpr double largest_heading = 1e9;  // rad; more whole turns than that are a mistake

constexpr double infinity = std::numeric_limits<double>::infinity();
constexpr std::size_t longest_sentence = 600;

/// Segments of a path of so many turns with straights around them.
std::size_t most_segments(std::size_t turns, const TurnShape& shape) {
  return turns * (2 * static_cast<std::size_t>(std::max(1, shape.arc_steps())) + 4) + 1;
}

/// Write a sentence into a string that keeps its memory.
void say(std::string& into, const char* pattern, ...) __attribute__((format(printf, 2, 3)));
void say(std::string& into, const char* pattern, ...) {
  char text[longest_sentence];
  va_list arguments;
  va_start(arguments, pattern);
  const int count = std::vsnprintf(text, sizeof text, pattern, arguments);
  va_end(arguments);
  into.assign(text, static_cast<std::size_t>(std::clamp(count, 0, static_cast<int>(sizeof text) - 1)));
}

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.4g", value);
  return text;
}

/// Four digits, never less than the value: a change that is read off a refusal is large enough.
std::string number_up(double value) {
  const double unit = std::pow(10.0, std::floor(std::log10(std::max(std::abs(value), 1e-300))) - 3.0);
  return number(std::ceil(value / unit) * unit);
}

TurnLimits scaled(const TurnLimits& limits, double factor) {
  // The same turn at another size: curvature goes with 1/size, sharpness with its square.
  return {limits.max_curvature * factor, limits.max_sharpness * factor * factor};
}

/// A pose in the frame of the start, forward for backward.
Pose2 mirrored(const Pose2& pose) { return {-pose.x, pose.y, -pose.yaw}; }

/// What one query needs again and again.
struct Question {
  const Pose2& start;
  const Pose2& goal;
  const DockingPlanConfig& config;
  Path& scratch;
  bool reverse = config.reverse;
  Pose2 seen = reverse ? mirrored(goal_seen_from(start, goal)) : goal_seen_from(start, goal);
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
  [[nodiscard]] Pose2 placed(const Pose2& on_path) const { return start * (reverse ? mirrored(on_path) : on_path); }

  /// Segments of a forward path, in whole periods if asked for; false if those cannot be had.
  [[nodiscard]] bool write(const ForwardPath& forward, const TurnShape& turn, Path& path, double& period) const {
    write_path(start, forward, turn, path, reverse ? -1 : 1);
    period = 0.0;
    if (!(config.period_length > 0.0) || path.segments.empty()) return true;
    const std::optional<double> cut =
        cut_to_whole_periods(path, goal, config.period_length, config.limits.max_curvature, config.straights);
    period = cut.value_or(0.0);
    return cut.has_value();
  }
};

/// The softest turns whose path is not longer than allowed.
struct Softest {
  double factor = 1.0;  ///< on the limits of curvature; on those of sharpness its square
  std::optional<ForwardPath> path;
};

Softest softest(const Question& question, const TurnShape& full, const ForwardPath& shortest, double allowed) {
  Softest best{1.0, shortest};
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

/// The wishes beyond geometry, in the order in which they are checked.
enum class Wish { periods, view, incidence, keep_out, none };

/// The first wish that a path does not fulfil.
Wish unfulfilled(const DockingPlanConfig& config, const Path& path, double& bearing) {
  if (config.view) {
    if (!keeps_view(path, *config.view, bearing)) return Wish::view;
    if (incidence_fault(path, *config.view) > 0.0) return Wish::incidence;
  }
  return keeps_clear(path, config.keep_out) ? Wish::none : Wish::keep_out;
}

constexpr int most_softnesses = 5;
constexpr int most_headings = 48;

/// Every heading of the middle straight at several softnesses is a path: visited by rising cost, until one is taken.
/// @param visit  gets the path, its turn and its cost; true takes it
template <class Visit>
bool visit_paths(const Question& question, double soft, double shortest, int softnesses, int headings,
                 const Visit& visit) {
  struct Option {
    double cost;
    short softness, heading;
  };
  std::array<Option, static_cast<std::size_t>(most_softnesses * (2 * most_headings + 1))> options;
  std::array<std::optional<TurnShape>, static_cast<std::size_t>(most_softnesses)> turns;
  std::size_t count = 0;
  const auto angle = [headings](int heading) { return 0.5 * std::numbers::pi * heading / headings; };
  for (int i = 0; i < softnesses; ++i) {
    const double factor = softnesses > 1 ? soft + (1.0 - soft) * i / (softnesses - 1) : 1.0;
    auto& turn = turns[static_cast<std::size_t>(i)];
    turn.emplace(question.shape(scaled(question.config.limits, factor)));
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

/// The wish that hinders, if no path of the question fulfils all; Wish::none if there is one, which `plan` receives.
Wish acceptable_path(const Question& question, double soft, double shortest, int softnesses, int headings,
                     DockingPlan& plan) {
  const DockingPlanConfig& config = question.config;
  Wish farthest = Wish::periods;
  visit_paths(question, soft, shortest, softnesses, headings, [&](const ForwardPath& forward, const TurnShape& turn) {
    if (config.view) {
      // The board is lost at an end of the middle straight more often than not: those two poses are looked at first.
      const double chord = turn.chord(forward.first);
      const Pose2 turned{forward.initial + chord * std::cos(0.5 * forward.first), chord * std::sin(0.5 * forward.first),
                         forward.first};
      if (!in_view(question.placed(turned * Pose2{forward.middle, 0.0, 0.0}), *config.view) ||
          !in_view(question.placed(turned), *config.view)) {
        farthest = std::max(farthest, Wish::view);
        return false;
      }
    }
    if (!question.write(forward, turn, question.scratch, plan.period_length)) return false;
    farthest = std::max(farthest, unfulfilled(config, question.scratch, plan.largest_bearing));
    if (farthest != Wish::none) return false;
    std::swap(plan.path, question.scratch);
    plan.sharpness = turn.limits().max_sharpness;
    return true;
  });
  return farthest;
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
  /// @param works     is the question with a change of this size answered? Sizes from 0 to `most`; also asked whether
  /// to
  ///                  look closely, which costs more where the answer is no
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
void look_for_changes(Cures& cures, const Question& question, const Works& works) {
  const DockingPlanConfig& config = question.config;
  const TurnLimits& limits = config.limits;
  const double radius = turning_radius(limits);
  const double way = question.reverse ? -1.0 : 1.0;
  const auto changed = [&](const TurnLimits& new_limits, double straight, const Pose2& start, const Pose2& goal,
                           bool closely) {
    DockingPlanConfig other = config;
    other.limits = new_limits;
    other.straights.final = straight;
    return works(Question{start, goal, other, question.scratch}, closely);
  };
  const double straight = config.straights.final;
  cures.look(
      3.0, 1.0,
      [&](double by, bool closely) {
        return changed({limits.max_curvature, limits.max_sharpness * (1.0 + by)}, straight, question.start,
                       question.goal, closely);
      },
      [&](double by) {
        return "raise the sharpness from " + number(limits.max_sharpness) + " to " +
               number_up(limits.max_sharpness * (1.0 + by)) + " 1/m2";
      });
  cures.look(
      3.0, 1.0,
      [&](double by, bool closely) {
        return changed(scaled(limits, 1.0 + by), straight, question.start, question.goal, closely);
      },
      [&](double by) {
        return "raise curvature from " + number(limits.max_curvature) + " to " +
               number_up(limits.max_curvature * (1.0 + by)) + " 1/m and sharpness from " +
               number(limits.max_sharpness) + " to " + number_up(limits.max_sharpness * (1.0 + by) * (1.0 + by)) +
               " 1/m2";
      });
  if (straight > 0.0)
    cures.look(
        straight, radius,
        [&](double by, bool closely) {
          return changed(limits, std::max(0.0, straight - by), question.start, question.goal, closely);
        },
        [&](double by) {
          return "shorten the final straight from " + number(straight) + " by " + number_up(by) + " m";
        });
  cures.look(
      8.0 * radius, radius,
      [&](double by, bool closely) {
        return changed(limits, straight, question.start * Pose2{-way * by, 0.0, 0.0}, question.goal, closely);
      },
      [&](double by) { return "start " + number_up(by) + " m further back"; });
  const Pose2 from_goal = between(question.goal, question.start);
  const double aside = std::abs(from_goal.y);
  if (aside > 1e-3 * radius)
    cures.look(
        aside, radius,
        [&](double by, bool closely) {
          const Pose2 nearer{from_goal.x, from_goal.y - std::copysign(by, from_goal.y), from_goal.yaw};
          return changed(limits, straight, question.goal * nearer, question.goal, closely);
        },
        [&](double by) { return "start " + number_up(by) + " m nearer to the goal's axis"; });
  cures.look(
      4.0 * radius, radius,
      [&](double by, bool closely) {
        return changed(limits, straight, question.start, question.goal * Pose2{way * by, 0.0, 0.0}, closely);
      },
      [&](double by) { return "move the approach point " + number_up(by) + " m further ahead"; });
}

// ---- Refusals: which limit, by how much, and what would help.

void no_room(const Question& question, const TurnShape& full, PlanRefusal& refusal) {
  const TurnLimits& limits = question.config.limits;
  refusal.reason = NoPlan::no_room;
  const Pose2 goal = goal_seen_from(question.start, question.goal);
  const double lacking = question.family(full).lacking();
  char by[80] = "";
  if (lacking > 0.0 && lacking < largest_number)
    std::snprintf(by, sizeof by, ": the best path lacks %.4g m of straight", lacking);
  say(refusal.sentence,
      "no path%s without a loop reaches a goal %.4g m ahead, %.4g m to the left and turned by %.4g deg with curvature "
      "up to %.4g 1/m, sharpness up to %.4g 1/m2, an initial straight of %.4g m and a final straight of %.4g m%s",
      question.reverse ? " in reverse" : "", goal.x, goal.y, degrees(goal.yaw), limits.max_curvature,
      limits.max_sharpness, question.config.straights.initial, question.config.straights.final, by);
  if (!question.config.find_cures) return;
  Cures cures;
  look_for_changes(cures, question, [](const Question& other, bool closely) {
    return other.shortest(other.shape(other.config.limits), closely).has_value();
  });
  // Where no small change helps, a change of direction does.
  if (cures.empty()) {
    if (const auto both = shortest_manoeuvre(goal, full, Driving::both, question.resolution))
      cures.add(0.0, "allow direction changes: a manoeuvre of " + number_up(both->length) + " m exists");
  }
  refusal.cure = cures.text();
}

/// Is there a path for a changed question that fulfils every wish? Looked for coarsely.
bool answered(const Question& question) {
  const DockingPlanConfig& config = question.config;
  if (config.view && (!in_view(question.start, *config.view) || !in_view(question.goal, *config.view))) return false;
  DockingPlan plan;
  return acceptable_path(question, 1.0, 0.0, 1, 16, plan) == Wish::none;
}

/// The smallest view of a lens that would keep the board in the image, margin included [rad], from the ends of the
/// segments of a coarse choice of paths: a path that needs less may exist, one that needs more was found.
double smallest_view(const Question& question) {
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
void look_for_cures(const Question& question, PlanRefusal& refusal) {
  if (!question.config.find_cures) return;
  Cures cures;
  look_for_changes(cures, question, [](const Question& other, bool) { return answered(other); });
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
      say(refusal.sentence,
          "the board does not fit into the image %s: it needs a horizontal view of %.4g deg with the margin, the lens "
          "has %.4g deg",
          where, degrees(needs), degrees(view.horizontal_view));
    else
      say(refusal.sentence, "the board does not fit into the image %s: its edge is %.4g deg off the optical axis",
          where, degrees(board_bearing(pose, view)));
    refusal.cure.assign(cure);
  } else {
    const bool near = range < view.min_range;
    say(refusal.sentence, "the board is %.4g m from the camera %s; it must be %s %.4g m", range, where,
        near ? "at least" : "at most", near ? view.min_range : view.max_range);
    say(refusal.cure, "%s %.4g m", near ? "stand further away by" : "stand nearer by",
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
  say(refusal.sentence,
      "no tag is seen between %.4g and %.4g deg off its normal %s, where yaw is measured: the best, tag %zu, is seen "
      "at %.4g deg, %.4g deg %s",
      degrees(view.least_incidence), degrees(view.most_incidence), where, best + 1, degrees(angle), degrees(nearest),
      angle < view.least_incidence ? "too head-on" : "too flat");
  say(refusal.cure, "turn a tag of the board by %.4g deg about the vertical, or measure elsewhere", degrees(nearest));
  return true;
}

/// What no path can mend: the board is not seen well from the start or the goal.
bool hopeless(const Question& question, PlanRefusal& refusal) {
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

void out_of_view(const Question& question, PlanRefusal& refusal) {
  const ViewWish& view = *question.config.view;
  refusal.reason = NoPlan::tag_out_of_view;
  refusal.cure.clear();
  if (!question.config.find_cures) {
    say(refusal.sentence,
        "every path within the limits loses the board on the way, or leaves its range of %.4g to "
        "%.4g m",
        view.min_range, view.max_range);
    return;
  }
  const double least = smallest_view(question);
  if (least > view.horizontal_view && least < std::numbers::pi) {
    say(refusal.sentence,
        "the board does not fit into the image on the way: it needs a horizontal view of %.4g deg with the margin, the "
        "lens has %.4g deg",
        degrees(least), degrees(view.horizontal_view));
    say(refusal.cure, "a lens of about %s deg", number_up(degrees(least)).c_str());
  } else {
    say(refusal.sentence,
        "every path within the limits loses the board on the way, or leaves its range of %.4g to "
        "%.4g m",
        view.min_range, view.max_range);
  }
  look_for_cures(question, refusal);
}

void too_near(const Question& question, PlanRefusal& refusal) {
  const KeepOut& keep_out = question.config.keep_out;
  refusal.reason = NoPlan::keep_out;
  refusal.cure.clear();
  if (!question.config.find_cures) {
    say(refusal.sentence, "every path within the limits comes nearer than %.4g m to what must not be touched",
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
  say(refusal.sentence,
      "every path within the limits comes nearer than %.4g m to what must not be touched: the best one found keeps "
      "%.4g m from polygon %zu, %.4g m after the start; %.4g m are missing",
      keep_out.margin, std::max(0.0, best.room), best.polygon + 1, best.driven,
      keep_out.margin - std::max(0.0, best.room));
  look_for_cures(question, refusal);
  if (refusal.cure.empty())
    say(refusal.cure, "%s", best.room > 0.0 ? "a smaller margin, or more room" : "more room beside the way");
}

// ---- Every word, with what speaks against it.

void rate(const Question& question, const std::optional<Driving>& manoeuvre, std::vector<Candidate>& candidates) {
  const DockingPlanConfig& config = question.config;
  const bool both = manoeuvre == Driving::both;
  const double run_in = manoeuvre ? 0.0 : config.straights.final;
  const Pose2 before_run_in = question.goal * Pose2{question.reverse ? run_in : -run_in, 0.0, 0.0};
  const double curvature = config.limits.max_curvature;
  std::array<bool, 72> solved{};
  candidates.clear();
  for (const ReedsSheppWord& found : reeds_shepp_words(question.start, before_run_in, curvature)) {
    solved.at(static_cast<std::size_t>(found.number)) = true;
    Candidate candidate{found, true, ""};
    std::string against;
    const auto say_against = [&](const std::string& reason) { against += (against.empty() ? "" : ", ") + reason; };
    const Path path = found.path(question.start, curvature);
    const int changes = found.cusps();
    if (changes > 0 && !both)
      say_against(std::to_string(changes) + (changes == 1 ? " direction change" : " direction changes"));
    if (changes == 0 && !both && !path.segments.empty() && (path.segments[0].length < 0.0) != question.reverse)
      say_against(question.reverse ? "driven forward" : "driven in reverse");
    if (!both && path.segments.size() > 3) say_against(std::to_string(path.segments.size()) + " segments");
    double turned = 0.0;
    for (const Segment& segment : path.segments) turned += std::abs(segment.turn());
    if (!manoeuvre && turned > std::abs(question.seen.yaw) + std::numbers::pi) say_against("loops");
    double largest = 0.0;
    if (!manoeuvre && config.view && !keeps_view(path, *config.view, largest)) say_against("loses the tag");
    double jump = 0.0;
    double before = 0.0;
    for (const Segment& segment : path.segments) {
      jump = std::max(jump, std::abs(segment.curvature - before));
      before = segment.curvature;
    }
    jump = std::max(jump, std::abs(before));
    const bool fine = against.empty();
    if (jump > 0.0) say_against("curvature jumps by " + number(jump) + " 1/m");
    candidate.verdict = !fine        ? against
                        : jump > 0.0 ? std::string(both               ? "drivable"
                                                   : question.reverse ? "reverse"
                                                                      : "forward") +
                                           ", but its " + against
                                     : "as planned";
    candidates.push_back(std::move(candidate));
  }
  for (const ReedsSheppWord& word : reeds_shepp_table())
    if (!solved.at(static_cast<std::size_t>(word.number)))
      candidates.push_back({word, false, "does not connect these poses"});
}

void measure(const Question& question, const std::optional<Driving>& manoeuvre, DockingPlan& plan) {
  plan.length = length(plan.path);
  plan.peak_curvature = 0.0;
  for (const Segment& segment : plan.path.segments)
    plan.peak_curvature =
        std::max({plan.peak_curvature, std::abs(segment.curvature), std::abs(segment.end_curvature())});
  plan.candidates.clear();
  if (question.config.list_candidates) rate(question, manoeuvre, plan.candidates);
}

/// Poses and limits checked; true if they are fine.
bool input_fine(const Pose2& start, const Pose2& goal, const TurnLimits& limits, PlanRefusal& refusal) {
  const auto refuse = [&](NoPlan reason) -> std::string& {
    refusal.reason = reason;
    refusal.cure.clear();
    return refusal.sentence;
  };
  for (const auto& [pose, name] : {std::pair{&start, "start"}, std::pair{&goal, "goal"}}) {
    if (is_finite(*pose)) continue;
    say(refuse(NoPlan::not_finite), "the %s pose is %g, %g, %g; its numbers must be finite", name, pose->x, pose->y,
        pose->yaw);
    return false;
  }
  const std::array<std::pair<double, const char*>, 2> both = {
      {{limits.max_curvature, "curvature"}, {limits.max_sharpness, "sharpness"}}};
  for (const auto& [limit, name] : both) {
    if (std::isfinite(limit)) continue;
    say(refuse(NoPlan::not_finite), "the limit of %s is %g; it must be finite", name, limit);
    return false;
  }
  for (const auto& [pose, name] : {std::pair{&start, "start"}, std::pair{&goal, "goal"}}) {
    if (std::max(std::abs(pose->x), std::abs(pose->y)) <= largest_number && std::abs(pose->yaw) <= largest_heading)
      continue;
    say(refuse(NoPlan::too_large), "the %s pose is %g, %g, %g; places must be within %g m, headings within %g rad",
        name, pose->x, pose->y, pose->yaw, largest_number, largest_heading);
    return false;
  }
  for (const auto& [limit, name] : both) {
    if (limit > 0.0 && std::isnormal(limit)) continue;
    say(refuse(NoPlan::bad_limit), "the limit of %s is %g; it must be a positive number", name, limit);
    return false;
  }
  for (const auto& [limit, name] : both) {
    if (limit <= largest_number && limit >= smallest_limit) continue;
    say(refuse(NoPlan::too_large), "the limit of %s is %g; it must lie between %g and %g", name, limit, smallest_limit,
        largest_number);
    return false;
  }
  return true;
}

/// Wishes checked; true if they make sense.
bool wishes_fine(const DockingPlanConfig& config, PlanRefusal& refusal) {
  const auto refuse = [&](const char* name, double value, const char* right) {
    refusal.reason = std::isnan(value) ? NoPlan::not_finite : NoPlan::bad_limit;
    refusal.cure.clear();
    say(refusal.sentence, "%s is %g; it must be %s", name, value, right);
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
    case NoPlan::bad_incidence:
      return "bad_incidence";
  }
  return "not_exact";
}

std::optional<PlanRefusal> refuse_input(const Pose2& start, const Pose2& goal, const TurnLimits& limits) {
  PlanRefusal refusal;
  if (input_fine(start, goal, limits, refusal)) return std::nullopt;
  return refusal;
}

std::optional<PlanRefusal> refuse_wishes(const DockingPlanConfig& config) {
  PlanRefusal refusal;
  if (wishes_fine(config, refusal)) return std::nullopt;
  return refusal;
}

bool already_there(const Pose2& start, const Pose2& goal) {
  const double resolution = pose_resolution(start, goal);
  return std::abs(goal.x - start.x) <= resolution && std::abs(goal.y - start.y) <= resolution &&
         std::abs(heading_difference(start.yaw, goal.yaw)) <=
             std::numeric_limits<double>::epsilon() * (4.0 + std::abs(start.yaw) + std::abs(goal.yaw));
}

DockingPlanner::DockingPlanner() {
  spare_sentence_.reserve(longest_sentence);
  spare_cure_.reserve(longest_sentence);
}

void DockingPlanner::recycle() {
  if (auto* plan = std::get_if<DockingPlan>(&result_)) std::swap(spare_path_, plan->path);
  if (auto* refusal = std::get_if<PlanRefusal>(&result_)) {
    std::swap(spare_sentence_, refusal->sentence);
    std::swap(spare_cure_, refusal->cure);
  }
  result_ = AlreadyThere{};
}

DockingPlan& DockingPlanner::fresh_plan() {
  recycle();
  auto& plan = result_.emplace<DockingPlan>();
  std::swap(plan.path, spare_path_);
  plan.path.segments.clear();
  return plan;
}

PlanRefusal& DockingPlanner::fresh_refusal() {
  recycle();
  auto& refusal = result_.emplace<PlanRefusal>();
  std::swap(refusal.sentence, spare_sentence_);
  std::swap(refusal.cure, spare_cure_);
  refusal.sentence.clear();
  refusal.cure.clear();
  return refusal;
}

const DockingPlanResult& DockingPlanner::plan(const Pose2& start, const Pose2& goal, const DockingPlanConfig& config) {
  if (PlanRefusal& refusal = fresh_refusal();
      !input_fine(start, goal, config.limits, refusal) || !wishes_fine(config, refusal))
    return result_;
  recycle();
  if (already_there(start, goal)) return result_;

  const Question question{start, goal, config, scratch_};
  const TurnShape full = question.shape(config.limits);
  for (Path* path : {&spare_path_, &scratch_}) path->segments.reserve(most_segments(2, full));
  const std::optional<ForwardPath> shortest = question.shortest(full, true);
  if (!shortest) {
    PlanRefusal& refusal = fresh_refusal();
    no_room(question, full, refusal);
    if (config.list_candidates) rate(question, std::nullopt, refusal.candidates);
    return result_;
  }
  if (PlanRefusal& refusal = fresh_refusal(); hopeless(question, refusal)) {
    if (config.list_candidates) rate(question, std::nullopt, refusal.candidates);
    return result_;
  }

  DockingPlan& plan = fresh_plan();
  plan.shortest = shortest->length;
  Softest chosen{1.0, shortest};
  if (config.softness > 0.0) chosen = softest(question, full, *shortest, (1.0 + config.softness) * shortest->length);
  Wish wish = Wish::periods;
  {
    // Larger turns may ask for more arcs; then the path is solved again with them.
    const TurnShape soft = question.shape(scaled(config.limits, chosen.factor));
    if (soft.arc_steps() != full.arc_steps()) chosen.path = question.shortest(soft, false);
    plan.sharpness = soft.limits().max_sharpness;
    if (chosen.path && question.write(*chosen.path, soft, plan.path, plan.period_length))
      wish = unfulfilled(config, plan.path, plan.largest_bearing);
  }
  if (wish != Wish::none) {
    const Wish other = acceptable_path(question, chosen.factor, shortest->length, most_softnesses, most_headings, plan);
    wish = std::max(wish, other);  // the scan may see no path at all where the window of headings is narrow
  }
  switch (wish) {
    case Wish::none:
      measure(question, std::nullopt, plan);
      break;
    case Wish::view:
      out_of_view(question, fresh_refusal());
      break;
    case Wish::incidence: {
      PlanRefusal& refusal = fresh_refusal();
      refusal.reason = NoPlan::bad_incidence;
      say(refusal.sentence,
          "on every path within the limits that keeps the board in view, no tag is seen between %.4g and %.4g deg off "
          "its normal somewhere on the last %.4g m, where yaw is measured",
          degrees(config.view->least_incidence), degrees(config.view->most_incidence), config.view->measured_over_last);
      look_for_cures(question, refusal);
      break;
    }
    case Wish::keep_out:
      too_near(question, fresh_refusal());
      break;
    case Wish::periods: {
      PlanRefusal& refusal = fresh_refusal();
      refusal.reason = NoPlan::not_exact;
      say(refusal.sentence,
          "no path within the limits can be cut into segments that are whole multiples of %.4g m without more "
          "curvature "
          "than %.4g 1/m",
          config.period_length, config.limits.max_curvature);
      say(refusal.cure, "a shorter period or a lower speed, or more curvature");
      break;
    }
  }
  if (auto* refusal = std::get_if<PlanRefusal>(&result_); refusal != nullptr && config.list_candidates)
    rate(question, std::nullopt, refusal->candidates);
  return result_;
}

const DockingPlanResult& DockingPlanner::manoeuvre(const Pose2& start, const Pose2& goal,
                                                   const DockingPlanConfig& config, Driving driving) {
  if (PlanRefusal& refusal = fresh_refusal(); !input_fine(start, goal, config.limits, refusal)) return result_;
  recycle();
  if (already_there(start, goal)) return result_;
  const Question question{start, goal, config, scratch_, false};
  const TurnShape turn = question.shape(config.limits);
  spare_path_.segments.reserve(most_segments(Manoeuvre::most_turns, turn));
  const std::optional<Manoeuvre> found = shortest_manoeuvre(question.seen, turn, driving, question.resolution);
  if (!found) {
    PlanRefusal& refusal = fresh_refusal();
    refusal.reason = NoPlan::not_exact;
    say(refusal.sentence, "every manoeuvre to this goal is spoilt by rounding at this scale");
    return result_;
  }
  DockingPlan& plan = fresh_plan();
  plan.shortest = found->length;
  plan.sharpness = config.limits.max_sharpness;
  write_path(start, *found, turn, plan.path);
  measure(question, driving, plan);
  return result_;
}

DockingPlanResult plan_docking(const Pose2& start, const Pose2& goal, const DockingPlanConfig& config) {
  DockingPlanner planner;
  planner.plan(start, goal, config);
  return planner.take();
}

DockingPlanResult plan_manoeuvre(const Pose2& start, const Pose2& goal, const DockingPlanConfig& config,
                                 Driving driving) {
  DockingPlanner planner;
  planner.manoeuvre(start, goal, config, driving);
  return planner.take();
}

}  // namespace tagdock
