#pragma once

#include <string>

#include "app/yaml_file.h"
#include "calibration/rig.h"
#include "calibration/target.h"
#include "planning/sensor_errors.h"

namespace tagdock {

/// What `tagdock evaluate accuracy-map` measured, with the rig and the board it was measured with.
struct SensorErrorFile {
  std::string method;  ///< of the corners
  int frames = 0;      ///< of each cell
  int tags = 0;
  double tag_size = 0.0;  ///< m
  int image_width = 0;    ///< px
  double focal_length_px = 0.0;
  SensorErrors errors;
};

/// Reads such a file. Throws Failure(usage) with file, line, key and what would be right.
SensorErrorFile read_sensor_errors(YamlMap map);

/// The file as text. A cell in which nothing was seen has -1.
std::string to_yaml(const SensorErrorFile& file);

/// The errors that a robot with this rig and board uses.
/// @param word  none; shipped: those of the default board and camera, for robots that have these; or a file
/// @param key   of the configuration, for what is refused
/// Throws Failure(usage): a file that cannot be read, or was measured with another lens or board.
std::optional<SensorErrors> sensor_errors_of(const std::string& word, const Rig& rig, const Board& board,
                                             const std::string& key);

}  // namespace tagdock
