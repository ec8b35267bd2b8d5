#include "app/simulation/robot_physics.h"

#include <cmath>
#include <functional>
#include <limits>

#include <catch2/catch.hpp>

#include "app/simulation/draws.h"

using namespace tagdock;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

namespace {

constexpr double camera_ahead = 0.35;

/// A start on the axis, without any spread.
StartScenario exact_start() {
  StartScenario start;
  start.range_sigma = start.bearing_sigma = start.bearing_spread = start.heading_sigma = start.heading_spread =
      start.castor_sigma = 0.0;
  return start;
}

/// A floor without friction under the castors, wheels that are known.
DriveScenario perfect_drive() {
  DriveScenario drive;
  drive.friction = drive.over_turn = drive.over_turn_field_sigma = drive.floor_coupling = drive.turn_scale_sigma =
      drive.speed_scale_sigma = drive.wheel_difference_sigma = drive.yaw_walk = 0.0;
  return drive;
}

/// Sends a command every 20 ms for a while.
void drive_for(RobotPhysics& robot, const Twist2& wanted, nanoseconds time) {
  const nanoseconds end = robot.truth().time + time;
  while (robot.truth().time < end) {
    robot.command(wanted, robot.truth().time);
    robot.advance(robot.truth().time + milliseconds(20));
  }
}

Pose2 moved(const RobotPhysics& robot, const Pose2& from) { return between(from, robot.truth().T_station_base); }

}  // namespace

TEST_CASE("on a perfect floor odometry is the truth") {
  RobotPhysics robot(exact_start(), perfect_drive(), camera_ahead, 1);
  const Pose2 start = robot.truth().T_station_base;
  CHECK(start.x == Approx(-3.85 - camera_ahead).margin(1e-12));
  drive_for(robot, {0.2, 0.0}, milliseconds(4000));
  drive_for(robot, {0.15, 0.3}, milliseconds(3000));
  drive_for(robot, {-0.1, -0.2}, milliseconds(3000));
  drive_for(robot, {}, milliseconds(2000));
  const Pose2 truth = moved(robot, start);
  const Pose2 odometry = robot.odometry().T_odom_base;
  CHECK(truth.x == Approx(odometry.x).margin(1e-9));  // m; the same integration, rounding alone
  CHECK(truth.y == Approx(odometry.y).margin(1e-9));
  CHECK(truth.yaw == Approx(odometry.yaw).margin(1e-9));
  CHECK(std::hypot(truth.x, truth.y) > 0.5);
}

TEST_CASE("the drive answers after its dead time, with its lag, within its limits") {
  const DriveScenario drive = perfect_drive();
  RobotPhysics robot(exact_start(), drive, camera_ahead, 1);
  nanoseconds first_motion{-1};
  double last = 0.0;
  double largest_acceleration = 0.0;
  const std::function<void(nanoseconds)> run_until = [&](nanoseconds end) {
    while (robot.truth().time < end) {
      if (robot.truth().time % milliseconds(20) == nanoseconds(0)) robot.command({0.2, 0.0}, robot.truth().time);
      robot.advance(robot.truth().time + milliseconds(5));
      const double speed = robot.truth().wheels.linear;
      if (first_motion.count() < 0 && speed > 0.0) first_motion = robot.truth().time - milliseconds(5);
      largest_acceleration = std::max(largest_acceleration, (speed - last) / 0.005);
      last = speed;
    }
  };
  run_until(milliseconds(3000));
  CHECK(first_motion == milliseconds(60));
  CHECK(largest_acceleration == Approx(0.3).margin(1e-9));  // m/s^2: 0.2 / 0.12 s would be more
  CHECK(last == Approx(0.2).margin(1e-6));
}

TEST_CASE("the robot stops by itself 200 ms after the last command, and stands within 300 ms") {
  for (const Twist2& motion : {Twist2{0.15, 0.0}, Twist2{0.1, 0.1}, Twist2{-0.1, 0.0}}) {
    RobotPhysics robot(exact_start(), DriveScenario{}, camera_ahead, 3);
    drive_for(robot, motion, milliseconds(2000));
    const nanoseconds last_command = robot.truth().time - milliseconds(20);
    nanoseconds slower{0};
    nanoseconds stands{0};
    const double before = std::abs(robot.truth().wheels.linear);
    for (int i = 0; i < 100; ++i) {
      robot.advance(robot.truth().time + milliseconds(5));
      const double speed = std::abs(robot.truth().wheels.linear);
      if (slower.count() == 0 && speed < before - 1e-6) slower = robot.truth().time;
      if (stands.count() == 0 && robot.truth().wheels == Twist2{}) stands = robot.truth().time;
    }
    CAPTURE(motion.linear, motion.angular);
    // The time-out and up to two steps of 5 ms; then 2 m/s^2.
    CHECK(slower - last_command > milliseconds(200));
    CHECK(slower - last_command <= milliseconds(210));
    CHECK(stands - last_command > milliseconds(240));
    CHECK(stands - last_command <= milliseconds(300));
  }
}

TEST_CASE("a robot that was told to stand stops by its ordinary ramp, also when nothing follows") {
  RobotPhysics robot(exact_start(), DriveScenario{}, camera_ahead, 3);
  RobotPhysics heard(exact_start(), DriveScenario{}, camera_ahead, 3);
  drive_for(robot, {0.15, 0.0}, milliseconds(2000));
  drive_for(heard, {0.15, 0.0}, milliseconds(2000));
  drive_for(robot, {}, milliseconds(20));
  robot.advance(robot.truth().time + milliseconds(800));
  drive_for(heard, {}, milliseconds(820));
  CHECK(robot.truth().wheels == heard.truth().wheels);
  CHECK(robot.truth().wheels.linear > 0.0);
}

TEST_CASE("encoders do not see slip, and castors push the robot aside where it turns") {
  DriveScenario drive = perfect_drive();
  RobotPhysics free(exact_start(), drive, camera_ahead, 1);
  drive.friction = 0.7;
  drive.friction_run_sigma = 0.0;
  RobotPhysics scrubbed(exact_start(), drive, camera_ahead, 1);
  const Pose2 start = free.truth().T_station_base;
  for (RobotPhysics* robot : {&free, &scrubbed}) {
    drive_for(*robot, {0.2, 0.0}, milliseconds(2000));
    drive_for(*robot, {0.2, 0.2}, milliseconds(3000));
    drive_for(*robot, {}, milliseconds(1500));
  }
  CHECK(scrubbed.odometry() == free.odometry());
  const Pose2 pushed = between(moved(free, start), moved(scrubbed, start));
  // The castors drag the turn back: notes/docking.md gives a peak of 0.09 to 0.42 rad/m over turns as sharp as these.
  CHECK(pushed.yaw < -0.01);
  CHECK(pushed.yaw > -0.3);
  // Twice the stiffness, half the push.
  drive.creep_stiffness *= 2.0;
  RobotPhysics stiffer(exact_start(), drive, camera_ahead, 1);
  drive_for(stiffer, {0.2, 0.0}, milliseconds(2000));
  drive_for(stiffer, {0.2, 0.2}, milliseconds(3000));
  drive_for(stiffer, {}, milliseconds(1500));
  CHECK(between(moved(free, start), moved(stiffer, start)).yaw == Approx(0.5 * pushed.yaw).epsilon(0.1));
}

TEST_CASE("castors trail after a run-in of two metres, reversed ones too") {
  for (const double angle : {0.5, 3.1}) {
    StartScenario start = exact_start();
    start.castor_angle = angle;
    RobotPhysics robot(start, DriveScenario{}, camera_ahead, 5);
    drive_for(robot, {0.2, 0.0}, milliseconds(2000));  // 0.3 m
    const double early = std::abs(robot.truth().castor_angles[0]);
    drive_for(robot, {0.2, 0.0}, milliseconds(8000));  // 1.9 m
    const double late = std::abs(robot.truth().castor_angles[0]);
    CHECK(late < 0.02);
    CHECK(early < angle);
  }
}

TEST_CASE("a wheel larger than believed bends the way, both lengthen it") {
  DriveScenario drive = perfect_drive();
  drive.right_radius_error = 0.005;
  RobotPhysics bent(exact_start(), drive, camera_ahead, 1);
  drive.left_radius_error = 0.005;
  RobotPhysics longer(exact_start(), drive, camera_ahead, 1);
  const Pose2 start = bent.truth().T_station_base;
  drive_for(bent, {0.2, 0.0}, milliseconds(10000));
  drive_for(longer, {0.2, 0.0}, milliseconds(10000));
  const double driven = longer.odometry().T_odom_base.x;
  CHECK(moved(longer, start).x == Approx(1.005 * driven).epsilon(1e-9));
  CHECK(moved(longer, start).yaw == Approx(0.0).margin(1e-12));
  CHECK(moved(bent, start).yaw == Approx(0.005 * driven / 0.6).epsilon(1e-9));
}

TEST_CASE("patches are fixed to the floor") {
  DriveScenario drive = perfect_drive();
  drive.over_turn_exponent = 0.0;
  drive.patch_length = 0.3;
  RobotPhysics robot(exact_start(), drive, camera_ahead, 1);
  // Turned on the spot at the axle's x = -4.2 m, which is 0.6 m behind a patch's start: no patch there.
  drive_for(robot, {0.0, 0.2}, milliseconds(2000));
  CHECK(robot.truth().motion.angular == Approx(robot.truth().wheels.angular).epsilon(1e-12));
  StartScenario nearer = exact_start();
  nearer.range = 3.55;  // axle at -3.9 m, 0.1 m into the patch that starts at -4.0 m
  RobotPhysics on_patch(nearer, drive, camera_ahead, 1);
  drive_for(on_patch, {0.0, 0.2}, milliseconds(2000));
  CHECK(on_patch.truth().motion.angular == Approx(1.02 * on_patch.truth().wheels.angular).epsilon(1e-12));
}

TEST_CASE("runs repeat by their seed, and starts spread as the scenario says") {
  const DriveScenario drive;
  const StartScenario start;
  RobotPhysics first(start, drive, camera_ahead, 9);
  RobotPhysics again(start, drive, camera_ahead, 9);
  RobotPhysics other(start, drive, camera_ahead, 10);
  for (RobotPhysics* robot : {&first, &again, &other}) drive_for(*robot, {0.15, 0.1}, milliseconds(3000));
  CHECK(first.truth().T_station_base == again.truth().T_station_base);
  CHECK(first.odometry() == again.odometry());
  CHECK_FALSE(first.truth().T_station_base == other.truth().T_station_base);

  double largest_bearing = 0.0;
  double largest_off = 0.0;
  double sum_of_squares = 0.0;
  constexpr int count = 1000;
  for (std::uint64_t seed = 1; seed <= count; ++seed) {
    const RobotPhysics robot(start, drive, camera_ahead, seed);
    const Pose2 camera = robot.truth().T_station_base * Pose2{camera_ahead, 0.0, 0.0};
    const double bearing = std::atan2(-camera.y, -camera.x);
    largest_bearing = std::max(largest_bearing, std::abs(bearing));
    largest_off = std::max(largest_off, std::abs(camera.yaw - bearing));
    sum_of_squares += std::pow(std::hypot(camera.x, camera.y) - start.range, 2);
  }
  CHECK(largest_bearing < radians(5.0 + 4.5 * 0.4));  // 4.5 sigma
  CHECK(largest_bearing > radians(4.5));
  CHECK(largest_off < radians(2.0 + 4.5 * 0.3));
  CHECK(std::sqrt(sum_of_squares / count) == Approx(0.01).epsilon(0.1));  // 4.5 sigma of a sigma
}

TEST_CASE("drawn numbers are normal, and do not follow each other") {
  Draws draws(4, 1);
  double sum = 0.0;
  double squares = 0.0;
  double products = 0.0;
  double fourth = 0.0;
  double last = 0.0;
  constexpr int count = 100000;
  for (int i = 0; i < count; ++i) {
    const double n = draws.normal();
    sum += n;
    squares += n * n;
    fourth += n * n * n * n;
    products += n * last;
    last = n;
  }
  const double four_sigma = 4.0 / std::sqrt(static_cast<double>(count));
  CHECK(std::abs(sum / count) < four_sigma);
  CHECK(std::abs(squares / count - 1.0) < std::sqrt(2.0) * four_sigma);
  CHECK(std::abs(fourth / count - 3.0) < std::sqrt(96.0) * four_sigma);
  CHECK(std::abs(products / count) < four_sigma);
}

TEST_CASE("a command that is not a number is refused") {
  RobotPhysics robot(exact_start(), DriveScenario{}, camera_ahead, 1);
  CHECK_THROWS(robot.command({std::numeric_limits<double>::quiet_NaN(), 0.0}, nanoseconds(0)));
}
