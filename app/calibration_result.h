#pragma once

#include <filesystem>
#include <string>

#include <nlohmann/json.hpp>

#include "calibration/camera_model.h"
#include "calibration/hand_eye.h"
#include "calibration/intrinsics.h"
#include "calibration/target.h"

namespace tagdock {

/// The blocks of a result file (CONTRACTS.md) in the order in which they are written.
nlohmann::ordered_json camera_block(const CameraModel& camera);
nlohmann::ordered_json transform_block(const Eigen::Isometry3d& T);
/// A board as a board file has it: family, tags.
nlohmann::ordered_json board_block(const Board& board);
nlohmann::ordered_json hand_eye_block(const HandEyeProblem& problem, const HandEyeResult& result);
nlohmann::ordered_json intrinsics_block(const IntrinsicsResult& result, const std::vector<std::string>& unreadable);

/// The same values as YAML: maps in blocks, lists and small maps on one line.
std::string to_yaml(const nlohmann::ordered_json& value);

/// Writes a text so that the file is either whole or as it was.
/// @param option  of the command line that names the file, for the sentence of a Failure(usage)
void write_whole(const std::filesystem::path& file, const std::string& text, const std::string& option = "--output");

/// Writes the result file of a calibration. What was refused does not replace what was good: that is kept beside it, as
/// FILE.good, and the user is told.
void write_result(const std::filesystem::path& file, const nlohmann::ordered_json& block);

}  // namespace tagdock
