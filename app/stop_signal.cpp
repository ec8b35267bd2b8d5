#include "app/stop_signal.h"

#include <csignal>
#include <unistd.h>

#include "app/failure.h"

namespace tagdock {
namespace {

volatile std::sig_atomic_t stop_requests = 0;

void on_signal(int) {
  stop_requests = stop_requests + 1;
  if (stop_requests > 1) ::_exit(static_cast<int>(ExitCode::interrupted));
}

}  // namespace

StopSignal::StopSignal() {
  stop_requests = 0;
  std::signal(SIGINT, on_signal);
  std::signal(SIGTERM, on_signal);
}

StopSignal::~StopSignal() {
  std::signal(SIGINT, SIG_DFL);
  std::signal(SIGTERM, SIG_DFL);
}

bool StopSignal::requested() const { return stop_requests > 0; }

}  // namespace tagdock
