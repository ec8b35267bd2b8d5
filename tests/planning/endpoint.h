#pragma once

#include "planning/path.h"

namespace tagdock {

/// Where a path really ends, by Gauss-Legendre quadrature of the heading in long double: independent of
/// planning/path.cpp.
struct LongPose {
  long double x = 0, y = 0, yaw = 0;
};

inline LongPose true_end(const Path& path) {
  constexpr long double nodes[8] = {0.0950125098376374401853193354L, 0.2816035507792589132304605015L,
                                    0.4580167776572273863424194430L, 0.6178762444026437484466717640L,
                                    0.7554044083550030338951011948L, 0.8656312023878317438804678977L,
                                    0.9445750230732325760779884155L, 0.9894009349916499325961541735L};
  constexpr long double weights[8] = {0.1894506104550684962853967232L, 0.1826034150449235888667636680L,
                                      0.1691565193950025381893120790L, 0.1495959888165767320815017305L,
                                      0.1246289712555338720524762822L, 0.0951585116824927848099251076L,
                                      0.0622535239386478928628438370L, 0.0271524594117540948517805725L};
  LongPose pose{path.start.x, path.start.y, path.start.yaw};
  for (const Segment& segment : path.segments) {
    const long double length = segment.length;
    const long double k = segment.curvature;
    const long double q = segment.sharpness;
    const long double turn = std::fabs(length) * (std::fabs(k) + std::fabs(q * length));
    const int panels = 1 + static_cast<int>(turn * 2);
    const long double half = length / (2 * panels);
    for (int p = 0; p < panels; ++p) {
      const long double middle = (2 * p + 1) * half;
      for (int i = 0; i < 8; ++i) {
        for (const int sign : {-1, 1}) {
          const long double s = middle + sign * nodes[i] * half;
          const long double heading = pose.yaw + s * (k + q * s / 2);
          pose.x += weights[i] * half * std::cos(heading);
          pose.y += weights[i] * half * std::sin(heading);
        }
      }
    }
    pose.yaw += length * (k + q * length / 2);
  }
  return pose;
}

/// Distance [m] and heading difference [rad] between a path's true end and a goal.
struct EndError {
  double position = 0.0;
  double heading = 0.0;
};

inline EndError end_error(const Path& path, const Pose2& goal) {
  const LongPose end = true_end(path);
  const long double dx = end.x - goal.x;
  const long double dy = end.y - goal.y;
  const long double turn = std::atan2(std::sin(end.yaw - goal.yaw), std::cos(end.yaw - goal.yaw));
  return {static_cast<double>(std::hypot(dx, dy)), static_cast<double>(std::fabs(turn))};
}

}  // namespace tagdock
