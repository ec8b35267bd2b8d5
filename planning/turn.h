#pragma once

#include <array>

#include "planning/path.h"

namespace tagdock {

/// How sharply a robot may turn. What decides a plan is only max_sharpness / max_curvature^2 and the ratio of the
/// distances to 1 / max_curvature: nothing below depends on the unit of length.
struct TurnLimits {
  double max_curvature = 1.0 / 0.97;  ///< 1/m; the paper's robot drives circles of 0.97 m radius
  double max_sharpness = 2.5;         ///< 1/m^2; full curvature within 0.41 m of path at the default curvature

  bool operator==(const TurnLimits&) const = default;
};

/// Largest deflection that a TurnShape knows [rad]: one whole circle.
inline constexpr double full_circle = 2.0 * std::numbers::pi;

/// A way this many times as long as the distance and two whole circles together is a detour that nobody means.
inline constexpr double detour_factor = 4.0;

/// The shape of a turn that begins and ends straight: curvature ramps up, stays, ramps down, mirror symmetric.
/// Because of the symmetry the turn leads from its start to its end along a chord that points into half the deflection,
/// whatever the ramp: a turn of deflection d that starts at heading h moves the robot by chord(d) * e(h + d/2).
/// Ramps are clothoids, or staircases of arcs whose heading error against the clothoid has zero mean along the ramp:
/// the first step begins h/6 late and the last ends h/6 early (h: length of a step), straight and top arc take the
/// rest. Deflections too small to reach full curvature use full sharpness and a lower peak, sqrt(|d| max_sharpness).
class TurnShape {
 public:
  /// @param limits     both finite and > 0 (the callers' doors refuse everything else)
  /// @param arc_steps  0 for clothoid ramps, else arcs per ramp
  explicit TurnShape(const TurnLimits& limits, int arc_steps = 0);

  /// The same shape with curvature times `factor` and sharpness times its square: every length divided by it.
  [[nodiscard]] TurnShape scaled(double factor) const;

  [[nodiscard]] const TurnLimits& limits() const { return limits_; }
  [[nodiscard]] int arc_steps() const { return arc_steps_; }

  /// Distance from start to end of a turn [m], signed: negative when the turn comes back behind its start.
  /// @param deflection  |d| <= full_circle
  [[nodiscard]] double chord(double deflection) const {
    return chord(deflection, std::cos(0.5 * deflection), std::sin(0.5 * std::abs(deflection)));
  }
  /// The same when cosine and sine of half of |d| are known.
  [[nodiscard]] double chord(double deflection, double cos_half, double sin_half) const {
    const double d = std::abs(deflection);
    if (d >= elementary_) return along_ * cos_half + across_ * sin_half;
    const double z = 0.25 * d * d;
    double sum = 0.0;
    for (int k = terms - 1; k >= 0; --k) sum = sum * z + series_[static_cast<std::size_t>(k)];
    return sum * std::sqrt(d * inverse_sharpness_);
  }

  /// Driven length of a turn [m].
  [[nodiscard]] double length(double deflection) const {
    const double d = std::abs(deflection);
    return d >= elementary_ ? ramp_ + d / limits_.max_curvature : 2.0 * std::sqrt(d * inverse_sharpness_);
  }

  /// Largest curvature of a turn [1/m].
  [[nodiscard]] double peak_curvature(double deflection) const {
    const double d = std::abs(deflection);
    return d >= elementary_ ? limits_.max_curvature
                            : std::min(limits_.max_curvature, std::sqrt(d * limits_.max_sharpness));
  }

  /// Straight piece at each end of the staircase turn; zero for clothoids [m].
  [[nodiscard]] double lead(double deflection) const;

  /// Append the turn to a path; straights of equal direction that meet become one.
  /// @param direction  +1 driven forward, -1 in reverse; the heading changes by `deflection` in both cases
  void append(std::vector<Segment>& segments, double deflection, int direction) const;

 private:
  // Terms of the power series in (d/2)^2: enough for |d| = 2 pi, where the next term is below 1e-17.
  static constexpr int terms = 17;

  TurnLimits limits_;
  int arc_steps_;
  double inverse_sharpness_;
  double ramp_;        // length of a full ramp: max_curvature / max_sharpness
  double elementary_;  // deflection of two full ramps without an arc between them
  double along_ = 0.0;
  double across_ = 0.0;
  std::array<double, terms> series_{};
};

/// Append a straight, joined to the last segment when that is a straight of the same direction. Nothing for zero.
void append_straight(std::vector<Segment>& segments, double length);

}  // namespace tagdock
