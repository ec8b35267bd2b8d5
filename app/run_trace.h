#pragma once

#include <filesystem>
#include <optional>
#include <vector>

#include "planning/pose2.h"

namespace tagdock {

/// The way of one run, as the simulator knows it and as the robot saw it.
struct TracePoint {
  double time_s = 0.0;
  Pose2 camera_point;                     ///< true, station frame
  std::optional<double> reprojection_px;  ///< of a sighting at this time
  std::optional<Pose2> seen;              ///< the camera point by that sighting alone
};
using RunTrace = std::vector<TracePoint>;

/// The first standstill of a run: where it was, and where its sightings said, on average.
struct StartLook {
  Pose2 truth;  ///< camera point, station frame
  Pose2 seen;
};

/// None if the robot saw nothing before it moved. Later sightings are of a time before their arrival, so that on the
/// way the two would differ by what was driven in between.
std::optional<StartLook> start_look(const RunTrace& trace);

/// A file each run: time_s,x,y,yaw,reprojection_px,seen_x,seen_y,seen_yaw.
void write_trace(const std::filesystem::path& file, const RunTrace& trace);

/// Throws Failure(usage) with file and line.
RunTrace read_trace(const std::filesystem::path& file);

}  // namespace tagdock
