#include "planning/docking_plan.h"

#include <algorithm>
#include <limits>

#include "planning/plan_refusal.h"
#include "planning/plan_search.h"

namespace tagdock {
namespace {

/// Segments of a path of so many turns with straights around them.
std::size_t most_segments(std::size_t turns, const TurnShape& shape) {
  return turns * (2 * static_cast<std::size_t>(std::max(1, shape.arc_steps())) + 4) + 1;
}

// ---- Every word, with what speaks against it.

void rate(const PlanQuestion& question, const std::optional<Driving>& manoeuvre, std::vector<Candidate>& candidates) {
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
    if (jump > 0.0) say_against("curvature jumps by " + four_digits(jump) + " 1/m");
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

void measure(const PlanQuestion& question, const std::optional<Driving>& manoeuvre, DockingPlan& plan) {
  plan.length = length(plan.path);
  plan.peak_curvature = 0.0;
  for (const Segment& segment : plan.path.segments)
    plan.peak_curvature =
        std::max({plan.peak_curvature, std::abs(segment.curvature), std::abs(segment.end_curvature())});
  plan.candidates.clear();
  if (question.config.list_candidates) rate(question, manoeuvre, plan.candidates);
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

  const PlanQuestion question{start, goal, config, scratch_};
  const TurnShape full = question.shape(config.limits);
  for (Path* path : {&spare_path_, &scratch_}) path->segments.reserve(most_segments(2, full));
  const std::optional<ForwardPath> shortest = question.shortest(full, true);
  if (!shortest) {
    PlanRefusal& refusal = fresh_refusal();
    refuse_no_room(question, full, refusal);
    if (config.list_candidates) rate(question, std::nullopt, refusal.candidates);
    return result_;
  }
  if (PlanRefusal& refusal = fresh_refusal(); refuse_hopeless(question, refusal)) {
    if (config.list_candidates) rate(question, std::nullopt, refusal.candidates);
    return result_;
  }

  DockingPlan& plan = fresh_plan();
  plan.shortest = shortest->length;
  SoftestTurns chosen{1.0, shortest};
  if (config.softness > 0.0)
    chosen = softest_turns(question, full, *shortest, (1.0 + config.softness) * shortest->length);
  PlanWish wish = PlanWish::periods;
  {
    // Larger turns may ask for more arcs; then the path is solved again with them.
    const TurnShape soft = question.shape(scaled_limits(config.limits, chosen.factor));
    if (soft.arc_steps() != full.arc_steps()) chosen.path = question.shortest(soft, false);
    plan.sharpness = soft.limits().max_sharpness;
    if (chosen.path && question.write(*chosen.path, soft, plan.path, plan.period_length))
      wish = unfulfilled_wish(config, plan.path, plan.largest_bearing);
  }
  if (wish != PlanWish::none) {
    const PlanWish other =
        acceptable_path(question, chosen.factor, shortest->length, most_plan_softnesses, most_plan_headings, plan);
    wish = std::max(wish, other);  // the scan may see no path at all where the window of headings is narrow
  }
  switch (wish) {
    case PlanWish::none:
      measure(question, std::nullopt, plan);
      break;
    case PlanWish::view:
      refuse_out_of_view(question, fresh_refusal());
      break;
    case PlanWish::incidence:
      refuse_bad_incidence(question, fresh_refusal());
      break;
    case PlanWish::keep_out:
      refuse_too_near(question, fresh_refusal());
      break;
    case PlanWish::periods:
      refuse_no_whole_periods(question, fresh_refusal());
      break;
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
  const PlanQuestion question{start, goal, config, scratch_, false};
  const TurnShape turn = question.shape(config.limits);
  spare_path_.segments.reserve(most_segments(Manoeuvre::most_turns, turn));
  const std::optional<Manoeuvre> found = shortest_manoeuvre(question.seen, turn, driving, question.resolution);
  if (!found) {
    PlanRefusal& refusal = fresh_refusal();
    refusal.reason = NoPlan::not_exact;
    write_sentence(refusal.sentence, "every manoeuvre to this goal is spoilt by rounding at this scale");
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
