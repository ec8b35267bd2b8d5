#include "app/svg.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <limits>

#include "app/html.h"

namespace tagdock {
namespace {

std::string coordinate(double value) { return plain(value, 2); }

std::string pairs(const std::vector<Eigen::Vector2d>& points) {
  std::string text;
  for (const Eigen::Vector2d& point : points) text += coordinate(point.x()) + "," + coordinate(point.y()) + " ";
  return text;
}

std::string base64(const std::vector<unsigned char>& bytes) {
  static constexpr char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t have = std::min<std::size_t>(3, bytes.size() - i);
    const unsigned group = (static_cast<unsigned>(bytes[i]) << 16) |
                           (have > 1 ? static_cast<unsigned>(bytes[i + 1]) << 8 : 0U) |
                           (have > 2 ? static_cast<unsigned>(bytes[i + 2]) : 0U);
    for (std::size_t j = 0; j < 4; ++j) text += j <= have ? letters[(group >> (18 - 6 * j)) & 63U] : '=';
  }
  return text;
}

}  // namespace

Svg::Svg(double width, double height) : width_(width), height_(height) {}

void Svg::line(const Eigen::Vector2d& from, const Eigen::Vector2d& to, const std::string& style) {
  body_ += "<line x1=\"" + coordinate(from.x()) + "\" y1=\"" + coordinate(from.y()) + "\" x2=\"" + coordinate(to.x()) +
           "\" y2=\"" + coordinate(to.y()) + "\" style=\"" + style + "\"/>\n";
}

void Svg::polyline(const std::vector<Eigen::Vector2d>& points, const std::string& style) {
  body_ += "<polyline points=\"" + pairs(points) + "\" style=\"fill:none;" + style + "\"/>\n";
}

void Svg::polygon(const std::vector<Eigen::Vector2d>& points, const std::string& style) {
  body_ += "<polygon points=\"" + pairs(points) + "\" style=\"" + style + "\"/>\n";
}

void Svg::circle(const Eigen::Vector2d& centre, double radius, const std::string& style) {
  body_ += "<circle cx=\"" + coordinate(centre.x()) + "\" cy=\"" + coordinate(centre.y()) + "\" r=\"" +
           coordinate(radius) + "\" style=\"" + style + "\"/>\n";
}

void Svg::rectangle(const Eigen::Vector2d& corner, double width, double height, const std::string& style) {
  body_ += "<rect x=\"" + coordinate(corner.x()) + "\" y=\"" + coordinate(corner.y()) + "\" width=\"" +
           coordinate(width) + "\" height=\"" + coordinate(height) + "\" style=\"" + style + "\"/>\n";
}

void Svg::text(const Eigen::Vector2d& place, const std::string& words, double size, const std::string& anchor,
               const std::string& style) {
  body_ += "<text x=\"" + coordinate(place.x()) + "\" y=\"" + coordinate(place.y()) + "\" font-size=\"" +
           coordinate(size) + "\" text-anchor=\"" + anchor + "\" style=\"" + style + "\">" + html_text(words) +
           "</text>\n";
}

void Svg::image(const Eigen::Vector2d& corner, double width, double height, const std::string& media_type,
                const std::vector<unsigned char>& bytes) {
  body_ += "<image x=\"" + coordinate(corner.x()) + "\" y=\"" + coordinate(corner.y()) + "\" width=\"" +
           coordinate(width) + "\" height=\"" + coordinate(height) + "\" href=\"data:" + media_type + ";base64," +
           base64(bytes) + "\"/>\n";
}

std::string Svg::text() const {
  return "<svg xmlns=\"http://www.w3.org/2000/svg\" viewBox=\"0 0 " + coordinate(width_) + " " + coordinate(height_) +
         "\" font-family=\"sans-serif\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n" + body_ + "</svg>\n";
}

std::vector<double> axis_ticks(double least, double most, int count) {
  const double rough = (most - least) / std::max(1, count);
  if (!(rough > 0.0) || !std::isfinite(rough)) return {least};
  const double power = std::pow(10.0, std::floor(std::log10(rough)));
  const double share = rough / power;
  const double step = power * (share < 1.5 ? 1.0 : share < 3.5 ? 2.0 : share < 7.5 ? 5.0 : 10.0);
  std::vector<double> ticks;
  for (double tick = std::ceil(least / step) * step; tick <= most + 1e-9 * step; tick += step) ticks.push_back(tick);
  return ticks;
}

std::string plain(double value, int decimals) {
  char text[64];
  std::snprintf(text, sizeof text, "%.*f", decimals, value);
  std::string number = text;
  if (number.find('.') != std::string::npos) {
    number.erase(number.find_last_not_of('0') + 1);
    if (number.back() == '.') number.pop_back();
  }
  return number == "-0" ? "0" : number;
}

void draw_diagram(Svg& svg, const Eigen::Vector2d& corner, double width, double height, const std::string& title,
                  const std::string& x_label, const std::string& y_label, const std::vector<Curve>& curves) {
  Eigen::Vector2d least = Eigen::Vector2d::Constant(std::numeric_limits<double>::infinity());
  Eigen::Vector2d most = -least;
  for (const Curve& curve : curves)
    for (const Eigen::Vector2d& point : curve.points) {
      least = least.cwiseMin(point);
      most = most.cwiseMax(point);
    }
  if (!(least.array() <= most.array()).all()) {
    svg.text(corner + Eigen::Vector2d(width / 2, height / 2), title + ": nothing to show", 13, "middle");
    return;
  }
  for (int axis = 0; axis < 2; ++axis)
    if (most[axis] - least[axis] < 1e-9) {
      most[axis] += 0.5;
      least[axis] -= 0.5;
    }
  const double border = 0.06 * (most.y() - least.y());
  least.y() -= border;
  most.y() += border;
  const Eigen::Vector2d origin = corner + Eigen::Vector2d(58, 24);
  const double w = width - 72;
  const double h = height - 66;
  const auto place = [&](const Eigen::Vector2d& point) {
    return Eigen::Vector2d(origin.x() + w * (point.x() - least.x()) / (most.x() - least.x()),
                           origin.y() + h * (most.y() - point.y()) / (most.y() - least.y()));
  };
  svg.rectangle(origin, w, h, "fill:#fafafa;stroke:#888");
  const auto decimals = [](double range) {
    return std::clamp(2 - static_cast<int>(std::floor(std::log10(range))), 0, 6);
  };
  for (const double tick : axis_ticks(least.x(), most.x(), 6)) {
    const Eigen::Vector2d at = place({tick, least.y()});
    svg.line(at, at - Eigen::Vector2d(0, h), "stroke:#ddd");
    svg.text(at + Eigen::Vector2d(0, 15), plain(tick, decimals(most.x() - least.x())), 11, "middle");
  }
  for (const double tick : axis_ticks(least.y(), most.y(), 5)) {
    const Eigen::Vector2d at = place({least.x(), tick});
    svg.line(at, at + Eigen::Vector2d(w, 0), std::abs(tick) < 1e-12 ? "stroke:#999" : "stroke:#ddd");
    svg.text(at + Eigen::Vector2d(-5, 4), plain(tick, decimals(most.y() - least.y())), 11, "end");
  }
  double name_x = origin.x() + w;
  for (const Curve& curve : curves) {
    std::vector<Eigen::Vector2d> points;
    for (const Eigen::Vector2d& point : curve.points) points.push_back(place(point));
    svg.polyline(points, curve.style);
  }
  for (auto curve = curves.rbegin(); curve != curves.rend(); ++curve) {
    if (curve->name.empty()) continue;
    svg.text({name_x, corner.y() + 16}, curve->name, 12, "end");
    name_x -= 6.2 * static_cast<double>(curve->name.size()) + 10;
    svg.line({name_x - 12, corner.y() + 12}, {name_x + 4, corner.y() + 12}, curve->style);
    name_x -= 22;
  }
  svg.text(corner + Eigen::Vector2d(58, 16), title, 14, "start", "font-weight:bold");
  svg.text({origin.x() + w / 2, corner.y() + height - 8}, x_label, 12, "middle");
  svg.text({corner.x() + 14, corner.y() + 16}, y_label, 12, "start");
}

}  // namespace tagdock
