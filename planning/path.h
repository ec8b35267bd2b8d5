#pragma once

#include <vector>

#include "planning/pose2.h"

namespace tagdock {

/// One piece of a path: curvature changes linearly along it. A line, an arc or a clothoid.
struct Segment {
  double length = 0.0;  ///< m, signed; negative is driven backwards
  double curvature =
      0.0;  ///< at the start [1/m]; positive turns left for the direction the robot faces, also in reverse
  double sharpness = 0.0;  ///< change of curvature per signed metre [1/m^2]; zero for a line or an arc

  [[nodiscard]] double end_curvature() const { return curvature + sharpness * length; }
  /// Change of heading along the whole segment [rad]: signed length times mean curvature.
  [[nodiscard]] double turn() const { return length * (curvature + 0.5 * sharpness * length); }

  bool operator==(const Segment&) const = default;
};

/// Segments driven one after the other from a start pose.
struct Path {
  Pose2 start;
  std::vector<Segment> segments;

  bool operator==(const Path&) const = default;
};

/// Where a robot that starts a segment at `start` stands after driving a part of it.
/// @param driven  signed distance along the segment, between 0 and segment.length
/// Exact to rounding: closed form for lines and arcs, Gauss-Legendre quadrature of the heading for clothoids.
Pose2 pose_along(const Pose2& start, const Segment& segment, double driven);

/// Driven distance of the whole path, always >= 0 [m].
double length(const Path& path);

/// A point of a path.
struct PathPoint {
  Pose2 pose;
  double curvature = 0.0;  ///< [1/m]
  int direction = 1;       ///< +1 forward, -1 reverse
};

/// The point after a driven distance, which is cut to [0, length(path)].
PathPoint point_at(const Path& path, double distance);

/// Its curvature alone, without the integral that the pose takes [1/m].
double curvature_at(const Path& path, double distance);

/// Points of one path one after the other: where its segments begin is integrated once. The path must live as long.
class PathWalk {
 public:
  explicit PathWalk(const Path& path);

  /// As `point_at`, to the last bit.
  PathPoint at(double distance);

 private:
  const Path& path_;
  std::vector<Pose2> starts_;  ///< of the segments, as far as they were reached
};

/// The pose at the end of the last segment.
Pose2 end_pose(const Path& path);

/// Number of changes between forward and reverse.
int cusps(const Path& path);

}  // namespace tagdock
