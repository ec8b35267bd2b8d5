#include "app/printed_target.h"

#include <algorithm>
#include <cairo/cairo-pdf.h>
#include <cairo/cairo.h>
#include <cmath>
#include <cstdio>
#include <memory>
#include <numbers>

#include "app/failure.h"
#include "detection/mark_decoder.h"
#include "detection/tag_pattern.h"
#include "planning/pose2.h"

namespace tagdock {
namespace {

using Type = CalibrationTarget::Type;

constexpr double margin = 10.0;       // mm, that printers cannot reach
constexpr double caption = 24.0;      // mm, below the pattern
constexpr double ruler_strip = 12.0;  // mm, left of the pattern
constexpr double cut_gap = 1.0;       // mm, from what is to be cut out to its marks
constexpr double cut_length = 5.0;    // mm, of a mark
constexpr double cut_reach = cut_gap + cut_length;

std::string text_of(double millimetres) {
  char text[32];
  std::snprintf(text, sizeof text, "%.2f", millimetres);
  return text;
}

/// One PDF whose unit is the millimetre.
class Sheet {
 public:
  Sheet(const Paper& paper, const std::filesystem::path& file) : file_(file.string()) {
    constexpr double points = 72.0 / 25.4;
    surface_ = cairo_pdf_surface_create(file_.c_str(), paper.width * points, paper.height * points);
    cairo_pdf_surface_set_metadata(surface_, CAIRO_PDF_METADATA_TITLE, "tagdock target");
    cr_ = cairo_create(surface_);
    cairo_scale(cr_, points, points);
    cairo_select_font_face(cr_, "sans-serif", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_NORMAL);
  }
  ~Sheet() {
    cairo_destroy(cr_);
    cairo_surface_destroy(surface_);
  }
  Sheet(const Sheet&) = delete;
  Sheet& operator=(const Sheet&) = delete;

  /// Black areas are collected and filled at once: neighbours filled one by one show hairlines between them.
  void black(double x, double y, double width, double height) { cairo_rectangle(cr_, x, y, width, height); }
  void fill() {
    cairo_set_source_rgb(cr_, 0, 0, 0);
    cairo_set_fill_rule(cr_, CAIRO_FILL_RULE_WINDING);
    cairo_fill(cr_);
  }

  void line(double x0, double y0, double x1, double y1, double width = 0.15, bool dashed = false) {
    cairo_set_source_rgb(cr_, 0, 0, 0);
    cairo_set_line_width(cr_, width);
    const double dash[] = {2.0, 1.5};
    cairo_set_dash(cr_, dash, dashed ? 2 : 0, 0.0);
    cairo_move_to(cr_, x0, y0);
    cairo_line_to(cr_, x1, y1);
    cairo_stroke(cr_);
    cairo_set_dash(cr_, dash, 0, 0.0);
  }

  /// @param most  width that the words must not exceed: they are written smaller then
  void text(double x, double y, const std::string& words, double size = 3.2, bool upwards = false, double most = 1e9) {
    cairo_set_source_rgb(cr_, 0, 0, 0);
    cairo_set_font_size(cr_, size);
    cairo_text_extents_t extents;
    cairo_text_extents(cr_, words.c_str(), &extents);
    if (extents.x_advance > most) cairo_set_font_size(cr_, size * most / extents.x_advance);
    cairo_save(cr_);
    cairo_move_to(cr_, x, y);
    if (upwards) cairo_rotate(cr_, -0.5 * std::numbers::pi);
    cairo_show_text(cr_, words.c_str());
    cairo_restore(cr_);
  }

  /// 100 mm with a tick every 10 mm.
  void ruler(double x, double y, bool upright) {
    constexpr double length = 100.0;
    const auto at = [&](double along, double across) {
      return upright ? std::pair(x + across, y - along) : std::pair(x + along, y + across);
    };
    const auto stroke = [&](double a0, double c0, double a1, double c1) {
      const auto [x0, y0] = at(a0, c0);
      const auto [x1, y1] = at(a1, c1);
      line(x0, y0, x1, y1, 0.2);
    };
    stroke(0, 0, length, 0);
    for (int i = 0; i <= 10; ++i) stroke(10.0 * i, 0, 10.0 * i, i % 10 == 0 ? 4.0 : i % 5 == 0 ? 3.0 : 2.0);
    if (upright)
      text(x - 1.0, y - 34.0, "100 mm (y)", 3.0, true);
    else
      text(x + 34.0, y - 1.0, "100 mm (x)", 3.0);
  }

  /// Four corner marks around what is to be cut out.
  void cut_marks(double x, double y, double width, double height) {
    for (const double cx : {x, x + width})
      for (const double cy : {y, y + height}) {
        const double sx = cx > x ? 1.0 : -1.0;
        const double sy = cy > y ? 1.0 : -1.0;
        line(cx + sx * cut_gap, cy, cx + sx * cut_reach, cy);
        line(cx, cy + sy * cut_gap, cx, cy + sy * cut_reach);
      }
  }

  void next_page() { cairo_show_page(cr_); }

  /// Throws if anything went wrong on the way.
  void finish() {
    cairo_surface_finish(surface_);
    if (cairo_surface_status(surface_) != CAIRO_STATUS_SUCCESS)
      throw Failure(ExitCode::usage,
                    "--output " + file_ + ": " + cairo_status_to_string(cairo_surface_status(surface_)));
  }

 private:
  std::string file_;
  cairo_surface_t* surface_;
  cairo_t* cr_;
};

/// @param x, y  top left of the square whose side is `size` [mm]
void draw_pattern(Sheet& sheet, const TagPattern& pattern, double x, double y, double size) {
  const double cell = size / pattern.border_cells;
  const int rim = (pattern.cells - pattern.border_cells) / 2;
  for (int row = 0; row < pattern.cells; ++row)
    for (int column = 0; column < pattern.cells; ++column) {
      if (pattern.at(column, row) != TagPattern::black) continue;
      int end = column + 1;
      while (end < pattern.cells && pattern.at(end, row) == TagPattern::black) ++end;
      sheet.black(x + (column - rim) * cell, y + (row - rim) * cell, (end - column) * cell, cell);
      column = end;
    }
}

TagPattern pattern_of(const std::string& family, int id) {
  try {
    return tag_pattern(family, id);
  } catch (const std::invalid_argument& error) {
    throw Failure(ExitCode::usage, error.what());
  }
}

struct Extent {
  double width;
  double height;
};

/// Of the pattern with the white that it needs around it, for a unit of its size (square or tag) of 1.
Extent unit_extent(const CalibrationTarget& target) {
  if (target.type == Type::charuco) return {target.squares_x + 0.5, target.squares_y + 0.5};
  if (target.type == Type::tag) return {1.25, 1.25};
  const double pitch = 1.0 + target.tag_spacing;
  return {target.tag_cols * pitch + target.tag_spacing, target.tag_rows * pitch + target.tag_spacing};
}

}  // namespace

Paper paper_of(const std::string& name) {
  const Paper known[] = {{"A0", 1189, 841}, {"A1", 841, 594}, {"A2", 594, 420},         {"A3", 420, 297},
                         {"A4", 297, 210},  {"A5", 210, 148}, {"letter", 279.4, 215.9}, {"tabloid", 431.8, 279.4}};
  std::string names;
  for (const Paper& paper : known) {
    if (paper.name == name) return paper;
    names += " " + paper.name;
  }
  throw Failure(ExitCode::usage, "--paper " + name + " is unknown; known are" + names);
}

CalibrationTarget fitted(const CalibrationTarget& target, const Paper& paper) {
  CalibrationTarget result = target;
  const Extent unit = unit_extent(target);
  const double marks = target.type == Type::tag ? 2.0 * cut_reach : 0.0;
  const double room_x = paper.width - 2.0 * margin - ruler_strip - marks;
  const double room_y = paper.height - 2.0 * margin - caption - marks;
  const double largest = std::floor(10.0 * std::min(room_x / unit.width, room_y / unit.height)) / 10.0;
  double& size = target.type == Type::charuco ? result.square : result.tag_size;
  if (size <= 0.0) size = std::round(10.0 * largest) / 10000.0;
  if (1000.0 * size > largest + 1e-9)
    throw Failure(ExitCode::usage, "a size of " + text_of(1000.0 * size) + " mm does not fit on " + paper.name +
                                       "; the largest is " + text_of(largest) + " mm, or take a larger --paper");
  if (target.type == Type::charuco && result.marker <= 0.0)
    result.marker = std::round(7500.0 * result.square) / 10000.0;
  try {
    (void)layouts_of(result);
  } catch (const std::invalid_argument& error) {
    throw Failure(ExitCode::usage, error.what());
  }
  return result;
}

void print_target(const CalibrationTarget& target, const Paper& paper, const std::filesystem::path& pdf) {
  const TargetLayout layout = layouts_of(target).front();
  Sheet sheet(paper, pdf);
  const double width = 1000.0 * layout.width;
  const double height = 1000.0 * layout.height;
  const double x0 = margin + ruler_strip + 0.5 * (paper.width - 2.0 * margin - ruler_strip - width);
  const double y0 = margin + 0.5 * (paper.height - 2.0 * margin - caption - height);
  std::string what;
  try {
    for (const auto& [id, corners] : layout.marks) {
      const TagPattern pattern =
          target.type == Type::charuco ? mark_pattern(target.dictionary, id) : tag_pattern(target.family, id);
      draw_pattern(sheet, pattern, x0 + 1000.0 * corners[0].x(), y0 + 1000.0 * corners[0].y(),
                   1000.0 * (corners[1].x() - corners[0].x()));
    }
  } catch (const std::invalid_argument& error) {
    throw Failure(ExitCode::usage, error.what());
  }
  if (target.type == Type::charuco) {
    const double square = 1000.0 * target.square;
    for (int row = 0; row < target.squares_y; ++row)
      for (int column = 0; column < target.squares_x; ++column)
        if ((row + column) % 2 == 0) sheet.black(x0 + column * square, y0 + row * square, square, square);
    what = "ChArUco " + std::to_string(target.squares_x) + " x " + std::to_string(target.squares_y) + ", square " +
           text_of(square) + " mm, marker " + text_of(1000.0 * target.marker) + " mm, " + target.dictionary +
           ", ids row by row from the top left";
  } else {
    const double size = 1000.0 * target.tag_size;
    const double gap = size * target.tag_spacing;
    if (target.type == Type::aprilgrid)
      for (int row = 0; row <= target.tag_rows; ++row)
        for (int column = 0; column <= target.tag_cols; ++column)
          sheet.black(x0 + column * (size + gap) - gap, y0 + row * (size + gap) - gap, gap, gap);
    what = (target.type == Type::tag ? "tag " + std::to_string(target.first_id)
                                     : std::string(target.type == Type::aprilgrid ? "Kalibr AprilGrid " : "tag grid ") +
                                           std::to_string(target.tag_cols) + " x " + std::to_string(target.tag_rows) +
                                           ", ids from the bottom left, gap " + text_of(gap) + " mm (spacing " +
                                           text_of(target.tag_spacing) + ")") +
           ", " + target.family + ", tag " + text_of(size) + " mm";
  }
  sheet.fill();
  if (target.type == Type::tag) {
    const double white = 0.125 * width;
    sheet.cut_marks(x0 - white, y0 - white, width + 2.0 * white, height + 2.0 * white);
  }
  const double bottom = paper.height - margin;
  sheet.ruler(margin + ruler_strip, bottom - 15.0, false);
  sheet.ruler(margin + 2.0, bottom - caption - 4.0, true);
  const double most = paper.width - 2.0 * margin - ruler_strip;
  sheet.text(margin + ruler_strip, bottom - 5.5, "tagdock: " + what, 3.2, false, most);
  sheet.text(
      margin + ruler_strip, bottom - 0.5,
      "Print at 100 % (no fitting to the page), glue onto something stiff and flat. Measured along the rulers, in "
      "mm:  x ________  y ________",
      3.2, false, most);
  sheet.finish();
}

Board v_board(double tag_size, double height) {
  Board board = default_board(0.0);
  const double scale = tag_size / board.tags.front().size;
  for (BoardTag& tag : board.tags) {
    tag.size *= scale;
    tag.T_station_tag.translation() *= scale;
    tag.T_station_tag.translation().z() = height;
  }
  return board;
}

void print_board(const Board& board, double plate, double fold, const Paper& paper, const std::filesystem::path& pdf) {
  const double side = 1000.0 * plate;
  // Between the two folds lies the plane of the centre tag, from one wing's inner edge to the other's.
  const double inner =
      2000.0 * (std::abs(board.tags.front().T_station_tag.translation().y()) - 0.5 * plate * std::cos(fold));
  const double strip = 2.0 * side + inner;
  // Cut marks stay clear of the upright ruler (the pattern stands in the middle) and of the foot.
  const double beside = 2.0 * (margin + ruler_strip + cut_reach);
  const double above_and_below = 2.0 * (margin + cut_reach) + caption;
  const bool one_sheet = strip + beside <= paper.width && side + above_and_below <= paper.height;
  if (!one_sheet && (side + beside > paper.width || side + above_and_below > paper.height))
    throw Failure(ExitCode::usage, "a plate of " + text_of(side) + " mm does not fit on " + paper.name +
                                       "; take a larger --paper or a smaller --tag-size");
  Sheet sheet(paper, pdf);
  const double bottom = paper.height - margin;
  const auto foot = [&](const std::string& words) {
    sheet.ruler(margin + ruler_strip, bottom - 15.0, false);
    sheet.ruler(margin + 2.0, bottom - caption - 4.0, true);
    const double most = paper.width - 2.0 * margin - ruler_strip;
    sheet.text(margin + ruler_strip, bottom - 5.5, words, 3.2, false, most);
    sheet.text(margin + ruler_strip, bottom - 0.5,
               "Print at 100 %. Measured along the rulers, in mm:  x ________  y ________", 3.2, false, most);
  };
  const auto tag_at = [&](const BoardTag& tag, double centre_x, double centre_y) {
    const double size = 1000.0 * tag.size;
    draw_pattern(sheet, pattern_of(board.family, tag.id), centre_x - 0.5 * size, centre_y - 0.5 * size, size);
    sheet.fill();
    sheet.text(centre_x - 0.5 * size, centre_y + 0.5 * side - 1.2,
               board.family + " id " + std::to_string(tag.id) + ", " + text_of(size) + " mm", 2.6);
  };
  if (one_sheet) {
    const double x0 = 0.5 * (paper.width - strip);
    const double y0 = 0.5 * (paper.height - caption - side);
    const double centres[] = {x0 + 0.5 * side, x0 + 0.5 * strip, x0 + strip - 0.5 * side};
    for (std::size_t i = 0; i < 3; ++i) tag_at(board.tags[i], centres[i], y0 + 0.5 * side);
    sheet.cut_marks(x0, y0, strip, side);
    for (const double x : {x0 + side, x0 + side + inner}) {
      sheet.line(x, y0 - 6.0, x, y0 - 1.0);
      sheet.line(x, y0 + side + 1.0, x, y0 + side + 6.0);
      sheet.line(x, y0, x, y0 + side, 0.1, true);
      sheet.text(x + 1.0, y0 - 2.5, "fold back by " + text_of(degrees(fold)) + " degrees", 2.6);
    }
    foot("tagdock V board: cut at the corner marks, fold both wings back along the dashed lines, onto a stiff body");
  } else {
    const char* const names[] = {"left wing", "centre", "right wing"};
    for (std::size_t i = 0; i < 3; ++i) {
      if (i > 0) sheet.next_page();
      const double width = i == 1 ? inner : side;
      const double y0 = 0.5 * (paper.height - caption - side);
      tag_at(board.tags[i], 0.5 * paper.width, y0 + 0.5 * side);
      sheet.cut_marks(0.5 * (paper.width - width), y0, width, side);
      foot(std::string("tagdock V board, ") + names[i] +
           " as seen: cut at the corner marks; plates meet at their upright "
           "edges, wings turned back by " +
           text_of(degrees(fold)) + " degrees");
    }
  }
  sheet.finish();
}

}  // namespace tagdock
