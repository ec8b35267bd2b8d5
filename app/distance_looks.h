#pragma once

#include <filesystem>
#include <vector>

#include "app/campaign_run.h"

namespace tagdock {

/// What one frame says from a place at which the robot stands: for the paper's Fig. 8.
struct DistanceLook {
  double distance = 0.0;         ///< true, from the board's centre to the camera point [m]
  double reprojection_px = 0.0;  ///< rms
  double distance_error = 0.0;   ///< of the distance by this frame alone, seen less true [m]
};

/// Looks from 1.0 to 6.5 m with the rig, board and corners of a campaign, several robots and frames at each distance:
/// from 26 degrees beside the axis with the paper's strategy, on the axis with the servo's. A frame that shows no board
/// gives no look. With images few, since each is rendered.
std::vector<DistanceLook> looks_over_distance(const RunSettings& settings, std::uint64_t seed);

/// distance,reprojection_px,distance_error. Read gives none where the file is missing.
/// Throws Failure(usage) with file and line.
void write_looks(const std::filesystem::path& file, const std::vector<DistanceLook>& looks);
std::vector<DistanceLook> read_looks(const std::filesystem::path& file);

}  // namespace tagdock
