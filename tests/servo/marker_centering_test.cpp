#include "servo/marker_centering.h"

#include <cmath>
#include <limits>

#include <catch2/catch.hpp>

#include "calibration/rig.h"
#include "servo/pose_filter.h"

using namespace tagdock;

namespace {
const Rig rig = default_rig();
}

TEST_CASE("the view of the board's middle is its bearing and depth") {
  // Camera 2 m before the board, 0.5 m to the right of its axis (y = -0.5), heading along it: the board is to the left.
  const Pose2 pose = Pose2{-2.0, -0.5, 0.0} * inverse(camera_point(rig));
  const std::optional<MarkerView> view = marker_view(rig.T_base_camera, level_view(rig, pose));
  REQUIRE(view);
  CHECK(view->x == Approx(-0.25).margin(1e-12));
  CHECK(view->depth == Approx(2.0).margin(1e-12));
  CHECK_FALSE(marker_view(rig.T_base_camera, level_view(rig, {-2.0, 0.0, 3.1})));  // behind
}

TEST_CASE("turning only: the bearing decays at the rate of the gain, without driving") {
  // The axle turns, the camera stands 0.35 m before it: simulated exactly, in 5 ms steps.
  Pose2 pose = Pose2{-3.45, -0.3, 0.35} * inverse(camera_point(rig));
  const MarkerCenteringConfig config{.max_turn_rate = 10.0};
  const double start = marker_view(rig.T_base_camera, level_view(rig, pose))->x;
  constexpr double dt = 0.005;
  for (int i = 0; i < 200; ++i) {
    const MarkerView view = *marker_view(rig.T_base_camera, level_view(rig, pose));
    const std::optional<Twist2> turn = center_marker(view, view.depth, rig.T_base_camera, Centering::turn_only, config);
    REQUIRE(turn);
    REQUIRE(std::abs(turn->linear) < 1e-12);
    pose.yaw += turn->angular * dt;
  }
  const double left = marker_view(rig.T_base_camera, level_view(rig, pose))->x;
  // After 1 s at a gain of 1.2 1/s: exp(-1.2) = 30 %; 1 % for the steps of 5 ms.
  CHECK(left / start == Approx(std::exp(-1.2)).epsilon(0.01));
}

TEST_CASE("turning and driving: the features end at (0, Z*), each at the rate of the gain") {
  Pose2 pose = Pose2{-2.5, 0.2, -0.2} * inverse(camera_point(rig));
  const MarkerCenteringConfig config{.max_speed = 10.0, .max_reverse = 10.0, .max_turn_rate = 10.0};
  constexpr double dt = 0.005;
  const MarkerView start = *marker_view(rig.T_base_camera, level_view(rig, pose));
  for (int i = 0; i < 400; ++i) {
    const MarkerView view = *marker_view(rig.T_base_camera, level_view(rig, pose));
    const Twist2 command = *center_marker(view, 1.0, rig.T_base_camera, Centering::turn_and_drive, config);
    const double turn = command.angular * dt;
    pose = pose * Pose2{command.linear * dt * std::cos(0.5 * turn), command.linear * dt * std::sin(0.5 * turn), turn};
  }
  const MarkerView end = *marker_view(rig.T_base_camera, level_view(rig, pose));
  // 2 s at 0.6 1/s: exp(-1.2).
  CHECK(end.x / start.x == Approx(std::exp(-1.2)).epsilon(0.02));
  CHECK(std::log(end.depth) / std::log(start.depth) == Approx(std::exp(-1.2)).epsilon(0.02));
}

TEST_CASE("signs: a board to the right turns the robot right, too near drives it back") {
  const Twist2 right = *center_marker({0.2, 2.0}, 2.0, rig.T_base_camera, Centering::turn_only, {});
  CHECK(right.angular < 0.0);
  const Twist2 near = *center_marker({0.0, 0.8}, 1.0, rig.T_base_camera, Centering::turn_and_drive, {});
  CHECK(near.linear < 0.0);
  CHECK(std::abs(near.angular) < 1e-9);
}

TEST_CASE("commands keep their limits, and what is not a number never reaches ViSP") {
  const MarkerCenteringConfig config;
  const Twist2 far = *center_marker({1.0, 50.0}, 1.0, rig.T_base_camera, Centering::turn_and_drive, config);
  CHECK(std::abs(far.linear) <= config.max_speed);
  CHECK(std::abs(far.angular) <= config.max_turn_rate);
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  constexpr double infinity = std::numeric_limits<double>::infinity();
  for (const MarkerView& bad : {MarkerView{nan, 1.0}, MarkerView{0.0, nan}, MarkerView{infinity, 1.0},
                                MarkerView{0.0, infinity}, MarkerView{0.0, 0.0}, MarkerView{0.0, -1.0}}) {
    for (const Centering mode : {Centering::turn_only, Centering::turn_and_drive}) {
      CHECK_FALSE(center_marker(bad, 1.0, rig.T_base_camera, mode, config));
    }
  }
  CHECK_FALSE(center_marker({0.1, 2.0}, nan, rig.T_base_camera, Centering::turn_only, config));
  CHECK_FALSE(center_marker({0.1, 2.0}, 0.0, rig.T_base_camera, Centering::turn_only, config));
}
