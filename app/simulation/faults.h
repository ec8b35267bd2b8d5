#pragma once

namespace tagdock {

/// What is made to go wrong, for tests and demonstrations; zero means never.
struct SimulationFaults {
  double camera_dies_at_s = 0.0;   ///< session time from which no frame comes
  double odometry_nan_at_s = 0.0;  ///< session time from which odometry is not a number
  bool no_board = false;           ///< the station has no tags
};

}  // namespace tagdock
