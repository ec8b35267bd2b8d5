#include "calibration/target.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace tagdock {

TagPoints tag_corners(double size) {
  const double h = 0.5 * size;
  return {Eigen::Vector3d(-h, -h, 0.0), Eigen::Vector3d(h, -h, 0.0), Eigen::Vector3d(h, h, 0.0),
          Eigen::Vector3d(-h, h, 0.0)};
}

const BoardTag* find_tag(const Board& board, int id) {
  const auto found = std::find_if(board.tags.begin(), board.tags.end(), [id](const BoardTag& t) { return t.id == id; });
  return found == board.tags.end() ? nullptr : &*found;
}

TagPoints corners_station(const BoardTag& tag) {
  TagPoints points = tag_corners(tag.size);
  for (Eigen::Vector3d& point : points) point = tag.T_station_tag * point;
  return points;
}

Eigen::Isometry3d upright_tag(double x, double y, double height, double turn) {
  Eigen::Matrix3d facing;   // columns: tag axes x (right), y (down), z (into the wall) in the station frame
  facing << 0.0, 0.0, 1.0,  //
      -1.0, 0.0, 0.0,       //
      0.0, -1.0, 0.0;
  Eigen::Isometry3d T_station_tag = Eigen::Isometry3d::Identity();
  T_station_tag.linear() = Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()).toRotationMatrix() * facing;
  T_station_tag.translation() << x, y, height;
  return T_station_tag;
}

Board default_board(double height) {
  constexpr double edge = 0.16;
  constexpr double plate = 0.20;  // the tag with its white border
  constexpr double wing_offset = 0.20;
  constexpr double tilt = std::numbers::pi / 6.0;
  // The inner edges of the wing plates stand this much proud of the plane of the wing centres.
  const double proud = 0.5 * plate * std::sin(tilt);
  Board board;
  // A wing at y > 0 (left when facing the wall, so left in the image) turns its face outwards, to the left: seen from
  // above that is clockwise, since the face looks along -x.
  board.tags.push_back({0, edge, upright_tag(0.0, wing_offset, height, -tilt)});
  board.tags.push_back({1, edge, upright_tag(-proud, 0.0, height, 0.0)});
  board.tags.push_back({2, edge, upright_tag(0.0, -wing_offset, height, tilt)});
  return board;
}

}  // namespace tagdock
