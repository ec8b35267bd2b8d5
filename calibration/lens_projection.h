#pragma once

#include <array>

#include <Eigen/Core>

#include "calibration/camera_model.h"

namespace tagdock {

/// The camera's values as a list that a solver can move: fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6.
inline constexpr int lens_values = 12;
using LensValues = std::array<double, lens_values>;

inline LensValues lens_of(const CameraModel& c) {
  return {c.fx, c.fy, c.cx, c.cy, c.k1, c.k2, c.p1, c.p2, c.k3, c.k4, c.k5, c.k6};
}

inline CameraModel camera_of(const LensValues& v, int width, int height) {
  return {width, height, v[0], v[1], v[2], v[3], v[4], v[5], v[6], v[7], v[8], v[9], v[10], v[11]};
}

/// `project` of camera_model.h for values that carry derivatives.
template <typename T, typename L>
Eigen::Matrix<T, 2, 1> project_point(const L* lens, const Eigen::Matrix<T, 3, 1>& point_camera) {
  const T x = point_camera.x() / point_camera.z();
  const T y = point_camera.y() / point_camera.z();
  const T r2 = x * x + y * y;
  const T radial =
      (1.0 + r2 * (lens[4] + r2 * (lens[5] + r2 * lens[8]))) / (1.0 + r2 * (lens[9] + r2 * (lens[10] + r2 * lens[11])));
  const T bent_x = x * radial + 2.0 * lens[6] * x * y + lens[7] * (r2 + 2.0 * x * x);
  const T bent_y = y * radial + lens[6] * (r2 + 2.0 * y * y) + 2.0 * lens[7] * x * y;
  return {lens[0] * bent_x + lens[2], lens[1] * bent_y + lens[3]};
}

}  // namespace tagdock
