#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "app/config.h"
#include "app/docking_loop.h"
#include "app/session.h"

namespace tagdock {

/// What session.yaml says.
struct SessionHead {
  std::string program;
  std::uint64_t seed = 0;
  std::string camera_name;
  CameraSettings camera;  ///< as it was read back; empty in recordings of earlier versions
  Config config;
};

/// Throws Failure(usage) with file, line and key; also for a format that this program does not know.
SessionHead read_session_head(const std::filesystem::path& folder);

struct ReplayResult {
  std::uint64_t cycles = 0;
  std::uint64_t frames = 0;
  std::uint64_t sightings = 0;
  std::string last_phase;
  int attempts = 1;
  std::string reason;      ///< of a docking that failed or was stopped
  std::optional<Fix> fix;  ///< the robot's own, where there was one
  std::vector<std::string> sighting_lines;
  std::vector<std::string> command_lines;
  std::vector<std::string> phase_lines;
  /// Where what was made now differs from what was recorded, one sentence each; empty means bit-equal.
  std::vector<std::string> differences;
  bool ended_early = false;            ///< the watcher ended it: only what was made is compared
  std::uint64_t difference_count = 0;  ///< all of them; `differences` names the first of each stream
  /// Frames that the docking used and that the recording lacks: what follows the first cannot be repeated.
  std::uint64_t frames_not_recorded = 0;
};

/// Called after each cycle; gives false to end early.
using ReplayWatcher = std::function<bool(const DockingLoop::Inputs&, const DockingLoop::Outputs&)>;

/// Drives a recorded session through the same code as the docking, cycle by cycle.
/// Throws Failure(usage) when a frame that a cycle used is damaged.
ReplayResult replay(const Session& session, const Config& config, const ReplayWatcher& watcher = {});

}  // namespace tagdock
