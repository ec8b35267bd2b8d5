#include "calibration/camera_model.h"

#include <cmath>
#include <stdexcept>
#include <string>

#include <Eigen/LU>

namespace tagdock {
namespace {

struct Bent {
  Eigen::Vector2d point;
  Eigen::Matrix2d by_ideal;
};

// The point of `bend` alone, by the same operations.
Eigen::Vector2d bent_point(const CameraModel& camera, double x, double y) {
  const double r2 = x * x + y * y;
  const double top = 1.0 + r2 * (camera.k1 + r2 * (camera.k2 + r2 * camera.k3));
  const double bottom = 1.0 + r2 * (camera.k4 + r2 * (camera.k5 + r2 * camera.k6));
  const double radial = top / bottom;
  return {x * radial + 2.0 * camera.p1 * x * y + camera.p2 * (r2 + 2.0 * x * x),
          y * radial + camera.p1 * (r2 + 2.0 * y * y) + 2.0 * camera.p2 * x * y};
}

Bent bend(const CameraModel& camera, const Eigen::Vector2d& ideal) {
  const double x = ideal.x();
  const double y = ideal.y();
  const double r2 = x * x + y * y;
  const double top = 1.0 + r2 * (camera.k1 + r2 * (camera.k2 + r2 * camera.k3));
  const double bottom = 1.0 + r2 * (camera.k4 + r2 * (camera.k5 + r2 * camera.k6));
  const double top_by_r2 = camera.k1 + r2 * (2.0 * camera.k2 + 3.0 * r2 * camera.k3);
  const double bottom_by_r2 = camera.k4 + r2 * (2.0 * camera.k5 + 3.0 * r2 * camera.k6);
  const double radial = top / bottom;
  const double radial_by_r2 = (top_by_r2 - radial * bottom_by_r2) / bottom;
  Bent bent;
  bent.point = {x * radial + 2.0 * camera.p1 * x * y + camera.p2 * (r2 + 2.0 * x * x),
                y * radial + camera.p1 * (r2 + 2.0 * y * y) + 2.0 * camera.p2 * x * y};
  const double cross = 2.0 * x * y * radial_by_r2 + 2.0 * camera.p1 * x + 2.0 * camera.p2 * y;
  bent.by_ideal << radial + 2.0 * x * x * radial_by_r2 + 2.0 * camera.p1 * y + 6.0 * camera.p2 * x, cross, cross,
      radial + 2.0 * y * y * radial_by_r2 + 6.0 * camera.p1 * y + 2.0 * camera.p2 * x;
  return bent;
}

}  // namespace

Eigen::Vector2d distort(const CameraModel& camera, const Eigen::Vector2d& ideal) {
  return bent_point(camera, ideal.x(), ideal.y());
}

std::optional<Eigen::Vector2d> undistort(const CameraModel& camera, const Eigen::Vector2d& distorted) {
  Eigen::Vector2d ideal = distorted;
  for (int i = 0; i < 50; ++i) {
    const Bent bent = bend(camera, ideal);
    const Eigen::Vector2d error = bent.point - distorted;
    const double determinant = bent.by_ideal.determinant();
    if (!std::isfinite(determinant) || determinant <= 0.0) return std::nullopt;  // the lens model folds over here
    const Eigen::Vector2d step = bent.by_ideal.inverse() * error;
    ideal -= step;
    if (step.squaredNorm() < 1e-26 * (1.0 + ideal.squaredNorm())) return ideal;
  }
  return (bend(camera, ideal).point - distorted).norm() < 1e-12 * (1.0 + distorted.norm()) ? std::optional(ideal)
                                                                                           : std::nullopt;
}

Eigen::Vector2d project(const CameraModel& camera, const Eigen::Vector3d& point_camera) {
  const Eigen::Vector2d bent =
      bent_point(camera, point_camera.x() / point_camera.z(), point_camera.y() / point_camera.z());
  return {camera.fx * bent.x() + camera.cx, camera.fy * bent.y() + camera.cy};
}

Projection project_with_jacobian(const CameraModel& camera, const Eigen::Vector3d& point_camera) {
  const double inverse_depth = 1.0 / point_camera.z();
  const Eigen::Vector2d ideal = point_camera.head<2>() * inverse_depth;
  const Bent bent = bend(camera, ideal);
  Projection seen;
  seen.pixel = {camera.fx * bent.point.x() + camera.cx, camera.fy * bent.point.y() + camera.cy};
  // focal lengths * by_ideal * d(ideal)/d(point), whose left square is diagonal
  for (int row = 0; row < 2; ++row) {
    const double focal = row == 0 ? camera.fx : camera.fy;
    const double by_x = focal * bent.by_ideal(row, 0);
    const double by_y = focal * bent.by_ideal(row, 1);
    seen.by_point(row, 0) = by_x * inverse_depth;
    seen.by_point(row, 1) = by_y * inverse_depth;
    seen.by_point(row, 2) = by_x * (-ideal.x() * inverse_depth) + by_y * (-ideal.y() * inverse_depth);
  }
  return seen;
}

std::optional<Eigen::Vector2d> unproject(const CameraModel& camera, const Eigen::Vector2d& pixel) {
  return undistort(camera, {(pixel.x() - camera.cx) / camera.fx, (pixel.y() - camera.cy) / camera.fy});
}

CameraModel camera_of_part(const CameraModel& camera, int binning, int offset_x, int offset_y, int width, int height) {
  CameraModel part = camera;
  part.fx /= binning;
  part.fy /= binning;
  part.cx = (camera.cx + 0.5) / binning - 0.5 - offset_x;
  part.cy = (camera.cy + 0.5) / binning - 0.5 - offset_y;
  part.width = width;
  part.height = height;
  return part;
}

double horizontal_view(const CameraModel& camera) {
  return std::atan(camera.cx / camera.fx) + std::atan((camera.width - 1 - camera.cx) / camera.fx);
}

void check(const CameraModel& camera) {
  const auto refuse = [](const std::string& what) { throw std::invalid_argument(what); };
  if (camera.width < 1 || camera.height < 1 || camera.width > 65536 || camera.height > 65536)
    refuse("image size " + std::to_string(camera.width) + "x" + std::to_string(camera.height) +
           " is not between 1x1 and 65536x65536");
  if (!(camera.fx > 0.0 && camera.fy > 0.0 && std::isfinite(camera.fx) && std::isfinite(camera.fy)))
    refuse("focal lengths fx, fy must be positive and finite");
  for (const double value :
       {camera.cx, camera.cy, camera.k1, camera.k2, camera.p1, camera.p2, camera.k3, camera.k4, camera.k5, camera.k6})
    if (!std::isfinite(value)) refuse("principal point and distortion must be finite numbers");
}

}  // namespace tagdock
