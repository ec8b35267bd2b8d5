#pragma once

#include <cerrno>
#include <csignal>
#include <cstdio>
#include <cstring>
#include <spawn.h>
#include <stdexcept>
#include <string>
#include <sys/wait.h>
#include <unistd.h>
#include <vector>

namespace tagdock {

/// A program beside the test, started with its output in a pipe; killed when the test is done with it.
class Process {
 public:
  explicit Process(const std::vector<std::string>& command) {
    int ends[2];
    if (::pipe(ends) != 0) throw std::runtime_error("no pipe");
    posix_spawn_file_actions_t actions;
    ::posix_spawn_file_actions_init(&actions);
    ::posix_spawn_file_actions_adddup2(&actions, ends[1], STDOUT_FILENO);
    ::posix_spawn_file_actions_addclose(&actions, ends[0]);
    ::posix_spawn_file_actions_addclose(&actions, ends[1]);
    std::vector<char*> arguments;
    for (const std::string& word : command) arguments.push_back(const_cast<char*>(word.c_str()));
    arguments.push_back(nullptr);
    const int failed = ::posix_spawn(&id_, arguments[0], &actions, nullptr, arguments.data(), environ);
    ::posix_spawn_file_actions_destroy(&actions);
    ::close(ends[1]);
    output_ = ::fdopen(ends[0], "r");
    if (failed != 0) throw std::runtime_error("cannot start " + command.front() + ": " + std::strerror(failed));
  }
  ~Process() {
    kill();
    std::fclose(output_);
  }
  Process(const Process&) = delete;
  Process& operator=(const Process&) = delete;

  void signal(int number) const {
    if (id_ > 0) ::kill(id_, number);
  }

  /// Empty while it runs; then "exit code 5" or "signal 11".
  [[nodiscard]] std::string ended() const {
    siginfo_t end{};
    if (id_ <= 0 || ::waitid(P_PID, static_cast<id_t>(id_), &end, WEXITED | WNOHANG | WNOWAIT) != 0) return "killed";
    if (end.si_pid == 0) return {};
    return (end.si_code == CLD_EXITED ? "exit code " : "signal ") + std::to_string(end.si_status);
  }

  /// kill -9, and waits until the process is gone.
  void kill() {
    if (id_ <= 0) return;
    ::kill(id_, SIGKILL);
    ::waitpid(id_, nullptr, 0);
    id_ = 0;
  }

  /// Next line of its output; waits for it. Empty when the process ended.
  std::string line() const {
    char text[256];
    if (std::fgets(text, sizeof text, output_) == nullptr) return {};
    return std::string(text, std::strcspn(text, "\n"));
  }

 private:
  pid_t id_ = 0;
  std::FILE* output_ = nullptr;
};

}  // namespace tagdock
