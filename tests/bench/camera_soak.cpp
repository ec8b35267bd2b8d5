// 1280x1024 at 30 frames a second for as long as wanted: no frame incomplete, none lost, and what it costs.
//   tests/in_namespace build/release/tests/bench/camera_soak build/release/tagdock 600 [FOLDER]
// With a folder, the frames are recorded there, too. Prints one JSON object; exit code 1 when a frame was incomplete
// after the first, or was sent and did not come, or the recorder dropped one. "lost" counts gaps in the numbers, also
// of frames that the simulated camera could not send because the machine held it up.
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <memory>
#include <string>
#include <sys/resource.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include "app/cameras/gige.h"
#include "app/session.h"
#include "app/simulation/gige_server.h"

namespace tagdock {
namespace {

using namespace std::chrono_literals;
using std::chrono::steady_clock;

double cpu_seconds(int who) {
  rusage used{};
  ::getrusage(who, &used);
  const auto seconds = [](const timeval& time) {
    return static_cast<double>(time.tv_sec) + 1e-6 * static_cast<double>(time.tv_usec);
  };
  return seconds(used.ru_utime) + seconds(used.ru_stime);
}

double resident_megabytes() {
  std::ifstream file("/proc/self/statm");
  double pages = 0.0, resident = 0.0;
  file >> pages >> resident;
  return resident * static_cast<double>(::sysconf(_SC_PAGESIZE)) / 1e6;
}

int soak(const std::string& program, double seconds, const char* folder) {
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
      next = std::max(next + 33333us, steady_clock::now());  // a held-up machine takes fewer frames
      std::this_thread::sleep_until(next);
    }
  });
  GigeSettings settings;
  settings.address = "127.0.0.1";
  settings.client_program = {program, "camera-client"};
  auto camera = open_gige(settings, start);
  std::unique_ptr<SessionRecorder> recorder;
  if (folder != nullptr) recorder = std::make_unique<SessionRecorder>(folder, "format: 1\n", "", false);
  while (!camera->newest(0ns)) std::this_thread::sleep_for(1ms);
  const CameraHealth first = camera->health();
  const std::uint64_t sent_before = server.sent();
  const double memory_before = resident_megabytes();
  std::vector<double> delays_ms;
  const auto begin = steady_clock::now();
  const double cpu_before = cpu_seconds(RUSAGE_SELF);
  while (std::chrono::duration<double>(steady_clock::now() - begin).count() < seconds) {
    if (auto frame = camera->newest(0ns)) {
      delays_ms.push_back(
          std::chrono::duration<double, std::milli>(steady_clock::now() - start - frame->camera_time).count());
      if (recorder) recorder->frame(*frame);
    }
    std::this_thread::sleep_for(1ms);
  }
  const double took = std::chrono::duration<double>(steady_clock::now() - begin).count();
  const double own_cpu = cpu_seconds(RUSAGE_SELF) - cpu_before;
  const std::uint64_t sent = server.sent();
  const CameraHealth last = camera->health();
  const double memory_after = resident_megabytes();
  camera.reset();
  end = true;
  producer.join();
  RecorderHealth recorded;
  if (recorder) {
    recorder->finish();
    recorded = recorder->health();
  }
  std::sort(delays_ms.begin(), delays_ms.end());
  const auto quantile = [&](double part) {
    return delays_ms.at(static_cast<std::size_t>(part * static_cast<double>(delays_ms.size() - 1)));
  };
  const auto count = [](std::uint64_t after, std::uint64_t before) {
    return static_cast<unsigned long long>(after - before);
  };
  std::printf(
      "{\"seconds\": %.1f, \"sent\": %llu, \"frames\": %llu, \"taken\": %zu, \"incomplete\": %llu, \"lost\": %llu, "
      "\"overwritten\": "
      "%llu, "
      "\"restarts\": %llu, \"delay_ms\": {\"p50\": %.2f, \"p95\": %.2f, \"p99\": %.2f, \"max\": %.2f}, "
      "\"client_cpu_percent\": %.1f, \"server_and_loop_cpu_percent\": %.1f, \"memory_mb\": [%.1f, %.1f], "
      "\"recorded\": %llu, \"recorder_dropped\": %llu, \"uid\": %u}\n",
      took, count(sent, sent_before), count(last.received, first.received), delays_ms.size(),
      count(last.incomplete, first.incomplete), count(last.lost, first.lost),
      count(last.overwritten, first.overwritten), count(last.restarts, 0), quantile(0.5), quantile(0.95),
      quantile(0.99), delays_ms.back(), 100.0 * cpu_seconds(RUSAGE_CHILDREN) / took, 100.0 * own_cpu / took,
      memory_before, memory_after, count(recorded.frames_written, 0), count(recorded.frames_dropped, 0),
      static_cast<unsigned>(::getuid()));
  // Numbers that the server left out because the machine held it up are not lost on the way; one frame may be on it.
  const std::uint64_t got = last.received - first.received;
  const bool all_came = got + 1 >= sent - sent_before;
  return last.incomplete == first.incomplete && all_came && recorded.frames_dropped == 0 ? 0 : 1;
}

}  // namespace
}  // namespace tagdock

int main(int argc, char** argv) {
  const double seconds = argc > 2 ? std::atof(argv[2]) : 0.0;
  if (!(seconds > 0.0)) {
    std::fprintf(stderr, "usage: camera_soak TAGDOCK SECONDS [FOLDER]\n");
    return 2;
  }
  return tagdock::soak(argv[1], seconds, argc > 3 ? argv[3] : nullptr);
}
