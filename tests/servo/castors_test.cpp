#include "servo/castors.h"

#include <cmath>
#include <numbers>
#include <random>

#include <catch2/catch.hpp>

#include "docking_run.h"
#include "servo/line_following.h"

using namespace tagdock;
using namespace tagdock::test;

namespace {

constexpr double track = 0.6;

// A base whose castors push as the model says, driven in short steps; the wheels drive `turn` per metre.
struct CastorRobot {
  CastorConfig config;
  double scrub = 0.2;
  CastorAngles angles;
  Pose2 truth;
  Pose2 odometry;

  void drive(double distance, double curvature) {
    constexpr double piece = 0.001;
    for (double driven = 0.0; driven < std::abs(distance) - 1e-9; driven += piece) {
      const double step = std::copysign(piece, distance);
      const Pose2 motion{step, 0.0, curvature * piece};
      const CastorPush pushed = push(angles, motion, track, config);
      angles = pushed.after;
      odometry = odometry * motion;
      truth = truth * Pose2{step, scrub * pushed.aside, motion.yaw + scrub * pushed.around};
    }
  }
};

}  // namespace

TEST_CASE("what castors hold back is what they give back on a straight") {
  for (const double front : {0.02, 0.2, 0.5, 1.0, 1.5, 2.5, 3.0}) {
    for (const double rear : {0.0, -0.3, 0.4, -2.0}) {
      CAPTURE(front, rear);
      CastorRobot robot;
      robot.angles = {front, rear};
      const double held = robot.scrub * held_back(robot.angles, robot.config);
      robot.drive(3.0, 0.0);
      CHECK(std::abs(robot.angles.front) < 1e-3);
      // 5.3 % of either castor's share for the formula, 2 % of the largest for steps of a fiftieth of the trail.
      const double largest = robot.scrub * held_back({0.5 * std::numbers::pi, 0.0}, robot.config);
      CHECK(std::abs(robot.truth.yaw - held) < (2.0 * 0.053 + 0.02) * largest);
    }
  }
}

TEST_CASE("the heading lags by heading_lag in a gentle turn, and nothing is lost once it is straight again") {
  CastorRobot robot;
  const double lag = heading_lag(robot.scrub, robot.config);
  CHECK(std::abs(lag - 0.2 * 0.9 / 1.5) < 1e-12);
  robot.drive(1.0, 0.01);
  const double behind = robot.odometry.yaw - robot.truth.yaw;
  CHECK(std::abs(behind - lag * 0.01) < 0.05 * lag * 0.01);
  CHECK(std::abs(robot.scrub * held_back_in_turn(0.01, robot.config) - behind) < 0.05 * behind);
  robot.drive(1.0, 0.0);
  CHECK(std::abs(robot.odometry.yaw - robot.truth.yaw) < 0.02 * behind);
}

TEST_CASE("a base without castors is not pushed") {
  CastorConfig none;
  none.front = none.rear = 0.0;
  const CastorPush pushed = push({0.5, -0.5}, {0.02, 0.0, 0.01}, track, none);
  CHECK(pushed.around == 0.0);
  CHECK(pushed.aside == 0.0);
  CHECK(held_back({0.5, -0.5}, none) == 0.0);
  CHECK(heading_lag(0.3, none) == 0.0);
}

TEST_CASE("wild readings cost no time and give numbers") {
  for (const Pose2& motion : {Pose2{1e6, 0.0, 0.0}, Pose2{0.0, 0.0, 1e6}, Pose2{1e-300, 0.0, 1e-300}, Pose2{}}) {
    const CastorPush pushed = push({0.3, 0.1}, motion, track, {});
    CHECK(std::isfinite(pushed.around));
    CHECK(std::isfinite(pushed.aside));
    CHECK(std::isfinite(pushed.after.front));
  }
}

TEST_CASE("the filter finds the castors' scrub while the robot drives, also where there is none") {
  const Rig rig = default_rig();
  for (const double scrub : {0.0, 0.1, 0.2, 0.35}) {
    CAPTURE(scrub);
    std::mt19937_64 random(7);
    std::normal_distribution<double> normal;
    CastorRobot robot;
    robot.scrub = scrub;
    const Pose2 start{-3.5, 0.3, -0.1};
    robot.truth = start;
    PoseFilter filter(rig, {});
    constexpr double sigma = 3e-4;  // m and rad
    nanoseconds time{0};
    for (int i = 0; i < 900; ++i) {
      const bool drives = i > 100;
      const double curvature = drives ? 0.5 * std::sin(0.02 * i) : 0.0;
      if (drives) robot.drive(0.003, curvature);
      filter.predict({time, robot.odometry, drives ? Twist2{0.15, 0.15 * curvature} : Twist2{}});
      if (i % 2 == 0) {
        BoardSighting seen;
        seen.time = time;
        Eigen::Matrix<double, 6, 1> error;
        for (int k = 0; k < 6; ++k) error[k] = sigma * normal(random);
        seen.T_camera_station = small_motion(error) * level_view(rig, robot.truth);
        seen.covariance = Matrix6::Identity() * sigma * sigma;
        seen.log_odds = 100.0;
        filter.update(seen);
      }
      time += milliseconds(20);
    }
    const std::optional<PoseEstimate> estimate = filter.estimate(time);
    REQUIRE(estimate);
    CHECK(estimate->castor_scrub_sigma < 0.03);
    CHECK(std::abs(estimate->castor_scrub - scrub) < 0.03);
    CHECK(std::abs(estimate->held_back - scrub * held_back(robot.angles, robot.config)) < 0.004);
  }
}

TEST_CASE("the line law steers onto the line by the heading with what castors hold back, and swings without") {
  // Scrub 0.35 rad/m is twice what a usual floor has; heading lag 0.21 m, L 0.32 m.
  const auto largest_heading_at_the_end = [](bool with_held_back) {
    CastorRobot robot;
    robot.scrub = 0.35;
    robot.truth = {-2.5, 0.03, 0.02};
    LineTarget target;
    target.T_station_goal = {0.0, 0.0, 0.0};
    LineLawConfig law;
    law.length = 1.5 * heading_lag(robot.scrub, robot.config);
    Twist2 last{0.15, 0.0};
    double largest = 0.0;
    while (robot.truth.x < -0.1) {
      Pose2 pose = robot.truth;
      if (with_held_back) pose.yaw += robot.scrub * held_back(robot.angles, robot.config);
      const LineCommand line = follow_line(target, pose, last, 0.15, milliseconds(20), false, law);
      if (line.reached) break;
      last = {0.15, line.command.angular};
      robot.drive(0.003, last.angular / last.linear);
      if (robot.truth.x > -0.6) largest = std::max(largest, std::abs(robot.truth.yaw));
    }
    return largest;
  };
  CHECK(largest_heading_at_the_end(true) < radians(0.6));
  CHECK(largest_heading_at_the_end(false) > radians(1.0));
}
