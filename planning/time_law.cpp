#include "planning/time_law.h"

#include <algorithm>
#include <limits>

namespace tagdock {
namespace {

double largest_curvature(const Segment& segment) {
  return std::max(std::abs(segment.curvature), std::abs(segment.end_curvature()));
}

/// A change of speed that begins and ends without acceleration.
struct Change {
  double from, to, acceleration, jerk;

  [[nodiscard]] double size() const { return std::abs(to - from); }
  /// Time of each of the two pieces with jerk [s].
  [[nodiscard]] double jerking() const { return std::min(acceleration / jerk, std::sqrt(size() / jerk)); }
  [[nodiscard]] double duration() const {
    if (size() == 0.0) return 0.0;
    return size() * jerk >= acceleration * acceleration ? size() / acceleration + acceleration / jerk
                                                        : 2.0 * std::sqrt(size() / jerk);
  }
  [[nodiscard]] double distance() const { return 0.5 * (from + to) * duration(); }

  struct State {
    double speed, driven;
  };
  [[nodiscard]] State after(double time) const {
    const double sign = to > from ? 1.0 : -1.0;
    const double ramp = jerking();
    const double whole = duration();
    if (time < ramp)
      return {from + sign * 0.5 * jerk * time * time, from * time + sign * jerk * time * time * time / 6.0};
    if (time > whole - ramp) {
      const double left = whole - time;
      return {to - sign * 0.5 * jerk * left * left, distance() - to * left + sign * jerk * left * left * left / 6.0};
    }
    const double steady = time - ramp;
    const double peak = jerk * ramp;
    return {
        from + sign * (0.5 * peak * ramp + peak * steady),
        from * time + sign * (peak * ramp * ramp / 6.0 + 0.5 * peak * ramp * steady + 0.5 * peak * steady * steady)};
  }
};

Change to_cruise(const SegmentTiming& timing, double cruise) {
  return {timing.entry, cruise, timing.acceleration, timing.jerk};
}
Change to_exit(const SegmentTiming& timing, double cruise) {
  return {cruise, timing.exit, timing.deceleration, timing.jerk};
}

/// Between `yes`, which fulfils a condition, and `no`: the last number that does, to the last bit.
template <class Fulfils>
double last_that(double yes, double no, const Fulfils& fulfils) {
  for (int i = 0; i < 100; ++i) {
    const double middle = 0.5 * (yes + no);
    if (middle == yes || middle == no) break;
    (fulfils(middle) ? yes : no) = middle;
  }
  return yes;
}

/// Highest speed that a change from `speed` reaches within a length [m/s].
double reachable(double speed, double length, double acceleration, double jerk) {
  return last_that(speed, std::sqrt(speed * speed + 2.0 * acceleration * length), [&](double other) {
    return Change{speed, other, acceleration, jerk}.distance() <= length;
  });
}

double changing_distance(const SegmentTiming& timing, double cruise) {
  return to_cruise(timing, cruise).distance() + to_exit(timing, cruise).distance();
}

double duration_at(const SegmentTiming& timing, double length, double cruise) {
  return to_cruise(timing, cruise).duration() + to_exit(timing, cruise).duration() +
         std::max(0.0, length - changing_distance(timing, cruise)) / cruise;
}

/// Cruise speed with which a segment takes a whole number of periods; false if there is none.
bool align(SegmentTiming& timing, double length, double fastest, double period) {
  const auto fits = [&](double cruise) { return changing_distance(timing, cruise) <= length; };
  const double higher = std::max(timing.entry, timing.exit);
  if (!fits(higher)) return false;
  const double high = fits(fastest) ? fastest : last_that(higher, fastest, fits);
  const double quickest = duration_at(timing, length, high);
  // A hair less than a whole number is that number: rounding must not cost a period.
  timing.periods = std::max(1, static_cast<int>(std::ceil(quickest / period - 1e-9)));
  const double wanted = timing.periods * period;
  // Slower than the ends only as far as the changes fit into the length. Two changes with jerk take more of it than
  // one: between the speeds of the ends a cruise may not fit although both ends would.
  const double lower = std::min(timing.entry, timing.exit);
  double slow = higher;
  constexpr int steps = 32;
  for (int i = 1; i <= 2 * steps; ++i) {
    const double next =
        i <= steps ? higher - (higher - lower) * i / steps : lower * (2 * steps - i) / static_cast<double>(steps);
    if (!fits(next)) {
      slow = last_that(slow, next, fits);
      break;
    }
    slow = next;
  }
  if (slow > 0.0 && duration_at(timing, length, slow) < wanted) return false;
  // Duration falls with the cruise speed.
  timing.cruise = last_that(high, slow, [&](double cruise) { return duration_at(timing, length, cruise) <= wanted; });
  return true;
}

}  // namespace

double TimeLaw::duration() const {
  long periods = 0;
  for (const SegmentTiming& timing : segments) periods += timing.periods;
  return static_cast<double>(periods) * period;
}

std::optional<TimeLaw> time_law(const Path& path, const WheelLimits& limits) {
  for (const double limit : {limits.speed, limits.wheel_speed, limits.wheel_acceleration, limits.wheel_jerk,
                             limits.track_width, limits.period, limits.approach_deceleration})
    if (!std::isfinite(limit) || !(limit > 0.0)) return std::nullopt;
  const double half_track = 0.5 * limits.track_width;
  const double share = 0.5 * limits.wheel_acceleration;
  const std::size_t count = path.segments.size();
  TimeLaw law{std::vector<SegmentTiming>(count), limits.period};
  std::vector<double> fastest(count);
  std::vector<double> corner(count + 1, std::numeric_limits<double>::infinity());
  corner.front() = 0.0;
  corner.back() = 0.0;
  double remaining = length(path);
  for (std::size_t i = 0; i < count; ++i) {
    const Segment& segment = path.segments[i];
    if (!std::isfinite(segment.length) || segment.length == 0.0) return std::nullopt;
    const double outer = 1.0 + largest_curvature(segment) * half_track;
    fastest[i] = std::min(limits.speed, limits.wheel_speed / outer);
    // Turning in costs v^2 |sharpness| b/2 of the wheels' share; it may take half of that.
    const double turning_in = std::abs(segment.sharpness) * half_track;
    if (turning_in > 0.0) fastest[i] = std::min(fastest[i], std::sqrt(0.5 * share / turning_in));
    SegmentTiming& timing = law.segments[i];
    timing.acceleration = (turning_in > 0.0 ? 0.5 : 1.0) * share / outer;
    timing.jerk = 0.5 * limits.wheel_jerk / outer;
    if (turning_in > 0.0) {
      // Changing speed while turning in jerks the wheels by 3 v a |sharpness| b/2: half of the share for each.
      timing.jerk *= 0.5;
      timing.acceleration = std::min(timing.acceleration, 0.25 * limits.wheel_jerk / (3.0 * fastest[i] * turning_in));
    }
    remaining = std::max(0.0, remaining - std::abs(segment.length));
    const double approach = std::sqrt(2.0 * limits.approach_deceleration * remaining);
    timing.deceleration = timing.acceleration;
    if (approach < fastest[i]) {
      timing.deceleration = std::min(timing.acceleration, limits.approach_deceleration);
      corner[i + 1] = std::min(corner[i + 1], approach);
    }
    const double bend_before =
        i > 0 ? path.segments[i - 1].sharpness * std::copysign(1.0, path.segments[i - 1].length) : 0.0;
    const double bend = segment.sharpness * std::copysign(1.0, segment.length);
    if (const double bend_jump = std::abs(bend - bend_before) * half_track; bend_jump > 0.0)
      corner[i] = std::min(corner[i], std::sqrt(0.5 * limits.wheel_jerk * limits.period / bend_jump));
    if (i + 1 == count && turning_in > 0.0)
      corner[i + 1] = std::min(corner[i + 1], std::sqrt(0.5 * limits.wheel_jerk * limits.period / turning_in));
    if (i == 0) continue;
    const Segment& before = path.segments[i - 1];
    if (before.length * segment.length < 0.0) {
      corner[i] = 0.0;
      continue;
    }
    const double jump = std::abs(segment.curvature - before.end_curvature()) * half_track;
    if (jump > 1e-12) corner[i] = std::min(corner[i], share * limits.period / jump);
  }
  for (std::size_t i = 0; i < count; ++i) {
    corner[i] = std::min(corner[i], fastest[i]);
    corner[i + 1] = std::min(corner[i + 1], fastest[i]);
  }
  const auto way = [&](std::size_t i, double part) { return part * std::abs(path.segments[i].length); };
  // Changes of speed use only a part of a segment: the rest is what it needs to be stretched to whole periods. While
  // some segment is too short for that, smaller parts and slower corners are tried.
  double part = 0.8;
  for (int attempt = 0; attempt < 40; ++attempt, part *= 0.93) {
    std::vector<double> speed = corner;
    for (std::size_t i = 0; i < count; ++i)
      speed[i + 1] =
          std::min(speed[i + 1], reachable(speed[i], way(i, part), law.segments[i].acceleration, law.segments[i].jerk));
    for (std::size_t i = count; i-- > 0;)
      speed[i] =
          std::min(speed[i], reachable(speed[i + 1], way(i, part), law.segments[i].deceleration, law.segments[i].jerk));
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
    const Change first = to_cruise(timing, timing.cruise);
    const Change last = to_exit(timing, timing.cruise);
    Change::State state{timing.cruise, 0.0};
    if (time < first.duration()) {
      state = first.after(time);
    } else if (time > duration - last.duration()) {
      state = last.after(std::max(0.0, time - (duration - last.duration())));
      state.driven += std::abs(segment.length) - last.distance();
    } else {
      state.driven = first.distance() + timing.cruise * (time - first.duration());
    }
    const double signed_driven = std::copysign(state.driven, segment.length);
    const double velocity = std::copysign(state.speed, segment.length);
    return {velocity, velocity * (segment.curvature + segment.sharpness * signed_driven)};
  }
  return {};
}

}  // namespace tagdock
