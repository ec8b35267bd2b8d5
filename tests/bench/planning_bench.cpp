// Times of the planner on docking starts and random poses. With OMPL (Debian: libompl-dev) installed, its Reeds-Shepp
// distance is timed in the same process as the measure of the machine; nothing but this comparison needs it.
#include <algorithm>
#include <ctime>
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

#ifdef TAGDOCK_BENCH_OMPL
void ompl_reeds_shepp(benchmark::State& state) {
  ompl::base::ReedsSheppStateSpace space(1.0);
  ompl::base::State* from = space.allocState();
  ompl::base::State* to = space.allocState();
  const auto set = [](ompl::base::State* into, const Pose2& pose) {
    auto* se2 = into->as<ompl::base::SE2StateSpace::StateType>();
    se2->setXY(pose.x, pose.y);
    se2->setYaw(pose.yaw);
  };
  std::size_t i = 0;
  for (auto _ : state) {
    const Query& query = random_queries()[i++ % queries];
    set(from, query.start);
    set(to, query.goal);
    benchmark::DoNotOptimize(space.reedsShepp(from, to));
  }
  space.freeState(from);
  space.freeState(to);
}
BENCHMARK(ompl_reeds_shepp);
#endif

}  // namespace

BENCHMARK_MAIN();
