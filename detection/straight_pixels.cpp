#include "detection/straight_pixels.h"

#include <cmath>
#include <limits>
#include <numbers>

#include <Eigen/LU>

namespace tagdock {
namespace {

constexpr double interpolation_error_px = 1e-4;  // a twentieth of the best corner accuracy

bool bends_lines(const CameraModel& camera) {
  return camera.k1 != 0.0 || camera.k2 != 0.0 || camera.p1 != 0.0 || camera.p2 != 0.0 || camera.k3 != 0.0 ||
         camera.k4 != 0.0 || camera.k5 != 0.0 || camera.k6 != 0.0;
}

std::optional<Eigen::Vector2d> exactly_straight(const CameraModel& camera, const Eigen::Vector2d& pixel) {
  const std::optional<Eigen::Vector2d> ideal = unproject(camera, pixel);
  if (!ideal) return std::nullopt;
  return Eigen::Vector2d(camera.fx * ideal->x() + camera.cx, camera.fy * ideal->y() + camera.cy);
}

template <int count>
Eigen::Matrix<double, count, 1> chebyshev(double x) {
  Eigen::Matrix<double, count, 1> values;
  values[0] = 1.0;
  values[1] = x;
  for (int i = 2; i < count; ++i) values[i] = 2.0 * x * values[i - 1] - values[i - 2];
  return values;
}

/// Maps [0, length - 1] to [-1, 1].
double unit(double place, int start, int length) {
  return length < 2 ? 0.0 : 2.0 * (place - start) / (length - 1) - 1.0;
}

}  // namespace

StraightPixels::StraightPixels(const std::optional<CameraModel>& camera, const cv::Rect& rectangle)
    : rectangle_(rectangle) {
  if (!camera || !bends_lines(*camera)) return;
  camera_ = camera;
  Coefficients values_x;
  Coefficients values_y;
  Coefficients basis;  // row i: the polynomials at node i
  std::array<double, nodes> places{};
  for (int i = 0; i < nodes; ++i) {
    places[i] = std::cos(std::numbers::pi * (i + 0.5) / nodes);
    basis.row(i) = chebyshev<nodes>(places[i]).transpose();
  }
  for (int i = 0; i < nodes; ++i)
    for (int j = 0; j < nodes; ++j) {
      const Eigen::Vector2d pixel(rectangle.x + 0.5 * (places[j] + 1.0) * (rectangle.width - 1),
                                  rectangle.y + 0.5 * (places[i] + 1.0) * (rectangle.height - 1));
      const std::optional<Eigen::Vector2d> place = exactly_straight(*camera_, pixel);
      if (!place) {
        exact_ = true;
        return;
      }
      values_x(i, j) = place->x() - pixel.x();
      values_y(i, j) = place->y() - pixel.y();
    }
  const Coefficients inverse = basis.inverse();
  shift_ = {inverse * values_x * inverse.transpose(), inverse * values_y * inverse.transpose()};
  exact_ = !interpolates();
}

bool StraightPixels::interpolates() const {
  for (const double v : {0.0, 0.31, 0.64, 1.0})
    for (const double u : {0.0, 0.27, 0.55, 1.0}) {
      const Eigen::Vector2d pixel(rectangle_.x + u * (rectangle_.width - 1),
                                  rectangle_.y + v * (rectangle_.height - 1));
      const std::optional<Eigen::Vector2d> exact = exactly_straight(*camera_, pixel);
      if (!exact || !((interpolated(pixel) - *exact).norm() < interpolation_error_px)) return false;
    }
  return true;
}

Eigen::Vector2d StraightPixels::interpolated(const Eigen::Vector2d& pixel) const {
  const auto along_x = chebyshev<nodes>(unit(pixel.x(), rectangle_.x, rectangle_.width));
  const auto along_y = chebyshev<nodes>(unit(pixel.y(), rectangle_.y, rectangle_.height));
  return pixel + Eigen::Vector2d(along_y.dot(shift_[0] * along_x), along_y.dot(shift_[1] * along_x));
}

std::optional<Eigen::Vector2d> StraightPixels::straight(const Eigen::Vector2d& pixel) const {
  return camera_ ? exactly_straight(*camera_, pixel) : std::optional(pixel);
}

void StraightPixels::row(int y, int first, int last, Eigen::ArrayXd& straight_x, Eigen::ArrayXd& straight_y) const {
  const Eigen::Index count = last - first + 1;
  straight_x = Eigen::ArrayXd::LinSpaced(count, first, last);
  straight_y = Eigen::ArrayXd::Constant(count, y);
  if (!camera_) return;
  if (exact_) {
    for (Eigen::Index i = 0; i < count; ++i) {
      const auto place = exactly_straight(*camera_, {straight_x[i], straight_y[i]});
      straight_x[i] = place ? place->x() : std::numeric_limits<double>::quiet_NaN();
      straight_y[i] = place ? place->y() : std::numeric_limits<double>::quiet_NaN();
    }
    return;
  }
  const auto along_y = chebyshev<nodes>(unit(y, rectangle_.y, rectangle_.height));
  const Eigen::Matrix<double, nodes, 1> row_x = shift_[0].transpose() * along_y;
  const Eigen::Matrix<double, nodes, 1> row_y = shift_[1].transpose() * along_y;
  for (Eigen::Index i = 0; i < count; ++i) {
    const auto along_x = chebyshev<nodes>(unit(straight_x[i], rectangle_.x, rectangle_.width));
    straight_x[i] += row_x.dot(along_x);
    straight_y[i] += row_y.dot(along_x);
  }
}

StraightPixels::Bent StraightPixels::bent(const Eigen::Vector2d& straight) const {
  if (!camera_) return {straight, Eigen::Matrix2d::Identity()};
  const Eigen::Vector2d focal(camera_->fx, camera_->fy);
  const Eigen::Vector3d ray((straight.x() - camera_->cx) / focal.x(), (straight.y() - camera_->cy) / focal.y(), 1.0);
  const Projection seen = project_with_jacobian(*camera_, ray);
  return {seen.pixel, seen.by_point.leftCols<2>() * focal.cwiseInverse().asDiagonal()};
}

}  // namespace tagdock
