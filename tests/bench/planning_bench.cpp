// Times of the planner on docking starts and random poses. With OMPL (Debian: libompl-dev) installed, its Reeds-Shepp
// distance is timed in the same process, question by question in turn with ours, as the measure of the machine; nothing
// but this comparison needs it.
#include <algorithm>
#include <chrono>
#include <ctime>
#include <limits>
#include <random>
#include <vector>

#include <benchmark/benchmark.h>

#include "planning/docking_plan.h"
#ifdef TAGDOCK_BENCH_OMPL
#include <ompl/base/spaces/ReedsSheppStateSpace.h>
#endif

using namespace tagdock;

namespace {

struct Query {
  Pose2 start;
  Pose2 goal;
};

constexpr std::size_t queries = 1024;

const std::vector<Query>& docking_queries() {
  static const std::vector<Query> made = [] {
    std::mt19937 random(404);
    std::uniform_real_distribution<double> range(2.0, 5.5);
    std::uniform_real_distribution<double> bearing(radians(-40.0), radians(40.0));
    std::uniform_real_distribution<double> off(radians(-10.0), radians(10.0));
    std::vector<Query> all;
    while (all.size() < queries) {
      const double r = range(random);
      const double b = bearing(random);
      all.push_back({{-r * std::cos(b), r * std::sin(b), -b + off(random)}, {-1.0, 0.0, 0.0}});
    }
    return all;
  }();
  return made;
}

/// Those docking queries that have a forward path.
const std::vector<Query>& solvable_queries() {
  static const std::vector<Query> made = [] {
    const TurnShape shape({1.25, 2.5});
    std::vector<Query> all;
    for (const Query& query : docking_queries())
      if (ForwardFamily(goal_seen_from(query.start, query.goal), shape, {0.0, 0.3}, 0.0).shortest())
        all.push_back(query);
    return all;
  }();
  return made;
}

const std::vector<Query>& random_queries() {
  static const std::vector<Query> made = [] {
    std::mt19937 random(48);
    std::uniform_real_distribution<double> place(-10.0, 10.0);
    std::uniform_real_distribution<double> angle(-std::numbers::pi, std::numbers::pi);
    std::vector<Query> all;
    while (all.size() < queries)
      all.push_back({{place(random), place(random), angle(random)}, {place(random), place(random), angle(random)}});
    return all;
  }();
  return made;
}

void reeds_shepp_shortest(benchmark::State& state) {
  std::size_t i = 0;
  for (auto _ : state) {
    const Query& query = random_queries()[i++ % queries];
    benchmark::DoNotOptimize(shortest_reeds_shepp(query.start, query.goal, 1.0));
  }
}
BENCHMARK(reeds_shepp_shortest);

void reeds_shepp_all_words(benchmark::State& state) {
  std::size_t i = 0;
  for (auto _ : state) {
    const Query& query = random_queries()[i++ % queries];
    benchmark::DoNotOptimize(reeds_shepp_words(query.start, query.goal, 1.0));
  }
}
BENCHMARK(reeds_shepp_all_words);

void forward_path(benchmark::State& state) {
  const TurnShape shape({1.25, 2.5}, static_cast<int>(state.range(0)));
  const auto& all = solvable_queries();
  Path path;
  std::size_t i = 0;
  for (auto _ : state) {
    const Query& query = all[i++ % all.size()];
    const ForwardFamily family(goal_seen_from(query.start, query.goal), shape, {0.0, 0.3},
                               pose_resolution(query.start, query.goal));
    if (const auto found = family.shortest()) write_path(query.start, *found, shape, path);
    benchmark::DoNotOptimize(path);
  }
}
BENCHMARK(forward_path)->Arg(0)->Arg(5);

void manoeuvre(benchmark::State& state) {
  const TurnShape shape({1.0, 1.0});
  Path path;
  std::size_t i = 0;
  for (auto _ : state) {
    const Query& query = random_queries()[i++ % queries];
    const auto found = shortest_manoeuvre(goal_seen_from(query.start, query.goal), shape, Driving::both,
                                          pose_resolution(query.start, query.goal));
    if (found) write_path(query.start, *found, shape, path);
    benchmark::DoNotOptimize(path);
  }
}
BENCHMARK(manoeuvre);

/// Time of this thread on a processor [us]: other work on the machine does not count.
double processor_us() {
  timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e6 * static_cast<double>(now.tv_sec) + 1e-3 * static_cast<double>(now.tv_nsec);
}

/// A wall with the dock's gap before the board, and a post beside the way.
KeepOut surroundings() {
  KeepOut keep_out;
  keep_out.polygons = {{{-1.2, 0.5}, {0.0, 0.5}, {0.0, 3.0}, {-1.2, 3.0}},
                       {{-1.2, -3.0}, {0.0, -3.0}, {0.0, -0.5}, {-1.2, -0.5}},
                       {{-2.6, 1.4}, {-2.5, 1.4}, {-2.5, 1.5}, {-2.6, 1.5}}};
  keep_out.contact_within = 0.3;
  return keep_out;
}

/// Everything that a docking asks for: view, keep-out, softness.
/// @param argument  1: refusals say by how much and what would help
void full_docking_plan(benchmark::State& state) {
  DockingPlanConfig config;
  config.limits = {1.25, 2.5};
  config.view = ViewWish{};
  config.view->horizontal_view = radians(70.0);
  config.keep_out = surroundings();
  config.list_candidates = false;
  config.find_cures = state.range(0) == 1;
  DockingPlanner planner;
  std::vector<double> times;
  std::size_t i = 0;
  int solved = 0;
  for (auto _ : state) {
    const Query& query = docking_queries()[i++ % queries];
    const double begin = processor_us();
    const DockingPlanResult& result = planner.plan(query.start, query.goal, config);
    times.push_back(processor_us() - begin);
    if (std::holds_alternative<DockingPlan>(result)) ++solved;
  }
  std::sort(times.begin(), times.end());
  state.counters["p50_us"] = times[times.size() / 2];
  state.counters["p99_us"] = times[times.size() * 99 / 100];
  state.counters["p99/p50"] = times[times.size() * 99 / 100] / times[times.size() / 2];
  state.counters["solved"] = static_cast<double>(solved) / static_cast<double>(times.size());
}
BENCHMARK(full_docking_plan)->Arg(0)->Arg(1);

/// How far arcs stray from the clothoid path that they stand for.
/// @param argument  arcs per ramp
void arc_deviation(benchmark::State& state) {
  DockingPlanConfig config;
  config.limits = {1.25, 2.5};
  config.softness = 0.0;
  config.list_candidates = config.find_cures = false;
  config.arc_wish = {static_cast<int>(state.range(0)), 0.0, 0.0};
  std::vector<double> deviations;
  std::size_t most = 0;
  for (auto _ : state) {
    for (const Query& query : solvable_queries()) {
      config.arcs = false;
      const DockingPlanResult smooth = plan_docking(query.start, query.goal, config);
      config.arcs = true;
      const DockingPlanResult arcs = plan_docking(query.start, query.goal, config);
      if (!std::holds_alternative<DockingPlan>(smooth) || !std::holds_alternative<DockingPlan>(arcs)) continue;
      const Path& path = std::get<DockingPlan>(arcs).path;
      most = std::max(most, path.segments.size());
      deviations.push_back(largest_deviation(path, std::get<DockingPlan>(smooth).path, 0.01));
    }
  }
  std::sort(deviations.begin(), deviations.end());
  state.counters["p50_um"] = 1e6 * deviations[deviations.size() / 2];
  state.counters["p99_um"] = 1e6 * deviations[deviations.size() * 99 / 100];
  state.counters["max_um"] = 1e6 * deviations.back();
  state.counters["segments"] = static_cast<double>(most);
}
BENCHMARK(arc_deviation)->Arg(5)->Arg(10)->Iterations(1);

/// How long continuous-curvature manoeuvres are against the Reeds-Shepp optimum.
void manoeuvre_lengths(benchmark::State& state) {
  const TurnShape shape({1.0, 1.0});
  double sum = 0.0;
  double worst = 0.0;
  std::size_t count = 0;
  for (auto _ : state) {
    for (const Query& query : random_queries()) {
      const auto found = shortest_manoeuvre(goal_seen_from(query.start, query.goal), shape, Driving::both,
                                            pose_resolution(query.start, query.goal));
      if (!found) continue;
      const double ratio = found->length / shortest_reeds_shepp(query.start, query.goal, 1.0).length;
      sum += ratio;
      worst = std::max(worst, ratio);
      ++count;
    }
  }
  state.counters["mean_over_RS"] = sum / static_cast<double>(count);
  state.counters["max_over_RS"] = worst;
  state.counters["answered"] = static_cast<double>(count) / static_cast<double>(queries);
}
BENCHMARK(manoeuvre_lengths)->Iterations(1);

/// How long docking paths are against the shortest with jumps of curvature and without a loop.
void docking_lengths(benchmark::State& state) {
  const TurnShape shape({1.25, 2.5});
  std::vector<double> ratios;
  for (auto _ : state) {
    ratios.clear();
    for (const Query& query : docking_queries()) {
      const ForwardFamily family(goal_seen_from(query.start, query.goal), shape, {},
                                 pose_resolution(query.start, query.goal));
      const auto path = family.shortest();
      if (!path) continue;
      double least = std::numeric_limits<double>::infinity();
      for (const ReedsSheppWord& word : reeds_shepp_words(query.start, query.goal, 1.25))
        if (word.cusps() == 0 && word.lengths[0] >= 0.0 && word.lengths[1] >= 0.0 && word.lengths[2] >= 0.0)
          least = std::min(least, word.length);
      ratios.push_back(path->length / least);
    }
  }
  std::sort(ratios.begin(), ratios.end());
  state.counters["solved"] = static_cast<double>(ratios.size()) / static_cast<double>(queries);
  state.counters["over_Dubins_p50"] = ratios[ratios.size() / 2];
  state.counters["over_Dubins_p95"] = ratios[ratios.size() * 95 / 100];
}
BENCHMARK(docking_lengths)->Iterations(1);

#ifdef TAGDOCK_BENCH_OMPL
double nanoseconds() {
  return static_cast<double>(
      std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now().time_since_epoch())
          .count());
}

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

/// Question by question, theirs and ours in turn, by the clock: what else the machine does meets both.
void interleaved_with_ompl(benchmark::State& state) {
  ompl::base::ReedsSheppStateSpace random_space(1.0);
  ompl::base::ReedsSheppStateSpace docking_space(1.0 / 1.25);
  ompl::base::State* from = random_space.allocState();
  ompl::base::State* to = random_space.allocState();
  const auto set = [](ompl::base::State* into, const Pose2& pose) {
    auto* se2 = into->as<ompl::base::SE2StateSpace::StateType>();
    se2->setXY(pose.x, pose.y);
    se2->setYaw(pose.yaw);
  };
  const TurnShape shape({1.25, 2.5});
  const TurnShape arcs({1.25, 2.5}, 5);
  Path path;
  std::vector<double> theirs, words, theirs_docking, forward, forward_arcs;
  const auto timed = [](std::vector<double>& into, const auto& work) {
    const double begin = nanoseconds();
    work();
    into.push_back(nanoseconds() - begin);
  };
  std::size_t i = 0;
  const auto& solvable = solvable_queries();
  for (auto _ : state) {
    const Query& query = random_queries()[i % queries];
    const Query& docking = solvable[i % solvable.size()];
    ++i;
    set(from, query.start);
    set(to, query.goal);
    timed(theirs, [&] { benchmark::DoNotOptimize(random_space.reedsShepp(from, to)); });
    timed(words, [&] { benchmark::DoNotOptimize(shortest_reeds_shepp(query.start, query.goal, 1.0)); });
    set(from, docking.start);
    set(to, docking.goal);
    timed(theirs_docking, [&] { benchmark::DoNotOptimize(docking_space.reedsShepp(from, to)); });
    const auto plan = [&](const TurnShape& turn) {
      const ForwardFamily family(goal_seen_from(docking.start, docking.goal), turn, {0.0, 0.3},
                                 pose_resolution(docking.start, docking.goal));
      if (const auto found = family.shortest()) write_path(docking.start, *found, turn, path);
      benchmark::DoNotOptimize(path);
    };
    timed(forward, [&] { plan(shape); });
    timed(forward_arcs, [&] { plan(arcs); });
  }
  random_space.freeState(from);
  random_space.freeState(to);
  state.counters["ompl_p50_ns"] = median(theirs);
  state.counters["ompl_docking_p50_ns"] = median(theirs_docking);
  state.counters["words/ompl"] = median(words) / median(theirs);
  state.counters["forward/ompl"] = median(forward) / median(theirs);
  state.counters["forward/ompl_docking"] = median(forward) / median(theirs_docking);
  state.counters["arcs/ompl"] = median(forward_arcs) / median(theirs);
}
BENCHMARK(interleaved_with_ompl)->Iterations(40000);
#endif

}  // namespace

BENCHMARK_MAIN();
