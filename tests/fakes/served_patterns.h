#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <optional>
#include <thread>
#include <vector>

#include <opencv2/core.hpp>

#include "app/cameras/gige.h"
#include "app/simulation/gige_server.h"

namespace tagdock {

using namespace std::chrono_literals;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using std::chrono::steady_clock;

/// A picture in which every pixel tells its place and its frame's number.
inline cv::Mat1b pattern(int width, int height, std::uint64_t number) {
  cv::Mat1b gray(height, width);
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x)
      gray(y, x) = static_cast<unsigned char>(7 * x + 13 * y + 31 * static_cast<int>(number % 251));
  return gray;
}

inline bool equal(const cv::Mat1b& a, const cv::Mat1b& b) {
  return a.size() == b.size() && cv::countNonZero(a != b) == 0;
}

/// Publishes numbered patterns at a steady rate on a thread of its own, stamped with the steady clock since `start`.
class Producer {
 public:
  Producer(GigeServer& server, const GigeServerSettings& settings, steady_clock::time_point start, double rate)
      : thread_([this, &server, settings, start, rate] {
          // Few different pictures, made beforehand: making one takes longer than a period under the sanitizers.
          std::vector<cv::Mat1b> pictures;
          for (std::uint64_t i = 0; i < variety; ++i) pictures.push_back(pattern(settings.width, settings.height, i));
          auto next = steady_clock::now();
          for (std::uint64_t number = 1; !end_; ++number) {
            server.publish({pictures[number % variety], number, steady_clock::now() - start});
            next += nanoseconds(static_cast<std::int64_t>(1e9 / rate));
            std::this_thread::sleep_until(next);
          }
        }) {}
  ~Producer() {
    end_ = true;
    thread_.join();
  }
  static constexpr std::uint64_t variety = 5;

 private:
  std::atomic<bool> end_{false};
  std::thread thread_;
};

inline std::optional<CameraFrame> wait_for_frame(Camera& camera, milliseconds timeout) {
  const auto deadline = steady_clock::now() + timeout;
  while (steady_clock::now() < deadline) {
    if (auto frame = camera.newest(0ns)) return frame;
    std::this_thread::sleep_for(1ms);
  }
  return std::nullopt;
}

inline bool wait_until(milliseconds timeout, const std::function<bool()>& condition) {
  const auto deadline = steady_clock::now() + timeout;
  while (steady_clock::now() < deadline) {
    if (condition()) return true;
    std::this_thread::sleep_for(2ms);
  }
  return condition();
}

/// A small sensor where the size does not matter: the tests also run under the thread sanitizer, which looks at every
/// byte that is copied.
inline GigeServerSettings small_sensor() {
  GigeServerSettings settings;
  settings.width = 320;
  settings.height = 256;
  return settings;
}

/// A test is no program that could be its own client.
inline GigeSettings anywhere() {
  GigeSettings settings;
  settings.client_program = {GIGE_PEER, "camera-client"};
  return settings;
}

inline GigeSettings at_home() {
  GigeSettings settings = anywhere();
  settings.address = "127.0.0.1";
  return settings;
}

inline double ms_since(steady_clock::time_point then) {
  return std::chrono::duration<double, std::milli>(steady_clock::now() - then).count();
}

}  // namespace tagdock
