#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "calibration/calibration_target.h"
#include "calibration/target.h"

namespace tagdock {

/// A sheet of paper, landscape [mm].
struct Paper {
  std::string name;
  double width = 0.0;
  double height = 0.0;
};

/// A0 to A5, letter, tabloid. Throws Failure(usage) with the names.
Paper paper_of(const std::string& name);

/// The same target with the sizes that are not given (zero) as large as the paper allows, in whole tenths of a mm.
/// Throws Failure(usage) if a given size does not fit, and says on which paper it would.
CalibrationTarget fitted(const CalibrationTarget& target, const Paper& paper);

/// Draws a calibration target at its true size: the pattern, a ruler of 100 mm along each axis, what it is, and room
/// for the two lengths that were measured. One page. Throws Failure(usage) if the file cannot be written.
void print_target(const CalibrationTarget& target, const Paper& paper, const std::filesystem::path& pdf);

/// Draws a station's board of three tags (wing, centre, wing), each on a plate with its white margin: on one sheet with
/// two fold lines if the paper is large enough, else a plate a page, with cutting marks.
/// @param plate  side of a wing's plate [m]
void print_board(const Board& board, double plate, double fold, const Paper& paper, const std::filesystem::path& pdf);

/// The V board scaled so that its tags have this size [m]; `default_board` is that of 0.16 m.
Board v_board(double tag_size, double height);

}  // namespace tagdock
