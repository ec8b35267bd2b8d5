#pragma once

#include <functional>
#include <thread>

namespace tagdock {

/// Says one last thing when the program is about to die of a signal (SIGSEGV, SIGABRT and their like, a closed terminal
/// or pipe). Nothing that locks or allocates may run in a signal handler, so the handler only wakes a thread that has
/// waited for it, gives it 100 ms, and lets the signal do what it would have done. It cannot help against SIGKILL or a
/// frozen machine: the robot's own command time-out does.
/// One at a time; a second one throws std::logic_error.
class CrashStop {
 public:
  /// @param last_words  runs on a thread of its own; takes no lock that the dying thread may hold
  explicit CrashStop(std::function<void()> last_words);
  ~CrashStop();
  CrashStop(const CrashStop&) = delete;
  CrashStop& operator=(const CrashStop&) = delete;

 private:
  std::thread thread_;
};

}  // namespace tagdock
