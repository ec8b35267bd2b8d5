#include "detection/tag_pose.h"

#include <cmath>
#include <random>

#include <catch2/catch.hpp>

#include "calibration/rig.h"
#include "planning/pose2.h"
#include "tests/detection/scene_rendering.h"

namespace tagdock {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Vector8 = Eigen::Matrix<double, 8, 1>;

const CameraModel lens{1280, 1024, 1230.0, 1228.0, 640.3, 510.9, -0.12, 0.06, 0.0003, -0.0002};

RefinedTag seen(const Eigen::Isometry3d& T_camera_tag, double size, const CameraModel& camera, double sigma_px) {
  RefinedTag tag;
  const TagPoints points = tag_corners(size);
  for (int i = 0; i < 4; ++i) tag.corners_px[i] = project(camera, T_camera_tag * points[i]);
  tag.covariance_px2.diagonal().setConstant(sigma_px * sigma_px);
  return tag;
}

RefinedTag shaken(RefinedTag tag, std::mt19937_64& random) {
  std::normal_distribution<double> normal;
  Vector8 white;
  for (double& value : white) value = normal(random);
  const Vector8 error = tag.covariance_px2.llt().matrixL() * white;
  for (int i = 0; i < 4; ++i) tag.corners_px[i] += error.segment<2>(2 * i);
  return tag;
}

/// The small motion on the left that turns `from` into `to`.
Vector6 motion(const Eigen::Isometry3d& from, const Eigen::Isometry3d& to) {
  const Eigen::Isometry3d step = to * from.inverse();
  const Eigen::AngleAxisd turn(step.linear());
  Vector6 result;
  result << step.translation(), turn.angle() * turn.axis();
  return result;
}

/// Where the station is for a camera on a robot that stands at (x, y) before it, heading off by yaw.
Eigen::Isometry3d station_from(const Eigen::Isometry3d& T_base_camera, double x, double y, double yaw,
                               double roll = 0.0, double pitch = 0.0, double height = 0.0) {
  Eigen::Isometry3d T_station_base = Eigen::Isometry3d::Identity();
  T_station_base.translation() << x, y, height;
  T_station_base.linear() =
      (Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()) * Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitY()) *
       Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitX()))
          .toRotationMatrix();
  return (T_station_base * T_base_camera).inverse();
}

std::vector<RefinedTag> tags_of(const Board& board, const Eigen::Isometry3d& T_camera_station,
                                const CameraModel& camera, double sigma_px) {
  std::vector<RefinedTag> tags;
  for (const BoardTag& tag : board.tags) {
    tags.push_back(seen(T_camera_station * tag.T_station_tag, tag.size, camera, sigma_px));
    tags.back().id = tag.id;
  }
  return tags;
}

}  // namespace

TEST_CASE("perfect corners give the pose back, from awkward places too") {
  for (const double tilt_deg : {0.0, 0.5, 10.0, 25.0, 45.0, 75.0})
    for (const double way_deg : {0.0, 37.0, 90.0, 200.0})
      for (const double roll_deg : {0.0, 45.0, 90.0, 179.9, 271.0})
        for (const Eigen::Vector2d& place : {Eigen::Vector2d(640.3, 510.9), Eigen::Vector2d(150.0, 890.0)}) {
          CAPTURE(tilt_deg, way_deg, roll_deg, place.transpose());
          const Eigen::Isometry3d truth =
              testing::pose_seen(lens, 0.16, 70.0, place, radians(tilt_deg), radians(way_deg), radians(roll_deg));
          const std::vector<TagPose> poses = tag_poses(seen(truth, 0.16, lens, 0.01), 0.16, lens);
          REQUIRE(!poses.empty());
          // At tilt 0 rotation enters by its square, so the last bits of a pixel (1e-13) become 1e-6 rad.
          const double tolerance = tilt_deg < 1.0 ? 1e-5 : 1e-8;
          CHECK(motion(truth, poses[0].T_camera_tag).norm() < tolerance);
          CHECK(poses[0].reprojection_rms_px < 1e-7);
          if (tilt_deg > 20.0) {
            REQUIRE(poses.size() == 2);
            CHECK(poses[1].chi2 > poses[0].chi2);
          }
        }
}

TEST_CASE("the second pose is the first one turned over, and explains a small tag nearly as well") {
  // Notes on detection, section 11: the wrong minimum's rms is about 0.33 s^2 sin(tilt) / f; at 33 px, 30 degrees and
  // f = 1229 px that is 0.15 px; a factor of 1.5 either way is a statement about the right minimum.
  const Eigen::Isometry3d truth = testing::pose_seen(lens, 0.16, 33.0, {640.3, 510.9}, radians(30.0), 0.0, 0.3);
  const auto poses = tag_poses(seen(truth, 0.16, lens, 0.01), 0.16, lens);
  REQUIRE(poses.size() == 2);
  const double expected = 0.33 * 33.0 * 33.0 * std::sin(radians(30.0)) / lens.fx;
  CHECK(poses[1].reprojection_rms_px > expected / 1.5);
  CHECK(poses[1].reprojection_rms_px < expected * 1.5);
  const double between = std::acos(poses[0].T_camera_tag.linear().col(2).dot(poses[1].T_camera_tag.linear().col(2)));
  CHECK(degrees(between) == Approx(60.0).margin(3.0));
}

TEST_CASE("the covariance of a tag's pose is true") {
  // Mean normalised squared error a coordinate over 300 draws: 1 +- 0.5 / sqrt(300) * ..., so 0.85 to 1.2 is 4 sigma;
  // inflation by a single tag's chi-square, which never deflates, raises the covariance, so the mean may be lower.
  std::mt19937_64 random(31);
  const Eigen::Isometry3d truth = testing::pose_seen(lens, 0.16, 80.0, {500.0, 600.0}, radians(35.0), 1.0, 0.4);
  double sum = 0.0;
  constexpr int draws = 300;
  for (int i = 0; i < draws; ++i) {
    const auto poses = tag_poses(shaken(seen(truth, 0.16, lens, 0.05), random), 0.16, lens);
    REQUIRE(!poses.empty());
    const Vector6 error = motion(poses[0].T_camera_tag, truth);
    sum += error.dot(poses[0].covariance.llt().solve(error)) / 6.0;
  }
  CAPTURE(sum / draws);
  CHECK(sum / draws > 0.5);
  CHECK(sum / draws < 1.2);
}

TEST_CASE("corners that are no tag seen from the front give no pose") {
  const Eigen::Isometry3d truth = testing::pose_seen(lens, 0.16, 80.0, {500.0, 600.0}, 0.4, 1.0, 0.4);
  const RefinedTag good = seen(truth, 0.16, lens, 0.05);
  RefinedTag mirror = good;
  std::swap(mirror.corners_px[0], mirror.corners_px[1]);
  std::swap(mirror.corners_px[2], mirror.corners_px[3]);
  CHECK(tag_poses(mirror, 0.16, lens).empty());
  RefinedTag broken = good;
  broken.corners_px[3].y() = std::nan("");
  CHECK(tag_poses(broken, 0.16, lens).empty());
  RefinedTag point = good;
  point.corners_px.fill({500.0, 600.0});
  CHECK(tag_poses(point, 0.16, lens).empty());
  RefinedTag dented = good;
  dented.corners_px[2] = 0.9 * dented.corners_px[0] + 0.1 * dented.corners_px[2];
  CHECK(tag_poses(dented, 0.16, lens).empty());
  for (const double size : {0.0, -0.16, std::nan(""), std::numeric_limits<double>::infinity()})
    CHECK(tag_poses(good, size, lens).empty());
  CameraModel blind = lens;
  blind.fx = std::nan("");
  CHECK(tag_poses(good, 0.16, blind).empty());
  RefinedTag unsure = good;
  unsure.covariance_px2.setZero();
  CHECK(tag_poses(unsure, 0.16, lens).empty());
}

TEST_CASE("a board gives the station's pose from any of its tags") {
  const Rig rig = default_rig();
  const Board board = default_board(0.35);
  for (const double x : {-3.5, -1.2, -0.9})
    for (const double yaw_deg : {-12.0, 0.0, 7.0}) {
      const Eigen::Isometry3d truth = station_from(rig.T_base_camera, x - 0.35, 0.1, radians(yaw_deg));
      const auto all = tags_of(board, truth, rig.camera, 0.02);
      for (const std::vector<RefinedTag>& some :
           {all, std::vector{all[0], all[2]}, std::vector{all[0]}, std::vector{all[2]}}) {
        CAPTURE(x, yaw_deg, some.size());
        const Sighting sighting = board_pose(some, board, rig.camera, GroundPrior{rig.T_base_camera});
        REQUIRE(std::holds_alternative<BoardSighting>(sighting));
        const BoardSighting& board_seen = std::get<BoardSighting>(sighting);
        CHECK(motion(truth, board_seen.T_camera_station).norm() < 1e-7);
        CHECK(board_seen.tags.size() == some.size());
        CHECK(board_seen.log_odds > 0.0);
      }
    }
}

TEST_CASE("the covariance of a board's pose is true with and without the floor") {
  // 200 draws of 6 coordinates: the mean scatters by sqrt(2 / 1200) = 0.04; inflation only lowers it, slightly.
  std::mt19937_64 random(32);
  std::normal_distribution<double> normal;
  const Rig rig = default_rig();
  const Board board = default_board(0.35);
  const GroundPrior floor{rig.T_base_camera};
  Matrix6 covariance[2];
  for (const bool with_floor : {false, true}) {
    double sum = 0.0;
    constexpr int draws = 200;
    for (int i = 0; i < draws; ++i) {
      const Eigen::Isometry3d truth =
          station_from(rig.T_base_camera, -3.0, 0.2, 0.05, floor.sigma_roll * normal(random),
                       floor.sigma_pitch * normal(random), floor.sigma_height * normal(random));
      std::vector<RefinedTag> tags = tags_of(board, truth, rig.camera, 0.02);
      for (RefinedTag& tag : tags) tag = shaken(tag, random);
      const Sighting sighting = board_pose(tags, board, rig.camera, with_floor ? std::optional(floor) : std::nullopt);
      REQUIRE(std::holds_alternative<BoardSighting>(sighting));
      const BoardSighting& board_seen = std::get<BoardSighting>(sighting);
      const Vector6 error = motion(board_seen.T_camera_station, truth);
      sum += error.dot(board_seen.covariance.llt().solve(error)) / 6.0;
      covariance[with_floor ? 1 : 0] = board_seen.covariance;
    }
    CAPTURE(with_floor, sum / draws);
    CHECK(sum / draws > 0.75);
    CHECK(sum / draws < 1.15);
  }
  CHECK(covariance[1].trace() < covariance[0].trace());
}

TEST_CASE("one small tag at 9 degrees is ambiguous and says so; a board of three is not") {
  const Rig rig = default_rig();
  const Board board = default_board(0.35);
  const Eigen::Isometry3d truth = station_from(rig.T_base_camera, -5.0, 0.8, radians(-8.0));
  const auto tags = tags_of(board, truth, rig.camera, 0.1);
  const Sighting single = board_pose(std::vector{tags[1]}, board, rig.camera, std::nullopt);
  REQUIRE(std::holds_alternative<BoardSighting>(single));
  CHECK(std::get<BoardSighting>(single).T_camera_station_mirrored.has_value());
  CHECK(std::get<BoardSighting>(single).log_odds < 5.0);
  const Sighting three = board_pose(tags, board, rig.camera, std::nullopt);
  REQUIRE(std::holds_alternative<BoardSighting>(three));
  CHECK_FALSE(std::get<BoardSighting>(three).T_camera_station_mirrored.has_value());
}

TEST_CASE("tags that do not stand as on the board, come twice or are others are refused by name") {
  const Rig rig = default_rig();
  const Board board = default_board(0.35);
  const Eigen::Isometry3d truth = station_from(rig.T_base_camera, -2.5, 0.1, 0.05);
  const auto tags = tags_of(board, truth, rig.camera, 0.02);
  const auto refused = [&](const std::vector<RefinedTag>& some) {
    const Sighting sighting = board_pose(some, board, rig.camera, std::nullopt);
    REQUIRE(std::holds_alternative<Unseen>(sighting));
    return std::get<Unseen>(sighting);
  };
  CHECK(refused({}) == Unseen::no_tag);
  CHECK(refused({tags[0], tags[0]}) == Unseen::duplicate_tag);
  RefinedTag stranger = tags[0];
  stranger.id = 99;
  CHECK(refused({stranger}) == Unseen::other_tags);
  auto swapped = tags;
  std::swap(swapped[0].id, swapped[2].id);
  CHECK(refused(swapped) == Unseen::layout_mismatch);
  Board hung_wrong = board;
  hung_wrong.tags[1].T_station_tag.translation().z() += 0.03;
  CHECK(refused(tags_of(hung_wrong, truth, rig.camera, 0.02)) == Unseen::layout_mismatch);
  auto broken = tags;
  broken[1].corners_px[0].x() = std::nan("");
  CHECK(refused(broken) == Unseen::no_pose);
}

}  // namespace tagdock
