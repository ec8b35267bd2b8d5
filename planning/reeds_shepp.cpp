#include "planning/reeds_shepp.h"

#include <limits>
#include <string_view>

#include "planning/clothoid.h"

namespace tagdock {
namespace {

constexpr double pi = std::numbers::pi;

// An angle on the wrong side of zero by no more than the rounding of its computation is zero, not a whole circle.
constexpr double rounding = 32.0 * std::numeric_limits<double>::epsilon();

/// Goal in the start's frame, lengths in radii.
struct Query {
  double x, y, yaw;
  double sine, cosine;  // of yaw
};

/// How a formula's solution is read: mirrored in time (reverse for forward), left for right, last piece first.
struct Reading {
  double drive;  // +1 or -1
  double side;   // +1 or -1
  bool backward;
};

/// The formulas of section 8: shape, signs of a solution's angles, and whether reading it from the end gives new words.
struct Formula {
  const char* turns;
  std::array<double, 5> signs;
  bool backward;
};
enum { csc_same, csc_opposite, c_c_c, c_cc, c_csc_same, c_csc_opposite, cc_cc, c_cc_c, c_csc_c };
constexpr std::array<Formula, 9> formulas = {{{"LSL", {1.0, 1.0, 1.0}, false},
                                              {"LSR", {1.0, 1.0, 1.0}, false},
                                              {"LRL", {1.0, -1.0, 1.0}, false},
                                              {"LRL", {1.0, -1.0, -1.0}, true},
                                              {"LRSL", {1.0, -1.0, -1.0, -1.0}, true},
                                              {"LRSR", {1.0, -1.0, -1.0, -1.0}, true},
                                              {"LRLR", {1.0, 1.0, -1.0, -1.0}, false},
                                              {"LRLR", {1.0, -1.0, -1.0, 1.0}, false},
                                              {"LRSLR", {1.0, -1.0, -1.0, -1.0, 1.0}, false}}};

int number_of(int formula, const Reading& reading) {
  return 8 * formula + (reading.drive < 0.0 ? 4 : 0) + (reading.side < 0.0 ? 2 : 0) + (reading.backward ? 1 : 0);
}

/// Reads a formula's solution into a word.
void read_word(int formula, const Reading& reading, int pieces, const char* turns, const std::array<double, 5>& angles,
               double radius, ReedsSheppWord& word) {
  word = {};
  word.number = number_of(formula, reading);
  word.pieces = pieces;
  for (int i = 0; i < pieces; ++i) {
    const auto from = static_cast<std::size_t>(reading.backward ? pieces - 1 - i : i);
    const auto to = static_cast<std::size_t>(i);
    word.lengths[to] = reading.drive * angles[from] * radius;
    const char turn = turns[from];
    word.turns[to] = reading.side > 0.0 || turn == 'S' ? turn : (turn == 'L' ? 'R' : 'L');
    word.length += std::abs(word.lengths[to]);
  }
}

/// Keeps every word.
struct Everything {
  ReedsSheppWords& found;
  double radius;

  void add(int formula, const Reading& reading, int pieces, const char* turns, const std::array<double, 5>& angles) {
    read_word(formula, reading, pieces, turns, angles, radius, found.words[static_cast<std::size_t>(found.count++)]);
  }
};

/// Keeps the shortest word only, as its formula gave it.
struct Shortest {
  int formula = 0;
  Reading reading{1.0, 1.0, false};
  int pieces = 0;
  const char* turns = "";
  std::array<double, 5> angles{};
  double turned = std::numeric_limits<double>::infinity();

  void add(int new_formula, const Reading& new_reading, int new_pieces, const char* new_turns,
           const std::array<double, 5>& new_angles) {
    double sum = 0.0;
    for (const double angle : new_angles) sum += std::abs(angle);
    if (!(sum < turned)) return;
    turned = sum;
    formula = new_formula;
    reading = new_reading;
    pieces = new_pieces;
    turns = new_turns;
    angles = new_angles;
  }
};

/// The same angle in [0, 2 pi).
double forward_angle(double angle) {
  // The sums of few angles that come here lie within a few circles.
  while (angle >= 2.0 * pi) angle -= 2.0 * pi;
  while (angle <= -rounding) angle += 2.0 * pi;
  return angle >= 2.0 * pi - rounding || angle < 0.0 ? 0.0 : angle;
}

double reverse_angle(double angle) { return -forward_angle(-angle); }

// The first angle of the words of four arcs (section 8.3 of the paper); the last follows from the headings.
double first_of_four(double u, double v, double xi, double eta) {
  const double delta = u - v;
  const double a = std::sin(u) - std::sin(delta);
  const double b = std::cos(u) - std::cos(delta) - 1.0;
  const double t = std::atan2(eta * a - xi * b, xi * a + eta * b);
  const double side = 2.0 * (std::cos(delta) - std::cos(v) - std::cos(u)) + 3.0;
  return side < 0.0 ? t + pi : t;
}

// Words whose outer arcs turn the same way: xi, eta is the goal's circle centre seen from the start's.
template <class Collector>
void same_side(const Query& q, const Reading& reading, Collector& out) {
  const double xi = q.x - q.sine;
  const double eta = q.y - 1.0 + q.cosine;
  const double distance = std::hypot(xi, eta);
  const double angle = std::atan2(eta, xi);
  if (!reading.backward) {  // 8.1: C S C
    const double t = forward_angle(angle);
    out.add(csc_same, reading, 3, "LSL", {t, distance, forward_angle(q.yaw - t)});
  }
  if (distance <= 4.0) {  // 8.3, 8.4: C | C | C and C | C C
    const double u = -2.0 * std::asin(0.25 * distance);
    const double t = forward_angle(angle + 0.5 * u + pi);
    if (!reading.backward) out.add(c_c_c, reading, 3, "LRL", {t, u, forward_angle(q.yaw - t + u)});
    out.add(c_cc, reading, 3, "LRL", {t, u, reverse_angle(q.yaw - t + u)});
  }
  if (distance >= 2.0) {  // 8.9: C | C(pi/2) S C
    const double r = std::sqrt((distance - 2.0) * (distance + 2.0));
    if (r >= 2.0) {
      const double t = forward_angle(angle + std::atan2(r, -2.0));
      out.add(c_csc_same, reading, 4, "LRSL", {t, -0.5 * pi, 2.0 - r, reverse_angle(q.yaw - 0.5 * pi - t)});
    }
  }
}

// Words whose outer arcs turn opposite ways.
template <class Collector>
void opposite_side(const Query& q, const Reading& reading, Collector& out) {
  const double xi = q.x + q.sine;
  const double eta = q.y - 1.0 - q.cosine;
  const double squared = xi * xi + eta * eta;
  const double distance = std::hypot(xi, eta);
  if (distance >= 2.0) {
    const double r = std::sqrt((distance - 2.0) * (distance + 2.0));
    if (!reading.backward) {  // 8.2: C S C
      const double t = forward_angle(std::atan2(eta, xi) + std::atan2(2.0, r));
      out.add(csc_opposite, reading, 3, "LSR", {t, r, forward_angle(t - q.yaw)});
      if (r >= 4.0) {  // 8.11: C | C(pi/2) S C(pi/2) | C
        const double u = 4.0 - r;
        const double first = forward_angle(std::atan2(r * xi - 2.0 * eta, -2.0 * xi - r * eta));
        out.add(c_csc_c, reading, 5, "LRSLR", {first, -0.5 * pi, u, -0.5 * pi, forward_angle(first - q.yaw)});
      }
    }
    // 8.10: C | C(pi/2) S C
    const double t = forward_angle(std::atan2(xi, -eta));
    out.add(c_csc_opposite, reading, 4, "LRSR", {t, -0.5 * pi, 2.0 - distance, reverse_angle(t + 0.5 * pi - q.yaw)});
  }
  if (reading.backward) return;
  const double near = 0.25 * (2.0 + distance);
  if (near <= 1.0) {  // 8.7: C C(u) | C(u) C
    const double u = std::acos(near);
    const double t = forward_angle(first_of_four(u, -u, xi, eta));
    out.add(cc_cc, reading, 4, "LRLR", {t, u, -u, reverse_angle(t - 2.0 * u - q.yaw)});
  }
  const double far = (20.0 - squared) / 16.0;
  if (far >= 0.0 && far <= 1.0) {  // 8.8: C | C(u) C(u) | C
    const double u = -std::acos(far);
    const double t = forward_angle(first_of_four(u, u, xi, eta));
    out.add(c_cc_c, reading, 4, "LRLR", {t, u, u, forward_angle(t - q.yaw)});
  }
}

/// Every formula in every reading.
template <class Collector>
void solve(const Pose2& start, const Pose2& goal, double curvature, Collector& collector) {
  const Pose2 seen = goal_seen_from(start, goal);
  const double x = seen.x * curvature;
  const double y = seen.y * curvature;
  const double s = std::sin(seen.yaw);
  const double c = std::cos(seen.yaw);
  // Driven from the goal back to the start, a word's pieces come last first.
  const double x_back = x * c + y * s;
  const double y_back = x * s - y * c;
  for (const double drive : {1.0, -1.0}) {
    for (const double side : {1.0, -1.0}) {
      const double turn = drive * side;
      const Query ahead{drive * x, side * y, turn * seen.yaw, turn * s, c};
      const Query back{drive * x_back, side * y_back, turn * seen.yaw, turn * s, c};
      same_side(ahead, {drive, side, false}, collector);
      opposite_side(ahead, {drive, side, false}, collector);
      same_side(back, {drive, side, true}, collector);
      opposite_side(back, {drive, side, true}, collector);
    }
  }
}

}  // namespace

std::string ReedsSheppWord::name() const {
  std::string text;
  for (int i = 0; i < pieces; ++i) {
    text += turns[static_cast<std::size_t>(i)];
    text += lengths[static_cast<std::size_t>(i)] < 0.0 ? '-' : '+';
  }
  return text;
}

int ReedsSheppWord::cusps() const {
  int changes = 0;
  double last = 0.0;
  for (const double piece : lengths) {
    if (piece == 0.0) continue;
    if (last * piece < 0.0) ++changes;
    last = piece > 0.0 ? 1.0 : -1.0;
  }
  return changes;
}

Path ReedsSheppWord::path(const Pose2& start, double curvature) const {
  Path path{start, {}};
  for (int i = 0; i < pieces; ++i) {
    const auto index = static_cast<std::size_t>(i);
    if (lengths[index] == 0.0) continue;
    const double sign = turns[index] == 'S' ? 0.0 : (turns[index] == 'L' ? 1.0 : -1.0);
    path.segments.push_back({lengths[index], sign * curvature, 0.0});
  }
  return path;
}

const std::array<ReedsSheppWord, 48>& reeds_shepp_table() {
  static const std::array<ReedsSheppWord, 48> table = [] {
    std::array<ReedsSheppWord, 48> all;
    std::size_t count = 0;
    for (std::size_t formula = 0; formula < formulas.size(); ++formula) {
      const Formula& shape = formulas[formula];
      const int pieces = static_cast<int>(std::string_view(shape.turns).size());
      for (const double drive : {1.0, -1.0})
        for (const double side : {1.0, -1.0})
          for (const bool backward : {false, true})
            if (!backward || shape.backward)
              read_word(static_cast<int>(formula), {drive, side, backward}, pieces, shape.turns, shape.signs, 1.0,
                        all.at(count++));
    }
    return all;
  }();
  return table;
}

ReedsSheppWords reeds_shepp_words(const Pose2& start, const Pose2& goal, double curvature) {
  ReedsSheppWords unsorted;
  Everything everything{unsorted, 1.0 / curvature};
  solve(start, goal, curvature, everything);
  const auto count = static_cast<std::size_t>(unsorted.count);
  std::array<unsigned char, 48> order{};
  for (std::size_t i = 0; i < count; ++i) {
    std::size_t place = i;
    for (; place > 0 && unsorted.words[order[place - 1]].length > unsorted.words[i].length; --place)
      order[place] = order[place - 1];
    order[place] = static_cast<unsigned char>(i);
  }
  ReedsSheppWords found;
  found.count = unsorted.count;
  for (std::size_t i = 0; i < count; ++i) found.words[i] = unsorted.words[order[i]];
  return found;
}

ReedsSheppWord shortest_reeds_shepp(const Pose2& start, const Pose2& goal, double curvature) {
  Shortest shortest;
  solve(start, goal, curvature, shortest);
  ReedsSheppWord word;
  read_word(shortest.formula, shortest.reading, shortest.pieces, shortest.turns, shortest.angles, 1.0 / curvature,
            word);
  return word;
}

}  // namespace tagdock
