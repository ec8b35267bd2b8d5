#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "app/camera.h"
#include "app/failure.h"
#include "servo/docking.h"

namespace tagdock {

/// What a docking came to; the content of `--report` (CONTRACTS.md).
struct DockingReport {
  struct PhaseSpan {
    std::string name;
    std::chrono::nanoseconds start{0};
    std::chrono::nanoseconds end{0};
  };

  Phase last;                ///< docked, failed or stopped
  bool interrupted = false;  ///< by Ctrl-C or a signal
  std::chrono::nanoseconds duration{0};
  std::optional<Pose2> stands;      ///< the camera point at the end, station frame, as estimated
  std::optional<Pose2> true_error;  ///< of the camera point and heading against the docking pose, station frame
  std::vector<PhaseSpan> phases;
  CameraHealth camera;
  std::vector<double> frame_ages_ms;  ///< of the frames used, from mid-exposure to use
  std::uint64_t sightings = 0;
  std::uint64_t seed = 0;
  bool taught = false;  ///< the docking pose; otherwise calibration and survey leave what no sigma here holds
};

/// The exit code that belongs to the end of a docking.
ExitCode exit_code(const DockingReport& report);

nlohmann::ordered_json to_json(const DockingReport& report);

/// The end of a docking in a few lines for people.
std::string summary(const DockingReport& report);

/// The p-quantile of values (0..1) by linear interpolation; 0 for none.
double quantile(std::vector<double> values, double p);

}  // namespace tagdock
