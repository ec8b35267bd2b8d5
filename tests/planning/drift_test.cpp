#include "planning/drift.h"

#include <random>

#include <catch2/catch.hpp>

using namespace tagdock;

TEST_CASE("drift along a straight line grows as the textbook says") {
  const OdometryDrift drift{0.01, 0.002, 0.003, 0.02};
  const double way = 4.0;
  const Eigen::Matrix3d end = covariance_at_end({{}, {{way, 0.0, 0.0}}}, Eigen::Matrix3d::Zero(), drift);
  const double heading = drift.heading * drift.heading;
  CHECK(end(0, 0) == Approx(drift.along * drift.along * way));
  CHECK(end(1, 1) == Approx(drift.across * drift.across * way + heading * way * way * way / 3.0));
  CHECK(end(2, 2) == Approx(heading * way));
  CHECK(end(1, 2) == Approx(heading * way * way / 2.0));
}

TEST_CASE("an error of the start's heading turns the whole path") {
  Eigen::Matrix3d start = Eigen::Matrix3d::Zero();
  start(2, 2) = 1e-4;
  const Path path{{1.0, 2.0, 0.5}, {{1.0, 0.0, 0.0}, {0.7, 0.9, 0.0}}};
  const Eigen::Matrix3d end = covariance_at_end(path, start, {0.0, 0.0, 0.0, 0.0});
  const Pose2 last = end_pose(path);
  CHECK(std::sqrt(end(0, 0) + end(1, 1)) == Approx(1e-2 * std::hypot(last.x - 1.0, last.y - 2.0)));
}

TEST_CASE("drift along a turning path is what many noisy drives scatter") {
  const OdometryDrift drift{0.004, 0.002, 0.01, 0.02};
  const Path path{{}, {{0.8, 0.0, 0.0}, {0.6, 0.0, 1.5}, {0.6, 0.9, -1.5}, {-0.5, 0.3, 0.0}}};
  const Eigen::Matrix3d expected = covariance_at_end(path, Eigen::Matrix3d::Zero(), drift);
  std::mt19937 random(11);
  std::normal_distribution<double> normal;
  const Pose2 end = end_pose(path);
  Eigen::Matrix3d found = Eigen::Matrix3d::Zero();
  constexpr int drives = 8000;
  constexpr int steps = 40;
  for (int i = 0; i < drives; ++i) {
    Pose2 pose = path.start;
    for (const Segment& segment : path.segments) {
      for (int j = 0; j < steps; ++j) {
        const double h = segment.length / steps;
        const Segment part{h, segment.curvature + segment.sharpness * h * j, segment.sharpness};
        pose = pose_along(pose, part, h);
        const double way = std::sqrt(std::abs(h));
        const double turn = std::sqrt(std::abs(part.turn()));
        pose = pose * Pose2{drift.along * way * normal(random), drift.across * way * normal(random),
                            drift.heading * way * normal(random) + drift.heading_turn * turn * normal(random)};
      }
    }
    const Eigen::Vector3d off(pose.x - end.x, pose.y - end.y, pose.yaw - end.yaw);
    found += off * off.transpose() / drives;
  }
  // The scatter of a variance from 8000 drives is 1.6 %; four of that.
  for (int i = 0; i < 3; ++i) CHECK(found(i, i) == Approx(expected(i, i)).epsilon(0.065));
}
