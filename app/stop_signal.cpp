#include "app/stop_signal.h"

#include <atomic>
#include <csignal>
#include <cstdint>
#include <ctime>
#include <unistd.h>

#include "app/failure.h"

namespace tagdock {
namespace {

// One Ctrl-C may come twice: from the terminal to the whole group and from a script that passes it on.
constexpr std::int64_t same_request_ns = 500'000'000;

std::atomic<std::int64_t> first_ns{0};                          // of the request; 0 is none
static_assert(std::atomic<std::int64_t>::is_always_lock_free);  // what a signal may touch

std::int64_t now_ns() {
  struct timespec now = {};
  ::clock_gettime(CLOCK_MONOTONIC, &now);
  return std::int64_t{now.tv_sec} * 1'000'000'000 + now.tv_nsec;
}

void on_signal(int) {
  const std::int64_t now = now_ns();
  std::int64_t first = 0;
  if (!first_ns.compare_exchange_strong(first, now) && now - first > same_request_ns)
    ::_exit(static_cast<int>(ExitCode::interrupted));
}

}  // namespace

StopSignal::StopSignal() {
  first_ns = 0;
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
}

StopSignal::~StopSignal() {
  std::signal(SIGINT, SIG_DFL);
  std::signal(SIGTERM, SIG_DFL);
}

bool StopSignal::requested() const { return first_ns != 0; }

}  // namespace tagdock
