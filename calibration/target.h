#pragma once

#include <array>
#include <string>
#include <vector>

#include <Eigen/Geometry>

namespace tagdock {

/// Corners of a tag's black square in the order in which the tag is read: top left, top right, bottom right, bottom
/// left.
using Corners = std::array<Eigen::Vector2d, 4>;
using TagPoints = std::array<Eigen::Vector3d, 4>;

/// The same corners in the tag frame (origin at the centre, x right, y down, z into the wall).
/// @param size  side of the black square [m]
TagPoints tag_corners(double size);

/// A tag that stands at a known place of a station.
struct BoardTag {
  int id = 0;
  double size = 0.0;  ///< side of the black square [m]
  Eigen::Isometry3d T_station_tag = Eigen::Isometry3d::Identity();
};

/// Tags that stand rigidly together; the station frame has its origin on the floor under the board's centre,
/// x towards the wall, y to the left when facing it, z up.
struct Board {
  std::string family = "tag36h11";
  std::vector<BoardTag> tags;
};

/// The tag of that id; none if the board has no such tag.
const BoardTag* find_tag(const Board& board, int id);

/// The corners of a board's tag in the station frame.
TagPoints corners_station(const BoardTag& tag);

/// T_station_tag of an upright tag.
/// @param x, y, height  centre of the tag in the station frame [m]
/// @param turn          about the vertical, counter-clockwise seen from above [rad]; 0 faces the arriving robot
Eigen::Isometry3d upright_tag(double x, double y, double height, double turn);

/// The default board: two tags turned by 30 degrees about the vertical, inner edges nearer to the robot (convex V),
/// with a centre tag flush with those inner edges (notes: bearable with poor corners, seen at 25..75 degrees all the
/// way in). Ids 0 (left wing as seen), 1 (centre), 2 (right wing); edge 0.16 m, centres at `height`.
Board default_board(double height);

}  // namespace tagdock
