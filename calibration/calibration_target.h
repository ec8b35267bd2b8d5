#pragma once

#include <array>
#include <map>
#include <string>
#include <vector>

#include <Eigen/Core>

namespace tagdock {

/// What is printed on a calibration board. Sizes in m. The drawing has its origin at the top left of the pattern, x
/// right, y down, as one looks at it.
struct CalibrationTarget {
  enum class Type {
    charuco,    ///< chessboard with markers in its white squares; its points are the inner corners
    aprilgrid,  ///< Kalibr's grid: tags with black squares that touch their corners
    taggrid,    ///< the same without the squares
    tag         ///< one tag
  };
  Type type = Type::charuco;
  // charuco
  int squares_x = 0;
  int squares_y = 0;
  double square = 0.0;
  double marker = 0.0;
  std::string dictionary;  ///< as OpenCV names it, with or without DICT_
  // grids and tag
  int tag_cols = 1;
  int tag_rows = 1;
  double tag_size = 0.0;     ///< side of the black square
  double tag_spacing = 0.0;  ///< gap between tags as a share of tag_size
  std::string family = "tag36h11";
  int first_id = 0;  ///< of the tag, or of the grid's first one
  /// Where the points really are, by corner id; empty: as drawn.
  std::map<int, Eigen::Vector3d> measured;
  /// Measured over drawn length, as printers stretch; enters as known.
  double scale_x = 1.0;
  double scale_y = 1.0;
};

/// One way to number a board's marks. Boards of the same description are printed in more than one way (OpenCV before
/// and after 4.7, Kalibr's rows from below); which one a picture shows is decided by the picture.
struct TargetLayout {
  struct Corner {
    int id = 0;
    Eigen::Vector2d drawn = Eigen::Vector2d::Zero();  ///< in the drawing [m]
    Eigen::Vector3d point = Eigen::Vector3d::Zero();  ///< on the board, x right, y down, z away from the viewer [m]
    int parity = 0;                                   ///< 0 or 1: which diagonal is dark
  };
  std::vector<Corner> corners;
  /// Marks that are decoded: id -> corners top left, top right, bottom right, bottom left in the drawing.
  std::map<int, std::array<Eigen::Vector2d, 4>> marks;
  double reach = 0.0;      ///< edges run straight from a corner for this length [m]
  double clearance = 0.0;  ///< within this distance of the edges nothing else is printed [m]
  double width = 0.0;      ///< of the drawing [m]
  double height = 0.0;
};

/// All layouts that the description allows, the usual one first.
/// Throws std::invalid_argument that names the key that makes no sense.
std::vector<TargetLayout> layouts_of(const CalibrationTarget& target);

}  // namespace tagdock
