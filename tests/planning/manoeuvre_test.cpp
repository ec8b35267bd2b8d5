#include "planning/manoeuvre.h"

#include <random>

#include <catch2/catch.hpp>

#include "planning/reeds_shepp.h"
#include "tests/planning/endpoint.h"

using namespace tagdock;

namespace {

struct Outcome {
  double position = 0.0;
  double heading = 0.0;
  int unanswered = 0;
  double ratio_sum = 0.0;
  int queries = 0;
  double jump = 0.0;

  void add(const Pose2& start, const Pose2& goal, const TurnShape& shape, Driving driving) {
    ++queries;
    const auto found = shortest_manoeuvre(goal_seen_from(start, goal), shape, driving, pose_resolution(start, goal));
    if (!found) {
      ++unanswered;
      return;
    }
    Path path;
    write_path(start, *found, shape, path);
    const EndError error = end_error(path, goal);
    position = std::max(position, error.position);
    heading = std::max(heading, error.heading);
    if (driving == Driving::both) {
      const double ideal = reeds_shepp_words(start, goal, shape.limits().max_curvature).words[0].length;
      ratio_sum += found->length / ideal;
    }
    double curvature = 0.0;
    for (const Segment& segment : path.segments) {
      if (driving == Driving::forward) CHECK(segment.length > 0.0);
      CHECK(std::abs(segment.curvature) <= shape.limits().max_curvature);
      if (shape.arc_steps() == 0) jump = std::max(jump, std::abs(segment.curvature - curvature));
      curvature = segment.end_curvature();
    }
    if (shape.arc_steps() == 0) jump = std::max(jump, std::abs(curvature));
  }
};

}  // namespace

TEST_CASE("manoeuvres between random poses end exactly and are hardly longer than without ramps") {
  std::mt19937 random(48);
  std::uniform_real_distribution<double> place(-10.0, 10.0);
  std::uniform_real_distribution<double> angle(-std::numbers::pi, std::numbers::pi);
  for (const int steps : {0, 4}) {
    const TurnShape shape({1.0, 1.0}, steps);
    Outcome both;
    Outcome forward;
    for (int i = 0; i < 3000; ++i) {
      const Pose2 start{place(random), place(random), angle(random)};
      const Pose2 goal{place(random), place(random), angle(random)};
      both.add(start, goal, shape, Driving::both);
      forward.add(start, goal, shape, Driving::forward);
    }
    INFO("steps " << steps << ": end error " << both.position << " m " << both.heading << " rad, mean length/RS "
                  << both.ratio_sum / both.queries << ", jump " << both.jump << "; forward: unanswered "
                  << forward.unanswered << " end error " << forward.position);
    CHECK(both.unanswered == 0);
    CHECK(both.position < 1e-12);
    CHECK(both.heading < 1e-12);
    CHECK(both.jump < 1e-9);
    CHECK(forward.position < 1e-12);
    CHECK(forward.heading < 1e-12);
    CHECK(both.ratio_sum / both.queries <= 1.12);
  }
}

TEST_CASE("poses from a picometre to a metre apart, near-equal headings included, get an exact manoeuvre") {
  std::mt19937 random(1012);
  std::uniform_real_distribution<double> exponent(-12.0, 0.0);
  std::uniform_real_distribution<double> angle(-std::numbers::pi, std::numbers::pi);
  const TurnShape shape({1.0, 1.0}, 0);
  Outcome outcome;
  double longest = 0.0;
  for (int i = 0; i < 3000; ++i) {
    const double distance = std::pow(10.0, exponent(random));
    const double bearing = angle(random);
    const double turn = i % 3 == 0 ? 0.0 : std::copysign(std::pow(10.0, exponent(random)), angle(random));
    const double yaw = i % 2 == 0 ? 0.0 : angle(random);
    const Pose2 start{0.0, 0.0, yaw};
    const Pose2 goal{distance * std::cos(bearing), distance * std::sin(bearing), yaw + turn};
    outcome.add(start, goal, shape, Driving::both);
  }
  INFO("near: end error " << outcome.position << " m " << outcome.heading << " rad, unanswered " << outcome.unanswered
                          << ", mean length/RS " << outcome.ratio_sum / outcome.queries << " " << longest);
  CHECK(outcome.unanswered == 0);
  CHECK(outcome.position < 1e-12);
  CHECK(outcome.heading < 1e-12);
}

TEST_CASE("goals almost straight ahead by less than a nanometre are answered where straights are nearly parallel") {
  const TurnShape shape({1.0, 1.0}, 5);
  for (const Pose2& goal : {Pose2{3.4010984808206231e-10, 1.6537119193249321e-12, 0.0},
                            Pose2{1.9062002536115881e-10, 1.668431580564789e-12, -4.8387516216052973e-11},
                            Pose2{1.4236946012175638e-09, 8.0603905592936747e-13, 6.677578490155156e-10},
                            Pose2{-7.5772299676452881e-10, 2.8113407245838365e-12, 0.0}}) {
    const auto found = shortest_manoeuvre(goal, shape, Driving::both, 0.0);
    REQUIRE(found.has_value());
    Path path;
    write_path({}, *found, shape, path);
    CHECK(end_error(path, goal).position < 1e-15);  // m; a few roundings of a manoeuvre of some millimetres
    CHECK(end_error(path, goal).heading < 1e-15);
  }
}
