#pragma once

#include <chrono>
#include <cstdint>
#include <string>

namespace tagdock {

class GigeServer;

/// One thing that a simulated camera is told to do wrong, as written on a command line or typed while it runs.
struct FaultCommand {
  enum class What { lose, freeze, stale, jump, size, silence, malformed, die, status, quit };
  What what = What::status;
  double value = 0.0;              ///< share of packets, 1 or 0 for on or off, ms of the jump, or number of datagrams
  double rate = 1000.0;            ///< malformed: datagrams a second
  std::chrono::nanoseconds at{0};  ///< after the camera began

  bool operator==(const FaultCommand&) const = default;
};

/// "[AT_S] WORD [VALUE ..]"; see fault_words().
/// @throws Failure (usage) with the text and what would be right
FaultCommand parse_fault(const std::string& text);

/// The commands, one a line, for help texts.
std::string fault_words();

/// Does it. `malformed` sends its datagrams before it returns; `die`, `status` and `quit` are the caller's.
/// @param seed  of the malformed datagrams
void apply(const FaultCommand& command, GigeServer& server, std::uint64_t seed);

}  // namespace tagdock
