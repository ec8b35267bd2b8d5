#include "detection/edge_refiner.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>
#include <Eigen/LU>
#include <ceres/ceres.h>

#include "detection/blur_filter.h"
#include "detection/straight_pixels.h"

namespace tagdock {
namespace {

constexpr double band_modules = 0.55;  ///< half width of the mask: stays clear of the cells inside and the white's end
constexpr double least_band_px = 1.6;  ///< two pixels on each side of the edge
constexpr double most_band_px = 6.0;   ///< farther pixels tell nothing of the edge's place
constexpr double most_trim = 0.2;      ///< of a side, left out at each end, where two edges mix
constexpr double start_blur_px = 0.8;
/// No camera is sharper than its own pixel, sigma 0.29; below this a fit no longer sees on which side of the edge a
/// pixel lies, and the spread is held (point-sampled pictures).
constexpr double least_blur_px = 0.2;
constexpr double held_blur_px = 0.25;
constexpr double most_blur_px = 8.0;
constexpr double least_contrast = 3.0;  ///< grey levels; below there is no edge to be found
/// Corners of noise-free renderings still scatter by this much, since rounding to 8 bits is not random (notes).
constexpr double error_floor_px = 0.0015;

/// theta of eq. (4). The line is in Hessian form, the normal being given by its turn from the coarse one; the spread
/// is kept as its logarithm, so that it cannot become negative.
enum Theta { turn, offset, low, contrast, log_spread, theta_size };

/// Pixels of the mask of one side, as places relative to the middle of the coarse side along its coarse normal
/// (outwards) and its direction [px].
struct Mask {
  Eigen::ArrayXd outward;
  Eigen::ArrayXd along;
  Eigen::ArrayXd grey;
};

/// One side of the tag as its coarse corners give it, in straight pixels.
struct CoarseSide {
  Eigen::Vector2d middle;
  Eigen::Vector2d normal;  ///< outwards
  Eigen::Vector2d direction;
  double half_length;
  double band;  ///< half width of the mask [px]
};

/// Residuals of eq. (3) over the whole mask of one side, with exact derivatives.
class SideCost final : public ceres::CostFunction {
 public:
  SideCost(const Mask& mask, EdgeProfile profile) : mask_(mask), profile_(profile) {
    set_num_residuals(static_cast<int>(mask.grey.size()));
    mutable_parameter_block_sizes()->push_back(theta_size);
  }

  bool Evaluate(double const* const* parameters, double* residuals, double** jacobians) const override {
    const double* theta = parameters[0];
    const double cosine = std::cos(theta[turn]);
    const double sine = std::sin(theta[turn]);
    const double spread = std::exp(theta[log_spread]);
    if (!(spread > 1e-6 && spread < 1e6)) return false;
    const double scale = 1.0 / (std::numbers::sqrt2 * spread);
    // Eq. (5): signed distance to the line, in units of sqrt(2) sigma.
    scaled_ = (cosine * mask_.outward + sine * mask_.along - theta[offset]) * scale;
    if (profile_ == EdgeProfile::tanh)
      shape_ = 1.0 - 2.0 / (1.0 + (2.0 * scaled_.min(300.0)).exp());
    else
      shape_ = scaled_.unaryExpr([](double z) { return std::erf(z); });
    const Eigen::Index count = mask_.grey.size();
    Eigen::Map<Eigen::ArrayXd>(residuals, count) = theta[low] + 0.5 * theta[contrast] * (shape_ + 1.0) - mask_.grey;
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    if (profile_ == EdgeProfile::tanh)
      slope_ = 0.5 * theta[contrast] * (1.0 - shape_.square());
    else
      slope_ = theta[contrast] * std::numbers::inv_sqrtpi * (-scaled_.square()).exp();
    using RowMajor = Eigen::Matrix<double, Eigen::Dynamic, theta_size, Eigen::RowMajor>;
    Eigen::Map<RowMajor> jacobian(jacobians[0], count, theta_size);
    jacobian.col(turn) = slope_ * scale * (cosine * mask_.along - sine * mask_.outward);
    jacobian.col(offset) = -scale * slope_;
    jacobian.col(low).setOnes();
    jacobian.col(contrast) = 0.5 * (shape_ + 1.0);
    jacobian.col(log_spread) = -slope_ * scaled_;
    return true;
  }

 private:
  const Mask& mask_;
  EdgeProfile profile_;
  mutable Eigen::ArrayXd scaled_, shape_, slope_;  // kept between calls to spare their allocation
};

/// A fitted side in straight pixels: the line `normal . p = distance`.
struct FittedSide {
  Eigen::Vector2d normal;
  double distance;
  Eigen::Vector2d foot;        ///< a point of the line near the side's middle
  Eigen::Matrix2d covariance;  ///< of (turn, offset)
  double spread_px;
  double squared_residuals;
  Eigen::Index pixels;
};

std::array<CoarseSide, 4> coarse_sides(const Corners& straight, int modules) {
  std::array<CoarseSide, 4> sides;
  for (int i = 0; i < 4; ++i) {
    const Eigen::Vector2d& from = straight[i];
    const Eigen::Vector2d& to = straight[(i + 1) % 4];
    CoarseSide& side = sides[i];
    side.middle = 0.5 * (from + to);
    side.direction = (to - from).normalized();
    side.normal = {side.direction.y(), -side.direction.x()};  // corners run clockwise as seen, so this points outwards
    side.half_length = 0.5 * (to - from).norm();
    // A cell beside this edge, measured square to it: foreshortened on a tilted tag.
    const double depth = std::min(std::abs(side.normal.dot(straight[(i + 2) % 4] - side.middle)),
                                  std::abs(side.normal.dot(straight[(i + 3) % 4] - side.middle)));
    side.band = std::clamp(band_modules * depth / modules, least_band_px, most_band_px);
  }
  return sides;
}

/// The rectangle of pixels that holds the masks of all sides.
cv::Rect region_of_interest(const Corners& corners_px, double margin, const cv::Size& image) {
  Eigen::Vector2d least = corners_px[0];
  Eigen::Vector2d most = corners_px[0];
  for (const Eigen::Vector2d& corner : corners_px) {
    least = least.cwiseMin(corner);
    most = most.cwiseMax(corner);
  }
  const auto bounded = [](double value, int limit) {
    return static_cast<int>(std::clamp(value, 0.0, static_cast<double>(limit)));
  };
  const cv::Point first(bounded(std::floor(least.x() - margin), image.width),
                        bounded(std::floor(least.y() - margin), image.height));
  const cv::Point last(bounded(std::ceil(most.x() + margin) + 1, image.width),
                       bounded(std::ceil(most.y() + margin) + 1, image.height));
  return {first, last};
}

/// The share of a row of pixels on which `low <= start + x * slope <= high`, cut to [first, last].
void cut(double start, double slope, double low, double high, double& first, double& last) {
  if (std::abs(slope) < 1e-12) {
    if (start < low || start > high) last = first - 1.0;
    return;
  }
  const double a = (low - start) / slope;
  const double b = (high - start) / slope;
  first = std::max(first, std::min(a, b));
  last = std::min(last, std::max(a, b));
}

/// The binary mask between two corners: pixels whose straight place is within the band of the coarse line, ends left
/// out.
/// @param bend_px  how far the lens may shift straight places from pixels beyond the shift of the side's middle
Mask mask_of(const CoarseSide& side, const cv::Mat1f& pixels, const cv::Rect& region, const StraightPixels& lens,
             double bend_px) {
  const double trim = std::min(side.band + 0.5, 2.0 * most_trim * side.half_length);
  const double reach = side.half_length - trim;
  const Eigen::Vector2d shift = lens.bent(side.middle).pixel - side.middle;
  const Eigen::Vector2d middle_px = side.middle + shift;
  std::vector<double> outward;
  std::vector<double> along;
  std::vector<double> grey;
  const auto expected = static_cast<std::size_t>(4.0 * (reach + 2) * (side.band + 1));
  outward.reserve(expected);
  along.reserve(expected);
  grey.reserve(expected);
  Eigen::ArrayXd straight_x;
  Eigen::ArrayXd straight_y;
  for (int row = 0; row < region.height; ++row) {
    const int y = region.y + row;
    // Only the part of the row near the side is undistorted and tested pixel by pixel.
    double first = region.x;
    double last = region.x + region.width - 1;
    const double dy = y - middle_px.y();
    cut(side.normal.y() * dy - side.normal.x() * middle_px.x(), side.normal.x(), -side.band - bend_px,
        side.band + bend_px, first, last);
    cut(side.direction.y() * dy - side.direction.x() * middle_px.x(), side.direction.x(), -reach - bend_px,
        reach + bend_px, first, last);
    const int begin = static_cast<int>(std::ceil(first - 1e-9));
    const int end = static_cast<int>(std::floor(last + 1e-9));
    if (end < begin) continue;
    lens.row(y, begin, end, straight_x, straight_y);
    for (int x = begin; x <= end; ++x) {
      const Eigen::Vector2d place = Eigen::Vector2d(straight_x[x - begin], straight_y[x - begin]) - side.middle;
      const double across = side.normal.dot(place);
      const double beside = side.direction.dot(place);
      if (!(std::abs(across) <= side.band && std::abs(beside) <= reach)) continue;  // also where the lens folds: NaN
      outward.push_back(across);
      along.push_back(beside);
      grey.push_back(pixels(row, x - region.x));
    }
  }
  const auto count = static_cast<Eigen::Index>(grey.size());
  return {Eigen::Map<Eigen::ArrayXd>(outward.data(), count), Eigen::Map<Eigen::ArrayXd>(along.data(), count),
          Eigen::Map<Eigen::ArrayXd>(grey.data(), count)};
}

/// Levels beyond half the band on each side of the coarse line.
std::pair<double, double> start_levels(const Mask& mask, double band) {
  double in = 0.0, out = 0.0;
  int in_count = 0, out_count = 0;
  for (Eigen::Index i = 0; i < mask.grey.size(); ++i) {
    if (mask.outward[i] > 0.5 * band) {
      out += mask.grey[i];
      ++out_count;
    } else if (mask.outward[i] < -0.5 * band) {
      in += mask.grey[i];
      ++in_count;
    }
  }
  if (in_count == 0 || out_count == 0) return {0.0, 0.0};
  return {in / in_count, out / out_count};
}

/// Brings theta to a minimum of the squared residuals.
/// @return  whether it got there
bool minimise(SideCost& cost, int max_iterations, bool hold_spread, std::array<double, theta_size>& theta) {
  ceres::Problem::Options ownership;
  ownership.cost_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::Problem problem(ownership);
  problem.AddResidualBlock(&cost, nullptr, theta.data());
  if (hold_spread) problem.SetManifold(theta.data(), new ceres::SubsetManifold(theta_size, {log_spread}));
  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_QR;
  options.max_num_iterations = max_iterations;
  options.function_tolerance = 1e-10;
  options.gradient_tolerance = 1e-10;
  options.parameter_tolerance = 1e-10;
  options.logging_type = ceres::SILENT;
  options.num_threads = 1;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  return summary.termination_type == ceres::CONVERGENCE;
}

std::variant<FittedSide, Unrefined> fit_side(const CoarseSide& side, const Mask& mask, const EdgeRefinerConfig& config,
                                             double noise_gain) {
  constexpr Eigen::Index least_pixels = 8;
  if (mask.grey.size() < least_pixels) return Unrefined::too_few_pixels;
  const auto [inside, outside] = start_levels(mask, side.band);
  if (std::abs(outside - inside) < least_contrast) return Unrefined::did_not_converge;

  std::array<double, theta_size> theta{};
  theta[low] = inside;
  theta[contrast] = outside - inside;  // negative for families whose square is white
  theta[log_spread] = std::log(start_blur_px);
  const std::array<double, theta_size> start = theta;
  SideCost cost(mask, config.profile);
  bool found = minimise(cost, config.max_iterations, false, theta);
  if (!found || std::exp(theta[log_spread]) < least_blur_px) {
    theta = start;
    theta[log_spread] = std::log(held_blur_px);
    found = minimise(cost, config.max_iterations, true, theta);
  }
  const double spread = std::exp(theta[log_spread]);
  if (!found || !(spread <= most_blur_px) || !(std::abs(theta[contrast]) >= least_contrast))
    return Unrefined::did_not_converge;

  Eigen::VectorXd residuals(mask.grey.size());
  Eigen::Matrix<double, Eigen::Dynamic, theta_size, Eigen::RowMajor> jacobian(mask.grey.size(), theta_size);
  const double* parameters = theta.data();
  double* rows = jacobian.data();
  if (!cost.Evaluate(&parameters, residuals.data(), &rows)) return Unrefined::did_not_converge;
  const Eigen::Matrix<double, theta_size, theta_size> normal_equations = jacobian.transpose() * jacobian;
  const Eigen::LLT<Eigen::Matrix<double, theta_size, theta_size>> factor(normal_equations);
  if (factor.info() != Eigen::Success) return Unrefined::did_not_converge;

  FittedSide fitted;
  fitted.squared_residuals = residuals.squaredNorm();
  fitted.pixels = mask.grey.size();
  // A filter lowers the pixels' noise but ties neighbours together: what it takes from their variance it does not give
  // in information, so the variance before the filter counts.
  const double variance =
      fitted.squared_residuals / (std::max<double>(1.0, fitted.pixels - theta_size) * noise_gain) + 1.0 / 12.0;
  const Eigen::Matrix<double, theta_size, theta_size> covariance =
      variance * factor.solve(Eigen::Matrix<double, theta_size, theta_size>::Identity());
  fitted.covariance = covariance.topLeftCorner<2, 2>();
  fitted.normal = std::cos(theta[turn]) * side.normal + std::sin(theta[turn]) * side.direction;
  fitted.foot = side.middle + theta[offset] * fitted.normal;
  fitted.distance = fitted.normal.dot(fitted.foot);
  fitted.spread_px = spread;
  return fitted;
}

/// A corner with its derivative by (turn, offset) of both sides that meet there.
struct Meeting {
  Eigen::Vector2d corner;
  Eigen::Matrix<double, 2, 4> by_lines;
};

std::optional<Meeting> intersect(const FittedSide& first, const FittedSide& second, const Eigen::Vector2d& first_middle,
                                 const Eigen::Vector2d& second_middle) {
  Eigen::Matrix2d normals;
  normals << first.normal.transpose(), second.normal.transpose();
  if (!(std::abs(normals.determinant()) > 0.02)) return std::nullopt;  // about 1 degree
  const Eigen::Matrix2d inverse = normals.inverse();
  Meeting meeting;
  meeting.corner = inverse * Eigen::Vector2d(first.distance, second.distance);
  // A line through the middle m of the coarse side, n(turn) . (p - m) = offset: turning it moves the corner against
  // the arm t . (corner - m), where t = dn/dturn.
  const auto arm = [&](const FittedSide& side, const Eigen::Vector2d& middle) {
    const Eigen::Vector2d turned(-side.normal.y(), side.normal.x());
    return turned.dot(meeting.corner - middle);
  };
  meeting.by_lines.col(0) = -inverse.col(0) * arm(first, first_middle);
  meeting.by_lines.col(1) = inverse.col(0);
  meeting.by_lines.col(2) = -inverse.col(1) * arm(second, second_middle);
  meeting.by_lines.col(3) = inverse.col(1);
  return meeting;
}

bool convex(const Corners& corners) {
  for (int i = 0; i < 4; ++i) {
    const Eigen::Vector2d a = corners[(i + 1) % 4] - corners[i];
    const Eigen::Vector2d b = corners[(i + 2) % 4] - corners[(i + 1) % 4];
    if (!(a.x() * b.y() - a.y() * b.x() > 0.0)) return false;
  }
  return true;
}

double mean_side(const Corners& corners) {
  double sum = 0.0;
  for (int i = 0; i < 4; ++i) sum += (corners[(i + 1) % 4] - corners[i]).norm();
  return 0.25 * sum;
}

}  // namespace

Refinement refine_edges(const cv::Mat1b& gray, const TagDetection& coarse, const EdgeRefinerConfig& config,
                        const std::optional<CameraModel>& camera) {
  for (const Eigen::Vector2d& corner : coarse.corners_px)
    if (!corner.allFinite()) return Unrefined::not_a_quadrilateral;
  if (!convex(coarse.corners_px) || coarse.modules < 1) return Unrefined::not_a_quadrilateral;

  // (1) the region of interest, filtered once if so wanted
  const cv::Rect region = region_of_interest(coarse.corners_px, most_band_px + 2.0, gray.size());
  if (region.width < 4 || region.height < 4) return Unrefined::too_few_pixels;
  BlurKernel kernel = BlurKernel::none;
  double seen_contrast = 0.0;
  if (config.pre_blur) {
    const EdgeLook look = look_at_edges(gray, coarse.corners_px, coarse.modules);
    kernel = choose_blur(look);
    seen_contrast = look.contrast;
  }
  const BlurredPart part = blurred(gray, region, kernel, seen_contrast);

  // (2, 3) masks and start values from the corners already found, where sides are straight
  const StraightPixels lens(camera, region);
  Corners straight;
  for (int i = 0; i < 4; ++i) {
    const std::optional<Eigen::Vector2d> place = lens.straight(coarse.corners_px[i]);
    if (!place) return Unrefined::not_a_quadrilateral;
    straight[i] = *place;
  }
  if (!convex(straight)) return Unrefined::not_a_quadrilateral;
  const std::array<CoarseSide, 4> sides = coarse_sides(straight, coarse.modules);
  double bend_px = 0.0;
  if (lens.bends())
    for (int i = 0; i < 4; ++i)
      for (const CoarseSide& side : sides)
        bend_px = std::max(
            bend_px,
            ((coarse.corners_px[i] - straight[i]) - (lens.bent(side.middle).pixel - side.middle)).norm() + 1.0);

  // (4) the fits
  std::array<FittedSide, 4> fitted;
  double squares = 0.0;
  double spread = 0.0;
  Eigen::Index pixels = 0;
  for (int i = 0; i < 4; ++i) {
    const auto fit = fit_side(sides[i], mask_of(sides[i], part.pixels, region, lens, bend_px), config, part.noise_gain);
    if (const Unrefined* reason = std::get_if<Unrefined>(&fit)) return *reason;
    fitted[i] = std::get<FittedSide>(fit);
    squares += fitted[i].squared_residuals;
    pixels += fitted[i].pixels;
    spread += 0.25 * fitted[i].spread_px;
  }

  // (5) the intersections; corner i lies between side i - 1 and side i
  RefinedTag refined;
  Eigen::Matrix<double, 8, 8> by_lines = Eigen::Matrix<double, 8, 8>::Zero();
  Eigen::Matrix<double, 8, 8> lines = Eigen::Matrix<double, 8, 8>::Zero();
  const double farthest = std::max(3.0, 0.06 * mean_side(coarse.corners_px));
  for (int i = 0; i < 4; ++i) {
    const int before = (i + 3) % 4;
    const auto meeting = intersect(fitted[before], fitted[i], sides[before].middle, sides[i].middle);
    if (!meeting) return Unrefined::not_a_quadrilateral;
    const StraightPixels::Bent seen = lens.bent(meeting->corner);
    if (!seen.pixel.allFinite() || !((seen.pixel - coarse.corners_px[i]).norm() <= farthest))
      return Unrefined::left_the_edge;
    refined.corners_px[i] = seen.pixel;
    by_lines.block<2, 2>(2 * i, 2 * before) = seen.by_straight * meeting->by_lines.leftCols<2>();
    by_lines.block<2, 2>(2 * i, 2 * i) = seen.by_straight * meeting->by_lines.rightCols<2>();
    lines.block<2, 2>(2 * i, 2 * i) = fitted[i].covariance;
  }
  if (!convex(refined.corners_px)) return Unrefined::not_a_quadrilateral;
  refined.id = coarse.id;
  refined.hamming = coarse.hamming;
  refined.margin = coarse.margin;
  refined.covariance_px2 = by_lines * lines * by_lines.transpose();
  refined.covariance_px2.diagonal().array() += error_floor_px * error_floor_px;
  refined.residual_rms = std::sqrt(squares / static_cast<double>(pixels));
  refined.blur_px = spread;
  refined.terms = config.profile == EdgeProfile::tanh ? "tanh" : "erf";
  if (kernel != BlurKernel::none) refined.terms.append("+").append(word(kernel));
  if (lens.bends()) refined.terms += "+lens";
  return refined;
}

}  // namespace tagdock
