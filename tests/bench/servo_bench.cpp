// What one cycle of the loop costs without images: a whole docking in the tests' planar world, and its simulated time
// over wall time.
#include <benchmark/benchmark.h>

#include "../servo/docking_run.h"

using namespace tagdock;
using namespace tagdock::test;

static void whole_docking(benchmark::State& state) {
  const Rig rig = default_rig();
  const WorldConfig physics;
  double simulated = 0.0;
  std::size_t cycles = 0;
  unsigned seed = 0;
  for (auto unused : state) {
    (void)unused;
    PlanarWorld world(rig, physics, start_pose(rig, 3.45, radians(5.0), radians(1.0)), ++seed);
    const Outcome outcome = run_docking(world, rig, DockingConfig{}, physics);
    simulated += seconds(outcome.time);
    cycles += outcome.commands.size();
  }
  state.counters["simulated_s_per_s"] = benchmark::Counter(simulated, benchmark::Counter::kIsRate);
  state.counters["cycles_per_s"] = benchmark::Counter(static_cast<double>(cycles), benchmark::Counter::kIsRate);
}
BENCHMARK(whole_docking)->Unit(benchmark::kMillisecond);

BENCHMARK_MAIN();
