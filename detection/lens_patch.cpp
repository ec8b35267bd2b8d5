#include "detection/lens_patch.h"

#include <cmath>
#include <numbers>

#include <Eigen/LU>

namespace tagdock {
namespace {

bool bends_lines(const CameraModel& camera) {
  return camera.k1 != 0.0 || camera.k2 != 0.0 || camera.p1 != 0.0 || camera.p2 != 0.0 || camera.k3 != 0.0 ||
         camera.k4 != 0.0 || camera.k5 != 0.0 || camera.k6 != 0.0;
}

}  // namespace

std::optional<LensPatch> LensPatch::make(const std::optional<CameraModel>& camera, const Eigen::Vector2d& low,
                                         const Eigen::Vector2d& high) {
  LensPatch patch;
  patch.shift_.fill(Coefficients::Zero());
  if (!camera || !bends_lines(*camera)) return patch;
  patch.camera_ = camera;
  patch.middle_ = 0.5 * (low + high);
  patch.half_ = (0.5 * (high - low)).cwiseMax(1.0);
  Eigen::Matrix<double, degree + 1, 1> node;
  Coefficients powers;
  for (int i = 0; i <= degree; ++i) {
    node[i] = std::cos(std::numbers::pi * (i + 0.5) / (degree + 1));
    for (int k = 0; k <= degree; ++k) powers(i, k) = std::pow(node[i], k);
  }
  std::array<Coefficients, 2> sample;  // row: y node, column: x node
  for (int i = 0; i <= degree; ++i)
    for (int j = 0; j <= degree; ++j) {
      const Eigen::Vector2d pixel = patch.middle_ + patch.half_.cwiseProduct(Eigen::Vector2d(node[j], node[i]));
      const auto ideal = unproject(*camera, pixel);
      if (!ideal) return std::nullopt;
      sample[0](i, j) = camera->fx * ideal->x() + camera->cx - pixel.x();
      sample[1](i, j) = camera->fy * ideal->y() + camera->cy - pixel.y();
    }
  const Coefficients inverse = powers.inverse();
  for (std::size_t k = 0; k < 2; ++k) patch.shift_[k] = inverse * sample[k] * inverse.transpose();
  return patch;
}

LensPatch::Place LensPatch::at(const Eigen::Vector2d& pixel) const {
  Place place{pixel, Eigen::Matrix2d::Identity()};
  if (!camera_) return place;
  const Eigen::Vector2d t = (pixel - middle_).cwiseQuotient(half_);
  for (std::size_t k = 0; k < 2; ++k) {
    double value = 0.0;
    double by_x = 0.0;
    double by_y = 0.0;
    for (int row = degree; row >= 0; --row) {
      double inner = 0.0;
      double inner_by_x = 0.0;
      for (int column = degree; column >= 0; --column) {
        inner_by_x = inner_by_x * t.x() + inner;
        inner = inner * t.x() + shift_[k](row, column);
      }
      by_y = by_y * t.y() + value;
      value = value * t.y() + inner;
      by_x = by_x * t.y() + inner_by_x;
    }
    const auto axis = static_cast<Eigen::Index>(k);
    place.undistorted[axis] += value;
    place.by_pixel(axis, 0) += by_x / half_.x();
    place.by_pixel(axis, 1) += by_y / half_.y();
  }
  return place;
}

LensPatch::Row::Row(const LensPatch& patch, double y) : y_(y), bent_(patch.bends()) {
  if (!bent_) return;
  middle_ = patch.middle_.x();
  half_ = patch.half_.x();
  const double t = (y - patch.middle_.y()) / patch.half_.y();
  for (std::size_t k = 0; k < 2; ++k)
    for (int row = degree; row >= 0; --row)
      for (int column = 0; column <= degree; ++column) {
        double& value = shift_[k][static_cast<std::size_t>(column)];
        value = value * t + patch.shift_[k](row, column);
      }
}

Eigen::Vector2d LensPatch::Row::undistorted(double x) const {
  if (!bent_) return {x, y_};
  const double t = (x - middle_) / half_;
  double dx = 0.0;
  double dy = 0.0;
  for (std::size_t i = shift_[0].size(); i-- > 0;) {
    dx = dx * t + shift_[0][i];
    dy = dy * t + shift_[1][i];
  }
  return {x + dx, y_ + dy};
}

Eigen::Vector2d LensPatch::distorted(const Eigen::Vector2d& undistorted) const {
  if (!camera_) return undistorted;
  return project(*camera_,
                 {(undistorted.x() - camera_->cx) / camera_->fx, (undistorted.y() - camera_->cy) / camera_->fy, 1.0});
}

}  // namespace tagdock
