#include "detection/photometric_refiner.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <utility>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>

#include "detection/fitted_tag.h"
#include "detection/lens_patch.h"
#include "detection/photometric_fit.h"
#include "detection/photometric_model.h"
#include "detection/photometric_samples.h"
#include "detection/tag_pattern.h"

namespace tagdock {
namespace {

using Vector2 = Eigen::Vector2d;
using Vector8 = Eigen::Matrix<double, 8, 1>;
using A = TagAppearance;

/// Score above which a term is freed: chance alone passes it in 1 of 600 images.
constexpr double score_threshold = 10.0;
/// A term whose score is more than this share of the other's may be the one that is meant.
constexpr double rival = 0.3;
/// A freed term must stand this many of its sigmas from nothing.
constexpr double significant = 3.0;
/// A smaller tag tells too little of the tone curve.
constexpr double least_side_for_tone = 20.0;
/// Of ten thousand normal residuals the largest is 4; more than this is no noise [robust scales].
constexpr double largest_by_noise = 5.5;
/// Rms over robust scale of residuals: 1 for normal ones, whose ratio scatters by 2 % over a thousand pixels.
constexpr double heavy_tails = 1.2;
/// A step whose gain in the cost (chi-square) is less moves nothing by more than a fifth of its sigma; the step after
/// it would be a square of that.
constexpr double enough = 0.04;
/// Fits that only lead to the next one may end this much sooner.
constexpr double leading = 10.0;

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

/// The image around a tag, without its lens; none if it lies outside of the image or where the lens folds over.
std::optional<TagRegion> region_of(const cv::Mat1b& gray, const TagPattern& pattern, const Corners& corners,
                                   const std::optional<CameraModel>& camera) {
  Vector2 low = corners[0];
  Vector2 high = low;
  for (const Vector2& corner : corners) {
    low = low.cwiseMin(corner);
    high = high.cwiseMax(corner);
  }
  // Half as much again as the print's margin, for perspective.
  const double margin = 0.75 * (pattern.cells - pattern.border_cells) / pattern.border_cells;
  const Vector2 size(gray.cols, gray.rows);
  const Vector2 more = (high - low) * margin + Vector2::Constant(3.0);
  low = (low - more).cwiseMax(0.0).cwiseMin(size);
  high = (high + more).cwiseMax(0.0).cwiseMin(size);
  TagRegion region;
  region.pixels = cv::Rect(cv::Point(static_cast<int>(low.x()), static_cast<int>(low.y())),
                           cv::Point(static_cast<int>(std::ceil(high.x())), static_cast<int>(std::ceil(high.y()))));
  if (region.pixels.area() == 0) return std::nullopt;
  const auto lens = LensPatch::make(camera, low, high);
  if (!lens) return std::nullopt;
  region.lens = *lens;
  region.side_px = 0.0;
  for (std::size_t k = 0; k < 4; ++k) {
    region.centre += 0.25 * lens->undistorted(corners[k]);
    region.side_px += 0.25 * (corners[(k + 1) % 4] - corners[k]).norm();
  }
  return region;
}

/// Share of rounding that is alike in pixels which a border crosses alike (Widrow's law of dither): noise above half a
/// grey level leaves nothing of it.
double undithered(const PixelNoise& noise) {
  const double variance = 0.5 * (noise.black + noise.white);
  return std::exp(-4.0 * std::numbers::pi * std::numbers::pi * variance);
}

/// How far a side turns the phase between border and pixel grid [rad].
double phase_turn(const Vector2& side) { return std::numbers::pi * side.cwiseAbs().minCoeff(); }

/// How many pixels err alike, for rounding along borders that run with the pixel grid does not average out.
double rounded_alike(const Corners& corners, const PixelNoise& noise) {
  double pixels = 0.0;
  for (std::size_t k = 0; k < 4; ++k) {
    const Vector2 side = corners[(k + 1) % 4] - corners[k];
    const double turn = phase_turn(side);
    pixels += 0.25 * side.norm() / (1.0 + turn * turn);
  }
  return 1.0 + undithered(noise) * pixels;
}

/// What one image of a tag says of it, term by term.
class TagFit {
 public:
  TagFit(const cv::Mat1b& gray, const TagPattern& pattern, const TagRegion& region, int max_iterations)
      : gray_(gray),
        region_(region),
        model_(pattern, region.side_px, region.tag_lens()),
        max_iterations_(max_iterations) {}

  /// Fits from the coarse corners; none when the pixels explain themselves.
  std::optional<Unrefined> run(const Corners& coarse, const Eigen::Matrix<double, 8, 1>& start);

  [[nodiscard]] const TagImageModel& model() const { return model_; }
  [[nodiscard]] const FitQuality& last_quality() const { return quality_; }
  [[nodiscard]] const PixelNoise& noise() const { return noise_; }
  [[nodiscard]] std::string terms(bool lens) const;
  [[nodiscard]] double inflation() const { return inflation_; }
  /// All of it; the fit is spent.
  [[nodiscard]] FittedTag fitted(const RefinedTag& tag) && {
    return {tag, region_, std::move(model_), std::move(samples_), std::move(free_), inflation_ * rounding_};
  }

  /// Covariance of the homography's eight parameters.
  [[nodiscard]] std::optional<Eigen::Matrix<double, 8, 8>> covariance();

 private:
  /// Fits on a share of the pixels, which brings borders within hundredths of a pixel.
  std::optional<Unrefined> approach(const Corners& coarse, const Eigen::Matrix<double, 8, 1>& start);
  /// A tag that fills a large image has more pixels than its model is exact for: every so many-th row and column do.
  [[nodiscard]] int thinning() const { return std::max(1, static_cast<int>(region_.side_px / 500.0)); }
  void refit(bool noise_anew, double times_enough = 1.0);
  void ask_for_motion();
  void ask_for_shape();
  void ask();
  void forgo();
  void reweigh();

  cv::Mat1b gray_;
  TagRegion region_;
  TagImageModel model_;
  int max_iterations_;
  std::vector<TagSample> samples_;
  PixelNoise noise_;
  FreeParameters free_ = free_parameters(false, false);
  PhotometricFit fit_;
  FitQuality quality_;
  double inflation_ = 1.0;  ///< of the covariance, by what pixels of one view err together
  double rounding_ = 1.0;   ///< of the covariance, by what pixels are rounded alike
  double alike_ = 1.0;      ///< pixels that are rounded alike, see rounded_alike
  bool bleed_ = false;
  bool tone_ = false;
  bool motion_ = false;
  bool shape_ = false;
  bool robust_ = false;
};

std::optional<Unrefined> TagFit::approach(const Corners& coarse, const Eigen::Matrix<double, 8, 1>& start) {
  const double blur = start_blur(gray_, coarse);
  TagAppearance appearance;
  appearance.value.head<8>() = start;
  appearance.value[A::blur_xx] = appearance.value[A::blur_yy] = blur * blur;
  appearance.value[A::tone] = 1.0;
  model_.set(appearance);
  // So many rows and columns leave some hundred pixels on borders; a small tag needs all its pixels at once. Coarse
  // corners are off by a few tenths of a pixel.
  const int every = std::clamp(static_cast<int>(region_.side_px / 30.0), 1, 3) * thinning();
  samples_ = select_samples(gray_, model_, region_, blur, every, 0.8);
  std::vector<double> whites;
  std::vector<double> blacks;
  (void)model_.equations(samples_);
  for (const TagSample& sample : samples_) (sample.whiteness > 0.5F ? whites : blacks).push_back(sample.grey);
  if (samples_.size() < 40 || whites.size() < 5 || blacks.size() < 5) return Unrefined::too_few_pixels;
  const auto quartile = [](std::vector<double>& values, std::size_t quarters) {
    const auto at = values.begin() + static_cast<std::ptrdiff_t>(quarters * (values.size() - 1) / 4);
    std::nth_element(values.begin(), at, values.end());
    return *at;
  };
  appearance.value[A::white] = quartile(whites, 3);
  appearance.value[A::drop] = appearance.value[A::white] - quartile(blacks, 1);
  model_.set(appearance);
  // Noise is not known yet; two grey levels are a guess that only sets what leaks in from beyond the print against it.
  const PixelNoise guess{4.0, 4.0, 1.0, blur, appearance.value[A::drop], region_.side_px};
  // A ninth of the pixels errs by three of the final sigmas; a tenth of that is close enough.
  fit_ = fit_appearance(model_, samples_, free_, max_iterations_, 0.3, &guess);
  if (!std::isfinite(fit_.at.cost)) return Unrefined::did_not_converge;
  return std::nullopt;
}

/// @param times_enough  how much coarser it may end; for fits that only lead to the next one
void TagFit::refit(bool noise_anew, double times_enough) {
  if (noise_anew) noise_ = measure_noise(model_, samples_, region_.side_px);
  // Where the model does not explain the pixels, steps are measured by the misfit.
  const double worth = enough * times_enough * std::max(1.0, quality_.chi2_per_pixel);
  fit_ = fit_appearance(model_, samples_, free_, max_iterations_, worth, &noise_);
  quality_ = quality(samples_, free_.size());
}

/// Is a blur that is longer than wide the way of an image that moved at an even speed, or a Gaussian? Both have as many
/// parameters, so the pixels may choose. The way follows from the blur, whose longer axis it lengthens by a twelfth of
/// its square; what is left is round.
void TagFit::ask_for_motion() {
  // Below this fourth cumulant, in units of the squared variance, the two differ by less than 0.3 % of the contrast.
  constexpr double too_alike = 0.1;
  const TagAppearance gaussian = model_.appearance();
  const double cost = fit_.at.cost;
  for (int round = 0; round < 3; ++round) {
    TagAppearance moving = model_.appearance();
    Eigen::Matrix2d blur;
    blur << moving.value[A::blur_xx], moving.value[A::blur_xy], moving.value[A::blur_xy], moving.value[A::blur_yy];
    blur += moving.motion_px * moving.motion_px.transpose() / 12.0;
    const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> axes(blur);
    const double longer = axes.eigenvalues()[1];
    const double more = longer - axes.eigenvalues()[0];
    if (round == 0 && 1.2 * more * more < too_alike * longer * longer) return;
    // A Gaussian stretches itself beyond the variance of a way, so the first way takes half of it.
    moving.motion_px = std::sqrt(12.0 * (round == 0 ? 0.5 : 1.0) * more) * axes.eigenvectors().col(1);
    // Nearer than this to the last one it changes no border by a thousandth of the contrast.
    constexpr double near_px = 0.1;
    if (round > 1 && std::abs(moving.motion_px.norm() - model_.appearance().motion_px.norm()) < near_px) break;
    blur -= moving.motion_px * moving.motion_px.transpose() / 12.0;
    moving.value[A::blur_xx] = blur(0, 0);
    moving.value[A::blur_xy] = blur(0, 1);
    moving.value[A::blur_yy] = blur(1, 1);
    model_.set(moving);
    refit(false, leading);
  }
  motion_ = fit_.converged && fit_.at.cost < cost - score_threshold * std::max(1.0, quality_.chi2_per_pixel);
  if (!motion_) model_.set(gaussian);
  refit(motion_);
}

/// Is the blur a Gaussian? The grey values follow its excess kurtosis linearly, so one step from nothing is its fit.
void TagFit::ask_for_shape() {
  // Optics that spread less than a pixel show no shape: the pixel's box and the Gaussian hide it.
  constexpr double least_blur_px = 1.0;
  constexpr double most_excess = 1.0;  // beyond, a series of one term is no kernel any more
  const TagAppearance gaussian = model_.appearance();
  if (gaussian.blur_px() < least_blur_px) return;
  struct Found {
    double excess, score;
  };
  const auto look = [&](std::vector<TagSample> samples) -> Found {
    constexpr double step = 0.1;
    TagAppearance other = gaussian;
    other.excess = step;
    model_.set(other);
    std::vector<TagSample> waves = samples;
    (void)model_.equations(waves);
    model_.set(gaussian);
    const Equations at = model_.equations(samples);
    double slope = 0.0;
    double own = 0.0;
    for (std::size_t i = 0; i < samples.size(); ++i) {
      const TagSample& sample = samples[i];
      const double by = (waves[i].modelled - sample.modelled) / step;
      const bool clipped = sample.grey >= highest_grey || sample.grey <= lowest_grey;
      waves[i].weight = clipped ? 0.0F : sample.weight;
      waves[i].grey = sample.modelled - static_cast<float>(by);
      const double weight = waves[i].weight / sample.variance;
      slope += weight * by * (sample.modelled - sample.grey);
      own += weight * by * by;
    }
    const A::Vector cross_all = model_.equations(waves).gradient;
    Eigen::VectorXd cross(static_cast<Eigen::Index>(free_.size()));
    Eigen::VectorXd gradient(cross.size());
    for (Eigen::Index i = 0; i < cross.size(); ++i) {
      cross[i] = cross_all[free_[static_cast<std::size_t>(i)]];
      gradient[i] = at.gradient[free_[static_cast<std::size_t>(i)]];
    }
    const Eigen::VectorXd solved = reduced(at.hessian, free_).ldlt().solve(cross);
    const double information = own - cross.dot(solved);
    const double rest = slope - gradient.dot(solved);
    if (!(information > 1e-9 * own)) return {0.0, 0.0};
    return {-rest / information, rest * rest / information / (std::max(1.0, quality_.chi2_per_pixel) * alike_)};
  };
  // A quarter of the pixels shows a quarter of the score, and spares most images the rest.
  constexpr std::size_t share = 4;
  std::vector<TagSample> some;
  for (std::size_t i = 0; i < samples_.size(); i += share) some.push_back(samples_[i]);
  if (look(std::move(some)).score < score_threshold / static_cast<double>(share)) return;
  const Found found = look(samples_);
  if (found.score < score_threshold) return;
  const double cost = fit_.at.cost;
  TagAppearance shaped = gaussian;
  shaped.excess = std::clamp(found.excess, -most_excess, most_excess);
  model_.set(shaped);
  refit(false, leading);
  shape_ = fit_.converged && fit_.at.cost < cost;
  if (!shape_) model_.set(gaussian);
  refit(shape_);
}

/// Which further terms the image asks for: by score tests, which need no refit (notes on detection, section 9).
void TagFit::ask() {
  for (int round = 0; round < 2; ++round) {
    const double inflation = std::max(1.0, quality_.chi2_per_pixel) * alike_;
    const bool tone_allowed = region_.side_px > least_side_for_tone;
    const double bleed_score = bleed_ ? 0.0 : score(fit_.at, free_, A::bleed, inflation);
    const double tone_score = tone_ || !tone_allowed ? 0.0 : score(fit_.at, free_, A::tone, inflation);
    const double most = std::max(bleed_score, tone_score);
    if (most < score_threshold) return;
    const TagAppearance before = model_.appearance();
    const auto with = [&](bool bleed, bool tone) {
      model_.set(before);
      bleed_ = bleed;
      tone_ = tone;
      free_ = free_parameters(bleed, tone);
      refit(false, leading);
      refit(true);
    };
    // Far from the minimum each imitates the other, so both are freed then, and `forgo` takes back the one that was not
    // meant.
    const bool bleed = bleed_ || bleed_score > rival * most;
    const bool tone = tone_ || tone_score > rival * most;
    with(bleed, tone);
    // A tone curve that runs out of what cameras have stands for something else.
    if (!fit_.converged && tone) with(true, false);
    if (!fit_.converged) with(false, false);
  }
}

/// A term that turns out to be within its uncertainty of nothing is taken out again.
void TagFit::forgo() {
  const double inflation = significant * std::sqrt(std::max(1.0, quality_.chi2_per_pixel) * alike_);
  TagAppearance plain = model_.appearance();
  const bool no_bleed = bleed_ && std::abs(plain.value[A::bleed]) < inflation * deviation(fit_.at, free_, A::bleed);
  const bool no_tone = tone_ && std::abs(plain.value[A::tone] - 1.0) < inflation * deviation(fit_.at, free_, A::tone);
  if (!no_bleed && !no_tone) return;
  if (no_bleed) plain.value[A::bleed] = 0.0;
  if (no_tone) plain.value[A::tone] = 1.0;
  bleed_ = bleed_ && !no_bleed;
  tone_ = tone_ && !no_tone;
  free_ = free_parameters(bleed_, tone_);
  model_.set(plain);
  refit(true);
}

/// Robust weights, which come after ink and tone: they would take the signs of these for outliers.
void TagFit::reweigh() {
  robust_ = true;
  weigh(samples_, region_.pixels.size(), noise_.blur_px, 5.0 * quality_.scale, Weighing::tukey);
  refit(true, leading);
  weigh(samples_, region_.pixels.size(), noise_.blur_px, 4.5 * quality_.spread, Weighing::tukey);
  refit(true, leading);
  forgo();
  ask();
  weigh(samples_, region_.pixels.size(), noise_.blur_px, 4.5 * quality_.spread, Weighing::all_or_nothing);
  refit(true);
}

std::optional<Unrefined> TagFit::run(const Corners& coarse, const Eigen::Matrix<double, 8, 1>& start) {
  if (const auto why = approach(coarse, start)) return why;
  noise_ = measure_noise(model_, samples_, region_.side_px);
  // Borders are within hundredths of a pixel now.
  samples_ = select_samples(gray_, model_, region_, noise_.blur_px, thinning(), 0.15);
  if (samples_.size() < 40) return Unrefined::too_few_pixels;
  alike_ = rounded_alike(coarse, noise_);
  refit(false);
  // Few pixels may have misjudged the noise.
  const PixelNoise again = measure_noise(model_, samples_, region_.side_px);
  const auto variance = [](const PixelNoise& noise) { return noise.black + noise.white + 2.0 * rounding_variance; };
  if (std::abs(variance(again) / variance(noise_) - 1.0) > 0.15) refit(true);
  ask_for_motion();
  ask_for_shape();
  ask();
  if (quality_.largest > largest_by_noise * quality_.scale || quality_.spread > heavy_tails * quality_.scale) reweigh();
  forgo();
  if (!fit_.converged && (bleed_ || tone_)) {
    TagAppearance plain = model_.appearance();
    plain.value[A::bleed] = 0.0;
    plain.value[A::tone] = 1.0;
    bleed_ = tone_ = false;
    free_ = free_parameters(false, false);
    model_.set(plain);
    refit(true);
  }
  if (quality_.count <= static_cast<int>(free_.size())) return Unrefined::too_few_pixels;
  // Half of all borders elsewhere than modelled, or residuals of a quarter of the contrast: not this tag's pattern.
  const double contrast = model_.appearance().value[A::drop];
  if (!(contrast > 0.0) || quality_.rejected > 0.5 || quality_.rms > 0.25 * contrast) return Unrefined::other_pattern;
  if (!fit_.converged) return Unrefined::did_not_converge;
  return std::nullopt;
}

std::string TagFit::terms(bool lens) const {
  std::string words = "homography+slope+blur";
  if (lens) words += "+lens";
  if (motion_) words += "+motion";
  if (shape_) words += "+shape";
  if (quality_.clipped > 0.01) words += "+saturation";
  if (bleed_) words += "+bleed";
  if (tone_) words += "+tone";
  if (robust_) words += "+robust";
  return words;
}

/// The sandwich, which stays right under unequal noise and robust weights; everything else that was free is marginal.
std::optional<Eigen::Matrix<double, 8, 8>> TagFit::covariance() {
  const Eigen::LLT<Eigen::MatrixXd> factor(reduced(fit_.at.hessian, free_));
  if (factor.info() != Eigen::Success) return std::nullopt;
  const Scatter scatter = model_.scatter(samples_);
  const auto sandwich = [&](const A::Matrix& middle) -> Eigen::Matrix<double, 8, 8> {
    const Eigen::MatrixXd half = factor.solve(reduced(middle, free_));
    return Eigen::MatrixXd(factor.solve(half.transpose())).topLeftCorner<8, 8>();
  };
  Eigen::Matrix<double, 8, A::count> influence = Eigen::Matrix<double, 8, A::count>::Zero();
  const auto count = static_cast<Eigen::Index>(free_.size());
  const Eigen::MatrixXd inverse = factor.solve(Eigen::MatrixXd::Identity(count, count));
  for (Eigen::Index i = 0; i < count; ++i)
    influence.col(free_[static_cast<std::size_t>(i)]) = inverse.block<8, 1>(0, i);
  const RoundedTogether rounded = rounded_together(model_, samples_, influence);
  const Eigen::Matrix<double, 8, 8> alone = sandwich(scatter.pixels);
  const Eigen::Matrix<double, 8, 8> all = (1.0 - rounded.share) * alone + rounded.covariance;
  rounding_ = (all.diagonal().array() / alone.diagonal().array()).mean();
  // Where the model does not describe the borders, pixels of one view err together, and the scatter of the views' sums
  // exceeds what single pixels make of it. As a factor for all coordinates, since there are too few views for more;
  // fitted parameters have taken their share of it.
  const auto views = static_cast<double>(scatter.views.size());
  const auto parameters = static_cast<double>(free_.size());
  if (views > 2.0 * parameters) {
    Vector8 squares = Vector8::Zero();
    Vector8 fourths = Vector8::Zero();
    for (const A::Vector& slope : scatter.views) {
      const Vector8 square = (influence * slope).cwiseAbs2();
      squares += square;
      fourths += square.cwiseAbs2();
    }
    const double ratio = (squares.array() / all.diagonal().array()).mean() * views / (views - parameters);
    // A sum of squares of normal variables scatters by the root of two thirds of their fourth powers. What lies within
    // that of 1 is chance, and is believed by as much as it exceeds it.
    const double chance = (2.0 / 3.0 * fourths.array()).sqrt().cwiseQuotient(squares.array()).mean();
    const double excess = std::log(std::max(1.0, ratio));
    inflation_ = std::exp(excess * excess * excess / (excess * excess + chance * chance));
  }
  return inflation_ * all;
}

/// Derivative of (u, v) by the undistorted place.
Eigen::Matrix2d tag_by_place(const A::Vector& p, const Vector2& place) {
  const double w = p[6] * place.x() + p[7] * place.y() + 1.0;
  const double u = (p[0] * place.x() + p[1] * place.y() + p[2]) / w;
  const double v = (p[3] * place.x() + p[4] * place.y() + p[5]) / w;
  Eigen::Matrix2d result;
  result << p[0] - u * p[6], p[1] - u * p[7], p[3] - v * p[6], p[4] - v * p[7];
  return result / w;
}

}  // namespace

namespace {

/// The model's image of the print, and its values.
PhotometricExplanation explained(const TagImageModel& model, const TagRegion& region) {
  PhotometricExplanation result;
  result.region = region.pixels;
  result.modelled = cv::Mat1f(region.pixels.size(), std::numeric_limits<float>::quiet_NaN());
  const A::Vector& p = model.appearance().value;
  const double rim = 0.5 * model.pattern().cells;
  const double blur = model.appearance().blur_px();
  for (int row = 0; row < region.pixels.height; ++row)
    for (int column = 0; column < region.pixels.width; ++column) {
      const Vector2 at = region.place(region.lens.undistorted({region.pixels.x + column, region.pixels.y + row}));
      const Vector2 tag = model.to_tag(at.x(), at.y());
      if (!(p[6] * at.x() + p[7] * at.y() + 1.0 > 0.0 && tag.cwiseAbs().maxCoeff() < rim)) continue;
      result.modelled(row, column) =
          static_cast<float>(model.at(at.x(), at.y(), model.view(at.x(), at.y(), 4.0 * blur)).grey);
    }
  result.white = p[A::white];
  result.black = p[A::white] - p[A::drop];
  result.blur_px2 << p[A::blur_xx], p[A::blur_xy], p[A::blur_xy], p[A::blur_yy];
  const Vector2& motion_px = model.appearance().motion_px;
  result.blur_px2 += motion_px * motion_px.transpose() / 12.0;
  result.bleed_modules = p[A::bleed];
  result.tone_exponent = p[A::tone];
  return result;
}

/// Fits, and if `explanation` is given says what the fit sees; `fitted` gets all of it.
Refinement fit_tag(const cv::Mat1b& gray, const std::string& family, const TagDetection& coarse,
                   const PhotometricConfig& config, const std::optional<CameraModel>& camera,
                   PhotometricExplanation* explanation, std::optional<FittedTag>* fitted = nullptr) {
  const TagPattern pattern = tag_pattern(family, coarse.id);
  for (const Vector2& corner : coarse.corners_px)
    if (!corner.allFinite()) return Unrefined::not_a_quadrilateral;
  if (!convex(coarse.corners_px)) return Unrefined::not_a_quadrilateral;
  if (gray.cols < 2 || gray.rows < 2) return Unrefined::too_few_pixels;
  const auto region = region_of(gray, pattern, coarse.corners_px, camera);
  if (!region) return Unrefined::too_few_pixels;

  const double half = 0.5 * pattern.border_cells;
  const std::array<Vector2, 4> tag = {Vector2(-half, -half), Vector2(half, -half), Vector2(half, half),
                                      Vector2(-half, half)};
  std::array<Vector2, 4> image;
  for (std::size_t k = 0; k < 4; ++k) image[k] = region->place(region->lens.undistorted(coarse.corners_px[k]));
  const auto start = homography(image, tag);
  if (!start) return Unrefined::not_a_quadrilateral;

  TagFit fit(gray, pattern, *region, config.max_iterations);
  if (const auto why = fit.run(coarse.corners_px, *start)) return *why;

  // Corners, and how they follow the homography.
  const A::Vector& p = fit.model().appearance().value;
  const Eigen::Matrix3d inverse = matrix(p).inverse();
  RefinedTag refined;
  Eigen::Matrix<double, 8, 8> corner_by;
  for (std::size_t k = 0; k < 4; ++k) {
    const Vector2 place = (inverse * tag[k].homogeneous()).hnormalized();
    const double w = p[6] * place.x() + p[7] * place.y() + 1.0;
    if (!place.allFinite() || !(w > 0.0)) return Unrefined::not_a_quadrilateral;
    const Vector2 corner = region->lens.distorted(place * region->side_px + region->centre);
    // A coarse corner is never farther off than this (notes on detection, section 8).
    if (!((corner - coarse.corners_px[k]).norm() < std::max(3.0, 0.06 * region->side_px)))
      return Unrefined::left_the_edge;
    refined.corners_px[k] = corner;
    Eigen::Matrix<double, 2, 8> tag_by_g = Eigen::Matrix<double, 2, 8>::Zero();
    const Eigen::RowVector3d xy1(place.x() / w, place.y() / w, 1.0 / w);
    tag_by_g.block<1, 3>(0, 0) = xy1;
    tag_by_g.block<1, 3>(1, 3) = xy1;
    tag_by_g.block<2, 2>(0, 6) = -tag[k] * xy1.head<2>();
    const Eigen::Matrix2d by_px = tag_by_place(p, place) * region->lens.at(corner).by_pixel / region->side_px;
    corner_by.block<2, 8>(2 * static_cast<Eigen::Index>(k), 0) = -by_px.inverse() * tag_by_g;
  }
  if (!convex(refined.corners_px)) return Unrefined::not_a_quadrilateral;
  const auto covariance = fit.covariance();
  if (!covariance) return Unrefined::did_not_converge;
  const FitQuality& quality = fit.last_quality();
  refined.id = coarse.id;
  refined.hamming = coarse.hamming;
  refined.margin = coarse.margin;
  refined.covariance_px2 = corner_by * *covariance * corner_by.transpose();
  refined.residual_rms = quality.rms;
  refined.chi2_per_pixel = quality.chi2_per_pixel;
  refined.blur_px = fit.model().appearance().blur_px();
  refined.terms = fit.terms(camera.has_value());
  if (explanation != nullptr) {
    *explanation = explained(fit.model(), *region);
    explanation->noise_black = std::sqrt(fit.noise().black + rounding_variance);
    explanation->noise_white = std::sqrt(fit.noise().white + rounding_variance);
    explanation->inflation = fit.inflation();
    explanation->rejected = quality.rejected;
  }
  if (fitted != nullptr) fitted->emplace(std::move(fit).fitted(refined));
  return refined;
}

}  // namespace

Refinement refine_photometric(const cv::Mat1b& gray, const std::string& family, const TagDetection& coarse,
                              const PhotometricConfig& config, const std::optional<CameraModel>& camera) {
  return fit_tag(gray, family, coarse, config, camera, nullptr);
}

std::variant<FittedTag, Unrefined> fit_photometric(const cv::Mat1b& gray, const std::string& family,
                                                   const TagDetection& coarse, const PhotometricConfig& config,
                                                   const std::optional<CameraModel>& camera) {
  std::optional<FittedTag> fitted;
  const Refinement refined = fit_tag(gray, family, coarse, config, camera, nullptr, &fitted);
  if (const Unrefined* reason = std::get_if<Unrefined>(&refined)) return *reason;
  return std::move(fitted.value());
}

std::variant<PhotometricExplanation, Unrefined> explain_photometric(const cv::Mat1b& gray, const std::string& family,
                                                                    const TagDetection& coarse,
                                                                    const PhotometricConfig& config,
                                                                    const std::optional<CameraModel>& camera) {
  PhotometricExplanation explanation;
  Refinement refined = fit_tag(gray, family, coarse, config, camera, &explanation);
  if (const Unrefined* reason = std::get_if<Unrefined>(&refined)) return *reason;
  explanation.tag = std::move(std::get<RefinedTag>(refined));
  return explanation;
}

}  // namespace tagdock
