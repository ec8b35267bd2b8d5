#pragma once

#include <stdexcept>
#include <string>

namespace tagdock {

/// What the program tells the shell (CONTRACTS.md).
enum class ExitCode {
  done = 0,
  failed = 1,
  usage = 2,
  camera = 3,
  tag_never_seen = 4,
  robot_link = 5,
  stopped = 6,
  calibration_refused = 7,
  internal = 70,
  interrupted = 130
};

/// The set-up is wrong or a link broke: a sentence that a technician can act on, and what the shell gets.
class Failure : public std::runtime_error {
 public:
  Failure(ExitCode code, const std::string& sentence);
  [[nodiscard]] ExitCode code() const { return code_; }

 private:
  ExitCode code_;
};

}  // namespace tagdock
