#pragma once

#include <cstdlib>
#include <string>

#include <CLI/CLI.hpp>

namespace tagdock {

/// For numbers of the command line that are counts, times or seeds: 0 or more, with a sentence that a person can read.
inline CLI::Validator not_negative() {
  return {[](std::string& text) {
            char* end = nullptr;
            const double value = std::strtod(text.c_str(), &end);
            return end != text.c_str() && *end == '\0' && value >= 0.0 ? std::string()
                                                                       : text + " is no number of 0 or more";
          },
          "", "not negative"};
}

}  // namespace tagdock
