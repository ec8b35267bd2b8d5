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
  double contact_until = 0.0;   ///< the same for the first part, when the robot leaves a dock

  bool operator==(const KeepOut&) const = default;
};

/// Distance between the robot's outline at T_station_base and a polygon [m]; zero if they touch or overlap.
double clearance(const Pose2& T_station_base, const Footprint& footprint, const Polygon& polygon);

/// Does the robot stay clear along a path? A path that passes has more than `margin` less 1 mm of room everywhere:
/// steps are as long as the room allows no point of the outline to outrun, and never shorter than what bends a distance
/// by 1 mm between two looks.
bool keeps_clear(const Path& path, const KeepOut& keep_out);

/// Where a path comes nearest to what must not be touched.
struct Nearest {
  double room = 0.0;        ///< least clearance found [m]; infinite without polygons
  double driven = 0.0;      ///< where on the path [m]
  std::size_t polygon = 0;  ///< index of the polygon
};
/// @param spacing  of the looks along the path [m], > 0
Nearest nearest_approach(const Path& path, const KeepOut& keep_out, double spacing);

}  // namespace tagdock
