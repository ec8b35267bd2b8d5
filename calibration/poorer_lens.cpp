#include "calibration/poorer_lens.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include <Eigen/Cholesky>

#include "calibration/intrinsics.h"
#include "calibration/lens_projection.h"
#include "calibration/projection_difference.h"

namespace tagdock {
namespace {

constexpr int columns = 24;
constexpr int rows = 18;

/// Places of the grid that have a line of sight, with it.
struct Ray {
  Eigen::Vector2d pixel;
  Eigen::Vector2d ideal;
};

std::vector<Ray> rays_of(const CameraModel& camera) {
  std::vector<Ray> rays;
  for (const Eigen::Vector2d& pixel : image_grid(camera.width, camera.height, columns, rows))
    if (const std::optional<Eigen::Vector2d> ideal = unproject(camera, pixel)) rays.push_back({pixel, *ideal});
  return rays;
}

}  // namespace

CameraModel poorer_lens(const CameraModel& camera, LensTerms terms) {
  std::vector<Eigen::Index> free{0, 1, 2, 3, 4};
  if (terms != LensTerms::radial1) free.insert(free.end(), {5, 6, 7});
  if (terms == LensTerms::brown5) free.push_back(8);
  LensValues values = lens_of(camera);
  bool loses = false;
  for (Eigen::Index i = 4; i < lens_values; ++i)
    if (terms != LensTerms::all && std::find(free.begin(), free.end(), i) == free.end()) {
      loses = loses || values[static_cast<std::size_t>(i)] != 0.0;
      values[static_cast<std::size_t>(i)] = 0.0;
    }
  if (!loses) return camera;
  const std::vector<Ray> rays = rays_of(camera);
  const auto count = static_cast<Eigen::Index>(free.size());
  for (int step = 0; step < 30; ++step) {
    const CameraModel now = camera_of(values, camera.width, camera.height);
    Eigen::MatrixXd information = Eigen::MatrixXd::Identity(count, count) * 1e-12;
    Eigen::VectorXd gradient = Eigen::VectorXd::Zero(count);
    for (const Ray& ray : rays) {
      const Eigen::Matrix<double, 2, 12> all = pixel_by_lens(now, ray.ideal);
      Eigen::MatrixXd J(2, count);
      for (Eigen::Index i = 0; i < count; ++i) J.col(i) = all.col(free[static_cast<std::size_t>(i)]);
      information += J.transpose() * J;
      gradient += J.transpose() * (project(now, ray.ideal.homogeneous()) - ray.pixel);
    }
    const Eigen::VectorXd move = information.ldlt().solve(gradient);
    for (Eigen::Index i = 0; i < count; ++i)
      values[static_cast<std::size_t>(free[static_cast<std::size_t>(i)])] -= move[i];
    if (move.norm() < 1e-9) break;
  }
  return camera_of(values, camera.width, camera.height);
}

Loss loss_between(const CameraModel& camera, const CameraModel& poorer) {
  Loss loss;
  const std::vector<Ray> rays = rays_of(camera);
  for (const Ray& ray : rays) {
    const double way = (project(poorer, ray.ideal.homogeneous()) - ray.pixel).norm();
    loss.largest_px = std::max(loss.largest_px, way);
    loss.rms_px += way * way / static_cast<double>(rays.size());
  }
  loss.rms_px = std::sqrt(loss.rms_px);
  return loss;
}

double visp_kdu(const CameraModel& radial) {
  double top = 0.0;
  double bottom = 0.0;
  for (const Ray& ray : rays_of(radial)) {
    const Eigen::Vector2d seen((ray.pixel.x() - radial.cx) / radial.fx, (ray.pixel.y() - radial.cy) / radial.fy);
    const Eigen::Vector2d cubic = seen * seen.squaredNorm();
    top += cubic.dot(ray.ideal - seen);
    bottom += cubic.squaredNorm();
  }
  return bottom > 0.0 ? top / bottom : 0.0;
}

}  // namespace tagdock
