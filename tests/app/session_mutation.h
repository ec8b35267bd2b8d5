#pragma once

#include <cstdint>
#include <filesystem>
#include <random>
#include <string>

namespace tagdock {

/// Damages a recording as disks, crashes and people do, by a written seed: one file of a session folder is cut short,
/// has bytes or digits turned, lines taken out or doubled, or values put in at which arithmetic goes wrong.
class SessionMutation {
 public:
  explicit SessionMutation(std::uint64_t seed) : random_(seed) {}

  /// @param content  of a file of a session
  std::string damaged(std::string content);
  /// Any number up to the bound.
  std::size_t below(std::size_t bound) { return bound == 0 ? 0 : random_() % bound; }

 private:
  std::mt19937_64 random_;
};

/// A small recorded docking in a folder: frames that show nothing, odometry, commands, phases and sightings, with the
/// default configuration.
void make_small_session(const std::filesystem::path& folder, bool compress);

/// Reads a session whole, as every verb does: head, streams, frames, and a replay of a few cycles.
/// @return whether it could be read; any other exception than Failure goes through
bool try_session(const std::filesystem::path& folder);

}  // namespace tagdock
