#pragma once

#include <deque>
#include <optional>
#include <string>

#include "planning/pose2.h"
#include "servo/pose_filter.h"

namespace tagdock {

/// Beyond what odometry, castors and unequal wheels explain, and 3 sigma of the seen yaw. Source: notes on docking, 9
/// (yaw), notes on reliability, row 17 (place). Castors that turn round push a robot by over 3 degrees without slip; so
/// twice what they are believed to do is allowed again, and nothing is judged before they have settled to a direction.
struct SlipConfig {
  double yaw = 0.0524;        ///< rad (3 degrees) ...
  double yaw_way = 0.3;       ///< ... over this way [m]
  double place = 0.050;       ///< m ...
  double place_way = 0.2;     ///< ... over this way [m]
  int sightings = 3;          ///< in a row that say so; a single one may be wrong itself
  double castor_times = 2.0;  ///< what castors may do unforeseen, to the turn that they are believed to have done
  double castor_way = 0.6;    ///< m in one direction, until castors that stood anywhere trail
};

/// What the filter had to put right along the way: how far encoders and camera are apart.
class SlipWatch {
 public:
  explicit SlipWatch(const SlipConfig& config) : config_(config) {}

  /// The robot stands, or the estimate is new: what was put right before does not count.
  void reset();

  /// Takes what became of a sighting.
  /// @param travelled  by the wheels since the last change of direction [m]
  /// @return           a sentence if the robot slipped
  std::optional<std::string> take(const FilterUpdate& update, double travelled);

 private:
  struct Moment {
    double travelled;
    Pose2 corrected;  ///< sum since the reset: x, y in the station frame, yaw
    double castor_turn;
  };
  SlipConfig config_;
  std::deque<Moment> moments_;
  Pose2 corrected_;
  int in_a_row_ = 0;
};

}  // namespace tagdock
