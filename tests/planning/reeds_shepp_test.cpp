#include "planning/reeds_shepp.h"

#include <random>
#include <set>

#include <catch2/catch.hpp>

#include "tests/planning/endpoint.h"

using namespace tagdock;

TEST_CASE("every Reeds-Shepp word ends at the goal, the shortest first") {
  std::mt19937 random(1990);
  std::uniform_real_distribution<double> place(-10.0, 10.0);
  std::uniform_real_distribution<double> angle(-4.0, 4.0);
  std::set<std::string> names;
  for (int i = 0; i < 3000; ++i) {
    const double field = i % 3 == 0 ? 0.1 : 1.0;
    const Pose2 start{field * place(random), field * place(random), angle(random)};
    const Pose2 goal{field * place(random), field * place(random), angle(random)};
    const ReedsSheppWords words = reeds_shepp_words(start, goal, 1.0);
    REQUIRE(words.count >= 8);
    CHECK(shortest_reeds_shepp(start, goal, 1.0).length == Approx(words.words[0].length).epsilon(1e-14));
    double last = 0.0;
    for (const ReedsSheppWord& word : words) {
      CAPTURE(i, word.name(), word.length);
      const EndError error = end_error(word.path(start, 1.0), goal);
      CHECK(error.position < 1e-12);  // m; tens of roundings of 20 m
      CHECK(error.heading < 1e-13);   // rad
      CHECK(word.length >= last);
      last = word.length;
      names.insert(word.name());
    }
  }
  CHECK(names.size() == 48);
  std::set<std::string> listed;
  for (const ReedsSheppWord& word : reeds_shepp_table()) listed.insert(word.name());
  CHECK(listed == names);
}

TEST_CASE("a word keeps its number in every answer, so that those without a solution can be told") {
  std::mt19937 random(4800);
  std::uniform_real_distribution<double> place(-4.0, 4.0);
  for (int i = 0; i < 300; ++i) {
    const ReedsSheppWords words = reeds_shepp_words({}, {place(random), place(random), place(random)}, 1.0);
    std::set<int> numbers;
    for (const ReedsSheppWord& word : words) {
      numbers.insert(word.number);
      for (const ReedsSheppWord& listed : reeds_shepp_table())
        if (listed.number == word.number) CHECK(listed.name() == word.name());
    }
    CHECK(numbers.size() == static_cast<std::size_t>(words.count));
  }
}

TEST_CASE("a goal straight ahead or behind is reached straight, without a whole circle from rounding") {
  for (const double yaw : {0.0, 0.3, 1.5707963267948966, 2.9, -3.1}) {
    const Pose2 start{1.0, -2.0, yaw};
    for (const double way : {3.0, -2.0}) {
      const ReedsSheppWords words = reeds_shepp_words(start, start * Pose2{way, 0.0, 0.0}, 1.3);
      CHECK(words.words[0].length == Approx(std::abs(way)).epsilon(1e-12));
    }
  }
}

TEST_CASE("a goal on the first arc is reached by that arc alone") {
  const Pose2 goal = pose_along({}, {1.1, 0.8, 0.0}, 1.1);
  CHECK(reeds_shepp_words({}, goal, 0.8).words[0].length == Approx(1.1).epsilon(1e-12));
}
