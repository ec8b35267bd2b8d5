#include "calibration/calibration_target.h"

#include <cmath>
#include <stdexcept>

namespace tagdock {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;

void need(bool good, const std::string& sentence) {
  if (!good) throw std::invalid_argument(sentence);
}

bool sane(double length) { return std::isfinite(length) && length > 1e-4 && length < 10.0; }

/// The measured points say whether rows are numbered from above (1) or from below (-1); 0 if they do not.
int rows_by_points(const CalibrationTarget& target, int first, int last) {
  const auto a = target.measured.find(first);
  const auto b = target.measured.find(last);
  if (a == target.measured.end() || b == target.measured.end() || a->second.y() == b->second.y()) return 0;
  return b->second.y() > a->second.y() ? 1 : -1;
}

Vector3d board_point(const CalibrationTarget& target, int id, const Vector2d& drawn) {
  const auto measured = target.measured.find(id);
  if (measured != target.measured.end()) return measured->second;
  return {drawn.x() * target.scale_x, drawn.y() * target.scale_y, 0.0};
}

bool wanted(const CalibrationTarget& target, int id) { return target.measured.empty() || target.measured.contains(id); }

TargetLayout charuco(const CalibrationTarget& target, bool top_left_black, bool rows_from_above) {
  TargetLayout layout;
  layout.width = target.squares_x * target.square;
  layout.height = target.squares_y * target.square;
  layout.reach = 0.45 * target.square;
  layout.clearance = 0.4 * (target.square - target.marker);
  const double margin = 0.5 * (target.square - target.marker);
  int next = target.first_id;
  for (int row = 0; row < target.squares_y; ++row)
    for (int column = 0; column < target.squares_x; ++column) {
      if (((row + column) % 2 == 0) == top_left_black) continue;
      const Vector2d at(column * target.square + margin, row * target.square + margin);
      const double side = target.marker;
      layout.marks[next++] = {at, at + Vector2d(side, 0.0), at + Vector2d(side, side), at + Vector2d(0.0, side)};
    }
  for (int row = 1; row < target.squares_y; ++row)
    for (int column = 1; column < target.squares_x; ++column) {
      const int line = rows_from_above ? row - 1 : target.squares_y - 1 - row;
      const int id = line * (target.squares_x - 1) + column - 1;
      if (!wanted(target, id)) continue;
      const Vector2d drawn(column * target.square, row * target.square);
      layout.corners.push_back({id, drawn, board_point(target, id, drawn), (row + column) % 2});
    }
  return layout;
}

TargetLayout grid(const CalibrationTarget& target, bool rows_from_above) {
  TargetLayout layout;
  const double size = target.tag_size;
  const double gap = size * target.tag_spacing;
  const double pitch = size + gap;
  layout.width = target.tag_cols * pitch - gap;
  layout.height = target.tag_rows * pitch - gap;
  layout.reach = std::min(0.9 * gap, 0.4 * size);
  layout.clearance = 0.09 * size;  // the black border is an eighth of the tag
  for (int row = 0; row < target.tag_rows; ++row)
    for (int column = 0; column < target.tag_cols; ++column) {
      const int line = rows_from_above ? row : target.tag_rows - 1 - row;
      const int tag = line * target.tag_cols + column;
      const Vector2d at(column * pitch, row * pitch);
      const std::array<Vector2d, 4> read{at, at + Vector2d(size, 0.0), at + Vector2d(size, size),
                                         at + Vector2d(0.0, size)};
      layout.marks[target.first_id + tag] = read;
      constexpr int from_below[] = {3, 2, 1, 0};  // bottom left, bottom right, top right, top left
      for (int k = 0; k < 4; ++k) {
        const int id = 4 * (target.first_id + tag) + k;
        if (!wanted(target, id)) continue;
        const Vector2d drawn = read[static_cast<std::size_t>(from_below[k])];
        layout.corners.push_back({id, drawn, board_point(target, id, drawn), k % 2});
      }
    }
  return layout;
}

}  // namespace

std::vector<TargetLayout> layouts_of(const CalibrationTarget& target) {
  need(target.scale_x > 0.9 && target.scale_x < 1.1 && target.scale_y > 0.9 && target.scale_y < 1.1,
       "the measured lengths differ from the drawn ones by more than 10 %");
  std::vector<TargetLayout> layouts;
  if (target.type == CalibrationTarget::Type::charuco) {
    need(target.squares_x >= 3 && target.squares_y >= 3 && target.squares_x <= 100 && target.squares_y <= 100,
         "squares_x and squares_y must be between 3 and 100");
    need(sane(target.square), "square must be a length in m, for example 0.04");
    need(sane(target.marker) && target.marker < target.square, "marker must be smaller than square, in m");
    const int last = (target.squares_x - 1) * (target.squares_y - 1) - 1;
    const bool from_above = rows_by_points(target, 0, last) >= 0;
    layouts.push_back(charuco(target, true, from_above));
    layouts.push_back(charuco(target, false, from_above));
    return layouts;
  }
  need(target.tag_cols >= 1 && target.tag_rows >= 1 && target.tag_cols <= 100 && target.tag_rows <= 100,
       "tag_cols and tag_rows must be between 1 and 100");
  need(sane(target.tag_size), "tag_size must be a length in m, for example 0.088");
  const bool alone = target.type == CalibrationTarget::Type::tag;
  need(alone || (target.tag_spacing > 0.01 && target.tag_spacing < 5.0),
       "tag_spacing is the gap between tags over tag_size, for example 0.3");
  if (alone || target.tag_rows == 1) return {grid(target, true)};
  const int first = 4 * target.first_id;
  const int rows = rows_by_points(target, first, first + 4 * (target.tag_cols * target.tag_rows - 1));
  if (rows <= 0) layouts.push_back(grid(target, false));
  if (rows >= 0) layouts.push_back(grid(target, true));
  return layouts;
}

}  // namespace tagdock
