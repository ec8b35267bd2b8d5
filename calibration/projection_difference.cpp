#include "calibration/projection_difference.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include <Eigen/Cholesky>
#include <Eigen/Geometry>

namespace tagdock {

double ImageMap::largest() const {
  double most = 0.0;
  for (const Eigen::Vector2d& value : values) most = std::max(most, value.norm());
  return most;
}

double ImageMap::rms() const {
  double sum = 0.0;
  for (const Eigen::Vector2d& value : values) sum += value.squaredNorm();
  return values.empty() ? 0.0 : std::sqrt(sum / static_cast<double>(values.size()));
}

std::vector<Eigen::Vector2d> image_grid(int width, int height, int columns, int rows) {
  std::vector<Eigen::Vector2d> pixels;
  for (int row = 0; row < rows; ++row)
    for (int column = 0; column < columns; ++column)
      pixels.emplace_back((width - 1.0) * column / (columns - 1), (height - 1.0) * row / (rows - 1));
  return pixels;
}

ImageMap projection_difference(const CameraModel& camera, const CameraModel& other, int columns, int rows) {
  ImageMap map{columns, rows, image_grid(camera.width, camera.height, columns, rows), {}};
  std::vector<std::optional<Eigen::Vector3d>> sights;
  for (const Eigen::Vector2d& pixel : map.pixels) {
    const std::optional<Eigen::Vector2d> ideal = unproject(camera, pixel);
    sights.push_back(ideal ? std::optional(Eigen::Vector3d(ideal->homogeneous())) : std::nullopt);
  }
  Eigen::Matrix3d turn = Eigen::Matrix3d::Identity();
  for (int i = 0; i < 10; ++i) {
    Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
    Eigen::Vector3d gradient = Eigen::Vector3d::Zero();
    for (std::size_t k = 0; k < sights.size(); ++k) {
      if (!sights[k]) continue;
      const Eigen::Vector3d sight = turn * *sights[k];
      if (sight.z() < 0.05) continue;
      const Projection seen = project_with_jacobian(other, sight);
      Eigen::Matrix3d by_turn;  // d(turned sight) / d(small turn on the left)
      by_turn << 0.0, sight.z(), -sight.y(), -sight.z(), 0.0, sight.x(), sight.y(), -sight.x(), 0.0;
      const Eigen::Matrix<double, 2, 3> J = seen.by_point * by_turn;
      information += J.transpose() * J;
      gradient += J.transpose() * (seen.pixel - map.pixels[k]);
    }
    const Eigen::Vector3d step = -information.ldlt().solve(gradient);
    if (!step.allFinite()) break;
    if (step.norm() > 0.0) turn = Eigen::AngleAxisd(step.norm(), step.normalized()).toRotationMatrix() * turn;
    if (step.norm() < 1e-12) break;
  }
  for (std::size_t k = 0; k < sights.size(); ++k) {
    // Where one of the two has no line of sight at all, they differ by more than any picture.
    const Eigen::Vector2d none(camera.width, camera.height);
    if (!sights[k]) {
      map.values.push_back(none);
      continue;
    }
    const Eigen::Vector3d sight = turn * *sights[k];
    map.values.push_back(sight.z() > 0.05 ? Eigen::Vector2d(project(other, sight) - map.pixels[k]) : none);
  }
  return map;
}

}  // namespace tagdock
