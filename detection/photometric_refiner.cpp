#include "detection/photometric_refiner.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "detection/lens_patch.h"
#include "detection/normal_distribution.h"
#include "detection/photometric_model.h"
#include "detection/tag_pattern.h"

namespace tagdock {
namespace {

using Vector2 = Eigen::Vector2d;
using A = TagAppearance;

/// Pixels at the ends of the range say only that the light was beyond them.
constexpr double lowest_grey = 0.5;
constexpr double highest_grey = 254.5;
constexpr double rounding_variance = 1.0 / 12.0;
/// Least blur covariance on an axis: the pixel's own box has 1/12.
constexpr double least_blur = 0.05;
constexpr double most_blur = 36.0;

struct Sample {
  TagPixel pixel;
  bool edge = false;       ///< a border is near; others inform the levels only
  double beyond_px = 1e9;  ///< distance from what is beyond the print, where anything may be
  double weight = 1.0;     ///< of robustness, 0 to 1
  double variance = 1.0;   ///< of the pixel [grey levels^2]
};

/// Twice the negative log likelihood of a pixel and its derivatives by the model's grey value.
struct Misfit {
  double cost = 0.0;
  double slope = 0.0;      ///< half the derivative of the cost
  double curvature = 0.0;  ///< half its second derivative
};

Misfit misfit(double modelled, double measured, double variance) {
  const bool high = measured >= highest_grey;
  const bool low = measured <= lowest_grey;
  if (!high && !low) {
    const double residual = modelled - measured;
    return {residual * residual / variance, residual / variance, 1.0 / variance};
  }
  // Censored: the light lay beyond the end of the range, wherever that was.
  const double sigma = std::sqrt(variance);
  const double sign = high ? 1.0 : -1.0;
  const double t = sign * (modelled - (high ? highest_grey : lowest_grey)) / sigma;
  if (t > 6.0) return {};
  if (t < -6.0) {  // -2 ln Phi(t) -> t^2 + ln(2 pi t^2)
    return {t * t + std::log(2.0 * std::numbers::pi * t * t), sign * (t + 1.0 / t) / sigma,
            (1.0 - 1.0 / (t * t)) / variance};
  }
  const double below = 0.5 * std::erfc(-t / std::numbers::sqrt2);
  const double ratio = std::exp(-0.5 * t * t) / std::sqrt(2.0 * std::numbers::pi) / below;
  return {-2.0 * std::log(below), -sign * ratio / sigma, ratio * (ratio + t) / variance};
}

struct Equations {
  double cost = 0.0;
  A::Vector gradient = A::Vector::Zero();
  A::Matrix hessian = A::Matrix::Zero();
};

/// Slopes of light across a tag are not known to a factor of ten, but never thousands of grey levels: this holds them
/// where clipping leaves them undetermined, and is far weaker than any unclipped tag's pixels.
constexpr double slope_sigma = 300.0;

Equations equations(const TagImageModel& model, const std::vector<Sample>& samples) {
  Equations sum;
  for (const Sample& sample : samples) {
    if (sample.weight == 0.0) continue;
    const ModelledPixel at = model.at(sample.pixel);
    const Misfit fit = misfit(at.grey, sample.pixel.grey, sample.variance);
    sum.cost += sample.weight * fit.cost;
    sum.gradient += sample.weight * fit.slope * at.by;
    sum.hessian.selfadjointView<Eigen::Lower>().rankUpdate(at.by, sample.weight * fit.curvature);
  }
  for (const int i : {A::white + 1, A::white + 2, A::drop + 1, A::drop + 2}) {
    const double value = model.appearance().value[i];
    sum.cost += value * value / (slope_sigma * slope_sigma);
    sum.gradient[i] += value / (slope_sigma * slope_sigma);
    sum.hessian(i, i) += 1.0 / (slope_sigma * slope_sigma);
  }
  sum.hessian.triangularView<Eigen::StrictlyUpper>() = sum.hessian.transpose();
  return sum;
}

/// The parameters that are free, by index.
using Free = std::vector<int>;

Free free_parameters(bool bleed, bool tone) {
  Free free;
  for (int i = 0; i < A::bleed; ++i) free.push_back(i);
  if (bleed) free.push_back(A::bleed);
  if (tone) free.push_back(A::tone);
  return free;
}

bool plausible(const A::Vector& p) {
  const double xx = p[A::blur_xx];
  const double yy = p[A::blur_yy];
  return p.allFinite() && xx > least_blur && yy > least_blur && xx < most_blur && yy < most_blur &&
         xx * yy - p[A::blur_xy] * p[A::blur_xy] > least_blur * least_blur && std::abs(p[A::bleed]) < 0.35 &&
         p[A::tone] > 0.25 && p[A::tone] < 2.0;
}

/// Score above which a term is freed: chance alone passes it in 1 of 600 images.
constexpr double score_threshold = 10.0;
/// A freed term must stand this many of its sigmas from nothing.
constexpr double significant = 3.0;
/// The exponent of the tone curve and clipping imitate each other, and a small tag tells too little of either.
constexpr double most_clipped_for_tone = 0.03;
constexpr double least_side_for_tone = 30.0;
/// Of ten thousand normal residuals the largest is 4; more than this is no noise [sigma].
constexpr double largest_by_noise = 5.5;

struct Solution {
  bool converged = false;
  Equations at;
};

/// Levenberg-Marquardt over the free parameters; the model is left at the best appearance.
Solution solve(TagImageModel& model, const std::vector<Sample>& samples, const Free& free, int max_iterations) {
  Solution solution;
  solution.at = equations(model, samples);
  if (!std::isfinite(solution.at.cost)) return solution;
  double lambda = 1e-4;
  const auto n = static_cast<Eigen::Index>(free.size());
  int failures = 0;
  for (int iteration = 0; iteration < max_iterations; ++iteration) {
    Eigen::MatrixXd h(n, n);
    Eigen::VectorXd b(n);
    for (Eigen::Index i = 0; i < n; ++i) {
      b[i] = solution.at.gradient[free[static_cast<std::size_t>(i)]];
      for (Eigen::Index j = 0; j < n; ++j)
        h(i, j) = solution.at.hessian(free[static_cast<std::size_t>(i)], free[static_cast<std::size_t>(j)]);
    }
    h.diagonal() *= 1.0 + lambda;
    const Eigen::LLT<Eigen::MatrixXd> factor(h);
    bool better = false;
    double gain = 0.0;
    double predicted = 0.0;
    if (factor.info() == Eigen::Success) {
      const Eigen::VectorXd step = factor.solve(b);
      predicted = b.dot(step);
      TagAppearance next = model.appearance();
      for (Eigen::Index i = 0; i < n; ++i) next.value[free[static_cast<std::size_t>(i)]] -= step[i];
      if (plausible(next.value)) {
        const TagAppearance last = model.appearance();
        model.set(next);
        Equations at = equations(model, samples);
        if (at.cost < solution.at.cost) {
          gain = solution.at.cost - at.cost;
          solution.at = at;
          better = true;
        } else {
          model.set(last);
        }
      }
    }
    // What a further step could still gain is far below one pixel's noise: the corners no longer move.
    const bool settled = predicted < 1e-4 || (better && gain < 1e-7 * solution.at.cost);
    if (settled && factor.info() == Eigen::Success) {
      solution.converged = true;
      return solution;
    }
    lambda *= better ? 0.2 : 8.0;
    if (!better && ++failures > 12) return solution;
  }
  return solution;
}

/// Homography from image to tag through four points, last entry 1; none if there is no such.
std::optional<Eigen::Matrix<double, 8, 1>> homography(const std::array<Vector2, 4>& image,
                                                      const std::array<Vector2, 4>& tag) {
  Eigen::Matrix<double, 8, 8> m = Eigen::Matrix<double, 8, 8>::Zero();
  Eigen::Matrix<double, 8, 1> b;
  for (int k = 0; k < 4; ++k) {
    const Vector2& p = image[static_cast<std::size_t>(k)];
    const Vector2& t = tag[static_cast<std::size_t>(k)];
    m.row(2 * k) << p.x(), p.y(), 1.0, 0.0, 0.0, 0.0, -p.x() * t.x(), -p.y() * t.x();
    m.row(2 * k + 1) << 0.0, 0.0, 0.0, p.x(), p.y(), 1.0, -p.x() * t.y(), -p.y() * t.y();
    b[2 * k] = t.x();
    b[2 * k + 1] = t.y();
  }
  const Eigen::Matrix<double, 8, 1> g = m.fullPivLu().solve(b);
  if (!g.allFinite()) return std::nullopt;
  return g;
}

Eigen::Matrix3d matrix(const A::Vector& p) {
  Eigen::Matrix3d g;
  g << p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], 1.0;
  return g;
}

bool convex(const Corners& corners) {
  for (std::size_t k = 0; k < 4; ++k) {
    const Vector2 a = corners[(k + 1) % 4] - corners[k];
    const Vector2 b = corners[(k + 2) % 4] - corners[(k + 1) % 4];
    if (!(a.x() * b.y() - a.y() * b.x() > 0.0)) return false;  // clockwise as seen, y down
  }
  return true;
}

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

/// Sigma of the edges' spread [px], from the steepest slope along normals of the sides.
double start_blur(const cv::Mat1b& gray, const Corners& corners) {
  std::vector<double> sigmas;
  for (std::size_t k = 0; k < 4; ++k) {
    const Vector2 along = corners[(k + 1) % 4] - corners[k];
    const Vector2 normal = Vector2(along.y(), -along.x()).normalized();
    for (int i = 0; i <= 10; ++i) {
      const Vector2 middle = corners[k] + (0.25 + 0.05 * i) * along;
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

/// Undistorted pixels as the model counts them.
struct ImageFrame {
  LensPatch lens;
  Vector2 centre;
  double side = 1.0;

  [[nodiscard]] TagPixel pixel(const Vector2& at) const {
    const LensPatch::Place place = lens.at(at);
    TagPixel pixel;
    pixel.x = (place.undistorted.x() - centre.x()) / side;
    pixel.y = (place.undistorted.y() - centre.y()) / side;
    pixel.xx = place.by_pixel(0, 0);
    pixel.xy = place.by_pixel(0, 1);
    pixel.yx = place.by_pixel(1, 0);
    pixel.yy = place.by_pixel(1, 1);
    return pixel;
  }
};

/// Derivative of (u, v) by the pixel.
Eigen::Matrix2d tag_by_pixel(const A::Vector& p, const TagPixel& pixel, double side) {
  const double w = p[6] * pixel.x + p[7] * pixel.y + 1.0;
  const double u = (p[0] * pixel.x + p[1] * pixel.y + p[2]) / w;
  const double v = (p[3] * pixel.x + p[4] * pixel.y + p[5]) / w;
  Eigen::Matrix2d by_place;
  by_place << p[0] - u * p[6], p[1] - u * p[7], p[3] - v * p[6], p[4] - v * p[7];
  Eigen::Matrix2d bend;
  bend << pixel.xx, pixel.xy, pixel.yx, pixel.yy;
  return by_place * bend / (w * side);
}

/// Pixels nearer to what is beyond the print, in sigmas of the blur, say nothing of the print.
constexpr double least_from_unknown = 1.0;

/// The pixels that the model explains: the print, and of what surrounds it only what the print's margin makes sure.
std::vector<Sample> select(const cv::Mat1b& gray, const TagImageModel& model, const ImageFrame& frame, double blur,
                           const cv::Rect& region) {
  std::vector<Sample> samples;
  const A::Vector& p = model.appearance().value;
  const double limit = 0.5 * model.pattern().cells;
  int flats = 0;
  for (int row = region.y; row < region.y + region.height; ++row)
    for (int column = region.x; column < region.x + region.width; ++column) {
      TagPixel pixel = frame.pixel({column, row});
      if (!(p[6] * pixel.x + p[7] * pixel.y + 1.0 > 0.0)) continue;
      const Vector2 place = model.to_tag(pixel.x, pixel.y);
      if (place.cwiseAbs().maxCoeff() > limit) continue;
      const Eigen::Matrix2d slope = tag_by_pixel(p, pixel, frame.side);
      const Vector2 modules_per_pixel = slope.rowwise().norm();
      const double beyond_px = model.distance_from_unknown(place, modules_per_pixel);
      if (beyond_px < least_from_unknown * blur) continue;
      pixel.grey = gray(row, column);
      pixel.column = column;
      pixel.row = row;
      Sample sample;
      sample.pixel = pixel;
      sample.beyond_px = beyond_px;
      sample.edge = model.near_border(pixel, 3.6 * blur + 1.3);
      // One in eight pixels far from borders is plenty for the levels.
      if (!sample.edge && flats++ % 8 != 0) continue;
      samples.push_back(sample);
    }
  return samples;
}

/// Quantile of grey values.
double quantile(std::vector<double> values, double share) {
  const auto at = values.begin() + static_cast<std::ptrdiff_t>(share * static_cast<double>(values.size() - 1));
  std::nth_element(values.begin(), at, values.end());
  return *at;
}

/// What pixel noise is, by the light: from flat cells, where no model of edges can be wrong.
struct NoiseLevels {
  double black = 1.0, white = 1.0;  ///< variance [grey levels^2]
};

double spread(std::vector<double> residuals) {
  std::vector<double> sizes(residuals.size());
  std::transform(residuals.begin(), residuals.end(), sizes.begin(), [](double r) { return std::abs(r); });
  // Rounded pixels of a quiet image have a median that says little: one grey level is always within the cut.
  const double cut = std::max(4.0 * 1.4826 * quantile(sizes, 0.5), 1.0);
  double sum = 0.0;
  int count = 0;
  for (const double r : residuals)
    if (std::abs(r) <= cut) {
      sum += r * r;
      ++count;
    }
  return std::max(sum / std::max(count, 1), rounding_variance);
}

NoiseLevels noise_levels(const TagImageModel& model, const std::vector<Sample>& samples) {
  std::vector<double> black;
  std::vector<double> white;
  std::vector<double> all;
  for (const Sample& sample : samples) {
    if (sample.pixel.grey >= highest_grey || sample.pixel.grey <= lowest_grey) continue;
    const ModelledPixel at = model.at(sample.pixel);
    const double residual = at.grey - sample.pixel.grey;
    all.push_back(residual);
    if (at.whiteness < 1e-3) black.push_back(residual);
    if (at.whiteness > 1.0 - 1e-3) white.push_back(residual);
  }
  NoiseLevels noise;
  // Too few flat pixels (a small tag): all residuals must do. Thirty give the variance to 25 %.
  constexpr std::size_t enough = 30;
  const double both = all.empty() ? 1.0 : spread(all);
  noise.black = black.size() >= enough ? spread(black) : white.size() >= enough ? spread(white) : both;
  noise.white = white.size() >= enough ? spread(white) : noise.black;
  return noise;
}

/// What varies a pixel: noise by the light, and whatever may shine in from beyond the print.
/// Noise is interpolated where it arises, in linear light; the tone curve then stretches it.
void set_variances(const TagImageModel& model, double side_px, std::vector<Sample>& samples) {
  const NoiseLevels noise = noise_levels(model, samples);
  const A::Vector& p = model.appearance().value;
  const double exponent = p[A::tone];
  const auto stretch = [&](double light) {  // d(grey)/d(light), squared
    if (exponent == 1.0) return 1.0;
    const double slope = exponent * std::pow(std::max(light, 0.5) / 255.0, exponent - 1.0);
    return slope * slope;
  };
  const double white = std::max(noise.white - rounding_variance, 0.0) / stretch(p[A::white]);
  const double black = std::max(noise.black - rounding_variance, 0.0) / stretch(p[A::white] - p[A::drop]);
  const double blur = std::sqrt(0.5 * (p[A::blur_xx] + p[A::blur_yy]));
  for (Sample& sample : samples) {
    const ModelledPixel at = model.at(sample.pixel);
    const double share = std::clamp(at.whiteness, 0.0, 1.0);
    sample.variance = (black + share * (white - black)) * stretch(at.light) + rounding_variance;
    if (sample.beyond_px < 5.0 * blur) {
      // What lies beyond may differ from the margin by half the contrast, and is alike along a side: as many pixels as
      // a side has err together, so each must count for that many times less.
      const double leak = 0.5 * p[A::drop] * std::sqrt(stretch(at.light)) * normal(-sample.beyond_px / blur).cumulative;
      sample.variance += side_px * leak * leak;
    }
  }
}

/// Statistic of the score test of one parameter that is not free: about 1 when the parameter has no part in the image.
double score(const Equations& at, const Free& free, int parameter, double inflation) {
  const auto n = static_cast<Eigen::Index>(free.size());
  Eigen::MatrixXd h(n, n);
  Eigen::VectorXd column(n);
  Eigen::VectorXd gradient(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    const int fi = free[static_cast<std::size_t>(i)];
    column[i] = at.hessian(fi, parameter);
    gradient[i] = at.gradient[fi];
    for (Eigen::Index j = 0; j < n; ++j) h(i, j) = at.hessian(fi, free[static_cast<std::size_t>(j)]);
  }
  const Eigen::VectorXd solved = h.ldlt().solve(column);
  const double information = at.hessian(parameter, parameter) - column.dot(solved);
  const double slope = at.gradient[parameter] - gradient.dot(solved);
  return information > 1e-9 * at.hessian(parameter, parameter) ? slope * slope / information / inflation : 0.0;
}

/// Standard deviation of a free parameter by the normal equations.
double deviation(const Equations& at, const Free& free, int parameter) {
  const auto n = static_cast<Eigen::Index>(free.size());
  Eigen::MatrixXd h(n, n);
  Eigen::VectorXd unit = Eigen::VectorXd::Zero(n);
  for (Eigen::Index i = 0; i < n; ++i) {
    if (free[static_cast<std::size_t>(i)] == parameter) unit[i] = 1.0;
    for (Eigen::Index j = 0; j < n; ++j)
      h(i, j) = at.hessian(free[static_cast<std::size_t>(i)], free[static_cast<std::size_t>(j)]);
  }
  return std::sqrt(std::max(unit.dot(h.ldlt().solve(unit)), 0.0));
}

/// How well the model explains the pixels that count.
struct Quality {
  double chi2_per_pixel = 0.0;
  double rms = 0.0;
  double clipped = 0.0;   ///< share of pixels at an end of the range
  double rejected = 0.0;  ///< share of edge pixels that the robust weights threw out
  double largest = 0.0;   ///< residual [sigma]
  double scale = 1.0;     ///< 1.4826 times the median residual of edge pixels [sigma]
  int count = 0;
};

double residual_sigmas(const Sample& sample, double modelled) {
  if (sample.pixel.grey >= highest_grey && modelled >= highest_grey) return 0.0;
  if (sample.pixel.grey <= lowest_grey && modelled <= lowest_grey) return 0.0;
  return (modelled - sample.pixel.grey) / std::sqrt(sample.variance);
}

Quality quality(const TagImageModel& model, const std::vector<Sample>& samples, std::size_t parameters) {
  Quality result;
  double weights = 0.0;
  double chi2 = 0.0;
  double squares = 0.0;
  int clipped = 0;
  int edges = 0;
  int rejected = 0;
  std::vector<double> sizes;
  for (const Sample& sample : samples) {
    const double residual = residual_sigmas(sample, model.at(sample.pixel).grey);
    if (sample.edge) {
      ++edges;
      if (sample.weight < 0.05) ++rejected;
      sizes.push_back(std::abs(residual));
    }
    if (sample.pixel.grey >= highest_grey || sample.pixel.grey <= lowest_grey) ++clipped;
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
  result.rejected = static_cast<double>(rejected) / std::max(edges, 1);
  if (!sizes.empty()) result.scale = 1.4826 * quantile(sizes, 0.5);
  return result;
}

/// Tukey's weights; a patch of rejected pixels is something in front of the tag, and goes with its rim.
void weigh(const TagImageModel& model, const cv::Rect& region, double scale, double cut, std::vector<Sample>& samples) {
  cv::Mat1b rejected(region.height + 2, region.width + 2, static_cast<unsigned char>(0));
  const auto mark = [&](const Sample& sample) -> unsigned char& {
    return rejected(sample.pixel.row - region.y + 1, sample.pixel.column - region.x + 1);
  };
  for (Sample& sample : samples) {
    const double size = residual_sigmas(sample, model.at(sample.pixel).grey) / (cut * scale);
    const double rest = std::max(0.0, 1.0 - size * size);
    sample.weight = rest * rest;
    if (rest == 0.0) mark(sample) = 1;
  }
  const auto neighbours = [&](const Sample& sample, int value) {
    int count = 0;
    for (int dy = 0; dy <= 2; ++dy)
      for (int dx = 0; dx <= 2; ++dx)
        count += rejected(sample.pixel.row - region.y + dy, sample.pixel.column - region.x + dx) >= value;
    return count;
  };
  // Three of nine together are no accident of noise.
  for (const Sample& sample : samples)
    if (mark(sample) == 1 && neighbours(sample, 1) >= 3) mark(sample) = 2;
  for (Sample& sample : samples)
    if (neighbours(sample, 2) > 0) sample.weight = 0.0;
}

}  // namespace

Refinement refine_photometric(const cv::Mat1b& gray, const std::string& family, const TagDetection& coarse,
                              const PhotometricConfig& config, const std::optional<CameraModel>& camera) {
  const TagPattern pattern = tag_pattern(family, coarse.id);
  for (const Vector2& corner : coarse.corners_px)
    if (!corner.allFinite()) return Unrefined::not_a_quadrilateral;
  if (!convex(coarse.corners_px)) return Unrefined::not_a_quadrilateral;
  if (gray.cols < 2 || gray.rows < 2) return Unrefined::too_few_pixels;

  // The image around the tag, without its lens.
  Vector2 low = coarse.corners_px[0];
  Vector2 high = low;
  for (const Vector2& corner : coarse.corners_px) {
    low = low.cwiseMin(corner);
    high = high.cwiseMax(corner);
  }
  const double margin = 0.5 * (pattern.cells - pattern.border_cells) / pattern.border_cells;
  const Vector2 more = (high - low) * margin * 1.5 + Vector2::Constant(3.0);
  const cv::Rect wanted(cv::Point(static_cast<int>(std::floor(std::clamp(low.x() - more.x(), -1e6, 1e6))),
                                  static_cast<int>(std::floor(std::clamp(low.y() - more.y(), -1e6, 1e6)))),
                        cv::Point(static_cast<int>(std::ceil(std::clamp(high.x() + more.x(), -1e6, 1e6))) + 1,
                                  static_cast<int>(std::ceil(std::clamp(high.y() + more.y(), -1e6, 1e6))) + 1));
  const cv::Rect region = wanted & cv::Rect(0, 0, gray.cols, gray.rows);
  if (region.area() == 0) return Unrefined::too_few_pixels;
  const auto lens =
      LensPatch::make(camera, {region.x, region.y}, {region.x + region.width - 1.0, region.y + region.height - 1.0});
  if (!lens) return Unrefined::did_not_converge;

  // Start values.
  ImageFrame frame{*lens, Vector2::Zero(), 1.0};
  std::array<Vector2, 4> image;
  double side_px = 0.0;
  for (std::size_t k = 0; k < 4; ++k) {
    image[k] = lens->at(coarse.corners_px[k]).undistorted;
    frame.centre += 0.25 * image[k];
    side_px += 0.25 * (coarse.corners_px[(k + 1) % 4] - coarse.corners_px[k]).norm();
  }
  frame.side = side_px;
  for (Vector2& corner : image) corner = (corner - frame.centre) / frame.side;
  const double half = 0.5 * pattern.border_cells;
  const std::array<Vector2, 4> tag = {Vector2(-half, -half), Vector2(half, -half), Vector2(half, half),
                                      Vector2(-half, half)};
  const auto start = homography(image, tag);
  if (!start) return Unrefined::not_a_quadrilateral;
  const double blur = start_blur(gray, coarse.corners_px);
  TagAppearance appearance;
  appearance.value.head<8>() = *start;
  appearance.value[A::blur_xx] = appearance.value[A::blur_yy] = blur * blur;
  appearance.value[A::tone] = 1.0;
  TagImageModel model(pattern, frame.side);
  model.set(appearance);

  std::vector<Sample> samples = select(gray, model, frame, blur, region);
  std::vector<double> greys;
  std::vector<double> whites;
  std::vector<double> blacks;
  for (const Sample& sample : samples) {
    greys.push_back(sample.pixel.grey);
    (model.at(sample.pixel).whiteness > 0.5 ? whites : blacks).push_back(sample.pixel.grey);
  }
  if (greys.size() < 40 || whites.size() < 5 || blacks.size() < 5) return Unrefined::too_few_pixels;
  appearance.value[A::white] = quantile(whites, 0.75);
  appearance.value[A::drop] = appearance.value[A::white] - quantile(blacks, 0.25);
  model.set(appearance);

  // Everything but ink spread and tone curve first.
  Free free = free_parameters(false, false);
  Solution solution = solve(model, samples, free, config.max_iterations);
  if (!std::isfinite(solution.at.cost)) return Unrefined::did_not_converge;
  const auto refit = [&] {
    solution = solve(model, samples, free, config.max_iterations);
    set_variances(model, side_px, samples);
    solution = solve(model, samples, free, config.max_iterations);
  };
  set_variances(model, side_px, samples);
  solution = solve(model, samples, free, config.max_iterations);

  // Which further terms the image asks for: by score tests, which need no refit (notes on detection, section 9).
  bool bleed = false;
  bool tone = false;
  bool robust = false;
  const auto ask = [&] {
    for (int round = 0; round < 2; ++round) {
      const Quality now = quality(model, samples, free.size());
      const double inflation = std::max(1.0, now.chi2_per_pixel);
      const bool tone_allowed = now.clipped < most_clipped_for_tone && side_px > least_side_for_tone;
      const double bleed_score = bleed ? 0.0 : score(solution.at, free, A::bleed, inflation);
      const double tone_score = tone || !tone_allowed ? 0.0 : score(solution.at, free, A::tone, inflation);
      if (std::max(bleed_score, tone_score) < score_threshold) return;
      (bleed_score > tone_score ? bleed : tone) = true;
      free = free_parameters(bleed, tone);
      refit();
    }
  };
  // A term that turns out to be within its uncertainty of nothing is taken out again.
  const auto forgo = [&] {
    const double inflation = std::sqrt(std::max(1.0, quality(model, samples, free.size()).chi2_per_pixel));
    TagAppearance plain = model.appearance();
    const bool no_bleed =
        bleed && std::abs(plain.value[A::bleed]) < significant * inflation * deviation(solution.at, free, A::bleed);
    const bool no_tone =
        tone && std::abs(plain.value[A::tone] - 1.0) < significant * inflation * deviation(solution.at, free, A::tone);
    if (!no_bleed && !no_tone) return;
    if (no_bleed) plain.value[A::bleed] = 0.0;
    if (no_tone) plain.value[A::tone] = 1.0;
    bleed = bleed && !no_bleed;
    tone = tone && !no_tone;
    free = free_parameters(bleed, tone);
    model.set(plain);
    refit();
  };
  ask();
  Quality fit = quality(model, samples, free.size());
  if (fit.largest > largest_by_noise || fit.chi2_per_pixel > 1.0 + 6.0 * std::sqrt(2.0 / fit.count)) {
    robust = true;
    for (const double cut : {5.0, 4.5}) {
      weigh(model, region, std::max(1.0, fit.scale), cut, samples);
      refit();
      fit = quality(model, samples, free.size());
    }
    forgo();
    ask();
    weigh(model, region, std::max(1.0, quality(model, samples, free.size()).scale), 4.5, samples);
    refit();
  }
  forgo();
  if (!solution.converged) return Unrefined::did_not_converge;
  fit = quality(model, samples, free.size());

  // Corners, and how they follow the homography.
  const A::Vector& p = model.appearance().value;
  const Eigen::Matrix3d inverse = matrix(p).inverse();
  RefinedTag refined;
  Eigen::Matrix<double, 8, A::count> corner_by = Eigen::Matrix<double, 8, A::count>::Zero();
  for (std::size_t k = 0; k < 4; ++k) {
    const Eigen::Vector3d at = inverse * tag[k].homogeneous();
    const Vector2 place = at.hnormalized();
    if (!place.allFinite() || !(matrix(p).row(2).dot(place.homogeneous()) > 0.0)) return Unrefined::not_a_quadrilateral;
    const Vector2 corner = lens->distorted(place * frame.side + frame.centre);
    refined.corners_px[k] = corner;
    const TagPixel pixel = frame.pixel(corner);
    const double w = p[6] * pixel.x + p[7] * pixel.y + 1.0;
    Eigen::Matrix<double, 2, 8> tag_by_g = Eigen::Matrix<double, 2, 8>::Zero();
    const Eigen::RowVector3d xy1(pixel.x / w, pixel.y / w, 1.0 / w);
    tag_by_g.block<1, 3>(0, 0) = xy1;
    tag_by_g.block<1, 3>(1, 3) = xy1;
    tag_by_g.block<2, 2>(0, 6) = -tag[k] * xy1.head<2>();
    corner_by.block<2, 8>(2 * static_cast<Eigen::Index>(k), 0) =
        -tag_by_pixel(p, pixel, frame.side).inverse() * tag_by_g;
    // A coarse corner is never farther off than this (notes on detection, section 8).
    if (!((corner - coarse.corners_px[k]).norm() < std::max(3.0, 0.06 * side_px))) return Unrefined::left_the_edge;
  }
  if (!convex(refined.corners_px)) return Unrefined::not_a_quadrilateral;

  // Covariance: the sandwich stays right under unequal noise and weights.
  const auto n = static_cast<Eigen::Index>(free.size());
  Eigen::MatrixXd h(n, n);
  Eigen::MatrixXd corner_by_free(8, n);
  for (Eigen::Index i = 0; i < n; ++i) {
    corner_by_free.col(i) = corner_by.col(free[static_cast<std::size_t>(i)]);
    for (Eigen::Index j = 0; j < n; ++j)
      h(i, j) = solution.at.hessian(free[static_cast<std::size_t>(i)], free[static_cast<std::size_t>(j)]);
  }
  const Eigen::LLT<Eigen::MatrixXd> factor(h);
  if (factor.info() != Eigen::Success) return Unrefined::did_not_converge;
  const Eigen::MatrixXd gain = factor.solve(corner_by_free.transpose()).transpose();  // corners per unit of gradient
  Eigen::Matrix<double, 8, 8> covariance = Eigen::Matrix<double, 8, 8>::Zero();
  for (const Sample& sample : samples) {
    if (sample.weight == 0.0) continue;
    const ModelledPixel at = model.at(sample.pixel);
    const Misfit part = misfit(at.grey, sample.pixel.grey, sample.variance);
    Eigen::VectorXd by(n);
    for (Eigen::Index i = 0; i < n; ++i) by[i] = at.by[free[static_cast<std::size_t>(i)]];
    const Eigen::Matrix<double, 8, 1> pull = gain * by * (sample.weight * part.slope);
    covariance += pull * pull.transpose();
  }
  if (fit.count <= n) return Unrefined::too_few_pixels;
  refined.id = coarse.id;
  refined.hamming = coarse.hamming;
  refined.margin = coarse.margin;
  refined.covariance_px2 = covariance;
  refined.residual_rms = fit.rms;
  refined.chi2_per_pixel = fit.chi2_per_pixel;
  refined.blur_px = std::sqrt(0.5 * (p[A::blur_xx] + p[A::blur_yy]));
  refined.terms = "homography+slope+blur";
  if (camera) refined.terms += "+lens";
  if (fit.clipped > 0.01) refined.terms += "+saturation";
  if (bleed) refined.terms += "+bleed";
  if (tone) refined.terms += "+tone";
  if (robust) refined.terms += "+robust";
  return refined;
}

}  // namespace tagdock
