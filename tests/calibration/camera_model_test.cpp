#include "calibration/camera_model.h"

#include <limits>
#include <random>

#include <catch2/catch.hpp>

#include "calibration/rig.h"

using namespace tagdock;

TEST_CASE("unprojecting a projected point gives its line of sight back to 1e-11") {
  const CameraModel camera = default_rig().camera;
  for (double u = 0; u <= camera.width - 1; u += 63.95)
    for (double v = 0; v <= camera.height - 1; v += 51.15) {
      const auto ideal = unproject(camera, {u, v});
      REQUIRE(ideal);
      const Eigen::Vector2d pixel = project(camera, Eigen::Vector3d(ideal->homogeneous()) * 2.7);
      CHECK((pixel - Eigen::Vector2d(u, v)).norm() < 1e-8);  // 1e-11 on the plane is 1e-8 px
    }
}

TEST_CASE("the projection's derivative agrees with central differences, tangential and rational terms included") {
  CameraModel camera = default_rig().camera;
  camera.k4 = 0.02;
  camera.k5 = -0.01;
  camera.k6 = 0.003;
  std::mt19937 random(3);
  std::uniform_real_distribution<double> side(-0.6, 0.6);
  for (int i = 0; i < 50; ++i) {
    const Eigen::Vector3d point(side(random) * 2.0, side(random) * 2.0, 2.0);
    const Projection projection = project_with_jacobian(camera, point);
    CHECK((projection.pixel - project(camera, point)).norm() == 0.0);
    for (int axis = 0; axis < 3; ++axis) {
      Eigen::Vector3d step = Eigen::Vector3d::Zero();
      step[axis] = 1e-5;
      const Eigen::Vector2d difference = (project(camera, point + step) - project(camera, point - step)) / 2e-5;
      CHECK((difference - projection.by_point.col(axis)).norm() < 1e-4);  // of about 600 px/m
    }
  }
}

TEST_CASE("a lens model that folds over gives no line of sight instead of a wrong one") {
  CameraModel camera = default_rig().camera;
  camera.k1 = -0.6;
  camera.k2 = 0.0;
  CHECK_FALSE(unproject(camera, {-3000.0, -3000.0}));
}

TEST_CASE("the default camera sees 55 degrees across") {
  const CameraModel camera = default_rig().camera;
  CHECK(horizontal_view(camera) * 180.0 / 3.14159265358979 == Approx(55.0).margin(0.5));
}

TEST_CASE("cameras that cannot be are refused") {
  CameraModel camera = default_rig().camera;
  CHECK_NOTHROW(check(camera));
  camera.fx = 0.0;
  CHECK_THROWS_AS(check(camera), std::invalid_argument);
  camera = default_rig().camera;
  camera.k2 = std::numeric_limits<double>::quiet_NaN();
  CHECK_THROWS_AS(check(camera), std::invalid_argument);
  camera = default_rig().camera;
  camera.width = -1;
  CHECK_THROWS_AS(check(camera), std::invalid_argument);
}

TEST_CASE("a binned part of a picture sees each point at the mean of the pixels it covers") {
  const CameraModel camera = default_rig().camera;
  const CameraModel part = camera_of_part(camera, 2, 40, 16, 560, 480);
  CHECK(part.width == 560);
  CHECK(part.height == 480);
  // The binned pixel (100, 50) of the part covers the sensor's columns 280 and 281 and rows 132 and 133.
  const auto line_of_sight = unproject(camera, {280.5, 132.5});
  REQUIRE(line_of_sight);
  CHECK((project(part, line_of_sight->homogeneous()) - Eigen::Vector2d(100, 50)).norm() < 1e-9);
  CHECK(camera_of_part(camera, 1, 0, 0, camera.width, camera.height).cx == Approx(camera.cx).margin(1e-12));
}
