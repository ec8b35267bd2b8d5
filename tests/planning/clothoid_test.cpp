#include "planning/clothoid.h"

#include <random>

#include <catch2/catch.hpp>

#include "planning/arc_approximation.h"
#include "tests/planning/endpoint.h"

using namespace tagdock;

namespace {

/// Starts of issue 4: goal 1 m before the board, start 2 to 5.5 m from the board, bearing within 40 deg, facing it
/// within 10 deg. In the goal's frame.
Pose2 docking_start(std::mt19937& random) {
  std::uniform_real_distribution<double> range(2.0, 5.5);
  std::uniform_real_distribution<double> bearing(radians(-40.0), radians(40.0));
  std::uniform_real_distribution<double> off(radians(-10.0), radians(10.0));
  const double r = range(random);
  const double b = bearing(random);
  return {1.0 - r * std::cos(b), r * std::sin(b), -b + off(random)};
}

}  // namespace

TEST_CASE("a turn's chord is where its segments end, for clothoids and staircases of any sharpness") {
  for (const int steps : {0, 1, 2, 3, 5, 10, 40}) {
    for (const double sharpness : {0.01, 0.3, 1.0, 2.5, 40.0, 1e6}) {
      const TurnShape shape({1.25, sharpness}, steps);
      for (const int direction : {1, -1}) {
        for (const double d : {1e-12, 1e-3, 0.1, 0.5, 1.0, 2.0, 3.1, 4.5, 6.2, -0.7, -6.28}) {
          CAPTURE(steps, sharpness, d, direction);
          Path turn;
          shape.append(turn.segments, d, direction);
          const LongPose end = true_end(turn);
          const double chord = direction * shape.chord(d);
          const double scale = 1.0 + shape.length(d);
          CHECK(std::abs(double(end.x) - chord * std::cos(0.5 * d)) < 5e-15 * scale);
          CHECK(std::abs(double(end.y) - chord * std::sin(0.5 * d)) < 5e-15 * scale);
          CHECK(std::abs(double(end.yaw) - d) < 5e-15);
          CHECK(length(turn) == Approx(shape.length(d)).epsilon(1e-14));
        }
      }
    }
  }
}

TEST_CASE("docking starts: solved share, exact ends, no loop, run-in kept") {
  std::mt19937 random(404);
  struct Case {
    double final;
    int steps;
    double share;
  };
  // Shares that issue 4 asks for; arcs lose a little by their lead.
  for (const Case& wanted : {Case{0.0, 0, 0.747}, Case{0.3, 0, 0.647}, Case{0.3, 5, 0.647}}) {
    const TurnShape shape({1.25, 2.5}, wanted.steps);
    const int queries = 8000;
    int solved = 0;
    double worst = 0.0;
    double worst_heading = 0.0;
    int tiny = 0;
    Path path;
    for (int i = 0; i < queries; ++i) {
      const Pose2 start = docking_start(random);
      const ForwardFamily family(goal_seen_from(start, {}), shape, {0.0, wanted.final}, pose_resolution(start, {}));
      const auto forward = family.shortest();
      if (!forward) continue;
      ++solved;
      write_path(start, *forward, shape, path);
      const EndError error = end_error(path, {});
      worst = std::max(worst, error.position);
      worst_heading = std::max(worst_heading, error.heading);
      CHECK(std::abs(forward->first) + std::abs(forward->second) < std::numbers::pi + 1.0);
      CHECK(path.segments.size() <= (wanted.steps == 5 ? 25u : 9u));
      for (const Segment& segment : path.segments) {
        CHECK(segment.length > 0.0);
        if (segment.curvature == 0.0 && segment.sharpness == 0.0 && segment.length < 1e-3) ++tiny;
        CHECK(std::abs(segment.curvature) <= 1.25);
        CHECK(std::abs(segment.sharpness) <= 2.5 * (1.0 + 1e-9));
      }
      if (wanted.final > 0.0) {
        CHECK(path.segments.back().curvature == 0.0);
        CHECK(path.segments.back().length >= wanted.final);
      }
    }
    CAPTURE(wanted.final, wanted.steps, worst, worst_heading, double(solved) / queries);
    CHECK(worst < 1e-12);
    CHECK(worst_heading < 1e-13);
    CHECK(tiny * 100 < solved);  // straights of less than a millimetre are not left over, but by chance
    // 1 - 0.747 of 8000 has a standard deviation of 0.5 %: three of them.
    CHECK(double(solved) / queries >= wanted.share - 0.015);
    INFO("final straight " << wanted.final << " m, steps " << wanted.steps << ": solved " << double(solved) / queries
                           << ", end error " << worst << " m, " << worst_heading << " rad");
  }
}

TEST_CASE("lane changes down to the rounding of the poses are driven, left and right, with headings a little off") {
  const TurnShape shape({1.25, 2.5});
  for (double offset = 0.3; offset > 1e-16; offset *= 0.1) {
    for (const double side : {1.0, -1.0}) {
      for (const double turn : {0.0, 0.01 * offset, -0.1 * offset}) {
        const Pose2 start{-5.0, side * offset, turn};
        CAPTURE(offset, side, turn);
        const ForwardFamily family(goal_seen_from(start, {}), shape, {0.0, 0.3}, pose_resolution(start, {}));
        const auto forward = family.shortest();
        REQUIRE(forward.has_value());
        Path path;
        write_path(start, *forward, shape, path);
        CHECK(end_error(path, {}).position < 1e-14);  // m; a few roundings of 5 m
        CHECK(end_error(path, {}).heading < 1e-14);
        CHECK(forward->length < 5.0 + 2.0 * offset);
      }
    }
  }
}

TEST_CASE("a fine scan of middle headings finds no docking that the search refuses") {
  std::mt19937 random(404);
  const TurnShape shape({1.25, 2.5});
  int missed = 0;
  double worst = 1.0;
  for (int i = 0; i < 800; ++i) {
    const Pose2 start = docking_start(random);
    const ForwardFamily family(goal_seen_from(start, {}), shape, {0.0, 0.0}, pose_resolution(start, {}));
    const auto quick = family.shortest();
    double best = 1e300;
    constexpr int fine = 2000;
    for (int j = -fine; j <= fine; ++j)
      if (const auto path = family.at(std::numbers::pi * j / fine)) best = std::min(best, path->length);
    if (best < 1e300 && !quick) ++missed;
    if (quick) worst = std::max(worst, quick->length / best);
  }
  CHECK(missed == 0);
  CHECK(worst < 1.0001);
}
