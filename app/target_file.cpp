#include "app/target_file.h"

#include <cmath>
#include <sstream>
#include <stdexcept>

#include <yaml-cpp/yaml.h>

#include "app/failure.h"
#include "app/yaml_file.h"

namespace tagdock {
namespace {

using Type = CalibrationTarget::Type;

void read_points(YamlMap& map, const std::filesystem::path& file, CalibrationTarget& target) {
  if (!map.has("points")) return;
  // Lists of lists are not what YamlMap reads; it has checked the file's size, depth and aliases.
  const YAML::Node points = YAML::LoadFile(file.string())["points"];
  if (!points.IsSequence()) map.refuse("points", "must be a list of [id, x, y, z]");
  for (const auto& row : points) {
    double value[4];
    bool good = row.IsSequence() && row.size() == 4;
    for (std::size_t i = 0; good && i < 4; ++i) {
      try {
        value[i] = row[i].as<double>();
        good = std::isfinite(value[i]) && std::abs(value[i]) < 1e6;
      } catch (const YAML::Exception&) {
        good = false;
      }
    }
    if (!good || value[0] != std::floor(value[0]))
      throw Failure(ExitCode::usage, file.string() + ":" + std::to_string(row.Mark().line + 1) +
                                         ": points must be a list of [id, x, y, z] with whole ids and finite m");
    if (!target.measured.emplace(static_cast<int>(value[0]), Eigen::Vector3d(value[1], value[2], value[3])).second)
      map.refuse("points", "has the id " + std::to_string(static_cast<int>(value[0])) + " twice");
  }
  if (target.measured.size() < 4) map.refuse("points", "has fewer than four points");
}

}  // namespace

CalibrationTarget read_target(const std::filesystem::path& file) {
  YamlMap map = YamlMap::load(file);
  CalibrationTarget target;
  const std::string type = map.text("type");
  // Lengths that only make sense in m: a board of metres is refused as what it is, millimetres.
  constexpr double least = 1e-4;
  constexpr double most = 5.0;
  if (type == "charuco") {
    target.type = Type::charuco;
    target.squares_x = static_cast<int>(map.integer("squares_x", 3, 100));
    target.squares_y = static_cast<int>(map.integer("squares_y", 3, 100));
    target.square = map.number("square", least, most);
    target.marker = map.number("marker", least, most);
    target.dictionary = map.text("dictionary");
    if (target.marker >= target.square) map.refuse("marker", "must be smaller than square");
  } else if (type == "aprilgrid" || type == "taggrid") {
    target.type = type == "aprilgrid" ? Type::aprilgrid : Type::taggrid;
    target.tag_cols = static_cast<int>(map.integer("tag_cols", 1, 100));
    target.tag_rows = static_cast<int>(map.integer("tag_rows", 1, 100));
    target.tag_size = map.number("tag_size", least, most);
    target.tag_spacing = map.number("tag_spacing", 0.01, 5.0);
    map.read("family", target.family);
  } else if (type == "tag") {
    target.type = Type::tag;
    target.tag_size = map.number("tag_size", least, most);
    map.read("family", target.family);
    map.read("id", target.first_id, 0, 100000);
  } else {
    map.refuse("type", "is " + type + "; it must be charuco, aprilgrid, taggrid or tag");
  }
  map.read("first_id", target.first_id, 0, 100000);
  map.read("measured_over_drawn_x", target.scale_x, 0.9, 1.1);
  map.read("measured_over_drawn_y", target.scale_y, 0.9, 1.1);
  read_points(map, file, target);
  // Keys of the same board's other descriptions are passed over: people keep notes in these files.
  try {
    (void)layouts_of(target);
  } catch (const std::invalid_argument& error) {
    throw Failure(ExitCode::usage, file.string() + ": " + error.what());
  }
  return target;
}

std::string target_text(const CalibrationTarget& target) {
  std::ostringstream text;
  text.precision(12);  // lengths in whole tenths of a mm stay as short as they are
  text
      << "# As it was printed, in m; measure the two rulers on the sheet and put measured over printed length below.\n";
  switch (target.type) {
    case Type::charuco:
      text << "type: charuco\nsquares_x: " << target.squares_x << "\nsquares_y: " << target.squares_y
           << "\nsquare: " << target.square << "\nmarker: " << target.marker << "\ndictionary: " << target.dictionary
           << "\n";
      break;
    case Type::aprilgrid:
    case Type::taggrid:
      text << "type: " << (target.type == Type::aprilgrid ? "aprilgrid" : "taggrid")
           << "\ntag_cols: " << target.tag_cols << "\ntag_rows: " << target.tag_rows
           << "\ntag_size: " << target.tag_size << "\ntag_spacing: " << target.tag_spacing
           << "\nfamily: " << target.family << "\n";
      if (target.first_id != 0) text << "first_id: " << target.first_id << "\n";
      break;
    case Type::tag:
      text << "type: tag\nfamily: " << target.family << "\nid: " << target.first_id << "\ntag_size: " << target.tag_size
           << "\n";
      break;
  }
  text << "measured_over_drawn_x: " << target.scale_x << "\nmeasured_over_drawn_y: " << target.scale_y << "\n";
  return text.str();
}

}  // namespace tagdock
