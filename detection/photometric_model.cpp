#include "detection/photometric_model.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <numbers>

#include "detection/normal_distribution.h"

namespace tagdock {
namespace {

/// Most grid lines that one pixel may see in one direction; no family has more.
constexpr int most_lines = 12;

/// Unknown cells take the colour of a known neighbour: no border is drawn against them.
std::vector<std::int8_t> filled(const TagPattern& pattern) {
  const int n = pattern.cells;
  std::vector<std::int8_t> cells(pattern.cell.begin(), pattern.cell.end());
  const auto index = [n](int column, int row) { return static_cast<std::size_t>(row * n + column); };
  for (bool open = true; open;) {
    open = false;
    std::vector<std::int8_t> next = cells;
    for (int row = 0; row < n; ++row)
      for (int column = 0; column < n; ++column) {
        if (cells[index(column, row)] != TagPattern::unknown) continue;
        for (const auto& [dx, dy] : {std::pair{1, 0}, {-1, 0}, {0, 1}, {0, -1}}) {
          const int x = column + dx;
          const int y = row + dy;
          if (x < 0 || y < 0 || x >= n || y >= n || cells[index(x, y)] == TagPattern::unknown) continue;
          next[index(column, row)] = cells[index(x, y)];
        }
        open = true;
      }
    cells = std::move(next);
  }
  return cells;
}

}  // namespace

TagImageModel::TagImageModel(const TagPattern& pattern, double side_px)
    : pattern_(pattern), side_px_(side_px), middle_(0.5 * pattern.cells), cells_(filled(pattern)) {
  const int n = pattern.cells;
  assert(n < most_lines);
  for (auto& lines : lines_) lines.resize(static_cast<std::size_t>(n) + 1);
  vertices_.resize(static_cast<std::size_t>((n + 1) * (n + 1)));
  for (int j = 1; j < n; ++j)
    for (int i = 1; i < n; ++i) {
      const int top = cell(i, j - 1) - cell(i - 1, j - 1);
      const int bottom = cell(i, j) - cell(i - 1, j);
      const int left = cell(i - 1, j) - cell(i - 1, j - 1);
      const int right = cell(i, j) - cell(i, j - 1);
      const int sign = bottom - top;
      auto& [first, second] = vertices_[static_cast<std::size_t>(j * (n + 1) + i)];
      const auto side = [](int step) { return step > 0 ? 1 : 0; };
      // One corner of the area where three cells are alike; two, moved apart by the ink, where only opposite ones are.
      if (std::abs(sign) == 1) {
        first = {sign, side(top + bottom), side(left + right)};
      } else if (sign == 2) {
        first = {1, side(bottom), side(right)};
        second = {1, side(top), side(left)};
      } else if (sign == -2) {
        first = {-1, side(top), side(right)};
        second = {-1, side(bottom), side(left)};
      }
    }
}

int TagImageModel::cell(int column, int row) const {
  const int last = pattern_.cells - 1;
  return cells_[static_cast<std::size_t>(std::clamp(row, 0, last) * pattern_.cells + std::clamp(column, 0, last))];
}

Eigen::Vector2d TagImageModel::to_tag(double x, double y) const {
  const auto& g = appearance_.value;
  const double w = g[6] * x + g[7] * y + 1.0;
  return {(g[0] * x + g[1] * y + g[2]) / w, (g[3] * x + g[4] * y + g[5]) / w};
}

void TagImageModel::set(const TagAppearance& appearance) {
  appearance_ = appearance;
  const auto& g = appearance_.value;
  for (int direction = 0; direction < 2; ++direction)
    for (int i = 0; i <= pattern_.cells; ++i)
      for (int side = 0; side < 2; ++side) {
        Line& line =
            lines_[static_cast<std::size_t>(direction)][static_cast<std::size_t>(i)][static_cast<std::size_t>(side)];
        line.place = i - middle_ + (side == 1 ? g[TagAppearance::bleed] : -g[TagAppearance::bleed]);
        const int row = 3 * direction;
        line.a = g[row] - line.place * g[6];
        line.b = g[row + 1] - line.place * g[7];
        line.c = g[row + 2] - line.place;
        const double length2 = line.a * line.a + line.b * line.b;
        const double nx2 = line.a * line.a / length2;
        const double ny2 = line.b * line.b / length2;
        const double variance = g[TagAppearance::blur_xx] * nx2 + g[TagAppearance::blur_yy] * ny2 +
                                2.0 * g[TagAppearance::blur_xy] * line.a * line.b / length2;
        line.fourth = -(nx2 * nx2 + ny2 * ny2) / (2880.0 * variance * variance);
      }
}

ModelledPixel TagImageModel::at(const TagPixel& pixel) const {
  const auto& g = appearance_.value;
  const double sxx = g[TagAppearance::blur_xx];
  const double sxy = g[TagAppearance::blur_xy];
  const double syy = g[TagAppearance::blur_yy];
  const double x = pixel.x;
  const double y = pixel.y;
  const double w = g[6] * x + g[7] * y + 1.0;
  const double u = (g[0] * x + g[1] * y + g[2]) / w;
  const double v = (g[3] * x + g[4] * y + g[5]) / w;
  const int cells = pattern_.cells;

  /// A line as this pixel sees it through the blur.
  struct Seen {
    const Line* line = nullptr;
    double z = 0.0, inverse = 0.0;  ///< distance in units of the blur across the line; 1 / that unit
    double nx = 0.0, ny = 0.0;      ///< gradient of the line's value by image pixels
    double ba = 0.0, bb = 0.0;      ///< d(unit^2)/d(a, b) / 2
  };
  const auto see = [&](const Line& line) {
    Seen seen;
    seen.line = &line;
    seen.nx = (line.a * pixel.xx + line.b * pixel.yx) / side_px_;
    seen.ny = (line.a * pixel.xy + line.b * pixel.yy) / side_px_;
    const double tx = sxx * seen.nx + sxy * seen.ny;
    const double ty = sxy * seen.nx + syy * seen.ny;
    seen.inverse = 1.0 / std::sqrt(seen.nx * tx + seen.ny * ty);
    seen.z = (line.a * x + line.b * y + line.c) * seen.inverse;
    seen.ba = (tx * pixel.xx + ty * pixel.xy) / side_px_;
    seen.bb = (tx * pixel.yx + ty * pixel.yy) / side_px_;
    return seen;
  };

  // The lines within reach, in both directions; the cells above and left of them all.
  std::array<std::array<std::array<Seen, 2>, most_lines>, 2> seen;
  std::array<int, 2> first{};
  std::array<int, 2> last{};
  for (std::size_t direction = 0; direction < 2; ++direction) {
    const double place = direction == 0 ? u : v;
    const int here = static_cast<int>(std::clamp(std::floor(place + middle_), -1.0, static_cast<double>(cells)));
    first[direction] = std::clamp(here + 1, 1, cells);
    last[direction] = first[direction] - 1;
    const auto reached = [&](int i) {
      const auto& pair = lines_[direction][static_cast<std::size_t>(i)];
      std::array<Seen, 2> both = {see(pair[0]), see(pair[1])};
      if (both[0].z < -normal_reach && both[1].z < -normal_reach) return false;
      if (both[0].z > normal_reach && both[1].z > normal_reach) return false;
      seen[direction][static_cast<std::size_t>(i)] = both;
      return true;
    };
    for (int i = first[direction] - 1; i >= 1 && reached(i); --i) first[direction] = i;
    for (int i = last[direction] + 1; i < cells && reached(i); ++i) last[direction] = i;
  }

  ModelledPixel result;
  result.by.setZero();
  double r = cell(first[0] - 1, first[1] - 1);
  Eigen::Vector3d by_u = Eigen::Vector3d::Zero();  // d(r)/d(row of u in the homography)
  Eigen::Vector3d by_v = Eigen::Vector3d::Zero();
  Eigen::Vector2d by_w = Eigen::Vector2d::Zero();
  Eigen::Vector3d by_blur = Eigen::Vector3d::Zero();
  double by_bleed = 0.0;
  const auto add_by_z = [&](const Seen& line, bool along_u, int side, double by_z) {
    const double scale = by_z * line.inverse;
    const double shrink = line.z * line.inverse;
    const Eigen::Vector3d by_line(scale * (x - shrink * line.ba), scale * (y - shrink * line.bb), scale);
    (along_u ? by_u : by_v) += by_line;
    by_w -= line.line->place * by_line.head<2>();
    const double by_place = -(by_line[0] * g[6] + by_line[1] * g[7] + by_line[2]);
    by_bleed += side == 1 ? by_place : -by_place;
    const double by_variance = -0.5 * by_z * line.z * line.inverse * line.inverse;
    by_blur += by_variance * Eigen::Vector3d(line.nx * line.nx, 2.0 * line.nx * line.ny, line.ny * line.ny);
  };
  struct Step {
    double value, slope;
  };
  const auto boxed = [](const Normal& gauss, double z, double fourth) {
    const double z2 = z * z;
    return Step{gauss.cumulative - fourth * z * (z2 - 3.0) * gauss.density,
                gauss.density * (1.0 + fourth * (z2 * (z2 - 6.0) + 3.0))};
  };
  const auto add_step = [&](std::size_t direction, int i, int step) {
    if (step == 0) return;
    const int side = step > 0 ? 1 : 0;
    const Seen& line = seen[direction][static_cast<std::size_t>(i)][static_cast<std::size_t>(side)];
    const Step edge = boxed(normal(line.z), line.z, line.line->fourth);
    r += step * edge.value;
    add_by_z(line, direction == 0, side, step * edge.slope);
  };
  for (int i = first[0]; i <= last[0]; ++i) add_step(0, i, cell(i, first[1] - 1) - cell(i - 1, first[1] - 1));
  for (int j = first[1]; j <= last[1]; ++j) add_step(1, j, cell(first[0] - 1, j) - cell(first[0] - 1, j - 1));
  for (int j = first[1]; j <= last[1]; ++j)
    for (int i = first[0]; i <= last[0]; ++i)
      for (const Vertex& vertex : vertices_[static_cast<std::size_t>(j * (cells + 1) + i)]) {
        if (vertex.sign == 0) continue;
        const Seen& a = seen[0][static_cast<std::size_t>(i)][static_cast<std::size_t>(vertex.side_u)];
        const Seen& b = seen[1][static_cast<std::size_t>(j)][static_cast<std::size_t>(vertex.side_v)];
        if (a.z < -normal_reach || b.z < -normal_reach) continue;
        const double scale = a.inverse * b.inverse;
        const double correlation = std::clamp(
            (sxx * a.nx * b.nx + sxy * (a.nx * b.ny + a.ny * b.nx) + syy * a.ny * b.ny) * scale, -0.999, 0.999);
        const Normal2 corner = normal2(a.z, b.z, correlation);
        const Normal na = normal(a.z);
        const Normal nb = normal(b.z);
        const Step sa = boxed(na, a.z, a.line->fourth);
        const Step sb = boxed(nb, b.z, b.line->fourth);
        const double more_a = sa.value - na.cumulative;
        const double more_b = sb.value - nb.cumulative;
        r += vertex.sign * (corner.cumulative + more_a * nb.cumulative + more_b * na.cumulative);
        add_by_z(a, true, vertex.side_u,
                 vertex.sign * (corner.by_p + (sa.slope - na.density) * nb.cumulative + more_b * na.density));
        add_by_z(b, false, vertex.side_v,
                 vertex.sign * (corner.by_q + (sb.slope - nb.density) * na.cumulative + more_a * nb.density));
        const double by_correlation = vertex.sign * corner.density;
        const double half = 0.5 * correlation;
        const double ia2 = a.inverse * a.inverse;
        const double ib2 = b.inverse * b.inverse;
        by_blur +=
            by_correlation *
            Eigen::Vector3d(a.nx * b.nx * scale - half * (a.nx * a.nx * ia2 + b.nx * b.nx * ib2),
                            (a.nx * b.ny + a.ny * b.nx) * scale - correlation * (a.nx * a.ny * ia2 + b.nx * b.ny * ib2),
                            a.ny * b.ny * scale - half * (a.ny * a.ny * ia2 + b.ny * b.ny * ib2));
        const Eigen::Vector2d by_a = by_correlation * Eigen::Vector2d(b.ba * scale - correlation * a.ba * ia2,
                                                                      b.bb * scale - correlation * a.bb * ia2);
        const Eigen::Vector2d by_b = by_correlation * Eigen::Vector2d(a.ba * scale - correlation * b.ba * ib2,
                                                                      a.bb * scale - correlation * b.bb * ib2);
        by_u.head<2>() += by_a;
        by_v.head<2>() += by_b;
        by_w -= a.line->place * by_a + b.line->place * by_b;
        result.node += std::exp(-0.5 * (a.z * a.z + b.z * b.z));
      }

  const double drop = g[11] + g[12] * x + g[13] * y;
  const double black = 1.0 - r;
  result.whiteness = r;
  result.light = g[8] + g[9] * x + g[10] * y - drop * black;
  auto& by = result.by;
  by.segment<3>(0) = drop * by_u;
  by.segment<3>(3) = drop * by_v;
  by.segment<2>(6) = drop * by_w;
  by.segment<3>(8) = Eigen::Vector3d(1.0, x, y);
  by.segment<3>(11) = -black * Eigen::Vector3d(1.0, x, y);
  by.segment<3>(14) = drop * by_blur;
  by[TagAppearance::bleed] = drop * by_bleed;
  // The tone curve; light below a thousandth of a grey level is held there, where a power has no derivative.
  const double exponent = g[TagAppearance::tone];
  const double share = std::max(result.light, 1e-3) / 255.0;
  if (exponent == 1.0) {
    result.grey = result.light;
    by[TagAppearance::tone] = result.light * std::log(share);
  } else {
    result.grey = 255.0 * std::pow(share, exponent);
    by *= exponent * result.grey / (255.0 * share);
    by[TagAppearance::tone] = result.grey * std::log(share);
  }
  return result;
}

bool TagImageModel::near_border(const TagPixel& pixel, double reach_px) const {
  const Eigen::Vector2d place = to_tag(pixel.x, pixel.y);
  const int column = static_cast<int>(std::floor(place.x() + middle_));
  const int row = static_cast<int>(std::floor(place.y() + middle_));
  const auto distance = [&](const Line& line) {
    const double nx = (line.a * pixel.xx + line.b * pixel.yx) / side_px_;
    const double ny = (line.a * pixel.xy + line.b * pixel.yy) / side_px_;
    return std::abs(line.a * pixel.x + line.b * pixel.y + line.c) / std::hypot(nx, ny);
  };
  std::array<int, 2> first = {column + 1, row + 1};
  std::array<int, 2> last = {column, row};
  for (std::size_t direction = 0; direction < 2; ++direction) {
    const auto reached = [&](int i) {
      return i >= 0 && i <= pattern_.cells && distance(lines_[direction][static_cast<std::size_t>(i)][0]) < reach_px;
    };
    while (reached(first[direction] - 1)) --first[direction];
    while (reached(last[direction] + 1)) ++last[direction];
  }
  const int here = cell(column, row);
  for (int j = first[1] - 1; j <= last[1]; ++j)
    for (int i = first[0] - 1; i <= last[0]; ++i)
      if (cell(i, j) != here) return true;
  return false;
}

double TagImageModel::distance_from_unknown(const Eigen::Vector2d& place,
                                            const Eigen::Vector2d& modules_per_pixel) const {
  const int column = static_cast<int>(std::floor(place.x() + middle_));
  const int row = static_cast<int>(std::floor(place.y() + middle_));
  double nearest = 1e9;
  for (int y = row - 1; y <= row + 1; ++y)
    for (int x = column - 1; x <= column + 1; ++x) {
      const bool inside = x >= 0 && y >= 0 && x < pattern_.cells && y < pattern_.cells;
      if (inside && pattern_.at(x, y) != TagPattern::unknown) continue;
      const double du = std::max({x - middle_ - place.x(), place.x() - (x + 1 - middle_), 0.0});
      const double dv = std::max({y - middle_ - place.y(), place.y() - (y + 1 - middle_), 0.0});
      nearest = std::min(nearest, std::hypot(du / modules_per_pixel.x(), dv / modules_per_pixel.y()));
    }
  return nearest;
}

}  // namespace tagdock
