#pragma once

#include <mutex>
#include <optional>
#include <utility>

namespace tagdock {

/// Holds the latest value on its way from one thread to another. Nobody waits for anybody: a newer value replaces one
/// that was not taken, and an empty box gives none. The lock is held for a move only; a value that is replaced is
/// destroyed outside it.
template <typename Value>
class Mailbox {
 public:
  /// @return true if a value that nobody had taken was replaced
  bool put(Value value) {
    std::optional<Value> letter(std::move(value));
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      letter_.swap(letter);
    }
    return letter.has_value();
  }

  /// The latest value, once.
  std::optional<Value> take() {
    std::optional<Value> letter;
    const std::lock_guard<std::mutex> lock(mutex_);
    letter_.swap(letter);
    return letter;
  }

 private:
  std::mutex mutex_;
  std::optional<Value> letter_;
};

}  // namespace tagdock
