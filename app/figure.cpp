#include "app/figure.h"

#include <algorithm>
#include <cairo/cairo-pdf.h>
#include <cairo/cairo.h>
#include <cmath>
#include <cstdio>

#include "app/failure.h"
#include "app/html.h"
#include "app/svg.h"

namespace tagdock {
namespace {

using Eigen::Vector2d;

std::string colour(int value) {
  if (value < 0) return "none";
  char text[16];
  std::snprintf(text, sizeof text, "#%06x", static_cast<unsigned>(value));
  return text;
}

std::string style_of(const Ink& ink) {
  std::string style = "fill:" + colour(ink.fill) + ";stroke:" + colour(ink.stroke);
  if (ink.stroke >= 0) style += ";stroke-width:" + plain(ink.width, 2);
  if (ink.opacity < 1.0) style += ";opacity:" + plain(ink.opacity, 2);
  return style;
}

void set_colour(cairo_t* cr, int value, double opacity) {
  cairo_set_source_rgba(cr, ((value >> 16) & 255) / 255.0, ((value >> 8) & 255) / 255.0, (value & 255) / 255.0,
                        opacity);
}

void paint(cairo_t* cr, const Ink& ink) {
  if (ink.fill >= 0) {
    set_colour(cr, ink.fill, ink.opacity);
    cairo_fill_preserve(cr);
  }
  if (ink.stroke >= 0) {
    set_colour(cr, ink.stroke, ink.opacity);
    cairo_set_line_width(cr, ink.width);
    cairo_stroke_preserve(cr);
  }
  cairo_new_path(cr);
}

void draw_text(cairo_t* cr, const Vector2d& place, const std::string& words, double size, double anchor) {
  cairo_set_source_rgb(cr, 0.1, 0.1, 0.1);
  cairo_set_font_size(cr, size);
  cairo_text_extents_t extents;
  cairo_text_extents(cr, words.c_str(), &extents);
  cairo_move_to(cr, place.x() - anchor * extents.x_advance, place.y());
  cairo_show_text(cr, words.c_str());
  cairo_new_path(cr);
}

void draw(cairo_t* cr, const Figure& figure) {
  for (const Figure::Part& part : figure.parts()) {
    if (const auto* shape = std::get_if<Figure::Shape>(&part)) {
      for (std::size_t i = 0; i < shape->points.size(); ++i) {
        const Vector2d& p = shape->points[i];
        if (i == 0)
          cairo_move_to(cr, p.x(), p.y());
        else
          cairo_line_to(cr, p.x(), p.y());
      }
      if (shape->closed) cairo_close_path(cr);
      paint(cr, shape->ink);
    } else if (const auto* circle = std::get_if<Figure::Circle>(&part)) {
      cairo_arc(cr, circle->centre.x(), circle->centre.y(), circle->radius, 0.0, 2.0 * std::acos(-1.0));
      paint(cr, circle->ink);
    } else if (const auto* text = std::get_if<Figure::Text>(&part)) {
      draw_text(cr, text->place, text->words, text->size, text->anchor);
    }
  }
}

double width_of(cairo_t* cr, const std::string& words, double size) {
  cairo_set_font_size(cr, size);
  cairo_text_extents_t extents;
  cairo_text_extents(cr, words.c_str(), &extents);
  return extents.x_advance;
}

/// Words broken into lines that are no wider than that; a word that is wider by itself is broken, too.
std::vector<std::string> lines_of(cairo_t* cr, const std::string& words, double size, double width) {
  std::vector<std::string> lines(1);
  std::size_t at = 0;
  while (at < words.size()) {
    std::size_t end = words.find(' ', at);
    if (end == std::string::npos) end = words.size();
    std::string word = words.substr(at, end - at);
    if (!lines.back().empty() && width_of(cr, lines.back() + " " + word, size) > width) lines.emplace_back();
    while (lines.back().empty() && word.size() > 1 && width_of(cr, word, size) > width) {
      std::size_t letters = word.size() - 1;
      while (letters > 1 && width_of(cr, word.substr(0, letters), size) > width) --letters;
      lines.back() = word.substr(0, letters);
      lines.emplace_back();
      word.erase(0, letters);
    }
    lines.back() += (lines.back().empty() ? "" : " ") + word;
    at = end + 1;
  }
  return lines;
}

/// Numbers of an axis: as many decimals as their step needs, so that neighbours never read the same.
std::string tick_text(const std::vector<double>& ticks, double tick) {
  const double step = ticks.size() > 1 ? ticks[1] - ticks[0] : std::abs(tick);
  const int decimals = step > 0.0 ? static_cast<int>(std::ceil(-std::log10(step) - 1e-9)) : 0;
  return plain(tick, std::clamp(ticks.size() > 1 ? decimals : decimals + 2, 0, 9));
}

}  // namespace

Figure::Figure(std::string title, double width, double height)
    : title_(std::move(title)), width_(width), height_(height) {}

void Figure::shape(std::vector<Vector2d> points, bool closed, const Ink& ink) {
  parts_.emplace_back(Shape{std::move(points), closed, ink});
}
void Figure::line(const Vector2d& from, const Vector2d& to, const Ink& ink) { shape({from, to}, false, ink); }
void Figure::circle(const Vector2d& centre, double radius, const Ink& ink) {
  parts_.emplace_back(Circle{centre, radius, ink});
}
void Figure::rectangle(const Vector2d& corner, double width, double height, const Ink& ink) {
  shape({corner, corner + Vector2d(width, 0), corner + Vector2d(width, height), corner + Vector2d(0, height)}, true,
        ink);
}
void Figure::text(const Vector2d& place, const std::string& words, double size, double anchor) {
  parts_.emplace_back(Text{place, words, size, anchor});
}

std::string Figure::svg() const {
  Svg svg(width_, height_);
  for (const Part& part : parts_) {
    if (const auto* shape = std::get_if<Shape>(&part)) {
      if (shape->closed)
        svg.polygon(shape->points, style_of(shape->ink));
      else
        svg.polyline(shape->points, style_of(shape->ink));
    } else if (const auto* circle = std::get_if<Circle>(&part)) {
      svg.circle(circle->centre, circle->radius, style_of(circle->ink));
    } else if (const auto* text = std::get_if<Text>(&part)) {
      svg.text(text->place, text->words, text->size,
               text->anchor < 0.25   ? "start"
               : text->anchor < 0.75 ? "middle"
                                     : "end",
               "fill:#1a1a1a");
    }
  }
  return svg.text();
}

Vector2d Axes::operator()(const Vector2d& value) const {
  const Vector2d share = (value - least).cwiseQuotient(most - least);
  return corner + Vector2d(share.x() * width, (y_down ? share.y() : 1.0 - share.y()) * height);
}

void Axes::draw(Figure& figure, const std::string& x_label, const std::string& y_label) const {
  const Ink frame{-1, 0x808080, 1.0, 1.0};
  figure.rectangle(corner, width, height, frame);
  const auto below = [&](double x, const std::string& words) {
    figure.line({x, corner.y() + height}, {x, corner.y() + height + 4}, frame);
    figure.text({x, corner.y() + height + 16}, words, 10.0, 0.5);
  };
  if (names.empty()) {
    const std::vector<double> ticks = axis_ticks(least.x(), most.x(), 6);
    for (const double tick : ticks) below((*this)({tick, least.y()}).x(), tick_text(ticks, tick));
  }
  // Every first, second, fifth.. name, so that none touches the next.
  const auto touch = [&](std::size_t stride) {
    constexpr double letter = 6.0;  // px, of this size
    constexpr double gap = 3.0;
    for (std::size_t i = 0; i + stride < names.size(); i += stride) {
      const double apart = (*this)({names[i + stride].first, 0.0}).x() - (*this)({names[i].first, 0.0}).x();
      const std::size_t letters = names[i].second.size() + names[i + stride].second.size();
      if (apart < 0.5 * letter * static_cast<double>(letters) + gap) return true;
    }
    return false;
  };
  std::size_t stride = 1;
  for (std::size_t power = 1; touch(stride); power *= 10)
    for (const std::size_t share : {2, 5, 10})
      if (touch(stride)) stride = share * power;
  for (std::size_t i = 0; i < names.size(); i += stride)
    below((*this)({names[i].first, least.y()}).x(), names[i].second);
  const std::vector<double> ticks = axis_ticks(least.y(), most.y(), 5);
  for (const double tick : ticks) {
    const double y = (*this)({least.x(), tick}).y();
    figure.line({corner.x() - 4, y}, {corner.x(), y}, frame);
    figure.text({corner.x() - 7, y + 4}, tick_text(ticks, tick), 10.0, 1.0);
  }
  figure.text({corner.x() + 0.5 * width, corner.y() + height + 31}, x_label, 11.0, 0.5);
  figure.text({corner.x() - 45, corner.y() - 8}, y_label, 11.0);
}

std::string to_html(const Report& report) {
  std::string page =
      "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>" + html_text(report.title) +
      "</title>\n<style>body{font-family:sans-serif;max-width:1000px;margin:1.5em auto;padding:0 1em;color:#1a1a1a}"
      ".good,.bad{padding:.6em 1em;border-left:8px solid}.good{background:#e6f4e6;border-color:#2a7a2a}"
      ".bad{background:#fbe9e7;border-color:#b3261e}table{border-collapse:collapse;font-size:.85em}"
      "td,th{border:1px solid #ccc;padding:.15em .5em;text-align:left}figure{display:inline-block;margin:.5em;"
      "vertical-align:top;width:46%;min-width:300px}figcaption{font-weight:bold;font-size:.9em}svg{width:100%}</style>"
      "</head>\n<body>\n<h1>" +
      html_text(report.title) + "</h1>\n<div class=\"" + (report.good ? "good" : "bad") + "\">";
  for (const std::string& sentence : report.verdict) page += "<p>" + html_text(sentence) + "</p>";
  page += "</div>\n";
  for (const std::string& sentence : report.sentences) page += "<p>" + html_text(sentence) + "</p>\n";
  for (const Figure& figure : report.figures)
    page += "<figure><figcaption>" + html_text(figure.title()) + "</figcaption>" + figure.svg() + "</figure>\n";
  for (const Report::Table& table : report.tables) {
    page += "<h2>" + html_text(table.title) + "</h2>\n<table>\n";
    for (std::size_t i = 0; i < table.rows.size(); ++i) {
      page += "<tr>";
      const std::string cell = i == 0 ? "th" : "td";
      for (const std::string& words : table.rows[i]) page += "<" + cell + ">" + html_text(words) + "</" + cell + ">";
      page += "</tr>\n";
    }
    page += "</table>\n";
  }
  return page + "</body></html>\n";
}

void to_pdf(const Report& report, const std::filesystem::path& file) {
  constexpr double width = 595.0;  // A4 in points
  constexpr double height = 842.0;
  constexpr double margin = 40.0;
  cairo_surface_t* surface = cairo_pdf_surface_create(file.string().c_str(), width, height);
  cairo_t* cr = cairo_create(surface);
  cairo_select_font_face(cr, "sans-serif", CAIRO_FONT_SLANT_NORMAL, CAIRO_FONT_WEIGHT_NORMAL);
  double y = margin + 14.0;
  const auto room = [&](double needed) {
    if (y + needed < height - margin) return;
    cairo_show_page(cr);
    y = margin + 14.0;
  };
  const auto paragraph = [&](const std::string& words, double size) {
    for (const std::string& line : lines_of(cr, words, size, width - 2.0 * margin)) {
      room(1.3 * size);
      draw_text(cr, {margin, y}, line, size, 0.0);
      y += 1.35 * size;
    }
    y += 0.4 * size;
  };
  paragraph(report.title, 16.0);
  for (const std::string& sentence : report.verdict) {
    room(30.0);
    set_colour(cr, report.good ? 0x2a7a2a : 0xb3261e, 1.0);
    cairo_rectangle(cr, margin - 10.0, y - 10.0, 4.0, 14.0);
    cairo_fill(cr);
    paragraph(sentence, 11.0);
  }
  for (const std::string& sentence : report.sentences) paragraph(sentence, 10.0);
  // Figures two beside each other, each below its title.
  constexpr double column = (width - 2.0 * margin - 15.0) / 2.0;
  constexpr double title_size = 9.0;
  constexpr double title_line = 12.0;
  for (std::size_t i = 0; i < report.figures.size(); i += 2) {
    const std::size_t end = std::min(i + 2, report.figures.size());
    std::size_t title_lines = 0;
    double tallest = 0.0;
    for (std::size_t k = i; k < end; ++k) {
      const Figure& figure = report.figures[k];
      title_lines = std::max(title_lines, lines_of(cr, figure.title(), title_size, column).size());
      tallest = std::max(tallest, figure.height() * column / figure.width());
    }
    const double titles = title_line * static_cast<double>(title_lines);
    room(titles + tallest + 10.0);
    for (std::size_t k = i; k < end; ++k) {
      const Figure& figure = report.figures[k];
      const double x = margin + (k == i ? 0.0 : column + 15.0);
      double line_y = y;
      for (const std::string& line : lines_of(cr, figure.title(), title_size, column)) {
        draw_text(cr, {x, line_y}, line, title_size, 0.0);
        line_y += title_line;
      }
      cairo_save(cr);
      cairo_translate(cr, x, y + titles - title_line + 4.0);
      cairo_scale(cr, column / figure.width(), column / figure.width());
      draw(cr, figure);
      cairo_restore(cr);
    }
    y += titles + tallest + 10.0;
  }
  for (const Report::Table& table : report.tables) {
    y += 14.0;
    room(60.0);
    paragraph(table.title, 12.0);
    constexpr double size = 7.5;
    constexpr double gap = 10.0;
    constexpr double row_height = 10.5;
    std::vector<double> widths;
    for (const auto& row : table.rows)
      for (std::size_t i = 0; i < row.size(); ++i) {
        if (i >= widths.size()) widths.push_back(0.0);
        widths[i] = std::max(widths[i], width_of(cr, row[i], size) + gap);
      }
    // Too wide a table is narrowed where it is widest; there its words are broken into lines.
    double over = -(width - 2.0 * margin);
    for (const double wide : widths) over += wide;
    if (over > 0.0) {
      double& widest = *std::max_element(widths.begin(), widths.end());
      widest = std::max(60.0, widest - over);
    }
    for (std::size_t r = 0; r < table.rows.size(); ++r) {
      const auto& row = table.rows[r];
      std::vector<std::vector<std::string>> cells;
      std::size_t tall = 1;
      for (std::size_t i = 0; i < row.size(); ++i) {
        cells.push_back(lines_of(cr, row[i], size, widths[i] - gap + 0.01));
        tall = std::max(tall, cells.back().size());
      }
      room(row_height * static_cast<double>(tall));
      double x = margin;
      for (std::size_t i = 0; i < cells.size(); ++i) {
        for (std::size_t k = 0; k < cells[i].size(); ++k)
          draw_text(cr, {x, y + row_height * static_cast<double>(k)}, cells[i][k], size, 0.0);
        x += widths[i];
      }
      y += row_height * static_cast<double>(tall);
      if (r == 0) {
        set_colour(cr, 0x808080, 1.0);
        cairo_set_line_width(cr, 0.5);
        cairo_move_to(cr, margin, y - row_height + 3.0);
        cairo_line_to(cr, x, y - row_height + 3.0);
        cairo_stroke(cr);
        y += 2.0;
      }
    }
  }
  cairo_destroy(cr);
  cairo_surface_finish(surface);
  const cairo_status_t status = cairo_surface_status(surface);
  cairo_surface_destroy(surface);
  if (status != CAIRO_STATUS_SUCCESS)
    throw Failure(ExitCode::usage, file.string() + ": " + cairo_status_to_string(status));
}

}  // namespace tagdock
