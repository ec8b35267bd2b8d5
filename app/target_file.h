#pragma once

#include <filesystem>
#include <string>

#include "calibration/calibration_target.h"

namespace tagdock {

/// Reads the description of a calibration board (CONTRACTS.md: charuco, aprilgrid, taggrid, tag).
/// Throws Failure(usage) with file, line and key.
CalibrationTarget read_target(const std::filesystem::path& file);

/// The description as a file, as `read_target` reads it.
std::string target_text(const CalibrationTarget& target);

}  // namespace tagdock
