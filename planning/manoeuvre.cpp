#include "planning/manoeuvre.h"

#include <algorithm>
#include <limits>

#include "planning/reeds_shepp.h"

namespace tagdock {
namespace {

constexpr double pi = std::numbers::pi;
constexpr double none = std::numeric_limits<double>::infinity();
constexpr double epsilon = std::numeric_limits<double>::epsilon();

struct Vector {
  double x = 0.0;
  double y = 0.0;
};
Vector direction(double angle) { return {std::cos(angle), std::sin(angle)}; }
double cross(const Vector& a, const Vector& b) { return a.x * b.y - a.y * b.x; }
double dot(const Vector& a, const Vector& b) { return a.x * b.x + a.y * b.y; }
Vector operator-(const Vector& a, const Vector& b) { return {a.x - b.x, a.y - b.y}; }
Vector operator*(double f, const Vector& a) { return {f * a.x, f * a.y}; }

/// The best few manoeuvres so far, by length; more than one in case rounding spoils the first.
class Shortlist {
 public:
  /// @param longest  way that is not yet a detour [m]: nearly parallel straights meet far away
  explicit Shortlist(double longest) : longest_(longest) {}
  void add(const Manoeuvre& manoeuvre) {
    if (!(manoeuvre.length < worst()) || manoeuvre.length > longest_) return;
    std::size_t place = count_ < kept_.size() ? count_++ : kept_.size() - 1;
    for (; place > 0 && kept_[place - 1].length > manoeuvre.length; --place) kept_[place] = kept_[place - 1];
    kept_[place] = manoeuvre;
  }
  [[nodiscard]] double best() const { return count_ > 0 ? kept_[0].length : none; }
  [[nodiscard]] double worst() const { return count_ < kept_.size() ? none : kept_.back().length; }
  [[nodiscard]] const Manoeuvre* begin() const { return kept_.data(); }
  [[nodiscard]] const Manoeuvre* end() const { return kept_.data() + count_; }

 private:
  std::array<Manoeuvre, 4> kept_;
  std::size_t count_ = 0;
  double longest_;
};

struct Search {
  const Pose2& goal;
  const TurnShape& shape;
  Driving driving;
  Vector offset{goal.x, goal.y};
  Vector goal_direction = direction(goal.yaw);
  Shortlist found{detour_factor * (std::hypot(goal.x, goal.y) + 2.0 * shape.length(full_circle))};

  void set_length(Manoeuvre& manoeuvre) const {
    manoeuvre.length = 0.0;
    for (int i = 0; i < manoeuvre.turns; ++i)
      manoeuvre.length += shape.length(manoeuvre.deflections[static_cast<std::size_t>(i)]);
    for (const double straight : manoeuvre.straights) manoeuvre.length += std::abs(straight);
  }

  /// What a manoeuvre leaves open to the goal [m], from the chords of its turns.
  [[nodiscard]] Vector gap(const Manoeuvre& manoeuvre) const {
    Vector open = offset;
    double heading = 0.0;
    for (int i = 0; i < manoeuvre.turns; ++i) {
      const auto at = static_cast<std::size_t>(i);
      const double d = manoeuvre.deflections[at];
      if (manoeuvre.straights[at] != 0.0) open = open - manoeuvre.straights[at] * direction(heading);
      open = open - (manoeuvre.directions[at] * shape.chord(d)) * direction(heading + 0.5 * d);
      heading += d;
    }
    return open - manoeuvre.straights[static_cast<std::size_t>(manoeuvre.turns)] * goal_direction;
  }

  /// Put what rounding left open into two straights of a manoeuvre: where they are nearly parallel, their first
  /// solution is exact to rounding times the ratio of their lengths to the gap only. False if there are no two
  /// straights.
  bool close_gap(Manoeuvre& manoeuvre, const Vector& open) const {
    std::array<std::size_t, 2> at{};
    std::array<Vector, 2> way{};
    std::size_t count = 0;
    double heading = 0.0;
    for (std::size_t i = 0; i <= static_cast<std::size_t>(manoeuvre.turns); ++i) {
      if (manoeuvre.straights[i] != 0.0) {
        if (count == 2) return false;
        at[count] = i;
        way[count++] = i == static_cast<std::size_t>(manoeuvre.turns) ? goal_direction : direction(heading);
      }
      if (i < static_cast<std::size_t>(manoeuvre.turns)) heading += manoeuvre.deflections[i];
    }
    const double determinant = count == 2 ? cross(way[0], way[1]) : 0.0;
    if (determinant == 0.0) return false;
    const std::array<double, 2> more = {cross(open, way[1]) / determinant, cross(way[0], open) / determinant};
    for (std::size_t k = 0; k < 2; ++k) {
      const double before = manoeuvre.straights[at[k]];
      manoeuvre.straights[at[k]] = before + more[k];
      if (driving == Driving::forward && manoeuvre.straights[at[k]] < 0.0) return false;
    }
    set_length(manoeuvre);
    return true;
  }

  // ---- Two turns and straights around them: exists for every middle heading.

  [[nodiscard]] Manoeuvre two_turns(double heading, int drive_first, int drive_second) const {
    Manoeuvre best;
    best.length = none;
    const double first = heading;
    const double second = wrap_angle(goal.yaw - heading);
    const Vector middle = direction(heading);
    const Vector open = offset - (drive_first * shape.chord(first)) * direction(0.5 * first) -
                        (drive_second * shape.chord(second)) * direction(heading + 0.5 * second);
    const double turned = shape.length(first) + shape.length(second);
    const auto consider = [&](const Vector& a, const Vector& b, std::size_t at_a, std::size_t at_b) {
      const double determinant = cross(a, b);
      if (determinant == 0.0) return;
      const double along_a = cross(open, b) / determinant;
      const double along_b = cross(a, open) / determinant;
      if (driving == Driving::forward && (along_a < 0.0 || along_b < 0.0)) return;
      const double length = std::abs(along_a) + std::abs(along_b) + turned;
      if (!(length < best.length)) return;
      best = {};
      best.turns = 2;
      best.deflections = {first, second};
      best.directions = {drive_first, drive_second};
      best.straights[at_a] = along_a;
      best.straights[at_b] = along_b;
      best.length = length;
    };
    const Vector ahead{1.0, 0.0};
    consider(ahead, middle, 0, 1);
    consider(middle, goal_direction, 1, 2);
    consider(ahead, goal_direction, 0, 2);
    return best;
  }

  void try_two_turns() {
    const int last = driving == Driving::both ? -1 : 1;
    for (int first = 1; first >= last; first -= 2) {
      for (int second = 1; second >= last; second -= 2) {
        double best_heading = 0.0;
        double reach = 0.0;
        Manoeuvre best;
        best.length = none;
        const auto consider = [&](double heading, double step) {
          if (!(std::abs(heading) <= pi)) return;
          const Manoeuvre next = two_turns(heading, first, second);
          if (next.length < best.length) {
            best = next;
            best_heading = heading;
            reach = step;
          }
        };
        constexpr int coarse = 24;
        for (int i = 1; i <= coarse; ++i) consider(-pi + i * 2.0 * pi / coarse, 2.0 * pi / coarse);
        // Small offsets want small turns: closer and closer to the headings of start and goal.
        const double size = std::hypot(offset.x, offset.y) + std::abs(goal.yaw);
        const double smallest = std::clamp(1e-3 * size, 1e-15, 0.1);
        for (double step = 0.25; step > smallest; step *= 0.5) {
          for (const double centre : {0.0, goal.yaw}) {
            consider(centre + step, 0.4 * step);
            consider(centre - step, 0.4 * step);
          }
        }
        if (best.length == none) continue;
        constexpr double golden = 0.3819660112501051;
        double low = best_heading - reach;
        double high = best_heading + reach;
        for (int i = 0; i < 16; ++i) {
          const bool right = high - best_heading > best_heading - low;
          const double heading =
              right ? best_heading + golden * (high - best_heading) : best_heading - golden * (best_heading - low);
          const Manoeuvre next = std::abs(heading) <= pi ? two_turns(heading, first, second) : Manoeuvre{};
          if (next.turns == 2 && next.length < best.length) {
            (right ? low : high) = best_heading;
            best_heading = heading;
            best = next;
          } else {
            (right ? high : low) = heading;
          }
        }
        found.add(best);
      }
    }
  }

  // ---- Words with one straight: the heading of the straight is the one unknown.

  /// Turn, [fixed turn], straight, [fixed turn], turn. Deflections before and after the straight that are fixed are
  /// driven the way of the straight; the outer turns change direction at them.
  struct OneStraight {
    double sign_first = 1.0;  // of the first deflection
    double sign_last = 1.0;
    double fixed_before = 0.0;  // deflection, 0: none
    double fixed_after = 0.0;
  };

  /// One position on the way around: heading of the straight and both outer deflections.
  struct Place {
    double first = 0.0;
    double last = 0.0;
    double heading = 0.0;
  };

  struct Value {
    Vector middle;      // direction of the straight
    double side = 0.0;  // what the turns leave open across the straight, for drive +1: side_goal - side_turns
    double side_goal = 0.0;
    double side_turns = 0.0;
    double along_goal = 0.0;
    double along_turns = 0.0;
    double turned = 0.0;  // length of all turns
  };

  [[nodiscard]] Value value(const OneStraight& word, const Place& place) const {
    Value value;
    value.middle = direction(place.heading);
    // The straight's drive is +1 here; outer turns are driven the other way where a fixed turn stands between.
    const double drive_first = word.fixed_before == 0.0 ? 1.0 : -1.0;
    const double drive_last = word.fixed_after == 0.0 ? 1.0 : -1.0;
    Vector turns = (drive_first * shape.chord(place.first)) * direction(0.5 * place.first);
    value.turned = shape.length(place.first) + shape.length(place.last);
    const auto add = [&](double chord, double angle) {
      const Vector v = direction(angle);
      turns.x += chord * v.x;
      turns.y += chord * v.y;
    };
    if (word.fixed_before != 0.0) {
      add(shape.chord(word.fixed_before), place.heading - 0.5 * word.fixed_before);
      value.turned += shape.length(word.fixed_before);
    }
    if (word.fixed_after != 0.0) {
      add(shape.chord(word.fixed_after), place.heading + 0.5 * word.fixed_after);
      value.turned += shape.length(word.fixed_after);
    }
    add(drive_last * shape.chord(place.last), place.heading + word.fixed_after + 0.5 * place.last);
    value.side_goal = cross(value.middle, offset);
    value.side_turns = cross(value.middle, turns);
    value.along_goal = dot(value.middle, offset);
    value.along_turns = dot(value.middle, turns);
    return value;
  }

  [[nodiscard]] Manoeuvre manoeuvre(const OneStraight& word, const Place& place, const Value& at, int drive) const {
    Manoeuvre result;
    const auto turn = [&](double deflection, int way) {
      const auto index = static_cast<std::size_t>(result.turns++);
      result.deflections[index] = deflection;
      result.directions[index] = way;
    };
    turn(place.first, word.fixed_before == 0.0 ? drive : -drive);
    if (word.fixed_before != 0.0) turn(word.fixed_before, drive);
    result.straights[static_cast<std::size_t>(result.turns)] = at.along_goal - drive * at.along_turns;
    if (word.fixed_after != 0.0) turn(word.fixed_after, drive);
    turn(place.last, word.fixed_after == 0.0 ? drive : -drive);
    set_length(result);
    return result;
  }

  /// Places of a word form two intervals of the first deflection's size, split where the last deflection is zero.
  struct Interval {
    double begin, end;      // of |first|
    double offset_of_last;  // |last| = offset_of_last + slope_of_last * |first|
    double slope_of_last;
  };

  [[nodiscard]] std::array<Interval, 2> intervals(const OneStraight& word) const {
    double split = word.sign_first * (goal.yaw - word.fixed_before - word.fixed_after);
    split = std::remainder(split, 2.0 * pi);
    if (split < 0.0) split += 2.0 * pi;
    if (word.sign_first == word.sign_last)
      return {Interval{0.0, split, split, -1.0}, Interval{split, 2.0 * pi, 2.0 * pi + split, -1.0}};
    return {Interval{0.0, split, 2.0 * pi - split, 1.0}, Interval{split, 2.0 * pi, -split, 1.0}};
  }

  [[nodiscard]] static Place place(const OneStraight& word, const Interval& interval, double size) {
    Place place;
    place.first = word.sign_first * size;
    const double last = interval.offset_of_last + interval.slope_of_last * size;
    place.last = word.sign_last * std::clamp(last, 0.0, 2.0 * pi);
    place.heading = place.first + word.fixed_before;
    return place;
  }

  void refine(const OneStraight& word, const Interval& interval, int drive, double low, double high, double at_low,
              double at_high) {
    // Illinois: the secant's speed, never leaves the bracket.
    int stuck = 0;
    for (int i = 0; i < 60 && high - low > 2.0 * epsilon * high; ++i) {
      double middle = (low * at_high - high * at_low) / (at_high - at_low);
      if (!(middle > low && middle < high)) middle = 0.5 * (low + high);
      if (middle == low || middle == high) break;
      const Value next = value(word, place(word, interval, middle));
      const double side = next.side_goal - drive * next.side_turns;
      if (side == 0.0) {
        low = high = middle;
        at_low = at_high = 0.0;
        break;
      }
      if ((side > 0.0) == (at_low > 0.0)) {
        low = middle;
        at_low = side;
        if (stuck == -1) at_high *= 0.5;
        stuck = -1;
      } else {
        high = middle;
        at_high = side;
        if (stuck == 1) at_low *= 0.5;
        stuck = 1;
      }
    }
    const auto add = [&](double size) {
      const Place at = place(word, interval, size);
      const Manoeuvre candidate = manoeuvre(word, at, value(word, at), drive);
      if (driving == Driving::forward && candidate.straights[1] < 0.0) return;
      const Vector open = gap(candidate);
      const double scale = candidate.length + std::abs(offset.x) + std::abs(offset.y);
      if (std::max(std::abs(open.x), std::abs(open.y)) <= 8.0 * epsilon * scale) found.add(candidate);
    };
    add(low);
    if (high != low) add(high);
  }

  void try_one_straight(const OneStraight& word) {
    constexpr int samples = 16;
    const bool reverse = driving == Driving::both;
    for (const Interval& interval : intervals(word)) {
      double before_size = 0.0;
      std::array<double, 2> before{};
      bool have_before = false;
      for (int i = 0; i <= samples; ++i) {
        const double t = static_cast<double>(i) / samples;
        const double size = interval.begin + (interval.end - interval.begin) * t * t * (3.0 - 2.0 * t);
        const Place at = place(word, interval, size);
        const double turned = shape.length(at.first) + shape.length(at.last);
        // A straight cannot make it shorter; one neighbour further is kept for the bracket.
        const bool hopeless = turned > 1.2 * found.best();
        if (hopeless) {
          have_before = false;
          continue;
        }
        const Value next = value(word, at);
        const std::array<double, 2> sides = {next.side_goal - next.side_turns, next.side_goal + next.side_turns};
        for (int k = 0; k < (reverse ? 2 : 1); ++k) {
          const auto index = static_cast<std::size_t>(k);
          if (!have_before) continue;
          const double a = before[index];
          const double b = sides[index];
          if ((a > 0.0) == (b > 0.0) && a != 0.0 && b != 0.0) continue;
          const double along = next.along_goal - (k == 0 ? 1.0 : -1.0) * next.along_turns;
          if (next.turned + std::abs(along) > 1.3 * found.best() + shape.length(0.3)) continue;
          refine(word, interval, k == 0 ? 1 : -1, before_size, size, a, b);
        }
        before = sides;
        before_size = size;
        have_before = true;
      }
    }
  }

  // ---- A loop of three turns, forward only: straights in three directions that span the plane reach everything.

  void try_loop() {
    constexpr int parts = 24;
    for (const double side : {1.0, -1.0}) {
      for (int i = 1; i < parts; ++i) {
        for (int j = 1; i + j < parts; ++j) {
          const double first = side * i * 2.0 * pi / parts;
          const double second = side * j * 2.0 * pi / parts;
          double third = std::remainder(goal.yaw - first - second, 2.0 * pi);
          if (third * side < 0.0) third += side * 2.0 * pi;
          Manoeuvre loop;
          loop.turns = 3;
          loop.deflections = {first, second, third};
          loop.directions = {1, 1, 1};
          const Vector open = gap(loop);
          const std::array<Vector, 4> ways = {Vector{1.0, 0.0}, direction(first), direction(first + second),
                                              goal_direction};
          for (std::size_t a = 0; a < 4; ++a) {
            for (std::size_t b = a + 1; b < 4; ++b) {
              const double determinant = cross(ways[a], ways[b]);
              if (determinant == 0.0) continue;
              const double along_a = cross(open, ways[b]) / determinant;
              const double along_b = cross(ways[a], open) / determinant;
              if (!(along_a >= 0.0 && along_b >= 0.0)) continue;
              Manoeuvre found_loop = loop;
              found_loop.straights[a] = along_a;
              found_loop.straights[b] = along_b;
              set_length(found_loop);
              found.add(found_loop);
            }
          }
        }
      }
    }
  }

  // ---- Words of three and four turns: Newton from the Reeds-Shepp words of about the same size.

  /// Deflections as a function of two unknowns: the first turn, and the second (three turns) or both middle ones.
  [[nodiscard]] static Manoeuvre with_unknowns(const Manoeuvre& word, double first, double second, double total) {
    Manoeuvre result = word;
    result.deflections[0] = first;
    result.deflections[1] = second;
    if (word.turns == 4) {
      result.deflections[2] = word.deflections[1] * word.deflections[2] > 0.0 ? second : -second;
      result.deflections[3] = total - first - second - result.deflections[2];
    } else {
      result.deflections[2] = total - first - second;
    }
    return result;
  }

  void try_turns_only(const ReedsSheppWord& seed, double radius) {
    Manoeuvre word;
    double total = 0.0;
    for (int i = 0; i < seed.pieces; ++i) {
      const auto at = static_cast<std::size_t>(i);
      if (seed.turns[at] == 'S') return;
      word.directions[at] = seed.lengths[at] < 0.0 ? -1 : 1;
      word.deflections[at] = seed.lengths[at] / radius * (seed.turns[at] == 'L' ? 1.0 : -1.0);
      total += word.deflections[at];
    }
    word.turns = seed.pieces;
    // The headings add up to the goal's, give or take whole turns.
    total = goal.yaw + 2.0 * pi * std::round((total - goal.yaw) / (2.0 * pi));
    double first = word.deflections[0];
    double second = word.deflections[1];
    const double scale = std::abs(offset.x) + std::abs(offset.y) + shape.length(1e-3);
    double last_error = none;
    for (int i = 0; i < 12; ++i) {
      const Manoeuvre now = with_unknowns(word, first, second, total);
      const Vector open = gap(now);
      const double error = std::hypot(open.x, open.y);
      if (!(error < 4.0 * last_error)) return;
      if (error <= 4.0 * epsilon * scale || (i > 3 && error >= 0.5 * last_error)) break;
      last_error = error;
      const double step_first = 1e-6 * std::abs(first) + 1e-12;
      const double step_second = 1e-6 * std::abs(second) + 1e-12;
      const Vector by_first = (1.0 / step_first) * (gap(with_unknowns(word, first + step_first, second, total)) - open);
      const Vector by_second =
          (1.0 / step_second) * (gap(with_unknowns(word, first, second + step_second, total)) - open);
      const double determinant = cross(by_first, by_second);
      if (determinant == 0.0 || !std::isfinite(determinant)) return;
      first -= cross(open, by_second) / determinant;
      second -= cross(by_first, open) / determinant;
      if (!(std::abs(first) < 2.0 * pi) || !(std::abs(second) < 2.0 * pi)) return;
    }
    Manoeuvre result = with_unknowns(word, first, second, total);
    for (int i = 0; i < result.turns; ++i)
      if (!(std::abs(result.deflections[static_cast<std::size_t>(i)]) < 2.0 * pi)) return;
    set_length(result);
    const Vector open = gap(result);
    if (std::max(std::abs(open.x), std::abs(open.y)) >
        8.0 * epsilon * (result.length + std::abs(offset.x) + std::abs(offset.y)))
      return;
    found.add(result);
  }
};

// The fixed turn of the words with one straight is a quarter circle for arcs; with ramps a little less or more is
// shorter, and every deflection gives an exact path.
void improve_fixed_turns(Search& search, const Manoeuvre& from) {
  if (from.turns < 3) return;
  int straight = -1;
  for (int i = 0; i <= from.turns; ++i)
    if (from.straights[static_cast<std::size_t>(i)] != 0.0) straight = i;
  if (straight < 1 || straight >= from.turns) return;
  Search::OneStraight word;
  word.sign_first = std::copysign(1.0, from.deflections[0]);
  word.sign_last = std::copysign(1.0, from.deflections[static_cast<std::size_t>(from.turns - 1)]);
  const bool before = straight == 2;
  const bool after = from.turns - straight == 2;
  const double sign_before = before ? std::copysign(1.0, from.deflections[1]) : 0.0;
  const double sign_after = after ? std::copysign(1.0, from.deflections[static_cast<std::size_t>(straight)]) : 0.0;
  for (const double size : {0.3 * pi, 0.4 * pi, 0.45 * pi, 0.55 * pi, 0.6 * pi, 0.7 * pi}) {
    word.fixed_before = sign_before * size;
    word.fixed_after = sign_after * size;
    search.try_one_straight(word);
  }
}

}  // namespace

std::optional<Manoeuvre> shortest_manoeuvre(const Pose2& goal, const TurnShape& shape, Driving driving,
                                            double resolution) {
  if (std::abs(goal.yaw) <= 4.0 * epsilon && std::abs(goal.y) <= resolution &&
      (driving == Driving::both || goal.x >= 0.0)) {
    Manoeuvre straight;
    straight.straights[0] = goal.x;
    straight.length = std::abs(goal.x);
    return straight;
  }
  Search search{goal, shape, driving};
  search.try_two_turns();
  for (const double first : {1.0, -1.0}) {
    for (const double last : {1.0, -1.0}) {
      search.try_one_straight({first, last, 0.0, 0.0});
      if (driving == Driving::forward) continue;
      search.try_one_straight({first, last, first * 0.5 * pi, 0.0});
      search.try_one_straight({first, last, 0.0, last * 0.5 * pi});
    }
    if (driving == Driving::both) search.try_one_straight({first, -first, first * 0.5 * pi, -first * 0.5 * pi});
  }
  if (driving == Driving::forward && search.found.begin() == search.found.end()) search.try_loop();
  if (driving == Driving::both) {
    // Arcs whose quarter circle spans the chord of a quarter turn, and some sharper and wider ones.
    const double middle = shape.chord(0.5 * pi) / std::numbers::sqrt2;
    for (const double radius : {middle, 1.5 * middle, 1.0 / shape.limits().max_curvature}) {
      for (const ReedsSheppWord& seed : reeds_shepp_words({}, goal, 1.0 / radius)) {
        if (seed.length > 2.0 * search.found.best()) break;
        search.try_turns_only(seed, radius);
      }
    }
    if (search.found.begin() != search.found.end()) improve_fixed_turns(search, Manoeuvre(*search.found.begin()));
  }
  for (Manoeuvre candidate : search.found) {
    const double scale = candidate.length + std::abs(goal.x) + std::abs(goal.y);
    for (int round = 0; round < 4; ++round) {
      const Vector open = search.gap(candidate);
      if (std::max(std::abs(open.x), std::abs(open.y)) <= 16.0 * epsilon * scale + resolution) return candidate;
      if (!search.close_gap(candidate, open)) break;
    }
  }
  return std::nullopt;
}

void write_path(const Pose2& start, const Manoeuvre& manoeuvre, const TurnShape& shape, Path& path) {
  path.start = start;
  path.segments.clear();
  for (int i = 0; i < manoeuvre.turns; ++i) {
    const auto at = static_cast<std::size_t>(i);
    append_straight(path.segments, manoeuvre.straights[at]);
    shape.append(path.segments, manoeuvre.deflections[at], manoeuvre.directions[at]);
  }
  append_straight(path.segments, manoeuvre.straights[static_cast<std::size_t>(manoeuvre.turns)]);
}

}  // namespace tagdock
