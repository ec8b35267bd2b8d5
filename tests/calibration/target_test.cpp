#include "calibration/target.h"

#include <catch2/catch.hpp>

#include "calibration/rig.h"

using namespace tagdock;

TEST_CASE("an upright tag in front of the robot is seen upright: left corner left, top corner up") {
  const Rig rig = default_rig();
  const BoardTag tag{7, 0.16, upright_tag(0.0, 0.0, 0.35, 0.0)};
  // The robot stands 2 m before the wall and faces it.
  const Eigen::Isometry3d T_station_base(Eigen::Translation3d(-2.0, 0.0, 0.0));
  const Eigen::Isometry3d T_camera_station = (T_station_base * rig.T_base_camera).inverse();
  const TagPoints corners = corners_station(tag);
  const Eigen::Vector3d top_left = T_camera_station * corners[0];
  const Eigen::Vector3d bottom_right = T_camera_station * corners[2];
  CHECK(top_left.x() == Approx(-0.08));
  CHECK(top_left.y() == Approx(-0.08));
  CHECK(bottom_right.x() == Approx(0.08));
  CHECK(bottom_right.z() == Approx(2.0 - 0.35));
}

TEST_CASE("the default board is a convex V: inner edges nearer to the robot, wings facing outwards") {
  const Board board = default_board(0.35);
  REQUIRE(board.tags.size() == 3);
  const TagPoints left = corners_station(*find_tag(board, 0));
  CHECK(left[0].y() > left[1].y());  // its left corner is farther left (y to the left)
  CHECK(left[1].x() < left[0].x());  // and its inner, right corner nearer to the robot
  const Eigen::Vector3d face = -find_tag(board, 0)->T_station_tag.linear().col(2);
  CHECK(face.x() < 0.0);
  CHECK(face.y() > 0.0);
  CHECK(find_tag(board, 5) == nullptr);
}
