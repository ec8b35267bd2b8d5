#pragma once

#include <cstdio>
#include <string>

namespace tagdock {

/// Text of a printf format: sentences and figures for people.
template <typename... Values>
std::string print(const char* format, Values... values) {
  const int length = std::snprintf(nullptr, 0, format, values...);
  std::string text(length > 0 ? static_cast<std::size_t>(length) : 0, '\0');
  std::snprintf(text.data(), text.size() + 1, format, values...);
  return text;
}

}  // namespace tagdock
