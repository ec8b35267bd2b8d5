#include <cmath>

#include <catch2/catch.hpp>

#include "app/simulation/untouched.h"
#include "app/simulation/world.h"

using namespace tagdock;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

namespace {

/// The scenario without anything that differs between the robot's files and the world, and without shaking.
Scenario true_to_its_files() {
  Scenario scenario;
  scenario.residuals = {};
  scenario.residuals.camera_place_sigma = scenario.residuals.camera_angle_sigma =
      scenario.residuals.focal_length_sigma = scenario.residuals.principal_point_sigma_px =
          scenario.residuals.tag_place_sigma = scenario.residuals.tag_angle_sigma = 0.0;
  scenario.chassis = {0.0, 0.0, 0.0};
  return scenario;
}

Rig small_rig() {
  Rig rig = default_rig();
  rig.camera.width = 640;
  rig.camera.height = 512;
  rig.camera.fx = rig.camera.fy = 614.0;
  rig.camera.cx = 321.3;
  rig.camera.cy = 254.6;
  return rig;
}

void drive_for(World& world, const Twist2& wanted, nanoseconds time) {
  const nanoseconds end = world.now() + time;
  while (world.now() < end) {
    world.command(wanted, world.now());
    world.advance(world.now() + milliseconds(20));
  }
}

}  // namespace

TEST_CASE("what the camera sees is where the robot truly is") {
  const Rig rig = small_rig();
  const Board board = default_board(0.35);
  World world(true_to_its_files(), rig, board, 3);
  drive_for(world, {0.15, 0.05}, milliseconds(2000));
  const Rendering seen = world.render(world.now() - milliseconds(40));
  REQUIRE(seen.tags.size() == 3);
  CHECK(seen.gray.size() == cv::Size(640, 512));
  // The pose at mid-exposure: 40 ms ago, so 8 steps back along the driven arc.
  const RobotTruth& truth = world.truth();
  const Pose2 back{-0.04 * truth.motion.linear, 0.0, -0.04 * truth.motion.angular};
  const Pose2 T_station_base = truth.T_station_base * back;
  Eigen::Isometry3d T_station_camera = Eigen::Isometry3d::Identity();
  T_station_camera.linear() = Eigen::AngleAxisd(T_station_base.yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  T_station_camera.translation() << T_station_base.x, T_station_base.y, 0.0;
  T_station_camera = T_station_camera * rig.T_base_camera;
  for (const TrueTag& tag : seen.tags) {
    const Eigen::Vector2d expected =
        project(rig.camera, T_station_camera.inverse() * corners_station(*find_tag(board, tag.id))[0]);
    // 0.15 px: slip changes over the 40 ms, and the yaw walks by 0.08 mrad (0.05 px at 614 px), up to 3 sigma of it.
    // Had the image been taken at its arrival, the corner would be 1.2 px off.
    CHECK((tag.corners_px[0] - expected).norm() < 0.15);
  }
}

TEST_CASE("errors are of the camera point against the docking pose, in the station frame") {
  World world(true_to_its_files(), small_rig(), default_board(0.35), 3);
  const Pose2 base = world.truth().T_station_base;
  const Pose2 point = world.T_station_camera_point();
  CHECK(point.x == Approx(base.x + 0.35 * std::cos(base.yaw)).margin(1e-12));
  CHECK(point.y == Approx(base.y + 0.35 * std::sin(base.yaw)).margin(1e-12));
  const Pose2 error = world.docking_error({point.x - 0.003, point.y + 0.002, point.yaw - 0.1});
  CHECK(error.x == Approx(0.003).margin(1e-12));
  CHECK(error.y == Approx(-0.002).margin(1e-12));
  CHECK(error.yaw == Approx(0.1).margin(1e-12));
}

TEST_CASE("the same seed repeats images to the byte, however often and in whatever order they are asked for") {
  const Scenario scenario;
  World first(scenario, small_rig(), default_board(0.35), 5);
  World again(scenario, small_rig(), default_board(0.35), 5);
  World other(scenario, small_rig(), default_board(0.35), 6);
  for (World* world : {&first, &again, &other}) drive_for(*world, {0.1, 0.1}, milliseconds(500));
  const cv::Mat1b late = first.render(milliseconds(480)).gray;
  const cv::Mat1b early = again.render(milliseconds(400)).gray;
  CHECK(cv::norm(late, again.render(milliseconds(480)).gray, cv::NORM_INF) == 0.0);
  CHECK(cv::norm(early, first.render(milliseconds(400)).gray, cv::NORM_INF) == 0.0);
  CHECK(cv::norm(late, other.render(milliseconds(480)).gray, cv::NORM_INF) > 0.0);
  CHECK_THROWS(first.render(milliseconds(530)));  // the world does not know the future
}

TEST_CASE("instruments differ from their files as far as the scenario says") {
  const Rig rig = default_rig();
  const Board board = default_board(0.35);
  ResidualScenario residuals;
  double places = 0.0;
  double angles = 0.0;
  constexpr int count = 2000;
  for (std::uint64_t seed = 1; seed <= count; ++seed) {
    const Rig truth = true_rig(rig, residuals, seed);
    places += (truth.T_base_camera.translation() - rig.T_base_camera.translation()).squaredNorm();
    angles +=
        std::pow(Eigen::AngleAxisd(truth.T_base_camera.linear() * rig.T_base_camera.linear().transpose()).angle(), 2);
  }
  // 5 %: 4 sigma of a sigma of 6000 numbers is 3.7 %.
  CHECK(std::sqrt(places / (3 * count)) == Approx(residuals.camera_place_sigma).epsilon(0.05));
  CHECK(std::sqrt(angles / (3 * count)) == Approx(residuals.camera_angle_sigma).epsilon(0.05));

  // A bump to the left turns what the camera sees to the right.
  ResidualScenario bumped = true_to_its_files().residuals;
  bumped.camera_bump = radians(0.2);
  const Eigen::Vector3d axis = true_rig(rig, bumped, 1).T_base_camera.linear().col(2);
  CHECK(std::atan2(axis.y(), axis.x()) == Approx(radians(0.2)).margin(1e-12));

  StationScenario moved;
  moved.moved = {0.0, 0.02, 0.0};
  const Board truth = true_board(board, true_to_its_files().residuals, moved, 1);
  for (const BoardTag& tag : board.tags) {
    const Eigen::Vector3d shift =
        find_tag(truth, tag.id)->T_station_tag.translation() - tag.T_station_tag.translation();
    CHECK((shift - Eigen::Vector3d(0.0, 0.02, 0.0)).norm() < 1e-12);  // m
  }
}

TEST_CASE("frames come late and get lost as often as the scenario says") {
  Scenario scenario;
  scenario.camera.loss = 0.3;
  const World world(scenario, small_rig(), default_board(0.35), 2);
  CHECK(world.frame_period() == milliseconds(40));
  int lost = 0;
  nanoseconds least = milliseconds(1000);
  nanoseconds most{0};
  for (std::uint64_t frame = 0; frame < 10000; ++frame) {
    lost += world.is_lost(frame) ? 1 : 0;
    least = std::min(least, world.latency_of(frame));
    most = std::max(most, world.latency_of(frame));
  }
  CHECK(lost == Approx(3000).margin(4 * 46));  // 4 sigma of a binomial
  CHECK(least >= milliseconds(77));
  CHECK(most <= milliseconds(83));
  CHECK(most - least > milliseconds(5));
}

TEST_CASE("light changes once the camera comes near, and stays changed") {
  Scenario scenario = true_to_its_files();
  scenario.start = {};
  scenario.start.range = 1.70;
  scenario.start.range_sigma = scenario.start.bearing_spread = scenario.start.heading_spread = 0.0;
  scenario.station.light_change = 0.25;
  scenario.station.light_change_range = 1.6;
  World world(scenario, small_rig(), default_board(0.35), 2);
  const double bright = cv::mean(world.render(nanoseconds(0)).gray)[0];
  drive_for(world, {0.2, 0.0}, milliseconds(2000));
  const double dim = cv::mean(world.render(world.now()).gray)[0];
  CHECK(dim < 0.5 * bright);
  drive_for(world, {-0.2, 0.0}, milliseconds(4000));
  CHECK(-world.T_station_camera_point().x > 1.6);
  CHECK(cv::mean(world.render(world.now()).gray)[0] < 0.5 * bright);
}

TEST_CASE("dirt hides a part of its tag") {
  Scenario scenario = true_to_its_files();
  scenario.station.dirt.push_back({.tag = 1, .x = 0.02, .y = 0.0, .width = 0.03, .height = 0.03});
  const World dirty(scenario, small_rig(), default_board(0.35), 2);
  for (const TrueTag& tag : dirty.render(nanoseconds(0)).tags) CHECK(tag.fully_visible == (tag.id != 1));
  scenario.station.dirt[0].tag = 77;
  CHECK_THROWS_WITH(World(scenario, small_rig(), default_board(0.35), 2), Catch::Contains("77"));
}

TEST_CASE("the error of a docking is against the dock where it stands now, and teaching comes before it was moved") {
  Scenario moved = true_to_its_files();
  moved.station.moved = {0.0, 0.02, 0.0};
  moved.residuals.camera_bump = 0.003;
  moved.faults.frames_stop_range = 1.5;
  World world(moved, small_rig(), default_board(0.35), 3);
  const Pose2 point = world.T_station_camera_point();
  CHECK(world.docking_error(point).y == Approx(-0.02).margin(1e-12));
  const Scenario before = untouched(moved);
  World taught(before, small_rig(), default_board(0.35), 3);
  CHECK(taught.docking_error(taught.T_station_camera_point()).y == Approx(0.0).margin(1e-12));
  CHECK(before.residuals.camera_bump == 0.0);
  CHECK(before.faults.frames_stop_range == 0.0);
  CHECK(before.start.range == moved.start.range);
}
