#include "app/sensor_error_file.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>

#include "app/failure.h"
#include "app/shipped_sensor_errors.h"  // made by CMake from data/sensor_errors

namespace tagdock {
namespace {

constexpr std::size_t most_values = 50;  // of distances, bearings or places

std::string list_of(const std::vector<double>& values) {
  std::string text;
  for (const double value : values) {
    char number[32];
    std::snprintf(number, sizeof number, "%.4g", value);
    text += (text.empty() ? "[" : ", ") + std::string(number);
  }
  return text + "]";
}

std::vector<double> rising(YamlMap& map, const char* key, double least) {
  const std::vector<double> values = map.numbers(key, 1, most_values);
  if (!(values.front() >= least) || !std::is_sorted(values.begin(), values.end(), std::less_equal<>()))
    map.refuse(key, "must rise, from " + list_of({least}) + " or more");
  return values;
}

// Camera and board that a file was measured with; a sentence if the robot's are others.
std::string difference(const SensorErrorFile& file, const Rig& rig, const Board& board) {
  char text[200];
  const auto said = [&](const char* format, auto... values) {
    std::snprintf(text, sizeof text, format, values...);
    return std::string(text);
  };
  const int tags = static_cast<int>(board.tags.size());
  if (tags != file.tags) return said("tags is %d, but the board has %d", file.tags, tags);
  for (const BoardTag& tag : board.tags)
    if (std::abs(tag.size - file.tag_size) > 0.01 * file.tag_size)
      return said("tag_size_m is %g, but tag %d of the board has %g", file.tag_size, tag.id, tag.size);
  // The lens decides; coarser frames of the same lens only measure less well.
  const double width = file.image_width / file.focal_length_px;
  const double own = rig.camera.width / rig.camera.fx;
  constexpr double same = 0.02;
  if (std::abs(own / width - 1.0) > same)
    return said("image_width over focal_length_px is %.3f, but the rig's camera has %.3f", width, own);
  return {};
}

}  // namespace

SensorErrorFile read_sensor_errors(YamlMap map) {
  SensorErrorFile file;
  file.method = map.text("method");
  file.frames = static_cast<int>(map.integer("frames", 2, 100000));
  file.tags = static_cast<int>(map.integer("tags", 1, 1000));
  file.tag_size = map.number("tag_size_m", 0.01, 2.0);
  file.image_width = static_cast<int>(map.integer("image_width", 16, 100000));
  file.focal_length_px = map.number("focal_length_px", 1.0, 1e6);
  SensorErrors& errors = file.errors;
  errors.distances = rising(map, "distance_m", 0.05);
  errors.bearings = rising(map, "bearing_deg", 0.0);
  errors.places = rising(map, "place", 0.0);
  std::vector<YamlMap> rows = map.maps("rows");
  if (rows.size() != errors.places.size() * errors.bearings.size())
    map.refuse("rows", "must be one for each place and bearing, " +
                           std::to_string(errors.places.size() * errors.bearings.size()));
  const std::size_t columns = errors.distances.size();
  for (std::size_t row = 0; row < rows.size(); ++row) {
    const double place = errors.places[row / errors.bearings.size()];
    const double bearing = errors.bearings[row % errors.bearings.size()];
    if (rows[row].number("place", 0.0, 1.0) != place) rows[row].refuse("place", "must be the places in their order");
    if (rows[row].number("bearing_deg", 0.0, 90.0) != bearing)
      rows[row].refuse("bearing_deg", "must be the bearings in their order");
    const std::vector<double> along = rows[row].numbers("along_mm", columns, columns);
    const std::vector<double> across = rows[row].numbers("across_mm", columns, columns);
    const std::vector<double> heading = rows[row].numbers("heading_deg", columns, columns);
    for (std::size_t i = 0; i < columns; ++i) {
      const bool unseen = along[i] == -1.0 && across[i] == -1.0 && heading[i] == -1.0;
      for (const auto& [key, value] :
           {std::pair("along_mm", along[i]), std::pair("across_mm", across[i]), std::pair("heading_deg", heading[i])})
        if (!unseen && !(value > 0.0))
          rows[row].refuse(key, "must be above 0, or -1 in all three for a board not seen");
      if (unseen)
        errors.cells.emplace_back();
      else
        errors.cells.push_back(SensorErrors::Sigma{1e-3 * along[i], 1e-3 * across[i], radians(heading[i])});
    }
  }
  map.finish();
  for (double& bearing : errors.bearings) bearing = radians(bearing);
  return file;
}

std::string to_yaml(const SensorErrorFile& file) {
  const SensorErrors& errors = file.errors;
  std::vector<double> bearings_deg;
  for (const double bearing : errors.bearings) bearings_deg.push_back(degrees(bearing));
  char head[200];
  std::snprintf(head, sizeof head,
                "method: %s\nframes: %d\ntags: %d\ntag_size_m: %g\nimage_width: %d\nfocal_length_px: %.2f\n",
                file.method.c_str(), file.frames, file.tags, file.tag_size, file.image_width, file.focal_length_px);
  std::string text =
      "# How well one frame tells the robot's pose, measured with rendered images and the real detector: rms error of\n"
      "# the camera point along and across the line of sight, and of the heading. A row for each place of the board's\n"
      "# centre in the image (share of the half width) and bearing of the lens off the board's normal, with a value "
      "for\n"
      "# each distance; -1: not seen.\n";
  text += head;
  text += "distance_m: " + list_of(errors.distances) + "\nbearing_deg: " + list_of(bearings_deg) +
          "\nplace: " + list_of(errors.places) + "\nrows:\n";
  std::size_t cell = 0;
  for (const double place : errors.places)
    for (const double bearing : bearings_deg) {
      std::vector<double> along, across, heading;
      for (std::size_t i = 0; i < errors.distances.size(); ++i, ++cell) {
        const auto& sigma = errors.cells[cell];
        along.push_back(sigma ? 1e3 * sigma->along : -1.0);
        across.push_back(sigma ? 1e3 * sigma->across : -1.0);
        heading.push_back(sigma ? degrees(sigma->heading) : -1.0);
      }
      char start[80];
      std::snprintf(start, sizeof start, "  - place: %.4g\n    bearing_deg: %.4g\n", place, bearing);
      text += start;
      text += "    along_mm: " + list_of(along) + "\n    across_mm: " + list_of(across) +
              "\n    heading_deg: " + list_of(heading) + "\n";
    }
  return text;
}

std::optional<SensorErrors> sensor_errors_of(const std::string& word, const Rig& rig, const Board& board,
                                             const std::string& key) {
  if (word == "none") return std::nullopt;
  if (word == "shipped") {
    static const SensorErrorFile shipped =
        read_sensor_errors(YamlMap::parse(shipped_sensor_errors, "data/sensor_errors/v_convex_centre.yaml"));
    if (!difference(shipped, rig, board).empty()) return std::nullopt;
    return shipped.errors;
  }
  if (!std::filesystem::is_regular_file(word))
    throw Failure(ExitCode::usage, key + " is " + word +
                                       ": there is no such file; it must be none, shipped or a file of `tagdock "
                                       "evaluate accuracy-map`");
  const SensorErrorFile file = read_sensor_errors(YamlMap::load(word));
  if (const std::string other = difference(file, rig, board); !other.empty())
    throw Failure(ExitCode::usage,
                  word + " (" + key + "): " + other + "; measure it with `tagdock evaluate accuracy-map`");
  return file.errors;
}

}  // namespace tagdock
