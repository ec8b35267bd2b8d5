// From published to in the mailbox, 1280x1024 at 30 frames a second over real UDP on the loopback device.
// Run it as: tests/in_namespace build/release/tests/bench/gige_bench
#include <algorithm>
#include <atomic>
#include <chrono>
#include <map>
#include <mutex>
#include <sys/resource.h>
#include <thread>
#include <vector>

#include <benchmark/benchmark.h>

#include "app/cameras/gige.h"
#include "app/simulation/gige_server.h"

namespace tagdock {
namespace {

using namespace std::chrono_literals;
using std::chrono::nanoseconds;
using std::chrono::steady_clock;

double cpu_seconds() {
  rusage used{};
  ::getrusage(RUSAGE_SELF, &used);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
  };
  return seconds(used.ru_utime) + seconds(used.ru_stime);
}

/// Sleeps between looks, as a control loop does; the look itself costs nothing.
void streaming(benchmark::State& state) {
  GigeServerSettings served;
  served.frame_rate = 100.0;
  const auto start = steady_clock::now();
  GigeServer server(served);
  std::atomic<bool> end{false};
  std::thread producer([&] {
    const cv::Mat1b gray(served.height, served.width, static_cast<unsigned char>(100));
    auto next = steady_clock::now();
    for (std::uint64_t number = 1; !end; ++number) {
      server.publish({gray, number, steady_clock::now() - start});
      next += 33333us;
      std::this_thread::sleep_until(next);
    }
  });
  GigeSettings settings;
  settings.address = "127.0.0.1";
  settings.client_program = {TAGDOCK_PROGRAM, "camera-client"};
  const auto opening = steady_clock::now();
  const auto camera = open_gige(settings, start);
  const double open_ms = std::chrono::duration<double, std::milli>(steady_clock::now() - opening).count();
  while (!camera->newest(0ns)) std::this_thread::sleep_for(100us);
  const double first_ms = std::chrono::duration<double, std::milli>(steady_clock::now() - opening).count();

  std::vector<double> delays_ms, mapping_ms;
  const auto begin = steady_clock::now();
  const double cpu_before = cpu_seconds();
  for (auto _ : state) {
    std::optional<CameraFrame> frame;
    while (!(frame = camera->newest(0ns))) std::this_thread::sleep_for(200us);
    delays_ms.push_back(std::chrono::duration<double, std::milli>(frame->arrived - frame->camera_time).count());
    mapping_ms.push_back(std::chrono::duration<double, std::milli>(frame->frame.time - frame->camera_time).count());
  }
  const double took = std::chrono::duration<double>(steady_clock::now() - begin).count();
  const double cpu = cpu_seconds() - cpu_before;
  end = true;
  producer.join();
  const auto quantile = [](std::vector<double>& values, double part) {
    std::sort(values.begin(), values.end());
    return values[static_cast<std::size_t>(part * static_cast<double>(values.size() - 1))];
  };
  const CameraHealth health = camera->health();
  state.counters["open_ms"] = open_ms;
  state.counters["first_frame_ms"] = first_ms;
  state.counters["delay_p50_ms"] = quantile(delays_ms, 0.5);
  state.counters["delay_p95_ms"] = quantile(delays_ms, 0.95);
  state.counters["delay_p99_ms"] = quantile(delays_ms, 0.99);
  state.counters["mapped_p50_ms"] = quantile(mapping_ms, 0.5);
  state.counters["mapped_spread_ms"] = quantile(mapping_ms, 0.99) - quantile(mapping_ms, 0.01);
  state.counters["incomplete"] = static_cast<double>(health.incomplete);
  state.counters["lost"] = static_cast<double>(health.lost);
  state.counters["cpu_percent"] = 100.0 * cpu / took;
}
BENCHMARK(streaming)->Iterations(300)->Unit(benchmark::kMillisecond)->UseRealTime();

}  // namespace
}  // namespace tagdock

BENCHMARK_MAIN();
