#include "planning/path.h"

#include <algorithm>

#include <catch2/catch.hpp>

using namespace tagdock;

namespace {

// Truth by brute force: the midpoint rule in long double with steps small enough for 1e-12.
Pose2 integrated(const Segment& segment, int steps) {
  long double x = 0;
  long double y = 0;
  const long double h = static_cast<long double>(segment.length) / steps;
  for (int i = 0; i < steps; ++i) {
    const long double s = (i + 0.5L) * h;
    const long double heading = s * (segment.curvature + 0.5L * segment.sharpness * s);
    x += h * std::cos(heading);
    y += h * std::sin(heading);
  }
  return {static_cast<double>(x), static_cast<double>(y), segment.turn()};
}

}  // namespace

TEST_CASE("a line, an arc and a clothoid end where brute-force integration says, forward and in reverse") {
  for (const Segment& segment : {Segment{2.0, 0.0, 0.0}, Segment{-1.5, 0.8, 0.0}, Segment{1.2, 0.0, 1.5},
                                 Segment{-1.2, 0.4, -0.9}, Segment{6.0, -0.5, 0.7}, Segment{1.0, 1e-9, 0.0}}) {
    CAPTURE(segment.length, segment.curvature, segment.sharpness);
    const Pose2 end = pose_along({}, segment, segment.length);
    const Pose2 truth = integrated(segment, 2000000);  // midpoint error below 1e-11 m for these segments
    CHECK(end.x == Approx(truth.x).margin(1e-10));
    CHECK(end.y == Approx(truth.y).margin(1e-10));
    CHECK(end.yaw == Approx(truth.yaw).margin(1e-13));
  }
}

TEST_CASE("the point of a path at its length is its end, and distances outside are cut") {
  const Path path{{1.0, 2.0, 0.3}, {{1.0, 0.0, 0.0}, {0.8, 0.0, 1.0}, {0.8, 0.8, -1.0}}};
  const Pose2 end = end_pose(path);
  CHECK(length(path) == Approx(2.6));
  CHECK(point_at(path, length(path)).pose.x == Approx(end.x).margin(1e-14));
  CHECK(point_at(path, 100.0).pose.y == Approx(end.y).margin(1e-14));
  CHECK(point_at(path, -1.0).pose == path.start);
  CHECK(point_at(path, 1.8).curvature == Approx(0.8));
}

TEST_CASE("a change from forward to reverse is a cusp") {
  CHECK(cusps({{}, {{1.0, 0.0, 0.0}, {-1.0, 0.5, 0.0}, {-0.5, 0.0, 0.0}, {1.0, 0.0, 0.0}}}) == 2);
}

TEST_CASE("points of a walk along a path are those of the path, in whatever order they are asked for") {
  const Path path{{1.0, 2.0, 0.3}, {{1.0, 0.0, 0.0}, {0.8, 0.0, 1.0}, {0.8, 0.8, -1.0}, {-0.5, 0.0, 0.2}}};
  PathWalk walk(path);
  for (const double distance : {-1.0, 0.0, 0.5, 1.0, 1.3, 2.6, 2.2, 3.0, 0.9, 3.1, 9.0, 1.8}) {
    CAPTURE(distance);
    // Truth: every segment before the point is driven whole, one after the other.
    Pose2 start = path.start;
    double rest = std::clamp(distance, 0.0, length(path));
    std::size_t i = 0;
    while (i + 1 < path.segments.size() && rest > std::abs(path.segments[i].length)) {
      start = pose_along(start, path.segments[i], path.segments[i].length);
      rest -= std::abs(path.segments[i++].length);
    }
    const Segment& segment = path.segments[i];
    const double driven = std::copysign(std::min(rest, std::abs(segment.length)), segment.length);
    const PathPoint seen = walk.at(distance);
    CHECK(seen.pose == pose_along(start, segment, driven));
    CHECK(seen.curvature == segment.curvature + segment.sharpness * driven);
    CHECK(seen.direction == (segment.length < 0.0 ? -1 : 1));
    CHECK(curvature_at(path, distance) == seen.curvature);
    CHECK(point_at(path, distance).pose == seen.pose);
  }
}

TEST_CASE("a pose seen from another one and an angle that is wrapped are to the last bit what their definitions give") {
  for (const double yaw : {0.0, 0.4, -2.9, 3.1415, 7.0, -40.0}) {
    const Pose2 a{1.2, -0.7, yaw};
    const Pose2 b{-3.1, 0.2, 0.3 * yaw + 0.1};
    CHECK(between(a, b) == inverse(a) * b);
    const double wrapped = std::remainder(yaw, 2.0 * std::numbers::pi);
    CHECK(wrap_angle(yaw) == wrapped);
  }
  CHECK(wrap_angle(std::numbers::pi) == std::numbers::pi);
  CHECK(wrap_angle(-std::numbers::pi) == std::numbers::pi);
}
