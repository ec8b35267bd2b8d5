#include "detection/photometric_samples.h"

#include <algorithm>
#include <cmath>
#include <numbers>

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

/// Pixels nearer to what is beyond the print, in sigmas of the blur, say nothing of the print.
constexpr double least_from_unknown = 1.0;
constexpr std::size_t enough_flats = 500;
/// A pixel farther than this from all borders, in sigmas of the blur, knows less than a thousandth of what one on a
/// border knows of its place. Borders farther than `seen` change it by less than 3e-4 of the contrast.
constexpr double informs = 2.6;
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
  std::vector<TagSample> samples;
  const A::Vector& p = model.appearance().value;
  const double rim = 0.5 * model.pattern().cells;
  const double reach = seen * blur_px + slack_px;
  const cv::Rect& pixels = region.pixels;
  std::vector<TagSample> flats;
  // A tag fills about half of its region, and about half of its pixels are on borders.
  samples.reserve(static_cast<std::size_t>(pixels.area() / (5 * every * every)));
  flats.reserve(static_cast<std::size_t>(pixels.area() / (12 * every * every)));
  for (int row = pixels.y; row < pixels.y + pixels.height; row += every)
    for (int column = pixels.x; column < pixels.x + pixels.width; column += every) {
      const Vector2 at = region.place(region.lens.undistorted({column, row}));
      const double w = p[6] * at.x() + p[7] * at.y() + 1.0;
      const double u_w = p[0] * at.x() + p[1] * at.y() + p[2];
      const double v_w = p[3] * at.x() + p[4] * at.y() + p[5];
      if (!(std::abs(u_w) < rim * w && std::abs(v_w) < rim * w)) continue;
      const double u = u_w / w;
      const double v = v_w / w;
      TagSample sample;
      if (model.unknown_within_a_module(u, v)) {
        const double scale = 1.0 / (w * region.side_px);
        const Vector2 modules_per_pixel(std::sqrt(square(p[0] - u * p[6]) + square(p[1] - u * p[7])) * scale,
                                        std::sqrt(square(p[3] - v * p[6]) + square(p[4] - v * p[7])) * scale);
        sample.beyond_px = model.distance_from_unknown({u, v}, modules_per_pixel);
        if (sample.beyond_px < least_from_unknown * blur_px) continue;
      }
      sample.view = model.view(at.x(), at.y(), {u, v}, reach);
      if (sample.view.kind == PixelView::flat) {
        sample.x = at.x();
        sample.y = at.y();
        sample.grey = gray(row, column);
        sample.column = column;
        sample.row = row;
        flats.push_back(sample);
        continue;
      }
      if (sample.view.border_px > informs * blur_px + slack_px) continue;
      sample.x = at.x();
      sample.y = at.y();
      sample.grey = gray(row, column);
      sample.column = column;
      sample.row = row;
      samples.push_back(sample);
    }
  // Some hundreds tell the levels and the noise well enough.
  const std::size_t share = 1 + flats.size() / enough_flats;
  for (std::size_t i = 0; i < flats.size(); i += share) samples.push_back(flats[i]);
  return samples;
}

PixelNoise measure_noise(const TagImageModel& model, const std::vector<TagSample>& samples, double side_px) {
  const A::Vector& p = model.appearance().value;
  const double blur = std::sqrt(0.5 * (p[A::blur_xx] + p[A::blur_yy]));
  std::vector<double> black;
  std::vector<double> white;
  std::vector<double> all;
  for (const TagSample& sample : samples) {
    if (sample.grey >= highest_grey || sample.grey <= lowest_grey || sample.weight < 0.5) continue;
    if (sample.beyond_px < normal_reach * blur) continue;
    const double residual = sample.modelled - sample.grey;
    all.push_back(residual);
    if (sample.view.kind != PixelView::flat) continue;
    (sample.whiteness < 0.5 ? black : white).push_back(residual);
  }
  // Too few flat pixels (a small tag): all residuals must do. Thirty give the variance to 25 %.
  constexpr std::size_t enough = 30;
  const double both = all.empty() ? 1.0 : spread(all);
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
  std::vector<double> sizes;
  for (const TagSample& sample : samples) {
    const double residual = residual_sigmas(sample);
    if (sample.grey >= highest_grey || sample.grey <= lowest_grey) ++clipped;
    if (sample.leaks) continue;
    if (sample.view.kind != PixelView::flat) {
      ++borders;
      sizes.push_back(std::abs(residual));
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

void weigh(std::vector<TagSample>& samples, const cv::Rect& region, double blur_px, double cut, Weighing weighing) {
  // Beyond 1.5 sigma of its border an occluder's blur is below what a cut of a few sigmas of noise can see.
  const int rim = std::max(1, static_cast<int>(std::lround(1.5 * blur_px)));
  cv::Mat1b rejected(region.height + 2 * rim, region.width + 2 * rim, static_cast<unsigned char>(0));
  const auto mark = [&](const TagSample& sample) -> unsigned char& {
    return rejected(sample.row - region.y + rim, sample.column - region.x + rim);
  };
  const auto neighbours = [&](const TagSample& sample, int reach, int value) {
    int count = 0;
    for (int dy = -reach; dy <= reach; ++dy)
      for (int dx = -reach; dx <= reach; ++dx)
        count += rejected(sample.row - region.y + rim + dy, sample.column - region.x + rim + dx) >= value;
    return count;
  };
  for (TagSample& sample : samples) {
    const double size = residual_sigmas(sample) / cut;
    const double rest = std::max(0.0, 1.0 - size * size);
    sample.weight = weighing == Weighing::tukey ? rest * rest : rest > 0.0 ? 1.0 : 0.0;
    if (rest == 0.0) mark(sample) = 1;
  }
  // Three of nine together are no accident of noise.
  for (const TagSample& sample : samples)
    if (mark(sample) == 1 && neighbours(sample, 1, 1) >= 3) mark(sample) = 2;
  for (TagSample& sample : samples)
    if (neighbours(sample, rim, 2) > 0) sample.weight = 0.0;
}

}  // namespace tagdock
