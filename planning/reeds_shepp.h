#pragma once

#include <array>
#include <string>

#include "planning/path.h"

namespace tagdock {

/// One of the 48 words of Reeds and Shepp: up to five arcs of the smallest radius and straights, forward or in reverse.
struct ReedsSheppWord {
  std::array<double, 5> lengths{};  ///< signed [m]; negative is driven in reverse
  std::array<char, 5> turns{};      ///< 'L', 'S' or 'R', as the robot faces
  int pieces = 0;
  double length = 0.0;  ///< driven distance [m]
  int number = 0;       ///< which of the 48: the same in every answer

  /// For example "L+R-S-L-"; "|" of the literature is a change of sign.
  [[nodiscard]] std::string name() const;
  [[nodiscard]] int cusps() const;
  /// The word as arcs and straights, without pieces of length zero.
  [[nodiscard]] Path path(const Pose2& start, double curvature) const;

  bool operator==(const ReedsSheppWord&) const = default;
};

/// The words that connect two poses, the shortest first.
struct ReedsSheppWords {
  std::array<ReedsSheppWord, 48> words{};
  int count = 0;

  [[nodiscard]] const ReedsSheppWord* begin() const { return words.data(); }
  [[nodiscard]] const ReedsSheppWord* end() const { return words.data() + count; }
};

/// All 48 words, each with pieces of length one: what they are called and which way they are driven.
const std::array<ReedsSheppWord, 48>& reeds_shepp_table();

/// Every word of the 48 that has a solution between two poses. Outer arcs turn by less than a whole circle.
/// Method: Reeds and Shepp, Pacific Journal of Mathematics 145(2), 1990, section 8 with its formulas 8.1 to 8.11.
/// @param curvature  of the arcs [1/m], finite and > 0
ReedsSheppWords reeds_shepp_words(const Pose2& start, const Pose2& goal, double curvature);

/// The first of them alone, quicker.
ReedsSheppWord shortest_reeds_shepp(const Pose2& start, const Pose2& goal, double curvature);

}  // namespace tagdock
