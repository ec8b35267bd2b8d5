#include "planning/drift.h"

#include <algorithm>

namespace tagdock {
namespace {

constexpr double panel =
    0.05;  // m; the rest of the path hardly changes its lever over it, and the rule below is exact to h^4

// How a small motion [x y yaw] at a pose moves the end.
Eigen::Matrix3d effect(const Pose2& at, const Pose2& end) {
  Eigen::Matrix3d moved = Eigen::Matrix3d::Identity();
  moved(0, 2) = -(end.y - at.y);
  moved(1, 2) = end.x - at.x;
  return moved;
}

}  // namespace

Eigen::Matrix3d covariance_at_end(const Path& path, const Eigen::Matrix3d& at_start, const OdometryDrift& drift) {
  const Pose2 end = end_pose(path);
  const Eigen::Matrix3d from_start = effect(path.start, end);
  Eigen::Matrix3d sum = from_start * at_start * from_start.transpose();
  Pose2 segment_start = path.start;
  for (const Segment& segment : path.segments) {
    const int panels = std::clamp(static_cast<int>(std::ceil(std::abs(segment.length) / panel)), 1, 10000);
    const double way = std::abs(segment.length) / panels;
    for (int i = 0; i < panels; ++i) {
      // Two-point Gauss rule in each panel.
      for (const double place : {0.5 - 0.5 / std::numbers::sqrt3, 0.5 + 0.5 / std::numbers::sqrt3}) {
        const double driven = (i + place) * segment.length / panels;
        const Pose2 at = pose_along(segment_start, segment, driven);
        const double curvature = std::abs(segment.curvature + segment.sharpness * driven);
        Eigen::Matrix3d turned = Eigen::Matrix3d::Identity();
        turned(0, 0) = turned(1, 1) = std::cos(at.yaw);
        turned(1, 0) = std::sin(at.yaw);
        turned(0, 1) = -turned(1, 0);
        Eigen::Vector3d arising(drift.along * drift.along, drift.across * drift.across,
                                drift.heading * drift.heading + curvature * drift.heading_turn * drift.heading_turn);
        const Eigen::Matrix3d lever = effect(at, end) * turned;
        sum += 0.5 * way * lever * arising.asDiagonal() * lever.transpose();
      }
    }
    segment_start = pose_along(segment_start, segment, segment.length);
  }
  return sum;
}

}  // namespace tagdock
