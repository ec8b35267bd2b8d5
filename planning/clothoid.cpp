#include "planning/clothoid.h"

#include <algorithm>
#include <limits>
#include <vector>

namespace tagdock {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double none = std::numeric_limits<double>::infinity();
constexpr int headings = 64;  // first look; windows narrower than 2 pi / 64 are searched where the scan comes close
constexpr double spacing = 2.0 * pi / headings;
constexpr double golden = 0.3819660112501051;
// How far a search narrows its interval. At a smooth minimum a thousandth leaves 1e-7 of the length; where the minimum
// is the heading at which a straight is gone, that heading is found by itself afterwards, else the search goes on.
constexpr double roughly = 1e-3;
constexpr double closely = 1e-5;

}  // namespace

/// A middle heading with what is needed of it.
struct ForwardFamily::Direction {
  double angle = 0.0;
  double cos_half = 1.0;
  double sin_half = 0.0;

  static Direction at(double angle) { return {angle, std::cos(0.5 * angle), std::sin(0.5 * angle)}; }
};

/// What a heading gives: the path and, if it is none, how far it is from being one.
struct ForwardFamily::Trial {
  ForwardPath path;
  double heading = 0.0;
  double cost = none;     // length, infinite if there is no path
  double excess = -none;  // the shorter of the two free straights at the best vertex [m]; a path needs >= 0
};

ForwardFamily::ForwardFamily(const Pose2& goal, const TurnShape& shape, const Straights& straights, double resolution)
    : shape_(shape),
      straights_(straights),
      goal_(goal),
      resolution_(resolution),
      cos_goal_(std::cos(goal.yaw)),
      sin_goal_(std::sin(goal.yaw)),
      cos_half_goal_(std::cos(0.5 * goal.yaw)),
      sin_half_goal_(std::sin(0.5 * goal.yaw)),
      x_(goal.x - straights.initial - straights.final * cos_goal_),
      y_(goal.y - straights.final * sin_goal_),
      longest_(detour_factor *
               (std::hypot(goal.x, goal.y) + straights.initial + straights.final + 2.0 * shape.length(full_circle))) {}

ForwardFamily::Trial ForwardFamily::attempt(const Direction& heading) const {
  Trial trial;
  trial.heading = heading.angle;
  const double first = heading.angle;
  double second = goal_.yaw - first;
  double side = 1.0;
  if (second > pi || second < -pi) {
    second -= std::copysign(2.0 * pi, second);
    side = -1.0;
  }
  if (std::abs(first) > pi || std::abs(first) + std::abs(second) - std::abs(goal_.yaw) > pi) return trial;
  const double ch = heading.cos_half;
  const double sh = heading.sin_half;
  // Half of the second deflection and the direction of its chord, by the addition theorems.
  const double cos_half_second = std::abs(cos_half_goal_ * ch + sin_half_goal_ * sh);
  const double sin_half_second = std::abs(sin_half_goal_ * ch - cos_half_goal_ * sh);
  const double cos_chord = side * (cos_half_goal_ * ch - sin_half_goal_ * sh);
  const double sin_chord = side * (sin_half_goal_ * ch + cos_half_goal_ * sh);
  const double c = (ch - sh) * (ch + sh);
  const double s = 2.0 * sh * ch;
  const double chord_first = shape_.chord(first, std::abs(ch), std::abs(sh));
  const double chord_second = shape_.chord(second, cos_half_second, sin_half_second);
  // What the straights have to cover.
  const double x = x_ - chord_first * ch - chord_second * cos_chord;
  const double y = y_ - chord_first * sh - chord_second * sin_chord;
  const double sin_second = sin_goal_ * c - cos_goal_ * s;
  const double toward_goal = x * sin_goal_ - y * cos_goal_;
  const double toward_middle = x * s - y * c;

  double best = none;
  const auto consider = [&](double determinant, double one, double other, double& to_one, double& to_other) {
    if (determinant == 0.0) return;
    const double a = one / determinant;
    const double b = other / determinant;
    trial.excess = std::max(trial.excess, std::min(a, b));
    if (a < 0.0 || b < 0.0 || !(a + b < best) || a + b > longest_) return;
    best = a + b;
    trial.path = {straights_.initial, first, 0.0, second, straights_.final, 0.0};
    to_one += a;
    to_other += b;
  };
  consider(sin_second, toward_goal, -toward_middle, trial.path.middle, trial.path.final);
  consider(sin_goal_, toward_goal, y, trial.path.initial, trial.path.final);
  consider(s, toward_middle, y, trial.path.initial, trial.path.middle);
  if (best == none) return trial;
  trial.path.length = straights_.initial + straights_.final + best + shape_.length(first) + shape_.length(second);
  trial.cost = trial.path.length;
  return trial;
}

std::optional<ForwardPath> ForwardFamily::finished(const Trial& trial) const {
  if (!(trial.cost < none)) return std::nullopt;
  ForwardPath path = trial.path;
  // Where two of the straights are nearly parallel their lengths carry rounding errors; what they leave open is put
  // back along the two directions that differ most.
  const double middle = path.first;
  const double cos_middle = std::cos(middle);
  const double sin_middle = std::sin(middle);
  const double second = middle + 0.5 * path.second;
  const double chord_first = shape_.chord(path.first);
  const double chord_second = shape_.chord(path.second);
  const double cos_first = std::cos(0.5 * middle);
  const double sin_first = std::sin(0.5 * middle);
  const double cos_second = std::cos(second);
  const double sin_second = std::sin(second);
  const double scale = std::abs(goal_.x) + std::abs(goal_.y) + path.length;
  const double enough = 4.0 * std::numeric_limits<double>::epsilon() * scale;
  double best = none;
  for (int round = 0; round < 4; ++round) {
    const double dx = goal_.x - path.initial - chord_first * cos_first - path.middle * cos_middle -
                      chord_second * cos_second - path.final * cos_goal_;
    const double dy = goal_.y - chord_first * sin_first - path.middle * sin_middle - chord_second * sin_second -
                      path.final * sin_goal_;
    best = std::max(std::abs(dx), std::abs(dy));
    if (best <= enough) break;
    const double open_initial = path.initial > straights_.initial ? 1.0 : 0.0;
    const double open_middle = path.middle > 0.0 ? 1.0 : 0.0;
    const double open_final = path.final > straights_.final ? 1.0 : 0.0;
    const double cross_first = sin_middle;                                      // initial x middle
    const double cross_last = cos_middle * sin_goal_ - sin_middle * cos_goal_;  // middle x final
    const double a = std::abs(cross_first) * open_initial * open_middle;
    const double b = std::abs(cross_last) * open_middle * open_final;
    const double e = std::abs(sin_goal_) * open_initial * open_final;
    if (a == 0.0 && b == 0.0 && e == 0.0) break;
    if (a >= b && a >= e) {
      path.initial += (dx * sin_middle - dy * cos_middle) / cross_first;
      path.middle += dy / cross_first;
    } else if (b >= e) {
      path.middle += (dx * sin_goal_ - dy * cos_goal_) / cross_last;
      path.final += (cos_middle * dy - sin_middle * dx) / cross_last;
    } else {
      path.initial += (dx * sin_goal_ - dy * cos_goal_) / sin_goal_;
      path.final += dy / sin_goal_;
    }
    path.initial = std::max(path.initial, straights_.initial);
    path.middle = std::max(path.middle, 0.0);
    path.final = std::max(path.final, straights_.final);
  }
  if (best > 4.0 * enough && best > 2.0 * resolution_) return std::nullopt;
  path.length = path.initial + path.middle + path.final + shape_.length(path.first) + shape_.length(path.second);
  return path;
}

/// The shortest path often has one free straight only, where the search stops a hair before: a straight of micrometres
/// that nobody can drive. The heading at which it is gone is found by secants, to rounding; none where that does not
/// come out.
std::optional<ForwardPath> ForwardFamily::tidied(const ForwardPath& path) const {
  const std::array<double, 3> free = {path.initial - straights_.initial, path.middle, path.final - straights_.final};
  const double tiny = 1e-3 * path.length;
  std::size_t only = 3;
  int tiny_ones = 0;
  for (std::size_t i = 0; i < 3; ++i) {
    if (free[i] > tiny)
      only = only == 3 ? i : 4;
    else if (free[i] > 0.0)
      ++tiny_ones;
  }
  if (only > 2 || tiny_ones != 1) return std::nullopt;
  const double turns = path.first + path.second;
  struct At {
    double across, along;  // what is open to the goal, in the frame of the straight that stays
  };
  const auto open = [&](double first) {
    const double second = turns - first;
    const double chord_first = shape_.chord(first);
    const double chord_second = shape_.chord(second);
    const double x = x_ - chord_first * std::cos(0.5 * first) - chord_second * std::cos(first + 0.5 * second);
    const double y = y_ - chord_first * std::sin(0.5 * first) - chord_second * std::sin(first + 0.5 * second);
    const double heading = only == 0 ? 0.0 : only == 1 ? first : goal_.yaw;
    const double c = std::cos(heading);
    const double s = std::sin(heading);
    return At{c * y - s * x, c * x + s * y};
  };
  const double enough =
      2.0 * std::numeric_limits<double>::epsilon() * (std::abs(goal_.x) + std::abs(goal_.y) + path.length);
  double first = path.first;
  double before = path.first + 1e-7;
  At now = open(first);
  double across_before = open(before).across;
  for (int i = 0; i < 12 && std::abs(now.across) > enough && now.across != across_before; ++i) {
    const double next = first - now.across * (first - before) / (now.across - across_before);
    if (!(std::abs(next - path.first) < 0.1)) return std::nullopt;
    before = first;
    across_before = now.across;
    first = next;
    now = open(first);
  }
  ForwardPath tidy{straights_.initial, first, 0.0, turns - first, straights_.final, 0.0};
  (only == 0 ? tidy.initial : only == 1 ? tidy.middle : tidy.final) += now.along;
  tidy.length = tidy.initial + tidy.middle + tidy.final + shape_.length(tidy.first) + shape_.length(tidy.second);
  // The search knows the shortest length to a millionth.
  const bool fine = std::abs(now.across) <= enough && now.along > tiny && tidy.length <= path.length * (1.0 + 1e-6);
  return fine ? std::optional(tidy) : std::nullopt;
}

std::optional<ForwardPath> ForwardFamily::at(double heading) const {
  if (!(std::abs(heading) <= pi)) return std::nullopt;
  return finished(attempt(Direction::at(heading)));
}

template <class Visit>
void ForwardFamily::scan(const Visit& visit) const {
  struct Table {
    std::array<Direction, headings + 1> at;
    Table() {
      for (int i = 0; i <= headings; ++i) at[static_cast<std::size_t>(i)] = Direction::at((i - headings / 2) * spacing);
    }
  };
  static const Table table;
  for (const Direction& direction : table.at) visit(attempt(direction));
}

ForwardFamily::Trial ForwardFamily::shortest_between(double low, Trial middle, double high, double share) const {
  // Golden section on the length; outside a window of feasible headings it is infinite, which only narrows the search.
  const double enough = share * (high - low) + 4e-16 * std::abs(middle.heading);
  for (int i = 0; i < 48 && high - low > enough; ++i) {
    const bool right = high - middle.heading > middle.heading - low;
    const double angle =
        right ? middle.heading + golden * (high - middle.heading) : middle.heading - golden * (middle.heading - low);
    const Trial next = attempt(Direction::at(angle));
    if (next.cost < middle.cost) {
      (right ? low : high) = middle.heading;
      middle = next;
    } else {
      (right ? high : low) = angle;
    }
  }
  return middle;
}

std::optional<ForwardFamily::Trial> ForwardFamily::narrow_window(double low, Trial middle, double high) const {
  double a = low;
  double b = high;
  for (int i = 0; i < 40; ++i) {
    const bool right = b - middle.heading > middle.heading - a;
    const double angle =
        right ? middle.heading + golden * (b - middle.heading) : middle.heading - golden * (middle.heading - a);
    const Trial next = attempt(Direction::at(angle));
    if (next.cost < none) return shortest_between(a, next, b, closely);
    if (next.excess > middle.excess) {
      (right ? a : b) = middle.heading;
      middle = next;
    } else {
      (right ? b : a) = angle;
    }
  }
  return std::nullopt;
}

std::optional<ForwardPath> ForwardFamily::shortest(bool thorough) const {
  // No turn at all: offsets that the poses' own rounding hides count as zero, nothing else does.
  const double hidden = 4.0 * std::numeric_limits<double>::epsilon();
  const double ahead = goal_.x - straights_.initial - straights_.final;
  if (std::abs(goal_.yaw) <= hidden && std::abs(goal_.y) <= resolution_ && ahead >= -resolution_)
    return ForwardPath{straights_.initial + std::max(0.0, ahead), 0.0, 0.0, 0.0, straights_.final, goal_.x};

  std::array<Trial, headings + 1> trials;
  std::size_t count = 0;
  std::size_t best = 0;
  scan([&](const Trial& trial) {
    if (trial.cost < trials[best].cost) best = count;
    trials[count++] = trial;
  });
  Trial shortest;
  for (std::size_t i = 0; i < count; ++i) {
    // Valleys that are not deeper than one percent above the deepest sample may still lead to the shortest path.
    if (!(trials[i].cost < none) || trials[i].cost > 1.01 * trials[best].cost) continue;
    if (i > 0 && trials[i - 1].cost < trials[i].cost) continue;
    if (i + 1 < count && trials[i + 1].cost < trials[i].cost) continue;
    const double heading = trials[i].heading;
    const Trial trial = shortest_between(heading - spacing, trials[i], heading + spacing, roughly);
    if (trial.cost < shortest.cost) shortest = trial;
  }
  // One turn only: exactly the heading of the start or of the goal. There the length has a cusp, because ramps of small
  // turns shrink with the root of the deflection, and a second valley may lie close beside it.
  for (const double angle : {0.0, goal_.yaw}) {
    const Trial trial = attempt(Direction::at(angle));
    if (trial.cost < shortest.cost) shortest = trial;
    for (const double step : {-0.3 * spacing, 0.3 * spacing}) {
      const Trial beside = attempt(Direction::at(angle + step));
      if (!(beside.cost < 1.002 * shortest.cost)) continue;
      const Trial best_beside =
          shortest_between(std::min(angle, angle + 3.0 * step), beside, std::max(angle, angle + 3.0 * step), roughly);
      if (best_beside.cost < shortest.cost) shortest = best_beside;
    }
  }
  if (std::optional<ForwardPath> path = finished(shortest)) {
    if (const std::optional<ForwardPath> tidy = tidied(*path)) return tidy;
    const double around = 4.0 * roughly * spacing;
    const Trial closer =
        shortest_between(shortest.heading - around, shortest, shortest.heading + around, closely / roughly);
    if (const std::optional<ForwardPath> closest = finished(closer)) path = closest;
    return tidied(*path).value_or(*path);
  }
  if (!thorough) return std::nullopt;

  // Nothing yet: look closer where the scan came nearest to a path, and ever closer around the start's and the goal's
  // heading, where lane changes of any size have their windows.
  std::optional<ForwardPath> found;
  const auto keep = [&](const std::optional<Trial>& trial) {
    if (!trial || (found && trial->cost >= found->length)) return;
    if (const std::optional<ForwardPath> path = finished(*trial)) found = tidied(*path).value_or(*path);
  };
  for (std::size_t i = 0; i < count; ++i) {
    const double before = i > 0 ? trials[i - 1].excess : -none;
    const double after = i + 1 < count ? trials[i + 1].excess : -none;
    if (trials[i].excess == -none || trials[i].excess < before || trials[i].excess < after) continue;
    const double low = std::max(-pi, trials[i].heading - spacing);
    const double high = std::min(pi, trials[i].heading + spacing);
    keep(narrow_window(low, trials[i], high));
  }
  for (const double centre : {0.0, goal_.yaw}) {
    for (const double side : {1.0, -1.0}) {
      Trial nearest;
      double at = 0.0;
      for (double offset = spacing; offset > 1e-17; offset *= 0.25) {
        const double angle = centre + side * offset;
        if (std::abs(angle) > pi) continue;
        const Trial trial = attempt(Direction::at(angle));
        if (trial.cost < nearest.cost || (nearest.cost == none && trial.excess > nearest.excess)) {
          nearest = trial;
          at = offset;
        }
      }
      if (nearest.excess == -none) continue;
      const double low = centre + (side > 0.0 ? 0.25 : -4.0) * at;
      const double high = centre + (side > 0.0 ? 4.0 : -0.25) * at;
      if (nearest.cost < none)
        keep(shortest_between(low, nearest, high, closely));
      else
        keep(narrow_window(low, nearest, high));
    }
  }
  return found;
}

double ForwardFamily::lacking() const {
  double most = -none;
  scan([&](const Trial& trial) { most = std::max(most, trial.excess); });
  return -most;
}

void write_path(const Pose2& start, const ForwardPath& forward, const TurnShape& shape, Path& path, int direction) {
  path.start = start;
  path.segments.clear();
  append_straight(path.segments, direction * forward.initial);
  shape.append(path.segments, direction * forward.first, direction);
  append_straight(path.segments, direction * forward.middle);
  shape.append(path.segments, direction * forward.second, direction);
  append_straight(path.segments, direction * forward.final);
}

double heading_difference(double from, double to) {
  const double difference = to - from;
  if (std::abs(from) <= pi && std::abs(to) <= pi) return wrap_angle(difference);
  // Sines of large angles are exact to rounding; subtracting multiples of a rounded 2 pi is not.
  const double sine = std::sin(to) * std::cos(from) - std::cos(to) * std::sin(from);
  const double cosine = std::cos(to) * std::cos(from) + std::sin(to) * std::sin(from);
  return std::atan2(sine, cosine);
}

Pose2 goal_seen_from(const Pose2& start, const Pose2& goal) {
  const double c = std::cos(start.yaw);
  const double s = std::sin(start.yaw);
  const double dx = goal.x - start.x;
  const double dy = goal.y - start.y;
  return {c * dx + s * dy, c * dy - s * dx, heading_difference(start.yaw, goal.yaw)};
}

double pose_resolution(const Pose2& start, const Pose2& goal) {
  const double largest = std::max({std::abs(start.x), std::abs(start.y), std::abs(goal.x), std::abs(goal.y)});
  return 4.0 * std::numeric_limits<double>::epsilon() * largest;
}

}  // namespace tagdock
