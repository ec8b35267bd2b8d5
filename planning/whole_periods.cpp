#include "planning/whole_periods.h"

#include <algorithm>
#include <limits>

#include <Eigen/Core>
#include <Eigen/LU>

namespace tagdock {
namespace {

constexpr double epsilon = std::numeric_limits<double>::epsilon();

/// How the end of a path moves [x y yaw] with the curvature of a segment, and with its length in proportion.
struct Influence {
  Eigen::Vector3d of_curvature;
  Eigen::Vector3d of_scale;
};

Influence influence(const Pose2& from, const Segment& segment, const Pose2& end) {
  // Simpson's rule over the segment: a Jacobian need not be exact, the residual is.
  Influence sum{Eigen::Vector3d::Zero(), Eigen::Vector3d::Zero()};
  for (const auto& [place, weight] :
       {std::pair{0.0, 1.0 / 6.0}, std::pair{0.5, 4.0 / 6.0}, std::pair{1.0, 1.0 / 6.0}}) {
    const Pose2 at = pose_along(from, segment, place * segment.length);
    const Eigen::Vector3d turned(at.y - end.y, end.x - at.x, 1.0);
    sum.of_curvature += weight * segment.length * turned;
    sum.of_scale += weight * segment.length *
                    (Eigen::Vector3d(std::cos(at.yaw), std::sin(at.yaw), 0.0) + segment.curvature * turned);
  }
  return sum;
}

/// Curvatures and the common scale of the lengths, moved by Newton steps of least norm until the path ends at the goal.
bool repair(Path& path, const Pose2& goal, double max_curvature) {
  // What counts as equally much: a twentieth of the curvature and a twentieth of the length.
  const double curvature_unit = 0.05 * max_curvature;
  constexpr double scale_unit = 0.05;
  double last = std::numeric_limits<double>::infinity();
  for (int round = 0; round < 40; ++round) {
    const Pose2 end = end_pose(path);
    const double scale = length(path) + std::abs(goal.x) + std::abs(goal.y);
    const Eigen::Vector3d open(goal.x - end.x, goal.y - end.y, heading_difference(end.yaw, goal.yaw));
    const double size = std::max(std::hypot(open.x(), open.y()) / scale, std::abs(open.z()));
    if (size <= 4.0 * epsilon || (size <= 64.0 * epsilon && size >= 0.5 * last)) return true;
    last = size;
    const auto free = [&](const Segment& segment) {
      return segment.curvature != 0.0 && std::abs(segment.curvature) < max_curvature;
    };
    Eigen::Matrix3d normal = Eigen::Matrix3d::Zero();
    Eigen::Vector3d of_scale = Eigen::Vector3d::Zero();
    Pose2 at = path.start;
    for (const Segment& segment : path.segments) {
      const Influence moved = influence(at, segment, end);
      of_scale += scale_unit * moved.of_scale;
      if (free(segment)) {
        const Eigen::Vector3d column = curvature_unit * moved.of_curvature;
        normal += column * column.transpose();
      }
      at = pose_along(at, segment, segment.length);
    }
    normal += of_scale * of_scale.transpose();
    // A straight path cannot move sideways: what it need not do it is kept from trying.
    normal += 1e-13 * normal.trace() * Eigen::Matrix3d::Identity();
    const Eigen::Vector3d share = normal.inverse() * open;
    if (!share.allFinite()) return false;
    const double grow = 1.0 + scale_unit * of_scale.dot(share);
    if (!(grow > 0.8 && grow < 1.25)) return false;
    at = path.start;
    for (Segment& segment : path.segments) {
      const Segment before = segment;
      if (free(segment)) {
        const double change = curvature_unit * curvature_unit * influence(at, before, end).of_curvature.dot(share);
        segment.curvature = std::clamp(segment.curvature + change, -max_curvature, max_curvature);
      }
      at = pose_along(at, before, before.length);
      segment.length *= grow;
    }
  }
  return false;
}

}  // namespace

std::optional<double> cut_to_whole_periods(Path& path, const Pose2& goal, double most, double max_curvature,
                                           const Straights& straights) {
  const std::size_t count = path.segments.size();
  if (count == 0) return std::nullopt;
  // A straight path has its length to give only: it is cut into so many periods that they are not longer than wanted.
  double period = count == 1 ? std::abs(path.segments[0].length) / std::ceil(std::abs(path.segments[0].length) / most)
                             : most * (1.0 - 1e-3);
  // Every segment takes one period at least: where that makes the way much longer the period is too long for the path.
  const double longest = 1.1 * length(path) + period;
  int more_first = 0;
  int more_last = 0;
  for (int attempt = 0; attempt < 8; ++attempt) {
    double carried = 0.0;
    for (std::size_t i = 0; i < count; ++i) {
      Segment& segment = path.segments[i];
      const double whole = std::abs(segment.length);
      double periods = std::max(1.0, std::round((whole + carried) / period));
      const bool first = i == 0 && segment.curvature == 0.0 && straights.initial > 0.0;
      const bool last = i + 1 == count && segment.curvature == 0.0 && straights.final > 0.0;
      if (first) periods = std::max(periods, std::ceil(straights.initial / period) + more_first);
      if (last) periods = std::max(periods, std::ceil(straights.final / period) + more_last);
      carried += whole - periods * period;
      segment.length = std::copysign(periods * period, segment.length);
    }
    if (length(path) > longest || !repair(path, goal, max_curvature)) return std::nullopt;
    // The common length has changed a little. Lengths are made exact multiples of it: their rounding errors are what
    // repair() has left at the goal, and not more.
    const Segment& front = path.segments.front();
    const Segment& back = path.segments.back();
    const double first_periods = std::round(std::abs(front.length) / period);
    const double now = std::abs(front.length) / first_periods;
    const bool too_short_first =
        straights.initial > 0.0 && front.curvature == 0.0 && std::abs(front.length) < straights.initial;
    const bool too_short_last =
        straights.final > 0.0 && back.curvature == 0.0 && std::abs(back.length) < straights.final;
    if (now <= most && !too_short_first && !too_short_last) return now;
    if (too_short_first) ++more_first;
    if (too_short_last) ++more_last;
    period = now > most ? period * most / now * (1.0 - 1e-3) : now;
  }
  return std::nullopt;
}

}  // namespace tagdock
