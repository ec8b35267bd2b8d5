#include "planning/arc_approximation.h"

#include <algorithm>
#include <limits>
#include <vector>

namespace tagdock {
namespace {

// Swing of the zero-mean heading error inside a step, and the offset that the first late arc leaves behind.
const double deviation_factor = std::sqrt(3.0) / 216.0 + 1.0 / 144.0;
constexpr int most_steps = 1000;

int at_least(double steps) { return static_cast<int>(std::clamp(std::ceil(steps), 1.0, double(most_steps))); }

}  // namespace

double ramp_deviation(const TurnLimits& limits, int steps) {
  const double step = limits.max_curvature / limits.max_sharpness / steps;
  return deviation_factor * limits.max_sharpness * step * step * step;
}

int arc_steps(const TurnLimits& limits, const ArcWish& wish) {
  int steps = std::clamp(wish.steps, 1, most_steps);
  if (wish.deviation > 0.0)
    steps = std::max(steps, at_least(std::cbrt(ramp_deviation(limits, 1) / (0.5 * wish.deviation))));
  if (wish.curvature_step > 0.0) steps = std::max(steps, at_least(limits.max_curvature / wish.curvature_step));
  return steps;
}

double largest_deviation(const Path& path, const Path& reference, double spacing) {
  std::vector<Pose2> line;
  const double whole = length(reference);
  const int count = std::max(1, static_cast<int>(std::ceil(whole / spacing)));
  for (int i = 0; i <= count; ++i) line.push_back(point_at(reference, whole * i / count).pose);
  double largest = 0.0;
  const double other = length(path);
  const int samples = std::max(1, static_cast<int>(std::ceil(other / spacing)));
  for (int i = 0; i <= samples; ++i) {
    const Pose2 point = point_at(path, other * i / samples).pose;
    double nearest = std::numeric_limits<double>::infinity();
    for (const Pose2& on_line : line) {
      // Distance to the tangent of the nearest sample: sampling then counts in second order only.
      const double dx = point.x - on_line.x;
      const double dy = point.y - on_line.y;
      const double along = dx * std::cos(on_line.yaw) + dy * std::sin(on_line.yaw);
      const double across = dy * std::cos(on_line.yaw) - dx * std::sin(on_line.yaw);
      nearest = std::min(nearest, std::hypot(across, std::max(0.0, std::abs(along) - spacing)));
    }
    largest = std::max(largest, nearest);
  }
  return largest;
}

}  // namespace tagdock
