#include "servo/castors.h"

#include <algorithm>
#include <array>
#include <cmath>

namespace tagdock {
namespace {

// Pivots along x and how far they reach, as a share of the farther one.
std::array<double, 2> pivots(const CastorConfig& config) { return {config.front, -config.rear}; }
double reach(const CastorConfig& config) { return std::max(config.front, config.rear); }

}  // namespace

CastorPush push(const CastorAngles& before, const Pose2& motion, double track, const CastorConfig& config) {
  CastorPush result;
  result.after = before;
  const double farthest = reach(config);
  if (!(farthest > 0.0)) return result;
  constexpr double piece = 0.005;  // m; a tenth of a usual trail
  const double rolling = std::max(std::hypot(motion.x, motion.y), 0.5 * std::abs(motion.yaw) * track);
  if (rolling < 1e-9) return result;
  // A wild odometry reading must not take for ever.
  const int steps = static_cast<int>(std::clamp(std::ceil(rolling / piece), 1.0, 100.0));
  const double ahead = motion.x / steps;
  const double turn = motion.yaw / steps;
  std::array<double*, 2> angles = {&result.after.front, &result.after.rear};
  for (int step = 0; step < steps; ++step) {
    for (std::size_t i = 0; i < 2; ++i) {
      const double x = pivots(config)[i];
      if (x == 0.0) continue;
      double& angle = *angles[i];
      const double aside = turn * x;
      const double swivel = -turn + (-ahead * std::sin(angle) + aside * std::cos(angle)) / config.trail;
      const double spin = (turn + swivel) / std::max(1e-9, std::hypot(ahead, aside));
      const double force = -std::tanh(spin / config.creepage) * std::cos(angle) * rolling / steps;
      result.around += x / farthest * force;
      result.aside += track * track / (4.0 * farthest) * force;
      angle = wrap_angle(angle + swivel);
    }
  }
  return result;
}

double held_back(const CastorAngles& angles, const CastorConfig& config) {
  const double farthest = reach(config);
  if (!(farthest > 0.0)) return 0.0;
  const double scale = 1.0 / (config.trail * config.creepage);
  return config.trail * (config.front / farthest * std::asinh(std::sin(angles.front) * scale) -
                         config.rear / farthest * std::asinh(std::sin(angles.rear) * scale));
}

double held_back_in_turn(double curvature, const CastorConfig& config) {
  return held_back({std::atan(config.front * curvature), -std::atan(config.rear * curvature)}, config);
}

double heading_lag(double scrub, const CastorConfig& config) {
  const double farthest = reach(config);
  if (!(farthest > 0.0)) return 0.0;
  return scrub * (config.front * config.front + config.rear * config.rear) / (farthest * config.creepage);
}

}  // namespace tagdock
