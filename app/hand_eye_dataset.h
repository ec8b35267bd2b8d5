#pragma once

#include <filesystem>

#include "calibration/hand_eye.h"

namespace tagdock {

/// Reads a folder with corners.csv, board_points.csv, problem.yaml and tracker.csv or odometry.csv (CONTRACTS.md).
/// Throws Failure(usage) with file, line and key.
HandEyeProblem read_hand_eye_dataset(const std::filesystem::path& folder);

}  // namespace tagdock
