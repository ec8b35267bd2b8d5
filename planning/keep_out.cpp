#include "planning/keep_out.h"

#include <algorithm>
#include <array>
#include <limits>

namespace tagdock {
namespace {

constexpr double tolerance = 1e-3;  // m; what the clearance between two looks may be below the margin

double cross(const Corner& o, const Corner& a, const Corner& b) {
  return (a.x - o.x) * (b.y - o.y) - (a.y - o.y) * (b.x - o.x);
}

/// Of a point from a side, squared [m^2].
double squared_distance(const Corner& point, const Corner& a, const Corner& b) {
  const double dx = b.x - a.x;
  const double dy = b.y - a.y;
  const double squared = dx * dx + dy * dy;
  const double along =
      squared > 0.0 ? std::clamp(((point.x - a.x) * dx + (point.y - a.y) * dy) / squared, 0.0, 1.0) : 0.0;
  const double x = point.x - a.x - along * dx;
  const double y = point.y - a.y - along * dy;
  return x * x + y * y;
}

bool cut(const Corner& a, const Corner& b, const Corner& c, const Corner& d) {
  return cross(a, b, c) * cross(a, b, d) < 0.0 && cross(c, d, a) * cross(c, d, b) < 0.0;
}

template <class Corners>
bool contains(const Corners& polygon, const Corner& point) {
  bool inside = false;
  for (std::size_t i = 0, j = polygon.size() - 1; i < polygon.size(); j = i++) {
    const Corner& a = polygon[i];
    const Corner& b = polygon[j];
    if ((a.y > point.y) != (b.y > point.y) && point.x < (b.x - a.x) * (point.y - a.y) / (b.y - a.y) + a.x)
      inside = !inside;
  }
  return inside;
}

}  // namespace

double clearance(const Pose2& T_station_base, const Footprint& footprint, const Polygon& polygon) {
  if (polygon.empty()) return std::numeric_limits<double>::infinity();
  const double c = std::cos(T_station_base.yaw);
  const double s = std::sin(T_station_base.yaw);
  const auto placed = [&](double x, double y) {
    return Corner{T_station_base.x + c * x - s * y, T_station_base.y + s * x + c * y};
  };
  const double half = 0.5 * footprint.width;
  const std::array<Corner, 4> outline = {placed(footprint.ahead, half), placed(-footprint.behind, half),
                                         placed(-footprint.behind, -half), placed(footprint.ahead, -half)};
  if (contains(polygon, outline[0]) || contains(outline, polygon[0])) return 0.0;
  double least = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Corner& a = polygon[i];
    const Corner& b = polygon[(i + 1) % polygon.size()];
    for (std::size_t j = 0; j < outline.size(); ++j) {
      const Corner& from = outline[j];
      const Corner& to = outline[(j + 1) % outline.size()];
      if (cut(a, b, from, to)) return 0.0;
      least = std::min({least, squared_distance(from, a, b), squared_distance(a, from, to)});
    }
  }
  return std::sqrt(least);
}

bool keeps_clear(const Path& path, const KeepOut& keep_out) {
  if (keep_out.polygons.empty()) return true;
  const double reach =
      std::hypot(std::max(keep_out.footprint.ahead, keep_out.footprint.behind), 0.5 * keep_out.footprint.width);
  double until = keep_out.contact_until;
  double left = length(path) - keep_out.contact_within;
  Pose2 at = path.start;
  for (const Segment& segment : path.segments) {
    const double whole = std::abs(segment.length);
    const double span = std::min(whole, left);
    const double curvature = std::max(std::abs(segment.curvature), std::abs(segment.end_curvature()));
    // Of any point of the outline, per metre of path. Between two looks s apart a distance d to a corner or an edge is
    // at most bend s^2 / 8 below the smaller of the two: a point passing a corner bends d by speed^2 / d, a turning
    // robot by its points' own acceleration.
    const double speed = 1.0 + curvature * reach;
    const double bend = speed * speed / std::max(keep_out.margin - tolerance, tolerance) + curvature * speed +
                        std::abs(segment.sharpness) * reach;
    const double shortest = std::max(tolerance / speed, std::sqrt(8.0 * tolerance / bend));
    for (double driven = std::max(0.0, until); span >= driven;) {
      const Pose2 pose = pose_along(at, segment, std::copysign(driven, segment.length));
      double room = std::numeric_limits<double>::infinity();
      for (const Polygon& polygon : keep_out.polygons)
        room = std::min(room, clearance(pose, keep_out.footprint, polygon));
      if (!(room > keep_out.margin)) return false;
      if (driven >= span) break;
      driven = std::min(span, driven + std::max(shortest, (room - keep_out.margin) / speed));
    }
    left -= whole;
    until -= whole;
    if (left < 0.0) return true;
    at = pose_along(at, segment, segment.length);
  }
  return true;
}

Nearest nearest_approach(const Path& path, const KeepOut& keep_out, double spacing) {
  Nearest nearest{std::numeric_limits<double>::infinity(), 0.0, 0};
  const double end = length(path) - keep_out.contact_within;
  const double begin = keep_out.contact_until;
  const int looks = std::max(1, static_cast<int>(std::ceil((end - begin) / spacing)));
  double before = 0.0;  // driven until the segment
  std::size_t index = 0;
  Pose2 at = path.start;
  for (int i = 0; i <= looks && begin <= end; ++i) {
    const double driven = begin + (end - begin) * i / looks;
    while (index + 1 < path.segments.size() && driven - before > std::abs(path.segments[index].length)) {
      before += std::abs(path.segments[index].length);
      at = pose_along(at, path.segments[index], path.segments[index].length);
      ++index;
    }
    const Pose2 pose = path.segments.empty() ? at
                                             : pose_along(at, path.segments[index],
                                                          std::copysign(driven - before, path.segments[index].length));
    for (std::size_t k = 0; k < keep_out.polygons.size(); ++k) {
      const double room = clearance(pose, keep_out.footprint, keep_out.polygons[k]);
      if (room < nearest.room) nearest = {room, driven, k};
    }
  }
  return nearest;
}

}  // namespace tagdock
