#include "servo/rest_smoother.h"

#include <array>
#include <cmath>
#include <random>

#include <Eigen/LU>
#include <catch2/catch.hpp>

using namespace tagdock;

namespace {

struct Stand {
  double noise_px = 0.02;
  double lasting_px = 0.25;
  unsigned lasting_seed = 1;  // the same board and lens
  int frames = 20;
  double rolls = 0.0;  // m that the robot still rolls while it is looked at
};

class Looker {
 public:
  explicit Looker(unsigned seed) : random_(seed) {}
  double normal() { return distribution_(random_); }

 private:
  std::mt19937_64 random_;
  std::normal_distribution<double> distribution_;
};

// Corners by a projection of its own: a robot that rests at `pose` (axle) in the end, shaken from frame to frame.
std::vector<RestSighting> look(const Stand& stand, const Pose2& pose, unsigned seed) {
  const Rig rig = default_rig();
  const Board board = default_board(rig.T_base_camera.translation().z());
  Looker lasting(stand.lasting_seed);
  std::array<double, 24> lasting_px{};
  for (double& value : lasting_px) value = stand.lasting_px * lasting.normal();
  Looker noise(seed);
  std::vector<RestSighting> sightings;
  for (int frame = 0; frame < stand.frames; ++frame) {
    const double rest = stand.rolls * std::exp(-0.3 * frame);
    RestSighting sighting;
    sighting.T_odom_base = Pose2{5.0 - rest, 2.0, 0.0};  // odometry looks along x, as the robot nearly does
    const Pose2 now = pose * Pose2{-rest, 0.0, 0.0};
    const double roll = 0.001 * noise.normal();
    const double pitch = 0.0017 * noise.normal();
    const Eigen::Vector3d lens = rig.T_base_camera.translation();
    const Pose2 point = now * Pose2{lens.x(), lens.y(), 0.0};
    Eigen::Isometry3d T_station_camera = Eigen::Isometry3d::Identity();
    T_station_camera.translation() << point.x, point.y, lens.z() + 0.001 * noise.normal();
    T_station_camera.linear() =
        (Eigen::AngleAxisd(now.yaw, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitY()) *
         Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitX()))
            .toRotationMatrix() *
        rig.T_base_camera.linear();
    std::size_t coordinate = 0;
    for (const BoardTag& tag : board.tags) {
      CornersSeen seen;
      seen.id = tag.id;
      seen.variance_px2 = stand.noise_px * stand.noise_px;
      const TagPoints points = corners_station(tag);
      for (std::size_t i = 0; i < 4; ++i) {
        seen.corners_px[i] = project(rig.camera, T_station_camera.inverse() * points[i]);
        for (double& value : seen.corners_px[i]) value += lasting_px.at(coordinate++) + stand.noise_px * noise.normal();
      }
      sighting.tags.push_back(seen);
    }
    sighting.planar.T_station_base = now;
    sightings.push_back(sighting);
  }
  return sightings;
}

std::optional<SmoothedRest> smooth(const std::vector<RestSighting>& sightings) {
  const Rig rig = default_rig();
  return smooth_rest(sightings, sightings.back().T_odom_base, sightings.back().planar.T_station_base, rig,
                     default_board(rig.T_base_camera.translation().z()), RestSmootherConfig{});
}

Eigen::Vector3d error(const SmoothedRest& rest, const Pose2& truth) {
  return {rest.T_station_base.x - truth.x, rest.T_station_base.y - truth.y, rest.T_station_base.yaw - truth.yaw};
}

const Pose2 at_dock{-1.35, 0.01, 0.02};

}  // namespace

TEST_CASE("the pose of a standstill is as good as its covariance says") {
  Stand stand;
  stand.lasting_px = 0.0;
  Eigen::Vector3d squares = Eigen::Vector3d::Zero();
  double whole = 0.0;
  constexpr int runs = 60;
  for (unsigned seed = 1; seed <= runs; ++seed) {
    const auto rest = smooth(look(stand, at_dock, seed));
    REQUIRE(rest);
    const Eigen::Vector3d off = error(*rest, at_dock);
    squares += off.cwiseAbs2().cwiseQuotient(rest->covariance.diagonal()) / runs;
    whole += off.dot(rest->covariance.inverse() * off) / (3.0 * runs);
    CHECK(rest->scatter_px == Approx(stand.noise_px).epsilon(0.2));  // 20 frames of 24 values: 0.035, five times that
  }
  // Chi-square of 60 runs over 60: 0.45 to 1.75 holds 99.99 %.
  for (const double square : squares) {
    CHECK(square > 0.45);
    CHECK(square < 1.75);
  }
  CHECK(whole > 0.6);  // 180 values
  CHECK(whole < 1.45);
}

TEST_CASE("what survey and lens leave at the corners cancels between two standstills near each other") {
  const Pose2 beside{at_dock.x + 0.0002, at_dock.y - 0.0003, at_dock.yaw + 0.001};
  for (unsigned board = 1; board <= 5; ++board) {
    CAPTURE(board);
    Stand stand;
    stand.lasting_seed = board;
    stand.noise_px = 0.003;
    const auto taught = smooth(look(stand, at_dock, 11));
    const auto docked = smooth(look(stand, beside, 12));
    REQUIRE((taught && docked));
    const Eigen::Vector3d found(docked->T_station_base.x - taught->T_station_base.x,
                                docked->T_station_base.y - taught->T_station_base.y,
                                docked->T_station_base.yaw - taught->T_station_base.yaw);
    const Eigen::Vector3d off = found - Eigen::Vector3d(0.0002, -0.0003, 0.001);
    // Each alone is wrong by a millimetre or so; the difference by noise, and by the lever of so small a step.
    const Eigen::Vector3d sigma = (taught->covariance + docked->covariance).diagonal().cwiseSqrt();
    for (int i = 0; i < 3; ++i) CHECK(std::abs(off[i]) < 4.0 * sigma[i] + 0.002 * std::abs(error(*taught, at_dock)[i]));
    CHECK(taught->lasting_px > 0.1);  // 0.25 px, less what looks like a pose
    CHECK(taught->lasting_px < 0.4);
  }
}

TEST_CASE("a robot that still rolls out is placed where it ends") {
  Stand stand;
  stand.noise_px = 0.003;
  stand.lasting_px = 0.0;
  stand.rolls = 0.0005;
  const Pose2 straight{at_dock.x, at_dock.y, 0.0};
  const auto rest = smooth(look(stand, straight, 3));
  REQUIRE(rest);
  const Eigen::Vector3d sigma = rest->covariance.diagonal().cwiseSqrt();
  // The mean of the frames would be 0.08 mm short.
  for (int i = 0; i < 3; ++i) CHECK(std::abs(error(*rest, straight)[i]) < 4.0 * sigma[i]);
  CHECK(sigma.x() < 1e-5);
}

TEST_CASE("a corner that something hides in some frames does not pull the pose along") {
  Stand stand;
  stand.noise_px = 0.01;
  stand.lasting_px = 0.0;
  std::vector<RestSighting> sightings = look(stand, at_dock, 4);
  const auto clean = smooth(sightings);
  for (std::size_t i = 0; i < 4; ++i) sightings[5 * i].tags[0].corners_px[1].x() += 3.0;
  const auto disturbed = smooth(sightings);
  REQUIRE((clean && disturbed));
  // Four frames of twenty, 3 px each: their mean would be 0.6 px in that coordinate. Huber leaves 5 sigma of them.
  const double moved_y = disturbed->T_station_base.y - clean->T_station_base.y;
  std::vector<RestSighting> mean = look(stand, at_dock, 4);
  for (RestSighting& sighting : mean) sighting.tags[0].corners_px[1].x() += 0.6;
  const auto pulled = smooth(mean);
  REQUIRE(pulled);
  const double pulled_y = pulled->T_station_base.y - clean->T_station_base.y;
  CHECK(std::abs(pulled_y) > 0.0003);
  CHECK(std::abs(moved_y) < 0.2 * std::abs(pulled_y));
}

TEST_CASE("corners that cannot be explained are not smoothed") {
  Stand stand;
  std::vector<RestSighting> sightings = look(stand, at_dock, 5);
  CHECK_FALSE(smooth({sightings.begin(), sightings.begin() + 1}));
  std::vector<RestSighting> far_off = sightings;
  far_off[3].tags[2].corners_px[0].x() += 60.0;
  CHECK_FALSE(smooth(far_off));
  std::vector<RestSighting> not_a_number = sightings;
  not_a_number[3].tags[2].corners_px[0].x() = std::nan("");
  CHECK_FALSE(smooth(not_a_number));
  std::vector<RestSighting> foreign = sightings;
  foreign[0].tags[0].id = 99;
  CHECK_FALSE(smooth(foreign));
  for (RestSighting& sighting : sightings) sighting.tags.clear();
  CHECK_FALSE(smooth(sightings));
}
