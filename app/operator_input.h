#pragma once

#include <string>

#include "servo/docking.h"

namespace tagdock {

/// What the operator asks of a running job at the terminal: a key (p pause, r resume, c cancel, space or s stop), or
/// where there is no terminal the words pause, resume, cancel, stop, one a line, on standard input.
class OperatorInput {
 public:
  /// @param words  read words from standard input although it is no terminal; a last word needs no end of line
  explicit OperatorInput(bool words);
  ~OperatorInput();
  OperatorInput(const OperatorInput&) = delete;
  OperatorInput& operator=(const OperatorInput&) = delete;

  /// The next request since the last call; never waits.
  Request next();

  /// What to tell a person about the keys; empty where none are read.
  [[nodiscard]] std::string hint() const;

 private:
  bool keys_ = false;
  bool words_ = false;
  bool ended_ = false;  ///< standard input has no more, or cannot be read
  std::string text_;    ///< read and not yet understood
};

}  // namespace tagdock
