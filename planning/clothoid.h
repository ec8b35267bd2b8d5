#pragma once

#include <optional>

#include "planning/turn.h"

namespace tagdock {

/// A forward path: straight, turn, straight, turn, straight; zero curvature at both ends, heading never loops.
struct ForwardPath {
  double initial = 0.0;  ///< first straight [m], >= 0
  double first = 0.0;    ///< deflection of the first turn [rad], positive to the left
  double middle = 0.0;   ///< straight between the turns [m], >= 0
  double second = 0.0;   ///< deflection of the second turn [rad]
  double final = 0.0;    ///< last straight [m], >= 0
  double length = 0.0;   ///< of the whole path [m]

  bool operator==(const ForwardPath&) const = default;
};

/// Straights that a forward path must have at its ends [m], >= 0: the first lets castors swing in, the last is the
/// run-in.
struct Straights {
  double initial = 0.0;
  double final = 0.0;

  bool operator==(const Straights&) const = default;
};

/// All forward paths between two poses, one (or none) for every heading of the straight in the middle.
/// With the middle heading given, both turns and so their chords are known, and the straights follow from two linear
/// equations: every heading gives a path that ends exactly at the goal, so the heading is free to be chosen for
/// length, softness or view, and how finely it is searched never touches the accuracy of the end pose.
/// Of the three straights at most two are longer than they must be; the shortest such path is given. Where two of them
/// are nearly parallel they meet far away: a way more than four times as long as the distance and two whole circles
/// together is a detour that nobody means, and counts as none.
class ForwardFamily {
 public:
  /// @param goal        the goal in the frame of the start pose; heading in (-pi, pi]
  /// @param resolution  rounding of the poses [m]: offsets below it cannot be told from zero
  ForwardFamily(const Pose2& goal, const TurnShape& shape, const Straights& straights, double resolution);

  /// The path through a middle heading in [-pi, pi]; none if it would need a negative straight or more than half a
  /// circle of turning beyond the difference of the headings (a loop).
  [[nodiscard]] std::optional<ForwardPath> at(double heading) const;

  /// The shortest path of the family, to about 1e-6 of its length; none if no heading gives one.
  /// @param thorough  also look for windows of headings narrower than the scan; costs much where there is no path
  [[nodiscard]] std::optional<ForwardPath> shortest(bool thorough = true) const;

  /// How much straight the best heading of the scan lacks for a path without a loop [m]; zero or less: it has a path.
  [[nodiscard]] double lacking() const;

 private:
  struct Trial;
  struct Direction;
  [[nodiscard]] Trial attempt(const Direction& heading) const;
  [[nodiscard]] std::optional<ForwardPath> finished(const Trial& trial) const;
  [[nodiscard]] std::optional<ForwardPath> tidied(const ForwardPath& path) const;
  template <class Visit>
  void scan(const Visit& visit) const;
  [[nodiscard]] Trial shortest_between(double low, Trial middle, double high, double share) const;
  [[nodiscard]] std::optional<Trial> narrow_window(double low, Trial middle, double high) const;

  const TurnShape& shape_;
  Straights straights_;
  Pose2 goal_;
  double resolution_;
  double cos_goal_, sin_goal_;            // of the goal's heading
  double cos_half_goal_, sin_half_goal_;  // of half of it
  double x_, y_;                          // goal without the straights that must be
  double longest_;                        // way that is not yet a detour
};

/// Write a forward path as segments, in place: no allocation when `path` already has room.
/// @param direction  +1; or -1 for the mirrored path, driven backwards: what leads to (x, y, yaw) in the start's frame
///                   then leads to (-x, y, -yaw)
void write_path(const Pose2& start, const ForwardPath& forward, const TurnShape& shape, Path& path, int direction = 1);

/// Difference of two headings as an angle in (-pi, pi], exact to rounding however many whole turns they hold.
double heading_difference(double from, double to);

/// Frame of `start` -> goal, with the heading from heading_difference.
Pose2 goal_seen_from(const Pose2& start, const Pose2& goal);

/// Largest rounding of coordinates that went into two poses [m].
double pose_resolution(const Pose2& start, const Pose2& goal);

}  // namespace tagdock
