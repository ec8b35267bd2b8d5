#include "detection/saddle_refiner.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>

#include "detection/lens_patch.h"

namespace tagdock {
namespace {

using Eigen::Matrix2d;
using Eigen::Vector2d;

constexpr int unknowns = 10;  // corner x y, angle 1 2, log blur 1 2, mean, amplitude, slope x y
using Values = Eigen::Matrix<double, unknowns, 1>;
using Normal = Eigen::Matrix<double, unknowns, unknowns>;

constexpr double longest_reach_px = 14.0;  // beyond that lenses bend edges by more than the corner's noise
constexpr int least_pixels = 30;

struct Pixel {
  Vector2d place;
  double grey;
};

/// The pixels beside the edges, a cross around the guess.
std::vector<Pixel> window(const cv::Mat1b& gray, const SaddleGuess& guess) {
  const Matrix2d drawn_by_pixel = guess.pixel_by_drawn.inverse();
  const double reach_px[] = {guess.pixel_by_drawn.col(0).norm() * guess.reach,
                             guess.pixel_by_drawn.col(1).norm() * guess.reach};
  const double reach[] = {guess.reach * std::min(1.0, longest_reach_px / reach_px[0]),
                          guess.reach * std::min(1.0, longest_reach_px / reach_px[1])};
  const Vector2d half = (guess.pixel_by_drawn.cwiseAbs() * Vector2d(reach[0], reach[1]));
  const int x0 = static_cast<int>(std::ceil(guess.pixel.x() - half.x()));
  const int x1 = static_cast<int>(std::floor(guess.pixel.x() + half.x()));
  const int y0 = static_cast<int>(std::ceil(guess.pixel.y() - half.y()));
  const int y1 = static_cast<int>(std::floor(guess.pixel.y() + half.y()));
  if (x0 < 0 || y0 < 0 || x1 >= gray.cols || y1 >= gray.rows) return {};
  std::vector<Pixel> pixels;
  for (int y = y0; y <= y1; ++y)
    for (int x = x0; x <= x1; ++x) {
      const Vector2d drawn = (drawn_by_pixel * (Vector2d(x, y) - guess.pixel)).cwiseAbs();
      if (drawn.x() > reach[0] || drawn.y() > reach[1]) continue;
      if (drawn.x() > guess.clearance && drawn.y() > guess.clearance) continue;
      pixels.push_back({Vector2d(x, y), static_cast<double>(gray(y, x))});
    }
  return pixels;
}

/// Takes the bend of the lens out of a window and leaves its middle, with the scale there, where it is.
struct Straightening {
  LensPatch patch;
  Vector2d middle;
  Vector2d middle_straight;
  Matrix2d straight_by_pixel;
  Matrix2d pixel_by_straight;

  [[nodiscard]] Vector2d straight(const Vector2d& pixel) const {
    if (!patch.bends()) return pixel;
    return middle + pixel_by_straight * (patch.undistorted(pixel) - middle_straight);
  }
  [[nodiscard]] Vector2d seen(const Vector2d& straight) const {
    if (!patch.bends()) return straight;
    return patch.distorted(middle_straight + straight_by_pixel * (straight - middle));
  }
};

std::optional<Straightening> straightening(const std::vector<Pixel>& pixels, const Vector2d& middle,
                                           const std::optional<CameraModel>& camera) {
  Eigen::AlignedBox2d box(middle);
  for (const Pixel& pixel : pixels) box.extend(pixel.place);
  const std::optional<LensPatch> patch = LensPatch::make(camera, box.min(), box.max());
  if (!patch) return std::nullopt;
  if (!patch->bends()) return Straightening{*patch, middle, middle, Matrix2d::Identity(), Matrix2d::Identity()};
  const LensPatch::Place place = patch->at(middle);
  return Straightening{*patch, middle, place.undistorted, place.by_pixel, place.by_pixel.inverse()};
}

struct Side {
  double value;     // erf(z / sqrt 2)
  double by_place;  // d value / d distance
  double z;
};

Side side(double distance, double blur) {
  const double z = distance / blur;
  return {std::erf(z / std::numbers::sqrt2), std::sqrt(2.0 / std::numbers::pi) / blur * std::exp(-0.5 * z * z), z};
}

double evaluate(const std::vector<Pixel>& pixels, const Values& v, Normal* information, Values* gradient) {
  const Vector2d n1(std::cos(v[2]), std::sin(v[2]));
  const Vector2d n2(std::cos(v[3]), std::sin(v[3]));
  const Vector2d t1(-n1.y(), n1.x());
  const Vector2d t2(-n2.y(), n2.x());
  const double blur1 = std::exp(v[4]);
  const double blur2 = std::exp(v[5]);
  double squares = 0.0;
  if (information != nullptr) {
    information->setZero();
    gradient->setZero();
  }
  for (const Pixel& pixel : pixels) {
    const Vector2d d = pixel.place - v.head<2>();
    const Side one = side(n1.dot(d), blur1);
    const Side two = side(n2.dot(d), blur2);
    const double both = one.value * two.value;
    const double residual = v[6] + v[7] * both + v[8] * d.x() + v[9] * d.y() - pixel.grey;
    squares += residual * residual;
    if (information == nullptr) continue;
    const double by_one = v[7] * one.by_place * two.value;
    const double by_two = v[7] * two.by_place * one.value;
    Values row;
    row[0] = -by_one * n1.x() - by_two * n2.x() - v[8];
    row[1] = -by_one * n1.y() - by_two * n2.y() - v[9];
    row[2] = by_one * t1.dot(d);
    row[3] = by_two * t2.dot(d);
    row[4] = -by_one * blur1 * one.z;
    row[5] = -by_two * blur2 * two.z;
    row[6] = 1.0;
    row[7] = both;
    row[8] = d.x();
    row[9] = d.y();
    information->selfadjointView<Eigen::Lower>().rankUpdate(row);
    *gradient += residual * row;
  }
  return squares;
}

}  // namespace

std::optional<Saddle> refine_saddle(const cv::Mat1b& gray, const SaddleGuess& guess,
                                    const std::optional<CameraModel>& camera) {
  if (!(std::abs(guess.pixel_by_drawn.determinant()) > 1e-12) || !guess.pixel.allFinite()) return std::nullopt;
  std::vector<Pixel> pixels = window(gray, guess);
  if (pixels.size() < least_pixels) return std::nullopt;
  const std::optional<Straightening> lens = straightening(pixels, guess.pixel, camera);
  if (!lens) return std::nullopt;
  for (Pixel& pixel : pixels) pixel.place = lens->straight(pixel.place);

  // Edge 1 runs along the board's y (its normal along x), edge 2 along x.
  const Vector2d along_x = guess.pixel_by_drawn.col(0).normalized();
  const Vector2d along_y = guess.pixel_by_drawn.col(1).normalized();
  Vector2d n1(along_y.y(), -along_y.x());
  if (n1.dot(along_x) < 0.0) n1 = -n1;
  Vector2d n2(-along_x.y(), along_x.x());
  if (n2.dot(along_y) < 0.0) n2 = -n2;
  Values v;
  v << guess.pixel.x(), guess.pixel.y(), std::atan2(n1.y(), n1.x()), std::atan2(n2.y(), n2.x()), std::log(0.8),
      std::log(0.8), 0.0, 0.0, 0.0, 0.0;
  // Mean and amplitude from the diagonal fields.
  double sums[2] = {0.0, 0.0};
  int counts[2] = {0, 0};
  double clipped = 0.0;
  for (const Pixel& pixel : pixels) {
    const Vector2d d = pixel.place - guess.pixel;
    const int field = n1.dot(d) * n2.dot(d) > 0.0 ? 1 : 0;
    sums[field] += pixel.grey;
    ++counts[field];
    clipped += pixel.grey >= 254.0 ? 1.0 : 0.0;
  }
  if (counts[0] < 8 || counts[1] < 8) return std::nullopt;
  v[6] = 0.5 * (sums[0] / counts[0] + sums[1] / counts[1]);
  v[7] = 0.5 * (sums[1] / counts[1] - sums[0] / counts[0]);

  Normal information;
  Values gradient;
  double damping = 1e-3;
  double squares = evaluate(pixels, v, &information, &gradient);
  bool converged = false;
  constexpr int most_steps = 40;
  for (int i = 0; i < most_steps; ++i) {
    Normal damped = information.selfadjointView<Eigen::Lower>();
    for (int k = 0; k < unknowns; ++k) damped(k, k) += damping * (information(k, k) + 1e-9);
    const Values step = damped.ldlt().solve(gradient);
    if (!step.allFinite()) return std::nullopt;
    const Values moved = v - step;
    // Blur within what any lens shows; the corner near where it was looked for.
    const bool inside =
        moved[4] > std::log(0.2) && moved[4] < std::log(8.0) && moved[5] > std::log(0.2) && moved[5] < std::log(8.0);
    const double better = inside ? evaluate(pixels, moved, nullptr, nullptr) : squares + 1.0;
    if (better <= squares) {
      const bool small = step.head<2>().norm() < 1e-4;
      v = moved;
      squares = evaluate(pixels, v, &information, &gradient);
      damping = std::max(1e-9, 0.2 * damping);
      if (small) {
        converged = true;
        break;
      }
    } else {
      damping *= 8.0;
      if (damping > 1e8) {
        converged = step.head<2>().norm() < 1e-3;
        break;
      }
    }
  }
  if (!converged) return std::nullopt;
  const double far =
      0.6 * guess.reach * std::min(guess.pixel_by_drawn.col(0).norm(), guess.pixel_by_drawn.col(1).norm());
  if ((v.head<2>() - guess.pixel).norm() > std::max(2.0, far)) return std::nullopt;

  Saddle saddle;
  saddle.pixel = lens->seen(v.head<2>());
  const double freedom = static_cast<double>(pixels.size()) - unknowns;
  const double variance = std::max(squares / freedom, 1.0 / 12.0);  // at least the rounding to whole grey levels
  const Normal whole = information.selfadjointView<Eigen::Lower>();
  saddle.covariance_px2 = variance * whole.ldlt().solve(Normal::Identity()).topLeftCorner<2, 2>();
  if (!saddle.covariance_px2.allFinite()) return std::nullopt;
  saddle.mean = v[6];
  saddle.amplitude = v[7];
  saddle.normal[0] = {std::cos(v[2]), std::sin(v[2])};
  saddle.normal[1] = {std::cos(v[3]), std::sin(v[3])};
  saddle.blur_px[0] = std::exp(v[4]);
  saddle.blur_px[1] = std::exp(v[5]);
  saddle.residual_rms = std::sqrt(squares / freedom);
  saddle.clipped = clipped / static_cast<double>(pixels.size());
  return saddle;
}

}  // namespace tagdock
