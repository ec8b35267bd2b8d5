#pragma once

namespace tagdock {

/// Ctrl-C and SIGTERM while one of these lives: the first asks the running job to stop the robot and end; another one,
/// more than half a second later, ends the program at once.
class StopSignal {
 public:
  StopSignal();
  ~StopSignal();
  StopSignal(const StopSignal&) = delete;
  StopSignal& operator=(const StopSignal&) = delete;

  [[nodiscard]] bool requested() const;
};

}  // namespace tagdock
