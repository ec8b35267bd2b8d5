#pragma once

#include <array>
#include <optional>

#include "planning/clothoid.h"

namespace tagdock {

/// A way between any two poses by up to four turns that each begin and end straight, with straights between them,
/// each piece driven forward or in reverse. Curvature is zero at both ends and at every change of direction.
struct Manoeuvre {
  static constexpr int most_turns = 4;

  std::array<double, most_turns> deflections{};  ///< rad, the heading's change; positive is counter-clockwise
  std::array<int, most_turns> directions{};      ///< +1 forward, -1 reverse
  /// Signed straights [m]: straights[i] comes before turn i, straights[turns] is the last.
  std::array<double, most_turns + 1> straights{};
  int turns = 0;
  double length = 0.0;  ///< driven distance [m]

  bool operator==(const Manoeuvre&) const = default;
};

enum class Driving {
  forward,  ///< continuous-curvature Dubins: may loop, never reverses
  both      ///< continuous-curvature Reeds-Shepp
};

/// A short manoeuvre between any two poses, exact at its end; loops and direction changes as they come.
/// Words with one straight (turn, straight, turn; with a turn of the optimal opposite drive before or after) have one
/// unknown heading each, found by bracketing every sign change; words of three and four turns start from the
/// Reeds-Shepp words of about the same size; and two turns with straights around them always exist when both drives
/// are allowed. Nothing is compared with a fixed tolerance, so poses a picometre apart get a manoeuvre of their size.
/// @param goal        in the frame of the start, heading in (-pi, pi]
/// @param resolution  rounding of the poses' coordinates [m]
/// @return            none only if rounding spoils every word, or with Driving::forward where no word applies
std::optional<Manoeuvre> shortest_manoeuvre(const Pose2& goal, const TurnShape& shape, Driving driving,
                                            double resolution);

/// Write a manoeuvre as segments, in place.
void write_path(const Pose2& start, const Manoeuvre& manoeuvre, const TurnShape& shape, Path& path);

}  // namespace tagdock
