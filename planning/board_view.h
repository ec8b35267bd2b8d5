#pragma once

#include <vector>

#include "planning/path.h"

namespace tagdock {

/// What the camera must keep in view on the whole way.
struct ViewWish {
  Pose2 T_station_board;                   ///< foot of the board, x into the wall: by definition the station's origin
  double horizontal_view = radians(55.0);  ///< full angle of the lens [rad]
  double margin = radians(1.0);            ///< kept free at both sides of the image [rad]
  double camera_ahead = 0.35;              ///< camera before the axle [m]
  double board_half_width = 0.2;           ///< farthest tag corner from the board's centre [m]
  double min_range = 0.0;                  ///< camera to board centre [m]
  double max_range = 8.0;                  ///< [m]
  double camera_yaw = 0.0;                 ///< where the camera looks, against the robot's front; pi: backwards [rad]
  /// Centres of the tags in the board's frame, x into the tag's face. None: incidence is not asked for.
  std::vector<Pose2> tags;
  /// Where yaw is measured, at least one tag is seen between these angles off its normal [rad]: nearer to head-on a
  /// flat tag's yaw is lost in the noise (and has two solutions), flatter its corners run together. The paper's 25 to
  /// 75 deg.
  double least_incidence = radians(25.0);
  double most_incidence = radians(75.0);
  bool measured_at_start = true;    ///< yaw is measured at the start pose
  double measured_over_last = 0.0;  ///< and over so much of the way's end [m]; 0: at the goal; negative: not there

  bool operator==(const ViewWish&) const = default;
};

/// Bearing of the board's edge that is farther from the optical axis [rad], for a robot at T_station_base; above half
/// the view, the board is not whole in the image. Behind the camera it is above pi/2.
double board_bearing(const Pose2& T_station_base, const ViewWish& view);

/// Is the board whole in the image and within range, for a robot at T_station_base?
bool in_view(const Pose2& T_station_base, const ViewWish& view);

/// Does the board stay in view along a path? Between two looks nothing can have happened: steps are as long as bounds
/// on the second derivative of the distance between board edge and image border allow, but never below 1 mm.
/// @param largest  receives the largest bearing that was looked at [rad], at least at every end of a segment
bool keeps_view(const Path& path, const ViewWish& view, double& largest);

/// Angle between the line of sight from the camera to a tag's centre and the tag's normal [rad], 0 head-on, in [0, pi].
double incidence(const Pose2& T_station_base, const ViewWish& view, const Pose2& T_board_tag);

/// How far the best tag is outside of the wanted incidence [rad]; zero if some tag is seen well, or none was named.
double incidence_fault(const Pose2& T_station_base, const ViewWish& view);

/// The largest incidence_fault at the poses of a path where yaw is measured.
double incidence_fault(const Path& path, const ViewWish& view);

}  // namespace tagdock
