#pragma once

#include <filesystem>
#include <string>

#include <nlohmann/json.hpp>

#include "calibration/camera_model.h"
#include "calibration/hand_eye.h"
#include "calibration/intrinsics.h"

namespace tagdock {

/// The blocks of a result file (CONTRACTS.md) in the order in which they are written.
nlohmann::ordered_json camera_block(const CameraModel& camera);
nlohmann::ordered_json transform_block(const Eigen::Isometry3d& T);
nlohmann::ordered_json hand_eye_block(const HandEyeProblem& problem, const HandEyeResult& result);
nlohmann::ordered_json intrinsics_block(const IntrinsicsResult& result, const std::vector<std::string>& unreadable);

/// The same values as YAML: maps in blocks, lists and small maps on one line.
std::string to_yaml(const nlohmann::ordered_json& value);

/// Writes a text so that the file is either whole or as it was. Throws Failure(usage).
void write_whole(const std::filesystem::path& file, const std::string& text);

}  // namespace tagdock
