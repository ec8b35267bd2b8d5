#include "planning/board_view.h"

#include <algorithm>
#include <limits>

namespace tagdock {
namespace {

constexpr double step_floor = 1e-3;   // m; within it a board edge can cross the image border and back by under 1 um
constexpr double look_spacing = 0.1;  // m; between looks at measuring poses

struct Vector {
  double x = 0.0;
  double y = 0.0;
};

/// A view wish with what is needed of it again and again.
struct Sight {
  const ViewWish& view;
  double limit = 0.5 * view.horizontal_view - view.margin;
  double cos_limit = std::cos(limit);
  double sin_limit = std::sin(limit);
  double cos_camera = std::cos(view.camera_yaw);
  double sin_camera = std::sin(view.camera_yaw);
  double cos_board = std::cos(view.T_station_board.yaw);
  double sin_board = std::sin(view.T_station_board.yaw);

  /// A point of the station in the camera's frame: x along the optical axis, y to the left.
  struct Camera {
    double x, y, c, s;
    [[nodiscard]] Vector operator()(double px, double py) const {
      return {c * (px - x) + s * (py - y), c * (py - y) - s * (px - x)};
    }
  };
  [[nodiscard]] Camera camera(const Pose2& base) const {
    const double c = std::cos(base.yaw);
    const double s = std::sin(base.yaw);
    return {base.x + view.camera_ahead * c, base.y + view.camera_ahead * s, c * cos_camera - s * sin_camera,
            s * cos_camera + c * sin_camera};
  }
  [[nodiscard]] Vector seen(const Camera& from, double along_board) const {
    return from(view.T_station_board.x - sin_board * along_board, view.T_station_board.y + cos_board * along_board);
  }
  /// Distance of a point from the two borders of the image [m], negative outside; holds for views below 180 deg.
  [[nodiscard]] double room(const Vector& point, double side) const {
    return point.x * sin_limit - side * point.y * cos_limit;
  }
};

/// Longest way over which value + slope s - bend s^2 / 2 stays above zero.
double safe_way(double value, double slope, double bend) {
  if (slope >= 0.0 && bend == 0.0) return std::numeric_limits<double>::infinity();
  const double root = std::sqrt(slope * slope + 2.0 * bend * std::max(0.0, value));
  // The larger root of the parabola, in the form that does not cancel.
  return slope >= 0.0 ? (slope + root) / bend : 2.0 * std::max(0.0, value) / (root - slope);
}

}  // namespace

double board_bearing(const Pose2& T_station_base, const ViewWish& view) {
  const Sight sight{view};
  const Sight::Camera camera = sight.camera(T_station_base);
  double largest = 0.0;
  for (const double edge : {-view.board_half_width, view.board_half_width}) {
    const Vector point = sight.seen(camera, edge);
    largest = std::max(largest, std::abs(std::atan2(point.y, point.x)));
  }
  return largest;
}

bool in_view(const Pose2& T_station_base, const ViewWish& view) {
  const Sight sight{view};
  const Sight::Camera camera = sight.camera(T_station_base);
  for (const double edge : {-view.board_half_width, view.board_half_width}) {
    const Vector point = sight.seen(camera, edge);
    if (sight.room(point, 1.0) < 0.0 || sight.room(point, -1.0) < 0.0) return false;
  }
  const Vector centre = sight.seen(camera, 0.0);
  const double range = std::hypot(centre.x, centre.y);
  return range >= view.min_range && range <= view.max_range;
}

bool keeps_view(const Path& path, const ViewWish& view, double& largest) {
  const Sight sight{view};
  largest = 0.0;
  double steepest = 0.0;  // of |y| / x: the bearing without its arcus tangent
  Pose2 at = path.start;
  const auto finish = [&](bool kept) {
    largest = steepest < std::numeric_limits<double>::infinity() ? std::atan(steepest) : std::numbers::pi;
    return kept;
  };
  for (const Segment& segment : path.segments) {
    const double span = std::abs(segment.length);
    const double way = segment.length < 0.0 ? -1.0 : 1.0;
    const double bound = std::max(std::abs(segment.curvature), std::abs(segment.end_curvature()));
    const double sharpness = std::abs(segment.sharpness);
    Pose2 pose = at;
    for (double driven = 0.0;;) {
      const double curvature = segment.curvature + segment.sharpness * way * driven;
      const Sight::Camera camera = sight.camera(pose);
      // How the camera moves in its own frame per metre, and turns.
      const double lever = curvature * view.camera_ahead;
      const Vector speed{way * (sight.cos_camera + lever * sight.sin_camera),
                         way * (lever * sight.cos_camera - sight.sin_camera)};
      const double turning = way * curvature;
      const auto motion = [&](const Vector& point) {
        return Vector{-speed.x + turning * point.y, -speed.y - turning * point.x};
      };
      const Vector centre = sight.seen(camera, 0.0);
      const double range = std::hypot(centre.x, centre.y);
      // No step is longer than half the range, so no board point comes farther away than this.
      const double longest = std::max(0.5 * range, step_floor);
      const double reach = range + longest + view.board_half_width + std::abs(view.camera_ahead);
      const double fastest = 1.0 + bound * reach;               // of any board point in the camera's frame
      const double bend = bound * fastest + sharpness * reach;  // and its acceleration
      double free = longest;
      for (const double edge : {-view.board_half_width, view.board_half_width}) {
        const Vector point = sight.seen(camera, edge);
        const Vector moves = motion(point);
        for (const double side : {1.0, -1.0}) {
          const double room = sight.room(point, side);
          if (point.x > 0.0)
            steepest = std::max(steepest, std::abs(point.y) / point.x);
          else
            steepest = std::numeric_limits<double>::infinity();
          if (room < 0.0) return finish(false);
          free = std::min(free, safe_way(room, sight.room(moves, side), bend));
        }
      }
      if (range < view.min_range || range > view.max_range) return finish(false);
      if (range > 0.0) {
        const Vector moves = motion(centre);
        const double rate = (centre.x * moves.x + centre.y * moves.y) / range;
        if (view.min_range > 0.0) free = std::min(free, safe_way(range - view.min_range, rate, bend));
        const double outward = bend + 2.0 * fastest * fastest / range;
        free = std::min(free, safe_way(view.max_range - range, -rate, outward));
      }
      if (driven >= span) break;
      driven = std::min(span, driven + std::max(step_floor, free));
      pose = pose_along(at, segment, way * driven);
    }
    at = pose;
  }
  return finish(true);
}

double incidence(const Pose2& T_station_base, const ViewWish& view, const Pose2& T_board_tag) {
  const Pose2 camera = T_station_base * Pose2{view.camera_ahead, 0.0, 0.0};
  const Pose2 seen = between(view.T_station_board * T_board_tag, camera);
  return std::abs(std::atan2(seen.y, -seen.x));
}

double incidence_fault(const Pose2& T_station_base, const ViewWish& view) {
  double least = view.tags.empty() ? 0.0 : std::numeric_limits<double>::infinity();
  for (const Pose2& tag : view.tags) {
    const double angle = incidence(T_station_base, view, tag);
    least = std::min(least, std::max({0.0, view.least_incidence - angle, angle - view.most_incidence}));
  }
  return least;
}

double incidence_fault(const Path& path, const ViewWish& view) {
  if (view.tags.empty()) return 0.0;
  double worst = view.measured_at_start ? incidence_fault(path.start, view) : 0.0;
  if (view.measured_over_last < 0.0) return worst;
  const double whole = length(path);
  const double over = std::min(view.measured_over_last, whole);
  const int looks = 1 + static_cast<int>(std::ceil(over / look_spacing));
  for (int i = 0; i < looks; ++i) {
    const double driven = looks > 1 ? whole - over * i / (looks - 1) : whole;
    worst = std::max(worst, incidence_fault(point_at(path, driven).pose, view));
  }
  return worst;
}

}  // namespace tagdock
