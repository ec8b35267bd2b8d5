#include "detection/photometric_samples.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <map>
#include <numbers>
#include <utility>

#include <Eigen/LU>

namespace tagdock {
namespace {

using Vector2 = Eigen::Vector2d;
using A = TagAppearance;

double grey_at(const cv::Mat1b& gray, const Vector2& at) {
  const double x = std::clamp(at.x(), 0.0, gray.cols - 1.001);
  const double y = std::clamp(at.y(), 0.0, gray.rows - 1.001);
  const int column = static_cast<int>(x);
  const int row = static_cast<int>(y);
  const double a = x - column;
  const double b = y - row;
  return (1.0 - b) * ((1.0 - a) * gray(row, column) + a * gray(row, column + 1)) +
         b * ((1.0 - a) * gray(row + 1, column) + a * gray(row + 1, column + 1));
}

/// Quantile of grey values.
double quantile(std::vector<double> values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

double spread(std::vector<double> residuals) {
  std::vector<double> sizes(residuals.size());
  std::transform(residuals.begin(), residuals.end(), sizes.begin(), [](double r) { return std::abs(r); });
  // Rounded pixels of a quiet image have a median that says little: two grey levels are always within the cut.
  const double cut = std::max(4.0 * 1.4826 * quantile(sizes, 0.5), 2.5);
  double sum = 0.0;
  int count = 0;
  for (const double r : residuals)
    if (std::abs(r) <= cut) {
      sum += r * r;
      ++count;
    }
  return std::max(sum / std::max(count, 1), rounding_variance);
}

double square(double value) { return value * value; }

double residual_sigmas(const TagSample& sample) {
  if (sample.grey >= highest_grey && sample.modelled >= highest_grey) return 0.0;
  if (sample.grey <= lowest_grey && sample.modelled <= lowest_grey) return 0.0;
  return (sample.modelled - sample.grey) / std::sqrt(sample.variance);
}

/// A sample before it is put beside others of its view.
struct Picked {
  float x, y;
  std::int16_t column, row;
  float beyond_px;
  std::uint16_t group;
};

/// The samples, those of one view side by side, and in the order of the image among themselves.
std::vector<TagSample> side_by_side(const std::vector<Picked>& picked, const std::vector<PixelView>& groups,
                                    const cv::Mat1b& region) {
  std::vector<std::uint32_t> place(groups.size(), 0);
  for (const Picked& one : picked) ++place[one.group];
  std::uint32_t before = 0;
  for (std::uint32_t& count : place) before += std::exchange(count, before);
  std::vector<TagSample> sorted(picked.size());
  for (const Picked& one : picked) {
    TagSample& sample = sorted[place[one.group]++];
    sample.x = one.x;
    sample.y = one.y;
    sample.grey = region(one.row, one.column);
    sample.column = one.column;
    sample.row = one.row;
    sample.view = groups[one.group];
    sample.beyond_px = one.beyond_px;
  }
  return sorted;
}

/// Leaves of [first, last] where start + x slope < limit.
void cut(double start, double slope, double limit, double& first, double& last) {
  if (std::abs(slope) < 1e-12) {
    if (!(start < limit)) last = first - 1.0;
    return;
  }
  const double end = (limit - start) / slope;
  if (slope > 0.0)
    last = std::min(last, end);
  else
    first = std::max(first, end);
}

/// Marks the pixels of a mask that lie near a piece of a line.
/// @param from, to  its ends, in pixels of the mask
/// @param every     only so many-th rows are looked at
void mark_along(cv::Mat1b& mask, const Vector2& from, const Vector2& to, double reach_px, int every) {
  const double length = (to - from).norm();
  if (!(length > 0.0)) return;
  const Vector2 along = (to - from) / length;
  const Vector2 across(-along.y(), along.x());
  const double low = std::min(from.y(), to.y()) - reach_px;
  const double high = std::max(from.y(), to.y()) + reach_px;
  const int begin = std::max(0, static_cast<int>(std::ceil(low / every)) * every);
  for (int row = begin; row < mask.rows && row <= high; row += every) {
    const double y = row - from.y();
    double first = 0.0;
    double last = mask.cols - 1.0;
    const double beside = across.y() * y - across.x() * from.x();
    const double beyond = along.y() * y - along.x() * from.x();
    cut(beside, across.x(), reach_px, first, last);
    cut(-beside, -across.x(), reach_px, first, last);
    cut(beyond, along.x(), length + reach_px, first, last);
    cut(-beyond, -along.x(), reach_px, first, last);
    if (last >= first)
      std::fill(mask[row] + static_cast<int>(std::ceil(first)), mask[row] + static_cast<int>(last) + 1,
                static_cast<unsigned char>(1));
  }
}

/// The pixels of a region that may be near a border, and a lattice of others.
cv::Mat1b worth_a_look(const TagImageModel& model, const TagRegion& region, double reach_px, int every) {
  cv::Mat1b mask(region.pixels.size(), static_cast<unsigned char>(0));
  // A lattice that finds a few hundred flat pixels.
  const int apart = std::max(every, static_cast<int>(region.side_px / 33.0) / every * every);
  for (int row = 0; row < mask.rows; row += apart)
    for (int column = 0; column < mask.cols; column += apart) mask(row, column) = 1;
  const int cells = model.pattern().cells;
  const A::Vector& p = model.appearance().value;
  Eigen::Matrix3d tag_by_place;
  tag_by_place << p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], 1.0;
  const Eigen::Matrix3d place_by_tag = tag_by_place.inverse();
  const auto node = [&](int direction, int line, int piece) -> Vector2 {
    const double middle = 0.5 * cells;
    const Vector2 tag =
        direction == 0 ? Vector2(line - middle, piece - middle) : Vector2(piece - middle, line - middle);
    const Vector2 place = (place_by_tag * tag.homogeneous()).hnormalized();
    return region.lens.distorted(place * region.side_px + region.centre) - Vector2(region.pixels.x, region.pixels.y);
  };
  // A lens bends a run of several cells; from cell to cell it does not matter.
  const int longest = region.lens.bends() ? 1 : cells;
  for (const int direction : {0, 1})
    for (int line = 1; line < cells; ++line)
      for (int piece = 0; piece < cells;) {
        if (!model.border(direction, line, piece)) {
          ++piece;
          continue;
        }
        int end = piece + 1;
        while (end < cells && end - piece < longest && model.border(direction, line, end)) ++end;
        mark_along(mask, node(direction, line, piece), node(direction, line, end), reach_px, every);
        piece = end;
      }
  return mask;
}

/// Pixels nearer to what is beyond the print, in sigmas of the blur, say nothing of the print.
constexpr double least_from_unknown = 1.0;
constexpr std::size_t enough_flats = 500;
/// Pixels farther than this from all borders, in sigmas of the blur, hold 5e-3 of what is known of their places.
/// Borders farther than `seen` change it by less than 3e-4 of the contrast.
constexpr double informs = 2.0;
constexpr double seen = 3.7;

}  // namespace

TagImageModel::Lens TagRegion::tag_lens() const {
  TagImageModel::Lens result;
  const double half = 0.5 * side_px;
  const Vector2 middle = lens.distorted(centre);
  result.centre = lens.at(middle).by_pixel;
  result.by_x = lens.at(middle + Vector2(half, 0.0)).by_pixel - lens.at(middle - Vector2(half, 0.0)).by_pixel;
  result.by_y = lens.at(middle + Vector2(0.0, half)).by_pixel - lens.at(middle - Vector2(0.0, half)).by_pixel;
  return result;
}

double start_blur(const cv::Mat1b& gray, const Corners& corners_px) {
  std::vector<double> sigmas;
  for (std::size_t k = 0; k < 4; ++k) {
    const Vector2 along = corners_px[(k + 1) % 4] - corners_px[k];
    const Vector2 normal = Vector2(along.y(), -along.x()).normalized();
    for (int i = 0; i <= 10; ++i) {
      const Vector2 middle = corners_px[k] + (0.25 + 0.05 * i) * along;
      double low = 255.0;
      double high = 0.0;
      double steepest = 0.0;
      double before = 0.0;
      for (int step = -6; step <= 6; ++step) {
        const double grey = grey_at(gray, middle + 0.5 * step * normal);
        low = std::min(low, grey);
        high = std::max(high, grey);
        if (step > -6) steepest = std::max(steepest, 2.0 * std::abs(grey - before));
        before = grey;
      }
      if (steepest > 0.0) sigmas.push_back((high - low) / (steepest * std::sqrt(2.0 * std::numbers::pi)));
    }
  }
  if (sigmas.empty()) return 1.0;
  const auto median = sigmas.begin() + static_cast<std::ptrdiff_t>(sigmas.size() / 2);
  std::nth_element(sigmas.begin(), median, sigmas.end());
  return std::clamp(*median, 0.45, 4.0);
}

std::vector<TagSample> select_samples(const cv::Mat1b& gray, const TagImageModel& model, const TagRegion& region,
                                      double blur_px, int every, double slack_px) {
  const A::Vector& p = model.appearance().value;
  const double rim = 0.5 * model.pattern().cells;
  const double reach = seen * blur_px + slack_px;
  const double least_beyond = least_from_unknown * blur_px;
  const double farthest = informs * blur_px + slack_px;
  const cv::Rect& pixels = region.pixels;
  TagImageModel::Views views(model, reach);
  std::vector<Picked> samples;
  std::vector<Picked> flats;
  // A tag fills about half of its region, and a third of its pixels are on borders.
  samples.reserve(static_cast<std::size_t>(pixels.area() / (5 * every * every)));
  // Half a pixel more than needed, for what the lens bends and the distance of a corner.
  const cv::Mat1b mask = worth_a_look(model, region, farthest + 0.5, every);
  const double per_side = 1.0 / region.side_px;
  for (int row = 0; row < mask.rows; row += every) {
    const LensPatch::Row straight(region.lens, pixels.y + row);
    const Vector2 row_place = region.place(Vector2(pixels.x, pixels.y + row));
    const unsigned char* const marked = mask[row];
    for (int column = 0; column < mask.cols; column += every) {
      if (marked[column] == 0) continue;
      Vector2 at(row_place.x() + column * per_side, row_place.y());
      if (region.lens.bends()) at = region.place(straight.undistorted(pixels.x + column));
      const double w = p[6] * at.x() + p[7] * at.y() + 1.0;
      const double u_w = p[0] * at.x() + p[1] * at.y() + p[2];
      const double v_w = p[3] * at.x() + p[4] * at.y() + p[5];
      if (!(std::abs(u_w) < rim * w && std::abs(v_w) < rim * w)) continue;
      const double per_w = 1.0 / w;
      const double u = u_w * per_w;
      const double v = v_w * per_w;
      double beyond = 1e9;
      if (model.all_known()) {
        beyond = views.beyond_px({u + rim, v + rim}, w);
        if (beyond < least_beyond) continue;
      } else if (model.unknown_within_a_module(u, v)) {
        const double scale = per_w * per_side;
        const Vector2 modules_per_pixel(std::sqrt(square(p[0] - u * p[6]) + square(p[1] - u * p[7])) * scale,
                                        std::sqrt(square(p[3] - v * p[6]) + square(p[4] - v * p[7])) * scale);
        beyond = model.distance_from_unknown({u, v}, modules_per_pixel);
        if (beyond < least_beyond) continue;
      }
      const std::array<double, 2> cell = {u + rim, v + rim};
      const TagImageModel::Views::Entry& entry = views.at(cell, w);
      const bool flat = entry.view.kind == PixelView::flat;
      if (!flat && views.border_px(cell, w, entry) > farthest) continue;
      (flat ? flats : samples)
          .push_back({static_cast<float>(at.x()), static_cast<float>(at.y()), static_cast<std::int16_t>(column),
                      static_cast<std::int16_t>(row), static_cast<float>(beyond), entry.group});
    }
  }
  // Some hundreds tell the levels and the noise well enough.
  const std::size_t share = 1 + flats.size() / enough_flats;
  for (std::size_t i = 0; i < flats.size(); i += share) samples.push_back(flats[i]);
  return side_by_side(samples, views.groups(), gray(pixels));
}

PixelNoise measure_noise(const TagImageModel& model, const std::vector<TagSample>& samples, double side_px) {
  const A::Vector& p = model.appearance().value;
  const double blur = model.appearance().blur_px();
  std::vector<double> black;
  std::vector<double> white;
  for (const TagSample& sample : samples) {
    if (sample.grey >= highest_grey || sample.grey <= lowest_grey || sample.weight < 0.5) continue;
    if (sample.view.kind != PixelView::flat || sample.beyond_px < normal_reach * blur) continue;
    (sample.whiteness < 0.5F ? black : white).push_back(sample.modelled - sample.grey);
  }
  // Too few flat pixels (a small tag): all residuals must do. Thirty give the variance to 25 %.
  constexpr std::size_t enough = 30;
  double both = 1.0;
  if (black.size() < enough && white.size() < enough) {
    std::vector<double> all;
    for (const TagSample& sample : samples)
      if (sample.grey < highest_grey && sample.grey > lowest_grey && sample.weight >= 0.5F &&
          sample.beyond_px >= normal_reach * blur)
        all.push_back(sample.modelled - sample.grey);
    if (!all.empty()) both = spread(all);
  }
  const double black_variance = black.size() >= enough ? spread(black) : white.size() >= enough ? spread(white) : both;
  const double white_variance = white.size() >= enough ? spread(white) : black_variance;
  PixelNoise noise;
  noise.exponent = p[A::tone];
  noise.white = std::max(white_variance - rounding_variance, 0.0) / stretch(p[A::white], noise.exponent);
  noise.black = std::max(black_variance - rounding_variance, 0.0) / stretch(p[A::white] - p[A::drop], noise.exponent);
  noise.blur_px = blur;
  noise.contrast = p[A::drop];
  noise.side_px = side_px;
  return noise;
}

RoundedTogether rounded_together(const TagImageModel& model, const std::vector<TagSample>& samples,
                                 const Eigen::Matrix<double, 8, TagAppearance::count>& influence) {
  // Three terms hold five sixths of the variance; the others turn so fast from pixel to pixel that these err apart.
  constexpr std::size_t terms = 3;
  constexpr double nothing = 0.02;  // of a term's variance
  // Pixels whose distances from a border differ by more than this share of its rise pass the levels at other places.
  constexpr double bins = 16.0;
  RoundedTogether result;
  std::array<double, terms> variance{};
  std::size_t used = 0;
  for (; used < terms; ++used) {
    const double turn = 2.0 * std::numbers::pi * static_cast<double>(used + 1);
    variance[used] = 2.0 / (turn * turn);
    double mean = 0.0;
    for (const TagSample& sample : samples)
      mean += std::exp(-turn * turn * std::max(0.0, sample.variance - rounding_variance));
    mean /= static_cast<double>(std::max<std::size_t>(samples.size(), 1));
    if (mean < nothing) break;
    result.share += mean * variance[used] / rounding_variance;
  }
  if (used == 0) return result;
  using Wave = Eigen::Matrix<double, 8, 2>;
  std::map<int, std::array<Wave, terms>> waves;  // of one view, by bin
  const auto finish = [&] {
    for (const auto& [bin, by_term] : waves)
      for (std::size_t k = 0; k < used; ++k)
        result.covariance += variance[k] * by_term[k].lazyProduct(by_term[k].transpose());
    waves.clear();
  };
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const TagSample& sample = samples[i];
    if (i > 0 && !alike(sample.view, samples[i - 1].view)) finish();
    if (sample.weight == 0.0F || sample.grey >= highest_grey || sample.grey <= lowest_grey) continue;
    const auto [entry, fresh] = waves.try_emplace(static_cast<int>(std::floor(sample.whiteness * bins)));
    if (fresh) entry->second.fill(Wave::Zero());
    const ModelledPixel at = model.at(sample.x, sample.y, sample.view);
    const Eigen::Matrix<double, 8, 1> moves =
        influence.lazyProduct(at.by) * static_cast<double>(sample.weight / sample.variance);
    for (std::size_t k = 0; k < used; ++k) {
      const double turn = 2.0 * std::numbers::pi * static_cast<double>(k + 1);
      const double left = std::exp(-0.5 * turn * turn * std::max(0.0, sample.variance - rounding_variance));
      const double phase = turn * sample.modelled;
      entry->second[k].col(0) += left * std::cos(phase) * moves;
      entry->second[k].col(1) += left * std::sin(phase) * moves;
    }
  }
  finish();
  return result;
}

FitQuality quality(const std::vector<TagSample>& samples, std::size_t parameters) {
  FitQuality result;
  double weights = 0.0;
  double chi2 = 0.0;
  double squares = 0.0;
  double border_squares = 0.0;
  int border_count = 0;
  int clipped = 0;
  int borders = 0;
  int rejected = 0;
  // A thousand tell the median to 3 %.
  const int every = 1 + static_cast<int>(samples.size() / 1000);
  std::vector<double> sizes;
  for (const TagSample& sample : samples) {
    const double residual = residual_sigmas(sample);
    if (sample.grey >= highest_grey || sample.grey <= lowest_grey) ++clipped;
    if (sample.leaks) continue;
    if (sample.view.kind != PixelView::flat) {
      ++borders;
      if (borders % every == 0) sizes.push_back(std::abs(residual));
      if (sample.weight < 0.05) {
        ++rejected;
      } else {
        ++border_count;
        border_squares += residual * residual;
      }
    }
    if (sample.weight == 0.0) continue;
    result.largest = std::max(result.largest, std::abs(residual));
    chi2 += sample.weight * residual * residual;
    squares += sample.weight * residual * residual * sample.variance;
    weights += sample.weight;
    ++result.count;
  }
  result.chi2_per_pixel = chi2 / std::max(weights - static_cast<double>(parameters), 1.0);
  result.rms = std::sqrt(squares / std::max(weights, 1.0));
  result.clipped = static_cast<double>(clipped) / static_cast<double>(std::max<std::size_t>(samples.size(), 1));
  result.rejected = static_cast<double>(rejected) / std::max(borders, 1);
  if (!sizes.empty()) result.scale = std::max(1.0, 1.4826 * quantile(sizes, 0.5));
  result.spread = std::max(1.0, std::sqrt(border_squares / std::max(border_count, 1)));
  return result;
}

void weigh(std::vector<TagSample>& samples, const cv::Size& region, double blur_px, double cut, Weighing weighing) {
  // Beyond 1.5 sigma of its border an occluder's blur is below what a cut of a few sigmas of noise can see.
  const int rim = std::max(1, static_cast<int>(std::lround(1.5 * blur_px)));
  cv::Mat1b rejected(region.height + 2 * rim, region.width + 2 * rim, static_cast<unsigned char>(0));
  const auto mark = [&](const TagSample& sample) -> unsigned char& {
    return rejected(sample.row + rim, sample.column + rim);
  };
  const auto neighbours = [&](const TagSample& sample, int reach, int value) {
    int count = 0;
    for (int dy = -reach; dy <= reach; ++dy)
      for (int dx = -reach; dx <= reach; ++dx)
        count += rejected(sample.row + rim + dy, sample.column + rim + dx) >= value;
    return count;
  };
  for (TagSample& sample : samples) {
    const double size = residual_sigmas(sample) / cut;
    const double rest = std::max(0.0, 1.0 - size * size);
    sample.weight = weighing == Weighing::tukey ? static_cast<float>(rest * rest) : rest > 0.0 ? 1.0F : 0.0F;
    if (rest == 0.0) mark(sample) = 1;
  }
  // Three of nine together are no accident of noise.
  for (const TagSample& sample : samples)
    if (mark(sample) == 1 && neighbours(sample, 1, 1) >= 3) mark(sample) = 2;
  for (TagSample& sample : samples)
    if (neighbours(sample, rim, 2) > 0) sample.weight = 0.0;
}

}  // namespace tagdock
