#include "app/crash_stop.h"

#include <array>
#include <atomic>
#include <cerrno>
#include <csignal>
#include <ctime>
#include <stdexcept>
#include <unistd.h>

namespace tagdock {
namespace {

constexpr std::array<int, 8> deadly = {SIGSEGV, SIGBUS, SIGFPE, SIGILL, SIGABRT, SIGPIPE, SIGQUIT, SIGHUP};

std::atomic<bool> in_use{false};
std::atomic<bool> said{false};
std::array<int, 2> wake_up{-1, -1};  // a pipe
std::array<struct sigaction, deadly.size()> before{};

void on_deadly(int number) {
  const int saved = errno;
  const char crash = 'c';
  if (::write(wake_up[1], &crash, 1) == 1) {
    const struct timespec millisecond = {0, 1000000};
    for (int i = 0; i < 100 && !said; ++i) ::nanosleep(&millisecond, nullptr);
  }
  // As before; a fault happens again when this returns, the others are sent anew.
  for (std::size_t i = 0; i < deadly.size(); ++i)
    if (deadly[i] == number) ::sigaction(number, &before[i], nullptr);
  ::raise(number);
  errno = saved;
}

}  // namespace

CrashStop::CrashStop(std::function<void()> last_words) {
  if (in_use.exchange(true)) throw std::logic_error("only one CrashStop at a time");
  said = false;
  if (::pipe(wake_up.data()) != 0) {
    in_use = false;
    throw std::runtime_error("no pipe for the crash stop");
  }
  thread_ = std::thread([last_words = std::move(last_words)] {
    char word = 0;
    while (::read(wake_up[0], &word, 1) < 0 && errno == EINTR) {
    }
    if (word != 'c') return;
    last_words();
    said = true;
  });
  struct sigaction action = {};
  action.sa_handler = on_deadly;
  ::sigemptyset(&action.sa_mask);
  for (std::size_t i = 0; i < deadly.size(); ++i) {
    ::sigaction(deadly[i], nullptr, &before[i]);
    // What is ignored (SIGHUP under nohup) kills nobody and stays ignored.
    if (before[i].sa_handler != SIG_IGN) ::sigaction(deadly[i], &action, nullptr);
  }
}

CrashStop::~CrashStop() {
  for (std::size_t i = 0; i < deadly.size(); ++i) ::sigaction(deadly[i], &before[i], nullptr);
  const char end = 'e';
  while (::write(wake_up[1], &end, 1) < 0 && errno == EINTR) {
  }
  thread_.join();
  for (const int end_of_pipe : wake_up) ::close(end_of_pipe);
  in_use = false;
}

}  // namespace tagdock
