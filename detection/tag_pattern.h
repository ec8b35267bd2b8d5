#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace tagdock {

/// What is printed on a tag, as square cells ("modules") row by row from the top left, as the tag is read.
struct TagPattern {
  enum Cell : std::int8_t { black = 0, white = 1, unknown = 2 };

  int cells = 0;         ///< on a side of the whole print, its light or data-carrying margin included
  int border_cells = 0;  ///< on a side of the square whose corners are reported
  std::vector<Cell> cell;

  [[nodiscard]] Cell at(int column, int row) const { return cell[static_cast<std::size_t>(row * cells + column)]; }
};

/// The pattern of a tag. Cells that a family leaves open (outside a circle tag's data) are `unknown`.
/// @param family  tag36h11, tag25h9, tag16h5, tagStandard41h12, tagStandard52h13, tagCircle21h7 or tagCircle49h12
/// Throws std::invalid_argument when the family is none of these or has no such id.
TagPattern tag_pattern(const std::string& family, int id);

}  // namespace tagdock
