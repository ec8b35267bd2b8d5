#pragma once

#include <cstdint>
#include <string>

#include "app/config.h"
#include "app/devices.h"

namespace tagdock {

/// session.yaml of a recording: versions, seed, the camera with its identity and what it made of its settings, and the
/// configuration.
/// @param config_text  what the configuration of the run was parsed from: with the very text, replay is bit-equal
std::string session_yaml(const std::string& config_text, const std::string& camera_name, const CameraSettings& actual,
                         std::uint64_t seed);

/// cam0/sensor.yaml, as EuRoC has it.
std::string sensor_yaml(const CameraModel& camera, double frame_rate);

}  // namespace tagdock
