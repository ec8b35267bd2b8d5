#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "app/session.h"
#include "app/session_replay.h"

namespace tagdock {

/// What would have been seen and done with what was changed, against what was recorded. Seen: frame by frame. Done:
/// cycle by cycle on the recorded motion, which does not follow the new commands.
struct ReplayDifference {
  std::uint64_t seen_by_both = 0;
  std::uint64_t only_recorded = 0;  ///< frames in which the board was seen then, and would not be now
  std::uint64_t only_replayed = 0;
  // Distance between the station's poses, then and now, in frames where both saw it.
  double shift_median_mm = 0.0, shift_95_mm = 0.0, shift_largest_mm = 0.0;
  double turn_median_deg = 0.0, turn_95_deg = 0.0, turn_largest_deg = 0.0;
  std::uint64_t commands_compared = 0;
  std::uint64_t commands_different = 0;
  double linear_largest = 0.0;          ///< m/s
  double angular_largest = 0.0;         ///< rad/s
  std::string first_different_command;  ///< when and what, empty if none
  std::string phases_recorded;          ///< names in order
  std::string phases_replayed;
};

ReplayDifference difference(const Session& session, const ReplayResult& result);

/// As sentences for a person.
std::string words(const ReplayDifference& difference);

}  // namespace tagdock
