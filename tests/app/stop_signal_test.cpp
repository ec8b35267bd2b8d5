#include "app/stop_signal.h"

#include <chrono>
#include <csignal>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "app/crash_stop.h"

using namespace tagdock;

namespace {

// What a process of its own comes to: its exit code, or 128 and the signal that ended it.
template <class Job>
int in_child(const Job& job) {
  const pid_t child = ::fork();
  if (child == 0) ::_exit(job());
  int status = 0;
  REQUIRE(::waitpid(child, &status, 0) == child);
  return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
}

}  // namespace

TEST_CASE("two stop signals at once are one request, and a second one later ends the program") {
  // A terminal and the shell's job control both pass a Ctrl-C on, and `timeout` sends its signal twice.
  CHECK(in_child([] {
          const StopSignal signal;
          ::raise(SIGINT);
          ::raise(SIGTERM);
          return signal.requested() ? 7 : 8;
        }) == 7);
  CHECK(in_child([] {
          const StopSignal signal;
          ::raise(SIGINT);
          std::this_thread::sleep_for(std::chrono::milliseconds(600));
          ::raise(SIGINT);
          return 8;
        }) == 130);
}

TEST_CASE("a signal that is ignored stays ignored beside a crash stop") {
  // nohup: the docking outlives its terminal.
  const auto said = [](bool ignored) {
    return in_child([ignored] {
      std::signal(SIGHUP, ignored ? SIG_IGN : SIG_DFL);
      const CrashStop stop([] { ::_exit(9); });
      ::raise(SIGHUP);
      return 7;
    });
  };
  CHECK(said(true) == 7);
  CHECK(said(false) == 9);
}
