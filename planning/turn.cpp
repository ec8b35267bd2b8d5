#include "planning/turn.h"

#include <algorithm>

namespace tagdock {
namespace {

// Heading along a ramp as a fraction w(u) of the ramp's whole turn, u the fraction of its length. For a clothoid
// w = u^2; for a staircase a polygon. `piece(begin, end, w_begin, slope)` is called for each side of the polygon.
template <class Piece>
void for_each_stair(int steps, const Piece& piece) {
  const double step = 1.0 / steps;
  piece(0.0, step / 6.0, 0.0, 0.0);
  double w = 0.0;
  for (int i = 0; i < steps; ++i) {
    const double begin = i * step + (i == 0 ? step / 6.0 : 0.0);
    const double end = (i + 1) * step - (i == steps - 1 ? step / 6.0 : 0.0);
    const double slope = (2.0 * i + 1.0) * step;
    piece(begin, end, w, slope);
    w += (end - begin) * slope;
  }
  piece(1.0 - step / 6.0, 1.0, w, 2.0);
}

/// Integrals of w^j over the ramp (rising) or of (1 - w)^j (falling), for j = 0, 1, ...
template <std::size_t Count>
std::array<double, Count> moments(int steps, bool falling) {
  std::array<double, Count> result{};
  if (steps == 0) {
    double product = 1.0;
    for (std::size_t j = 0; j < Count; ++j) {
      const double power = static_cast<double>(j);
      if (j > 0) product *= 2.0 * power / (2.0 * power + 1.0);
      result[j] = falling ? product : 1.0 / (2.0 * power + 1.0);
    }
    return result;
  }
  for_each_stair(steps, [&](double begin, double end, double w, double slope) {
    const double from = falling ? 1.0 - w : w;
    const double to = falling ? std::max(0.0, from - slope * (end - begin)) : from + slope * (end - begin);
    double power_from = 1.0;
    double power_to = 1.0;
    for (std::size_t j = 0; j < Count; ++j) {
      if (slope == 0.0) result[j] += power_from * (end - begin);
      power_from *= from;
      power_to *= to;
      if (slope != 0.0) result[j] += std::abs(power_to - power_from) / (static_cast<double>(j + 1) * slope);
    }
  });
  return result;
}

}  // namespace

TurnShape::TurnShape(const TurnLimits& limits, int arc_steps)
    : limits_(limits),
      arc_steps_(arc_steps),
      inverse_sharpness_(1.0 / limits.max_sharpness),
      ramp_(limits.max_curvature / limits.max_sharpness),
      elementary_(limits.max_curvature * ramp_) {
  // Elementary turn: half the chord is the integral of cos(d/2 (1 - w)) over one ramp of length sqrt(|d|/sharpness).
  double factor = 2.0;
  const auto falling = moments<2 * terms>(arc_steps, true);
  for (int k = 0; k < terms; ++k) {
    series_[static_cast<std::size_t>(k)] = factor * falling[static_cast<std::size_t>(2 * k)];
    factor *= -1.0 / ((2.0 * k + 1.0) * (2.0 * k + 2.0));
  }
  if (elementary_ > full_circle) return;  // full curvature is never reached
  // Turn with an arc at the top: both ramps are fixed, only their direction against the chord changes with d.
  const double turn = 0.5 * elementary_;
  double cos_sum = 0.0;
  double sin_sum = 0.0;
  double power = 1.0;
  const auto rising = moments<2 * terms>(arc_steps, false);
  for (int j = 0; j < 2 * terms; ++j) {
    const double term = power * rising[static_cast<std::size_t>(j)] * ((j / 2) % 2 == 0 ? 1.0 : -1.0);
    (j % 2 == 0 ? cos_sum : sin_sum) += term;
    power *= turn / (j + 1);
  }
  const double radius = 1.0 / limits.max_curvature;
  along_ = 2.0 * (ramp_ * cos_sum - radius * std::sin(turn));
  across_ = 2.0 * (ramp_ * sin_sum + radius * std::cos(turn));
}

TurnShape TurnShape::scaled(double factor) const {
  TurnShape other(*this);
  other.limits_ = {limits_.max_curvature * factor, limits_.max_sharpness * factor * factor};
  other.inverse_sharpness_ = 1.0 / other.limits_.max_sharpness;
  other.ramp_ = ramp_ / factor;
  other.along_ = along_ / factor;
  other.across_ = across_ / factor;
  return other;
}

double TurnShape::lead(double deflection) const {
  if (arc_steps_ == 0) return 0.0;
  return peak_curvature(deflection) * inverse_sharpness_ / (6.0 * arc_steps_);
}

void TurnShape::append(std::vector<Segment>& segments, double deflection, int direction) const {
  const double d = std::abs(deflection);
  if (!(d > 0.0)) return;
  const double peak = peak_curvature(deflection);
  const double ramp = peak * inverse_sharpness_;
  const double top = std::max(0.0, (d - elementary_) / limits_.max_curvature);
  // Driven backwards a positive curvature turns the heading clockwise.
  const double curvature = std::copysign(peak, deflection * direction);
  if (arc_steps_ == 0) {
    const double sharpness = curvature * direction / ramp;
    segments.push_back({direction * ramp, 0.0, sharpness});
    if (top > 0.0) segments.push_back({direction * top, curvature, 0.0});
    segments.push_back({direction * ramp, curvature, -sharpness});
    return;
  }
  const double step = ramp / arc_steps_;
  const auto stair = [&](int i) {
    double span = step;
    if (i == 0) span -= step / 6.0;
    if (i == arc_steps_ - 1) span -= step / 6.0;
    segments.push_back({direction * span, curvature * (i + 0.5) / arc_steps_, 0.0});
  };
  append_straight(segments, direction * step / 6.0);
  for (int i = 0; i < arc_steps_; ++i) stair(i);
  segments.push_back({direction * (top + step / 3.0), curvature, 0.0});
  for (int i = arc_steps_ - 1; i >= 0; --i) stair(i);
  append_straight(segments, direction * step / 6.0);
}

void append_straight(std::vector<Segment>& segments, double length) {
  if (length == 0.0) return;
  if (!segments.empty()) {
    Segment& last = segments.back();
    if (last.curvature == 0.0 && last.sharpness == 0.0 && last.length * length > 0.0) {
      last.length += length;
      return;
    }
  }
  segments.push_back({length, 0.0, 0.0});
}

}  // namespace tagdock
