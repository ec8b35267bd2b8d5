#pragma once

#include <vector>

#include "planning/path.h"

namespace tagdock {

/// A corner of a polygon in the station frame [m].
struct Corner {
  double x = 0.0;
  double y = 0.0;

  bool operator==(const Corner&) const = default;
};
/// A simple polygon, closed from its last corner to its first; three corners or more.
using Polygon = std::vector<Corner>;

/// The robot from above, a rectangle around the axle.
struct Footprint {
  double ahead = 0.4;   ///< before the axle [m]
  double behind = 0.4;  ///< [m]
  double width = 0.6;   ///< [m]

  bool operator==(const Footprint&) const = default;
};

/// Where the robot must not be.
struct KeepOut {
  std::vector<Polygon> polygons;  ///< station frame
  Footprint footprint;
  double margin = 0.05;         ///< free room around the footprint [m]
  double contact_within = 0.0;  ///< the last part of the way [m] that is not checked: a dock may be touched

  bool operator==(const KeepOut&) const = default;
};

/// Distance between the robot's outline at T_station_base and a polygon [m]; zero if they touch or overlap.
double clearance(const Pose2& T_station_base, const Footprint& footprint, const Polygon& polygon);

/// Does the robot stay clear along a path? Checked in steps that no point of the outline can outrun, down to 1 mm: a
/// path that passes has more than `margin` less 1 mm of room everywhere.
bool keeps_clear(const Path& path, const KeepOut& keep_out);

}  // namespace tagdock
