#include "planning/path.h"

#include <algorithm>
#include <array>

namespace tagdock {
namespace {

// 10-point Gauss-Legendre rule on [-1, 1]; exact to rounding for the phase range that one panel is allowed below.
constexpr std::array<double, 5> gauss_nodes = {0.1488743389816312, 0.4333953941292472, 0.6794095682990244,
                                               0.8650633666889845, 0.9739065285171717};
constexpr std::array<double, 5> gauss_weights = {0.2955242247147529, 0.2692667193099963, 0.2190863625159820,
                                                 0.1494513491505806, 0.0666713443086881};

double sinc(double x) { return std::abs(x) < 1e-4 ? 1.0 - x * x / 6.0 : std::sin(x) / x; }

// Displacement of a clothoid piece in its start frame by quadrature, in panels of at most about 1 rad of turn.
Pose2 clothoid_displacement(double curvature, double sharpness, double driven) {
  const double turn_bound = std::abs(driven) * (std::abs(curvature) + std::abs(sharpness * driven));
  const int panels = std::clamp(static_cast<int>(std::ceil(turn_bound)), 1, 100000);
  const double half = 0.5 * driven / panels;
  double x = 0.0;
  double y = 0.0;
  for (int panel = 0; panel < panels; ++panel) {
    const double middle = (2 * panel + 1) * half;
    for (std::size_t i = 0; i < gauss_nodes.size(); ++i) {
      for (const double sign : {-1.0, 1.0}) {
        const double s = middle + sign * gauss_nodes[i] * half;
        const double heading = s * (curvature + 0.5 * sharpness * s);
        x += gauss_weights[i] * half * std::cos(heading);
        y += gauss_weights[i] * half * std::sin(heading);
      }
    }
  }
  return {x, y, driven * (curvature + 0.5 * sharpness * driven)};
}

}  // namespace

Pose2 pose_along(const Pose2& start, const Segment& segment, double driven) {
  if (segment.sharpness != 0.0) return start * clothoid_displacement(segment.curvature, segment.sharpness, driven);
  const double turn = driven * segment.curvature;
  const double chord = driven * sinc(0.5 * turn);
  return start * Pose2{chord * std::cos(0.5 * turn), chord * std::sin(0.5 * turn), turn};
}

double length(const Path& path) {
  double sum = 0.0;
  for (const Segment& segment : path.segments) sum += std::abs(segment.length);
  return sum;
}

PathPoint point_at(const Path& path, double distance) {
  PathPoint point{path.start, 0.0, 1};
  double rest = std::max(0.0, distance);
  for (const Segment& segment : path.segments) {
    const double span = std::abs(segment.length);
    const double driven = std::copysign(std::min(rest, span), segment.length);
    const Pose2 start = point.pose;
    point = {pose_along(start, segment, driven), segment.curvature + segment.sharpness * driven,
             segment.length < 0.0 ? -1 : 1};
    if (rest <= span) return point;
    rest -= span;
  }
  return point;
}

double curvature_at(const Path& path, double distance) {
  double curvature = 0.0;
  double rest = std::max(0.0, distance);
  for (const Segment& segment : path.segments) {
    const double span = std::abs(segment.length);
    curvature = segment.curvature + segment.sharpness * std::copysign(std::min(rest, span), segment.length);
    if (rest <= span) break;
    rest -= span;
  }
  return curvature;
}

PathWalk::PathWalk(const Path& path) : path_(path) {
  starts_.reserve(path.segments.size() + 1);
  starts_.push_back(path.start);
}

PathPoint PathWalk::at(double distance) {
  PathPoint point{path_.start, 0.0, 1};
  double rest = std::max(0.0, distance);
  for (std::size_t i = 0; i < path_.segments.size(); ++i) {
    const Segment& segment = path_.segments[i];
    const double span = std::abs(segment.length);
    const bool here = rest <= span;
    const double driven = std::copysign(here ? rest : span, segment.length);
    point.curvature = segment.curvature + segment.sharpness * driven;
    point.direction = segment.length < 0.0 ? -1 : 1;
    if (here) {
      point.pose = pose_along(starts_[i], segment, driven);
      return point;
    }
    if (i + 1 == starts_.size()) starts_.push_back(pose_along(starts_[i], segment, driven));
    point.pose = starts_[i + 1];
    rest -= span;
  }
  return point;
}

Pose2 end_pose(const Path& path) {
  Pose2 pose = path.start;
  for (const Segment& segment : path.segments) pose = pose_along(pose, segment, segment.length);
  return pose;
}

int cusps(const Path& path) {
  int changes = 0;
  double last = 0.0;
  for (const Segment& segment : path.segments) {
    if (segment.length == 0.0) continue;
    if (last * segment.length < 0.0) ++changes;
    last = segment.length;
  }
  return changes;
}

}  // namespace tagdock
