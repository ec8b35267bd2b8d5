#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/campaign_run.h"
#include "servo/robot.h"

namespace tagdock {

/// An external tracker (iGPS, laser tracker, motion capture): the pose of a body on the robot, in the tracker's frame.
struct TrackerReading {
  double time_s = 0.0;  ///< of the tracker's clock
  Pose2 T_tracker_body;
};

/// Reads a CSV with named columns: time_s or time_ns; x, y in m; yaw (rad), yaw_deg, or qx, qy, qz, qw. Others are
/// passed over. Throws Failure(usage) with file, line and column; also for times that do not rise.
std::vector<TrackerReading> read_tracker(const std::filesystem::path& file);

/// What a replayed session says of the robot's way.
struct DrivenWay {
  struct Moment {
    double time_s = 0.0;  ///< of the session
    Pose2 T_station_base;
  };
  std::vector<Odometry> odometry;
  std::vector<Moment> estimates;  ///< of the filter, rising in time
};

/// Session time minus tracker time, from how fast both say that the robot drove and turned.
/// Throws Failure(usage) where the robot moved too little, or the two do not go together at any shift.
struct ClockOffset {
  double seconds = 0.0;
  double correlation = 0.0;  ///< of the turn rates and speeds there; 1 is equal
};
ClockOffset align_clocks(const std::vector<TrackerReading>& tracker, const std::vector<Odometry>& odometry);

/// The two frames between a tracker and a robot: T_tracker_body = T_tracker_station * T_station_base * T_base_body.
struct TrackerFrames {
  Pose2 T_tracker_station;
  Pose2 T_base_body;  ///< the hand-eye frame
};
struct TrackerFit {
  TrackerFrames frames;
  bool station_fitted = false, body_fitted = false;
  Pose2 rms;  ///< of tracker against estimates over the way: m, m, rad
  int readings = 0;
  /// Of the fitted body's place, as far as the scatter tells [m]; large where the robot hardly turned, since then body
  /// and station cannot be told apart. 0 if it was given.
  double body_sigma = 0.0;
};

/// The frames that explain a way best; those that are known stay as given. What is fitted to the robot's own estimates
/// takes their constant errors with it: then only the scatter between dockings is independent.
/// @param ways  of one or more sessions with the same set-up, with their tracker readings and clock offsets
struct TrackedWay {
  DrivenWay way;
  std::vector<TrackerReading> tracker;
  ClockOffset clock;
};
TrackerFit fit_frames(const std::vector<TrackedWay>& ways, const std::optional<Pose2>& T_tracker_station,
                      const std::optional<Pose2>& T_base_body);

/// The robot's pose at rest at a session time, as the tracker has it: the mean of the readings of the last half second
/// before. None without readings there.
std::optional<Pose2> tracked_base(const TrackedWay& tracked, const TrackerFrames& frames, double session_time_s);

}  // namespace tagdock
