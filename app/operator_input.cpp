#include "app/operator_input.h"

#include <array>
#include <cerrno>
#include <poll.h>
#include <termios.h>
#include <unistd.h>

namespace tagdock {
namespace {

termios before_keys;

// A program in the background must not touch the terminal.
bool at_terminal() { return ::isatty(STDIN_FILENO) != 0 && ::tcgetpgrp(STDIN_FILENO) == ::getpgrp(); }

Request by_word(const std::string& word) {
  if (word == "pause") return Request::pause;
  if (word == "resume") return Request::resume;
  if (word == "cancel") return Request::cancel;
  if (word == "stop") return Request::stop;
  return Request::none;
}

Request by_key(char key) {
  switch (key) {
    case 'p':
      return Request::pause;
    case 'r':
      return Request::resume;
    case 'c':
      return Request::cancel;
    case 's':
    case ' ':
      return Request::stop;
    default:
      return Request::none;
  }
}

}  // namespace

OperatorInput::OperatorInput(bool words) {
  if (at_terminal() && ::tcgetattr(STDIN_FILENO, &before_keys) == 0) {
    termios raw = before_keys;
    raw.c_lflag &= ~static_cast<tcflag_t>(ICANON | ECHO);  // Ctrl-C stays a signal
    keys_ = ::tcsetattr(STDIN_FILENO, TCSANOW, &raw) == 0;
  }
  words_ = words && !keys_;
}

OperatorInput::~OperatorInput() {
  if (keys_) ::tcsetattr(STDIN_FILENO, TCSANOW, &before_keys);
}

Request OperatorInput::next() {
  if (!keys_ && !words_) return Request::none;
  pollfd ready{STDIN_FILENO, POLLIN, 0};
  std::array<char, 256> bytes{};
  while (!ended_ && text_.size() < 4096 && ::poll(&ready, 1, 0) > 0) {
    const ssize_t count = ::read(STDIN_FILENO, bytes.data(), bytes.size());
    ended_ = count == 0 || (count < 0 && errno != EINTR && errno != EAGAIN);
    if (count <= 0) break;
    text_.append(bytes.data(), static_cast<std::size_t>(count));
  }
  while (!text_.empty()) {
    Request request = Request::none;
    if (words_) {
      const std::size_t end = text_.find('\n');
      // Half a line may go on; one that nobody can end is noise.
      if (end == std::string::npos && !ended_ && text_.size() < 4096) return Request::none;
      std::string word = text_.substr(0, end);
      if (!word.empty() && word.back() == '\r') word.pop_back();
      text_.erase(0, end == std::string::npos ? end : end + 1);
      request = by_word(word);
    } else {
      request = by_key(text_.front());
      text_.erase(0, 1);
    }
    if (request != Request::none) return request;
  }
  return Request::none;
}

std::string OperatorInput::hint() const { return keys_ ? "keys: p pause, r resume, c cancel, space stop" : ""; }

}  // namespace tagdock
