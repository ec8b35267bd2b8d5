#include "planning/time_law.h"

#include <algorithm>
#include <limits>

namespace tagdock {
namespace {

double largest_curvature(const Segment& segment) {
  return std::max(std::abs(segment.curvature), std::abs(segment.end_curvature()));
}

/// Distance that the changes of speed take at a cruise speed [m].
double changing_distance(const SegmentTiming& timing, double cruise) {
  return (std::abs(cruise * cruise - timing.entry * timing.entry) +
          std::abs(cruise * cruise - timing.exit * timing.exit)) /
         (2.0 * timing.acceleration);
}

double duration_at(const SegmentTiming& timing, double length, double cruise) {
  const double changing = changing_distance(timing, cruise);
  const double times = (std::abs(cruise - timing.entry) + std::abs(cruise - timing.exit)) / timing.acceleration;
  return times + std::max(0.0, length - changing) / cruise;
}

/// Cruise speed with which a segment takes a whole number of periods; false if there is none.
bool align(SegmentTiming& timing, double length, double fastest, double period) {
  // Highest cruise that the length allows: v^2 = (2 a length + entry^2 + exit^2) / 2.
  const double reachable =
      std::sqrt(0.5 * (2.0 * timing.acceleration * length + timing.entry * timing.entry + timing.exit * timing.exit));
  const double high = std::min(fastest, reachable);
  const double quickest = duration_at(timing, length, high);
  // A hair less than a whole number is that number: rounding must not cost a period.
  timing.periods = std::max(1, static_cast<int>(std::ceil(quickest / period - 1e-9)));
  const double wanted = timing.periods * period;
  double slow = 0.0;
  // Below both end speeds the dip itself must fit into the length.
  const double dip = 0.5 * (timing.entry * timing.entry + timing.exit * timing.exit) - timing.acceleration * length;
  if (dip > 0.0) slow = std::sqrt(dip);
  double fast = high;
  if (slow > 0.0 && duration_at(timing, length, slow) < wanted) return false;
  // Duration falls with the cruise speed; bisection to the last bit, so that periods are whole to rounding.
  for (int i = 0; i < 100; ++i) {
    const double middle = 0.5 * (slow + fast);
    if (middle <= slow || middle >= fast) break;
    (duration_at(timing, length, middle) > wanted ? slow : fast) = middle;
  }
  timing.cruise = fast;
  return true;
}

}  // namespace

double TimeLaw::duration() const {
  long periods = 0;
  for (const SegmentTiming& timing : segments) periods += timing.periods;
  return static_cast<double>(periods) * period;
}

std::optional<TimeLaw> time_law(const Path& path, const WheelLimits& limits) {
  for (const double limit :
       {limits.speed, limits.wheel_speed, limits.wheel_acceleration, limits.track_width, limits.period})
    if (!std::isfinite(limit) || !(limit > 0.0)) return std::nullopt;
  const double half_track = 0.5 * limits.track_width;
  const double share = 0.5 * limits.wheel_acceleration;
  const std::size_t count = path.segments.size();
  TimeLaw law{std::vector<SegmentTiming>(count), limits.period};
  std::vector<double> fastest(count);
  std::vector<double> corner(count + 1, std::numeric_limits<double>::infinity());
  corner.front() = 0.0;
  corner.back() = 0.0;
  for (std::size_t i = 0; i < count; ++i) {
    const Segment& segment = path.segments[i];
    if (!std::isfinite(segment.length) || segment.length == 0.0) return std::nullopt;
    const double outer = 1.0 + largest_curvature(segment) * half_track;
    fastest[i] = std::min(limits.speed, limits.wheel_speed / outer);
    // Turning in costs v^2 |sharpness| b/2 of the wheels' share; it may take half of that.
    const double turning_in = std::abs(segment.sharpness) * half_track;
    if (turning_in > 0.0) fastest[i] = std::min(fastest[i], std::sqrt(0.5 * share / turning_in));
    law.segments[i].acceleration = (turning_in > 0.0 ? 0.5 : 1.0) * share / outer;
    if (i == 0) continue;
    const Segment& before = path.segments[i - 1];
    if (before.length * segment.length < 0.0) {
      corner[i] = 0.0;
      continue;
    }
    const double jump = std::abs(segment.curvature - before.end_curvature()) * half_track;
    if (jump > 1e-12) corner[i] = share * limits.period / jump;
  }
  for (std::size_t i = 0; i < count; ++i) {
    corner[i] = std::min(corner[i], fastest[i]);
    corner[i + 1] = std::min(corner[i + 1], fastest[i]);
  }
  const auto gain = [&](std::size_t i) {
    return 2.0 * law.segments[i].acceleration * std::abs(path.segments[i].length);
  };
  // Speeds at the ends of segments use only a part of the acceleration: the rest is what a segment needs to be
  // stretched to whole periods. While some segment is too short for that, smaller parts and slower corners are tried.
  double part = 0.8;
  for (int attempt = 0; attempt < 40; ++attempt, part *= 0.93) {
    std::vector<double> speed = corner;
    for (std::size_t i = 0; i < count; ++i)
      speed[i + 1] = std::min(speed[i + 1], std::sqrt(speed[i] * speed[i] + part * gain(i)));
    for (std::size_t i = count; i-- > 0;)
      speed[i] = std::min(speed[i], std::sqrt(speed[i + 1] * speed[i + 1] + part * gain(i)));
    bool whole = true;
    for (std::size_t i = 0; i < count && whole; ++i) {
      SegmentTiming& timing = law.segments[i];
      timing.entry = speed[i];
      timing.exit = speed[i + 1];
      whole = align(timing, std::abs(path.segments[i].length), fastest[i], limits.period);
      if (!whole) {
        corner[i] *= 0.9;
        corner[i + 1] *= 0.9;
      }
    }
    if (whole) return law;
  }
  return std::nullopt;
}

Twist2 twist_at(const Path& path, const TimeLaw& law, double time) {
  if (!(time >= 0.0)) return {};
  for (std::size_t i = 0; i < path.segments.size(); ++i) {
    const SegmentTiming& timing = law.segments[i];
    const Segment& segment = path.segments[i];
    const double duration = timing.periods * law.period;
    if (time > duration) {
      time -= duration;
      continue;
    }
    const double way = std::abs(segment.length);
    const double first = std::abs(timing.cruise - timing.entry) / timing.acceleration;
    const double last = std::abs(timing.cruise - timing.exit) / timing.acceleration;
    double speed = timing.cruise;
    double driven = 0.0;
    if (time < first) {
      speed = timing.entry + (timing.cruise - timing.entry) * time / first;
      driven = 0.5 * (timing.entry + speed) * time;
    } else if (time > duration - last) {
      const double left = duration - time;
      speed = timing.exit + (timing.cruise - timing.exit) * left / last;
      driven = way - 0.5 * (timing.exit + speed) * left;
    } else {
      driven = 0.5 * (timing.entry + timing.cruise) * first + timing.cruise * (time - first);
    }
    const double signed_driven = std::copysign(driven, segment.length);
    const double velocity = std::copysign(speed, segment.length);
    return {velocity, velocity * (segment.curvature + segment.sharpness * signed_driven)};
  }
  return {};
}

}  // namespace tagdock
