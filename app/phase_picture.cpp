#include "app/phase_picture.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <vector>

#include "app/svg.h"

namespace tagdock {
namespace {

using Eigen::Vector2d;

constexpr double width = 1400.0;
constexpr double box_width = 150.0;
constexpr double box_height = 44.0;
constexpr double column = 470.0;  // middle of the phases that act
constexpr double first_row = 120.0;
constexpr double row_height = 116.0;
constexpr double back_bus = 110.0;   // ways back to the first phase
constexpr double retry_bus = 850.0;  // ways to the back-off
constexpr double retry = 985.0;      // its middle
constexpr double end_bus = 1130.0;   // ways to the failure
constexpr double end_column = 1270.0;

constexpr const char* onward = "#303030";
constexpr const char* backward = "#2060c0";
constexpr const char* again = "#c06010";
constexpr const char* bad = "#a02030";

std::string stroke(const char* colour) { return std::string("stroke:") + colour + ";stroke-width:1.4"; }

void arrow_head(Svg& svg, const Vector2d& tip, const Vector2d& direction, const char* colour) {
  const Vector2d d = direction.normalized();
  const Vector2d across(-d.y(), d.x());
  svg.polygon({tip, tip - 9.0 * d + 4.0 * across, tip - 9.0 * d - 4.0 * across}, std::string("fill:") + colour);
}

void way(Svg& svg, const std::vector<Vector2d>& points, const char* colour, bool with_head) {
  svg.polyline(points, stroke(colour));
  if (with_head) arrow_head(svg, points.back(), points.back() - points[points.size() - 2], colour);
}

void label(Svg& svg, const Vector2d& place, std::string_view words, const char* colour, const char* anchor = "start") {
  svg.text(place, std::string(words), 11, anchor, std::string("fill:") + colour);
}

/// Where the phases stand.
struct Layout {
  std::vector<std::string_view> acting;  // in the column, from above
  std::map<std::string_view, Vector2d> middle;
  double bottom = 0.0;

  [[nodiscard]] int row(std::string_view phase) const {
    const auto found = std::find(acting.begin(), acting.end(), phase);
    return found == acting.end() ? -1 : static_cast<int>(found - acting.begin());
  }
};

bool stands_aside(std::string_view phase) {
  return phase == "backing off" || phase == "paused" || phase == "failed" || phase == "stopped" || phase == "any";
}

Layout laid_out(std::span<const Transition> table) {
  Layout layout;
  // In the order in which the table tells of them; those that nothing follows come last.
  const auto add = [&](std::string_view phase) {
    if (!stands_aside(phase) && layout.row(phase) < 0) layout.acting.push_back(phase);
  };
  for (const Transition& row : table) add(row.from);
  for (const Transition& row : table) add(row.to);
  double y = first_row;
  for (const std::string_view phase : layout.acting) {
    layout.middle[phase] = {column, y};
    y += row_height;
  }
  const double rows = static_cast<double>(layout.acting.size());
  // Between two rows, so that their ways pass it.
  layout.middle["backing off"] = {retry, first_row + (std::floor(0.5 * rows) + 0.5) * row_height};
  layout.middle["failed"] = {end_column, layout.middle["backing off"].y()};
  layout.middle["any"] = {column, y};
  layout.middle["paused"] = {back_bus, y};
  layout.middle["stopped"] = {end_column, y};
  layout.bottom = y + box_height;
  return layout;
}

void draw_box(Svg& svg, const Vector2d& middle, std::string_view name) {
  const bool good = name == "docked" || name == "undocked";
  const bool over = good || name == "failed" || name == "stopped";
  const char* fill = good                                    ? "#dff0dd"
                     : name == "failed" || name == "stopped" ? "#f6dfe0"
                     : name == "backing off"                 ? "#fae9d6"
                     : name == "any"                         ? "#ffffff"
                                                             : "#e8eef7";
  svg.rectangle(middle - Vector2d(0.5 * box_width, 0.5 * box_height), box_width, box_height,
                std::string("fill:") + fill + ";stroke:#404040;stroke-width:" + (over ? "2.4" : "1.2") +
                    (name == "any" ? ";stroke-dasharray:5 4" : ""));
  svg.text(middle + Vector2d(0.0, 5.0), name == "any" ? "any that acts" : std::string(name), 14, "middle");
}

/// A vertical piece of a way that is drawn already.
struct Lane {
  double x = 0.0, top = 0.0, bottom = 0.0;
};

/// Onward in the column: straight down to the next, around those between otherwise, beside ways that are there.
void draw_onward(Svg& svg, const Vector2d& from, const Vector2d& to, int skipped, std::string_view words,
                 std::vector<Lane>& lanes) {
  const Vector2d half(0.0, 0.5 * box_height);
  if (skipped == 0) {
    way(svg, {from + half, to - half}, onward, true);
    label(svg, {from.x() + 8.0, 0.5 * (from.y() + to.y()) + 4.0}, words, onward);
    return;
  }
  const double side = from.x() - 0.5 * box_width;
  double x = side - 26.0 - 74.0 * (skipped - 1);  // beside the words of the shorter ones
  const Lane wanted{x, from.y() + 12.0, to.y() - 12.0};
  constexpr double beside_words = 120.0;
  for (const Lane& lane : lanes)
    if (lane.x == x && lane.top < wanted.bottom && wanted.top < lane.bottom) x -= beside_words;
  lanes.push_back({x, wanted.top, wanted.bottom});
  way(svg, {{side, from.y() + 12.0}, {x, from.y() + 12.0}, {x, to.y() - 12.0}, {side, to.y() - 12.0}}, onward, true);
  const bool at_the_rim = x < back_bus;
  label(svg, {at_the_rim ? back_bus + 8.0 : x - 6.0, to.y() - 16.0}, words, onward, at_the_rim ? "start" : "end");
}

}  // namespace

std::string phase_picture(std::span<const Transition> table) {
  Layout layout = laid_out(table);
  Svg svg(width, layout.bottom + 40.0);
  svg.text({30, 36}, "Phases of a docking", 20);
  svg.text({30, 58},
           "drawn from the table that the program's own transitions are tested against; " +
               std::to_string(table.size()) + " ways",
           12);
  const Vector2d half_width(0.5 * box_width, 0.0);
  const Vector2d half_height(0.0, 0.5 * box_height);
  const Vector2d top = layout.middle[layout.acting.front()];
  std::vector<Lane> lanes;
  double back_lowest = top.y();
  double retry_top = 1e9;
  double retry_bottom = -1e9;
  double end_top = 1e9;
  double end_bottom = -1e9;
  for (const Transition& row : table) {
    const Vector2d from = layout.middle[row.from];
    const Vector2d to = layout.middle[row.to];
    const int from_row = layout.row(row.from);
    const int to_row = layout.row(row.to);
    if (row.from == "any") {
      const bool left = row.to == "paused";
      if (row.to == "failed") {
        way(svg, {from + half_width + Vector2d(0.0, -10.0), {end_bus, from.y() - 10.0}}, bad, false);
        label(svg, from + half_width + Vector2d(8.0, -14.0), row.word, bad);
        end_bottom = std::max(end_bottom, from.y() - 10.0);
        continue;
      }
      way(svg,
          {from + (left ? -1.0 : 1.0) * half_width + Vector2d(0.0, left ? 0.0 : 10.0),
           to + (left ? 1.0 : -1.0) * half_width + Vector2d(0.0, left ? 0.0 : 10.0)},
          left ? onward : bad, true);
      label(svg, from + (left ? -1.0 : 1.0) * (half_width + Vector2d(8.0, 0.0)) + Vector2d(0.0, left ? -5.0 : 23.0),
            row.word, left ? onward : bad, left ? "end" : "start");
    } else if (row.from == "paused" && to_row == 0) {
      back_lowest = std::max(back_lowest, from.y() - 0.5 * box_height);
      label(svg, {back_bus + 8.0, from.y() - 0.5 * box_height - 10.0}, row.word, backward);
    } else if (row.from == "paused" && to_row > 0) {
      const double x = back_bus + 55.0;
      way(svg, {{x, from.y() - 0.5 * box_height}, {x, to.y()}, to - half_width}, onward, true);
      label(svg, {x + 6.0, from.y() - 0.5 * box_height - 10.0}, row.word, onward);
    } else if (row.from == "paused" && row.to == "backing off") {
      const double y = from.y() + 0.5 * box_height + 14.0;
      way(svg, {from + half_height, {from.x(), y}, {retry_bus, y}}, again, false);
      label(svg, {from.x() + 0.5 * box_width + 8.0, y - 4.0}, row.word, again);
      retry_bottom = std::max(retry_bottom, y);
    } else if (row.from == "backing off" && to_row == 0) {
      const double y = top.y() - 0.5 * box_height - 22.0;
      way(svg, {from - half_height, {from.x(), y}, {to.x() + 30.0, y}, to - half_height + Vector2d(30.0, 0.0)}, again,
          true);
      label(svg, {to.x() + 130.0, y - 5.0}, row.word, again);
    } else if (row.to == "backing off") {
      const double y = from.y() + 9.0;
      way(svg, {{from.x() + 0.5 * box_width, y}, {retry_bus, y}}, again, false);
      label(svg, {from.x() + 0.5 * box_width + 8.0, y + 13.0}, row.word, again);
      retry_top = std::min(retry_top, y);
      retry_bottom = std::max(retry_bottom, y);
    } else if (row.to == "failed") {
      const double y = from.y() - 9.0;
      way(svg, {{from.x() + 0.5 * box_width, y}, {end_bus, y}}, bad, false);
      // Beside the box that stands before `failed` there is no room for words.
      label(svg,
            row.from == "backing off" ? from + Vector2d(-0.5 * box_width, 0.5 * box_height + 14.0)
                                      : Vector2d(from.x() + 0.5 * box_width + 8.0, y - 4.0),
            row.word, bad);
      end_top = std::min(end_top, y);
      end_bottom = std::max(end_bottom, y);
    } else if (to_row == 0 && from_row > 0) {
      way(svg, {from - half_width, {back_bus, from.y()}}, backward, false);
      label(svg, {back_bus + 8.0, from.y() - 4.0}, row.word, backward);
      back_lowest = std::max(back_lowest, from.y());
    } else if (from_row >= 0 && to_row > from_row) {
      draw_onward(svg, from, to, to_row - from_row - 1, row.word, lanes);
    } else {
      // A way that the picture has no place for yet is drawn straight across rather than left out.
      way(svg, {from, to}, bad, true);
      label(svg, 0.5 * (from + to), row.word, bad);
    }
  }
  if (back_lowest > top.y()) way(svg, {{back_bus, back_lowest}, {back_bus, top.y()}, top - half_width}, backward, true);
  const Vector2d off = layout.middle["backing off"];
  if (retry_top < retry_bottom) {
    svg.line({retry_bus, retry_top}, {retry_bus, retry_bottom}, stroke(again));
    way(svg, {{retry_bus, off.y() + 9.0}, off - half_width + Vector2d(0.0, 9.0)}, again, true);
  }
  const Vector2d end = layout.middle["failed"];
  if (end_top < end_bottom) {
    svg.line({end_bus, end_top}, {end_bus, end_bottom}, stroke(bad));
    way(svg, {{end_bus, end.y()}, end - half_width}, bad, true);
  }
  for (const auto& [name, middle] : layout.middle) draw_box(svg, middle, name);
  return svg.text();
}

}  // namespace tagdock
