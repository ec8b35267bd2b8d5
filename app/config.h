#pragma once

#include <filesystem>
#include <string>

#include "app/robots/ros2.h"
#include "app/simulation/faults.h"
#include "app/yaml_file.h"
#include "calibration/rig.h"
#include "calibration/target.h"
#include "detection/tag_locator.h"
#include "servo/docking.h"

namespace tagdock {

/// What is asked of a camera that obeys.
struct CameraConfig {
  std::string source = "sim";  ///< sim, gige:127.x.y.z, gige:SERIAL or images:DIR
  double exposure_us = 5000.0;
  double gain = 0.0;
  double frame_rate = 25.0;      ///< 1/s
  int receive_buffer = 4 << 20;  ///< bytes asked of the kernel for a GigE stream; frames are made to fit what it grants
  bool auto_exposure = false;    ///< holds the tags' white at 60 to 80 % while driving up; frozen in the final approach
  std::string pixel_format = "Mono8";  ///< Mono8, 10, 10Packed, 12, 12Packed or 16
  bool ptp = false;                    ///< IEEE 1588; not tried with a real camera
  bool chunks = false;                 ///< exposure and gain with each frame; not tried with a real camera
  double latency_ms = 80.0;            ///< from mid-exposure to arrival, declared; the ages of frames count beyond it
};

/// The simulated world; nothing that docks reads it.
struct SimulationConfig {
  std::string scenario;  ///< file; the built-in default one if empty
  /// Where the camera point truly was when the docking pose was taught; reports hold the true error against it.
  bool taught_at_known = false;
  Pose2 taught_at;
  SimulationFaults faults;
};

/// Everything a docking needs to know, read and checked once and then const. The defaults dock the simulated robot.
struct Config {
  CameraConfig camera;
  std::string robot = "sim";  ///< sim, ros2 or none
  Ros2Config ros2;            ///< where the robot is, for ros2
  Rig rig = default_rig();
  Board board = default_board(0.35);
  TagLocatorConfig locator;
  /// How well one frame tells the pose: none, shipped (where rig and board are the default ones) or a file.
  std::string sensor_errors = "shipped";
  DockingConfig docking;
  SimulationConfig simulation;
};

/// Reads a configuration; keys that are missing keep their defaults.
/// Throws Failure(usage) with file, line, key, value and what would be right.
Config read_config(const std::filesystem::path& file);
Config parse_config(const std::string& text, const std::string& name);
Config read_config(YamlMap map);

/// All keys with their values, as YAML that `parse_config` reads. Angles and rotations may come back changed in their
/// last bit; so a docking runs on what was parsed from the text that is recorded, and replay has it to the last bit.
std::string to_yaml(const Config& config);

}  // namespace tagdock
