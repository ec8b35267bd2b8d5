#include "detection/photometric_model.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <numbers>
#include <utility>

namespace tagdock {
namespace {

using A = TagAppearance;

/// Grid lines in one direction, the print's own rims included; no family has more.
constexpr std::size_t most_lines = 13;

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

/// A place on a way of length 1 about 0, and its part of it.
struct Node {
  double place, weight;
};

/// Gauss-Legendre nodes of a way that is so many sigmas of the remaining blur long; the mean over them differs from
/// that over the way by less than 1e-3 of a border's contrast up to eight sigmas.
std::vector<Node> nodes_on_the_way(double sigmas) {
  if (sigmas == 0.0) return {{0.0, 1.0}};
  if (sigmas < 1.7) return {{-0.288675134594813, 0.5}, {0.288675134594813, 0.5}};
  if (sigmas < 3.3) return {{-0.387298334620742, 5.0 / 18.0}, {0.0, 4.0 / 9.0}, {0.387298334620742, 5.0 / 18.0}};
  if (sigmas < 4.9)
    return {{-0.430568155797026, 0.173927422568727},
            {-0.169990521792428, 0.326072577431273},
            {0.169990521792428, 0.326072577431273},
            {0.430568155797026, 0.173927422568727}};
  if (sigmas < 6.6)
    return {{-0.453089922969332, 0.118463442528095},
            {-0.269234655052842, 0.239314335249683},
            {0.0, 0.284444444444444},
            {0.269234655052842, 0.239314335249683},
            {0.453089922969332, 0.118463442528095}};
  return {{-0.466234757101576, 0.0856622461895852}, {-0.330604693233132, 0.180380786524069},
          {-0.119309593041598, 0.233956967286345},  {0.119309593041598, 0.233956967286345},
          {0.330604693233132, 0.180380786524069},   {0.466234757101576, 0.0856622461895852}};
}

/// Smaller eigenvalue.
double least_variance(const Eigen::Matrix2d& m) {
  return 0.5 * (m(0, 0) + m(1, 1)) - std::hypot(0.5 * (m(0, 0) - m(1, 1)), m(0, 1));
}

}  // namespace

TagImageModel::TagImageModel(const TagPattern& pattern, double side_px, const Lens& lens)
    : pattern_(pattern), side_px_(side_px), lens_(lens), middle_(0.5 * pattern.cells), cells_(filled(pattern)) {
  const int n = pattern.cells;
  assert(n < static_cast<int>(most_lines));
  for (int row = 0; row < n; ++row)
    for (int column = 0; column < n; ++column) {
      bool beside = false;
      for (int y = row - 1; y <= row + 1; ++y)
        for (int x = column - 1; x <= column + 1; ++x)
          beside = beside || x < 0 || y < 0 || x >= n || y >= n || pattern.at(x, y) == TagPattern::unknown;
      beside_unknown_.push_back(beside);
      all_known_ = all_known_ && pattern.at(column, row) != TagPattern::unknown;
    }
  for (auto& vertices : vertices_) vertices.resize(static_cast<std::size_t>((n + 1) * (n + 1)));
  for (int j = 1; j < n; ++j)
    for (int i = 1; i < n; ++i) {
      const int top = cell(i, j - 1) - cell(i - 1, j - 1);
      const int bottom = cell(i, j) - cell(i - 1, j);
      const int left = cell(i - 1, j) - cell(i - 1, j - 1);
      const int right = cell(i, j) - cell(i, j - 1);
      const int sign = bottom - top;
      if (sign == 0) continue;
      const auto vertex = [sign](int along_u, int along_v) {
        Vertex result;
        result.sign = sign > 0 ? 1 : -1;
        result.side_u = along_u > 0 ? 1 : 0;
        result.side_v = along_v > 0 ? 1 : 0;
        return result;
      };
      if (std::abs(sign) == 1) {
        for (auto& vertices : vertices_) vertices[node(i, j)][0] = vertex(top + bottom, left + right);
        continue;
      }
      // Opposite cells are alike. Apart, the white ones are two quarter planes below right and above left (sign 2), or
      // above right and below left (sign -2); apart, the black ones are the other two.
      const std::array<Vertex, 2> falling = {vertex(bottom, right), vertex(top, left)};
      const std::array<Vertex, 2> rising = {vertex(top, right), vertex(bottom, left)};
      vertices_[0][node(i, j)] = sign > 0 ? falling : rising;
      vertices_[1][node(i, j)] = sign > 0 ? rising : falling;
    }
}

Eigen::Vector2d TagImageModel::to_tag(double x, double y) const {
  const auto& g = appearance_.value;
  const double w = g[6] * x + g[7] * y + 1.0;
  return {(g[0] * x + g[1] * y + g[2]) / w, (g[3] * x + g[4] * y + g[5]) / w};
}

void TagImageModel::set(const TagAppearance& appearance) {
  const bool moved = appearance.motion_px != appearance_.motion_px;
  appearance_ = appearance;
  const auto& g = appearance_.value;
  Eigen::Matrix2d blur;
  blur << g[A::blur_xx], g[A::blur_xy], g[A::blur_xy], g[A::blur_yy];
  const bool bent = !(lens_.by_x.isZero(0.0) && lens_.by_y.isZero(0.0));
  for (std::size_t direction = 0; direction < 2; ++direction)
    for (int i = 1; i < pattern_.cells; ++i)
      for (int side = 0; side < 2; ++side) {
        Line& line = lines_[direction][static_cast<std::size_t>(i)][static_cast<std::size_t>(side)];
        line.place = i - middle_ + (side == 1 ? g[A::bleed] : -g[A::bleed]);
        const Eigen::Index row = direction == 0 ? 0 : 3;
        line.a = g[row] - line.place * g[6];
        line.b = g[row + 1] - line.place * g[7];
        line.c = g[row + 2] - line.place;
        const Eigen::RowVector2d ab(line.a, line.b);
        const Eigen::RowVector2d n = ab * lens_.centre / side_px_;
        const Eigen::RowVector2d blurred = n * blur;
        const double variance = blurred.dot(n);
        line.nx = n.x();
        line.ny = n.y();
        line.unit = 1.0 / std::sqrt(variance);
        line.per_px = 1.0 / n.norm();
        const Eigen::RowVector2d by_ab = blurred * lens_.centre.transpose() / side_px_;
        line.ba = by_ab.x();
        line.bb = by_ab.y();
        if (bent) {  // d(1/sqrt(variance)), to first order over the tag
          const double scale = -line.unit * line.unit * line.unit / side_px_;
          line.unit_x = scale * blurred.dot(ab * lens_.by_x);
          line.unit_y = scale * blurred.dot(ab * lens_.by_y);
        }
        const Eigen::RowVector2d direction_px = n * line.per_px;
        const double sigma2 = variance * line.per_px * line.per_px;
        const double fourth_powers = std::pow(direction_px.x(), 4) + std::pow(direction_px.y(), 4);
        line.fourth = appearance.excess / 24.0 - fourth_powers / (2880.0 * sigma2 * sigma2);
      }
  if (moved) {
    stops_.clear();
    for (const Node& node : nodes_on_the_way(appearance.motion_px.norm() / std::sqrt(least_variance(blur)))) {
      const Eigen::Vector2d shift = lens_.centre * appearance.motion_px * node.place / side_px_;
      stops_.push_back({shift.x(), shift.y(), node.weight});
    }
  }
  auto& vertices = vertices_[g[A::bleed] >= 0.0 ? 0 : 1];
  for (int j = 1; j < pattern_.cells; ++j)
    for (int i = 1; i < pattern_.cells; ++i)
      for (Vertex& vertex : vertices[node(i, j)]) {
        if (vertex.sign == 0) continue;
        const Line& a = lines_[0][static_cast<std::size_t>(i)][static_cast<std::size_t>(vertex.side_u)];
        const Line& b = lines_[1][static_cast<std::size_t>(j)][static_cast<std::size_t>(vertex.side_v)];
        const double product = Eigen::RowVector2d(a.nx, a.ny) * blur * Eigen::Vector2d(b.nx, b.ny);
        vertex.correlation = std::clamp(product * a.unit * b.unit, -0.999, 0.999);
        vertex.integral = BivariateNormal(vertex.correlation);
      }
}

PixelView TagImageModel::view(double x, double y, double reach_px) const {
  Views views(*this, reach_px);
  const Eigen::Vector2d place = (to_tag(x, y).array() + middle_).max(0.0).min(static_cast<double>(pattern_.cells));
  const double w = appearance_.value[6] * x + appearance_.value[7] * y + 1.0;
  return views.at({place.x(), place.y()}, w).view;
}

TagImageModel::Views::Views(const TagImageModel& model, double reach_px)
    : model_(model),
      reach_px_(reach_px),
      table_(static_cast<std::size_t>(model.pattern_.cells * model.pattern_.cells * cases * cases * cases * cases)) {
  for (std::size_t direction = 0; direction < 2; ++direction) {
    px_per_cell_[direction].fill(1e18);
    for (std::size_t i = 1; i < static_cast<std::size_t>(model.pattern_.cells); ++i)
      px_per_cell_[direction][most_reached + i] = model.lines_[direction][i][0].per_px;
    const auto& g = model.appearance_.value;
    const Eigen::Index row = direction == 0 ? 0 : 3;
    for (const int side : {0, 1}) {
      const double place = side == 0 ? -model.middle_ : model.middle_;
      const Eigen::RowVector2d across(g[row] - place * g[6], g[row + 1] - place * g[7]);
      rim_px_[direction][static_cast<std::size_t>(side)] = model.side_px_ / (across * model.lens_.centre).norm();
    }
  }
}

TagImageModel::Views::Entry TagImageModel::Views::entry(const std::array<int, 2>& here,
                                                        const std::array<int, 2>& before,
                                                        const std::array<int, 2>& after) {
  const int first_u = here[0] + 1 - before[0];
  const int last_u = here[0] + after[0];
  const int first_v = here[1] + 1 - before[1];
  const int last_v = here[1] + after[1];
  Entry made;
  PixelView& view = made.view;
  view.first = {static_cast<std::int8_t>(first_u), static_cast<std::int8_t>(first_v)};
  view.last = {static_cast<std::int8_t>(last_u), static_cast<std::int8_t>(last_v)};
  const int column = first_u - 1;
  const int row = first_v - 1;
  view.white = static_cast<std::int8_t>(model_.cell(column, row));
  int steps = 0;
  bool corners = false;
  const auto border = [&](std::size_t direction, int i) {
    made.borders[direction] = static_cast<std::uint16_t>(made.borders[direction] | (1U << i));
  };
  const auto count = [&](std::size_t direction, int i, int step) {
    if (step == 0) return;
    ++steps;
    view.direction = static_cast<std::int8_t>(direction);
    view.index = static_cast<std::int8_t>(i);
    view.step = static_cast<std::int8_t>(step);
    border(direction, i);
  };
  for (int i = first_u; i <= last_u; ++i) count(0, i, model_.cell(i, row) - model_.cell(i - 1, row));
  for (int j = first_v; j <= last_v; ++j) count(1, j, model_.cell(column, j) - model_.cell(column, j - 1));
  for (int j = first_v; j <= last_v; ++j)
    for (int i = first_u; i <= last_u; ++i) {
      if (model_.vertices_[0][model_.node(i, j)][0].sign == 0) continue;
      corners = true;
      border(0, i);
      border(1, j);
    }
  view.kind = corners || steps > 1 ? PixelView::general : steps == 1 ? PixelView::line : PixelView::flat;
  const auto known = std::find_if(groups_.begin(), groups_.end(), [&](const PixelView& g) { return alike(g, view); });
  made.group = static_cast<std::uint16_t>(known - groups_.begin());
  if (known == groups_.end()) groups_.push_back(view);
  return made;
}

namespace {

/// A border through the blur and the pixel's box, and its derivative by the distance in units of the blur.
struct Step {
  double value, slope;
};

Step boxed(const Normal& gauss, double z, double fourth) {
  const double z2 = z * z;
  return {gauss.cumulative - fourth * z * (z2 - 3.0) * gauss.density,
          gauss.density * (1.0 + fourth * (z2 * (z2 - 6.0) + 3.0))};
}

/// The tone curve: grey value and its derivatives. Light below zero by the toe has none: it is held there.
struct Toned {
  double grey, by_light, by_exponent;
};

inline Toned toned(double light, double exponent) {
  const double share = std::max(light / 255.0 + tone_toe, 1e-4);
  const double toe = std::pow(tone_toe, exponent);
  const double whole = std::pow(1.0 + tone_toe, exponent);
  const double power = std::pow(share, exponent);
  const double range = whole - toe;
  const double part = (power - toe) / range;
  const double by_exponent = (power * std::log(share) - toe * std::log(tone_toe) -
                              part * (whole * std::log1p(tone_toe) - toe * std::log(tone_toe))) /
                             range;
  if (exponent == 1.0) return {light, 1.0, 255.0 * by_exponent};
  return {255.0 * part, exponent * power / share / range, 255.0 * by_exponent};
}

}  // namespace

ModelledPixel TagImageModel::at(double x_shown, double y_shown, const PixelView& view) const {
  const auto& g = appearance_.value;
  const auto& vertices = vertices_[g[A::bleed] >= 0.0 ? 0 : 1];
  double r = view.white;
  double x = x_shown;  // in turn where the pixel is at each stop
  double y = y_shown;
  double share = 1.0;
  std::array<double, 3> by_u{};  // d(r)/d(row of u in the homography)
  std::array<double, 3> by_v{};
  std::array<double, 2> by_w{};
  std::array<double, 3> by_blur{};
  double by_bleed = 0.0;
  struct Seen {
    double z = 0.0, unit = 0.0;
    Normal gauss{};
    Step step{};
  };
  const auto see = [&](const Line& line) {
    Seen seen;
    seen.unit = line.unit + line.unit_x * x + line.unit_y * y;
    seen.z = (line.a * x + line.b * y + line.c) * seen.unit;
    seen.gauss = normal(seen.z);
    seen.step = boxed(seen.gauss, seen.z, line.fourth);
    return seen;
  };
  const auto add_by_z = [&](const Line& line, const Seen& seen, std::array<double, 3>& by, bool higher, double by_z) {
    const double scale = share * by_z * seen.unit;
    const double shrink = seen.z * line.unit;
    const double da = scale * (x - shrink * line.ba);
    const double db = scale * (y - shrink * line.bb);
    by[0] += da;
    by[1] += db;
    by[2] += scale;
    by_w[0] -= line.place * da;
    by_w[1] -= line.place * db;
    const double by_place = -(da * g[6] + db * g[7] + scale);
    by_bleed += higher ? by_place : -by_place;
    const double by_variance = -0.5 * scale * seen.z * line.unit;
    by_blur[0] += by_variance * line.nx * line.nx;
    by_blur[1] += by_variance * 2.0 * line.nx * line.ny;
    by_blur[2] += by_variance * line.ny * line.ny;
  };
  const auto add_step = [&](std::size_t direction, int i, int step) {
    if (step == 0) return;
    const Line& line = lines_[direction][static_cast<std::size_t>(i)][step > 0 ? 1 : 0];
    const Seen seen = see(line);
    r += share * step * seen.step.value;
    if (seen.gauss.density > 0.0) add_by_z(line, seen, direction == 0 ? by_u : by_v, step > 0, step * seen.step.slope);
  };
  const int column = view.first[0] - 1;
  const int row = view.first[1] - 1;
  for (const Stop& stop : stops_) {
    x = x_shown + stop.x;
    y = y_shown + stop.y;
    share = stop.share;
    for (int i = view.first[0]; i <= view.last[0]; ++i) add_step(0, i, cell(i, row) - cell(i - 1, row));
    for (int j = view.first[1]; j <= view.last[1]; ++j) add_step(1, j, cell(column, j) - cell(column, j - 1));
    for (int j = view.first[1]; j <= view.last[1]; ++j)
      for (int i = view.first[0]; i <= view.last[0]; ++i)
        for (const Vertex& vertex : vertices[node(i, j)]) {
          if (vertex.sign == 0) break;
          const Line& line_a = lines_[0][static_cast<std::size_t>(i)][static_cast<std::size_t>(vertex.side_u)];
          const Line& line_b = lines_[1][static_cast<std::size_t>(j)][static_cast<std::size_t>(vertex.side_v)];
          const Seen a = see(line_a);
          if (a.z <= -normal_reach) continue;
          const Seen b = see(line_b);
          if (b.z <= -normal_reach) continue;
          if (a.z >= normal_reach || b.z >= normal_reach) {  // only the other border is near
            r += share * vertex.sign * (a.z >= normal_reach ? b.step.value : a.step.value);
            if (a.z < normal_reach) add_by_z(line_a, a, by_u, vertex.side_u == 1, vertex.sign * a.step.slope);
            if (b.z < normal_reach) add_by_z(line_b, b, by_v, vertex.side_v == 1, vertex.sign * b.step.slope);
            continue;
          }
          const Normal2 corner = vertex.integral.at(a.z, a.gauss, b.z, b.gauss);
          const double more_a = a.step.value - a.gauss.cumulative;
          const double more_b = b.step.value - b.gauss.cumulative;
          r += share * vertex.sign * (corner.cumulative + more_a * b.gauss.cumulative + more_b * a.gauss.cumulative);
          add_by_z(line_a, a, by_u, vertex.side_u == 1,
                   vertex.sign * (corner.by_p + (a.step.slope - a.gauss.density) * b.gauss.cumulative +
                                  more_b * a.gauss.density));
          add_by_z(line_b, b, by_v, vertex.side_v == 1,
                   vertex.sign * (corner.by_q + (b.step.slope - b.gauss.density) * a.gauss.cumulative +
                                  more_a * b.gauss.density));
          const double by_correlation = share * vertex.sign * corner.density;
          const double both = line_a.unit * line_b.unit;
          const double ca = vertex.correlation * line_a.unit * line_a.unit;
          const double cb = vertex.correlation * line_b.unit * line_b.unit;
          by_blur[0] += by_correlation * (line_a.nx * line_b.nx * both -
                                          0.5 * (ca * line_a.nx * line_a.nx + cb * line_b.nx * line_b.nx));
          by_blur[1] += by_correlation * ((line_a.nx * line_b.ny + line_a.ny * line_b.nx) * both -
                                          (ca * line_a.nx * line_a.ny + cb * line_b.nx * line_b.ny));
          by_blur[2] += by_correlation * (line_a.ny * line_b.ny * both -
                                          0.5 * (ca * line_a.ny * line_a.ny + cb * line_b.ny * line_b.ny));
          const double aa = by_correlation * (line_b.ba * both - ca * line_a.ba);
          const double ab = by_correlation * (line_b.bb * both - ca * line_a.bb);
          const double ba = by_correlation * (line_a.ba * both - cb * line_b.ba);
          const double bb = by_correlation * (line_a.bb * both - cb * line_b.bb);
          by_u[0] += aa;
          by_u[1] += ab;
          by_v[0] += ba;
          by_v[1] += bb;
          by_w[0] -= line_a.place * aa + line_b.place * ba;
          by_w[1] -= line_a.place * ab + line_b.place * bb;
        }
  }
  x = x_shown;
  y = y_shown;

  const double drop = g[11] + g[12] * x + g[13] * y;
  const double black = 1.0 - r;
  ModelledPixel result;
  result.whiteness = r;
  result.light = g[8] + g[9] * x + g[10] * y - drop * black;
  const Toned tone = toned(result.light, g[A::tone]);
  result.grey = tone.grey;
  const double scale = tone.by_light * drop;
  const double dark = -tone.by_light * black;
  result.by << scale * by_u[0], scale * by_u[1], scale * by_u[2], scale * by_v[0], scale * by_v[1], scale * by_v[2],
      scale * by_w[0], scale * by_w[1], tone.by_light, tone.by_light * x, tone.by_light * y, dark, dark * x, dark * y,
      scale * by_blur[0], scale * by_blur[1], scale * by_blur[2], scale * by_bleed, tone.by_exponent;
  return result;
}

double stretch(double light, double exponent) {
  if (exponent == 1.0) return 1.0;
  const double share = std::max(light / 255.0, 0.0) + tone_toe;
  const double slope =
      exponent * std::pow(share, exponent - 1.0) / (std::pow(1.0 + tone_toe, exponent) - std::pow(tone_toe, exponent));
  return slope * slope;
}

Misfit misfit(double modelled, double measured, double variance) {
  const bool high = measured >= highest_grey;
  const bool low = measured <= lowest_grey;
  const double residual = modelled - measured;
  if (!high && !low) {
    const double weighted = residual / variance;
    return {residual * weighted, weighted, 1.0 / variance};
  }
  // Censored: the light lay beyond the end of the range, wherever that was.
  const double sigma = std::sqrt(variance);
  const double sign = high ? 1.0 : -1.0;
  const double t = sign * (modelled - (high ? highest_grey : lowest_grey)) / sigma;
  if (t > 6.0) return {};
  if (t < -6.0)  // -2 ln Phi(t) -> t^2 + ln(2 pi t^2)
    return {t * t + std::log(2.0 * std::numbers::pi * t * t), sign * (t + 1.0 / t) / sigma,
            (1.0 - 1.0 / (t * t)) / variance};
  const double below = 0.5 * std::erfc(-t / std::numbers::sqrt2);
  const double ratio = std::exp(-0.5 * t * t) / std::sqrt(2.0 * std::numbers::pi) / below;
  return {-2.0 * std::log(below), -sign * ratio / sigma, ratio * (ratio + t) / variance};
}

double TagImageModel::distance_from_unknown(const Eigen::Vector2d& place,
                                            const Eigen::Vector2d& modules_per_pixel) const {
  const int column = static_cast<int>(std::floor(place.x() + middle_));
  const int row = static_cast<int>(std::floor(place.y() + middle_));
  double nearest = 1e18;
  for (int y = row - 1; y <= row + 1; ++y)
    for (int x = column - 1; x <= column + 1; ++x) {
      const bool inside = x >= 0 && y >= 0 && x < pattern_.cells && y < pattern_.cells;
      if (inside && pattern_.at(x, y) != TagPattern::unknown) continue;
      const double du = std::max({x - middle_ - place.x(), place.x() - (x + 1 - middle_), 0.0});
      const double dv = std::max({y - middle_ - place.y(), place.y() - (y + 1 - middle_), 0.0});
      const Eigen::Vector2d away(du / modules_per_pixel.x(), dv / modules_per_pixel.y());
      nearest = std::min(nearest, away.squaredNorm());
    }
  return std::sqrt(nearest);
}

}  // namespace tagdock
