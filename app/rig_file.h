#pragma once

#include <filesystem>
#include <vector>

#include "app/fields.h"
#include "calibration/rig.h"
#include "calibration/target.h"

namespace tagdock {

/// The keys of a rig (the block that `calibrate` writes) and of a board; CONTRACTS.md gives their meaning.
void visit(Fields& fields, Rig& rig);
void visit(Fields& fields, Board& board);

/// Distortion as `dist` lists it: k1, k2, p1, p2, k3, k4, k5, k6; those at the end that are not given are 0.
void set_distortion(CameraModel& camera, std::vector<double> dist);

/// Reads a rig file. Keys that only judges read (sigmas, rejected views) are passed over. Every value must be there;
/// only a calibration against a tracker, told by its uncertainty, may be without odometry and then has the default one.
/// Throws Failure(usage) with file, line and key.
Rig read_rig(const std::filesystem::path& file);

/// Reads a board file. Was it printed larger or smaller than drawn (measured_over_drawn_x, measured_over_drawn_y), the
/// board given is the one that was printed. A board that `calibrate station` refused is no board to dock at.
/// Throws Failure(usage): no tags, an id twice, a size outside 0.01..2 m, a tag without id, size or place, a print that
/// is stretched so that tags are no squares.
Board read_board(const std::filesystem::path& file);

/// A board as drawn, with keys for what the rulers of its print measure.
std::string drawn_board_text(Board board);

}  // namespace tagdock
