#pragma once

#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include "app/simulation/renderer.h"
#include "app/simulation/scenario.h"
#include "detection/tag_locator.h"

namespace tagdock {

/// Where the board is looked at from, to learn how well one frame tells the robot's pose (Abawi et al. 2004, Abbas et
/// al. 2019: distance, angle and place in the image decide it).
struct AccuracyMapWish {
  Rig rig = default_rig();
  Board board = default_board(0.35);
  TagLocatorConfig locator;
  Sensor sensor;
  ChassisScenario chassis;                                         ///< shakes as the default robot does
  std::vector<double> distances = {1.0, 1.5, 2.2, 3.0, 4.0, 5.5};  ///< m, lens to the board's centre
  std::vector<double> bearings;                   ///< rad, of the lens off the board's normal; see below
  std::vector<double> places = {0.0, 0.5, 0.85};  ///< of the board's centre in the image, share of the half width
  int frames = 6;                                 ///< of each cell
  std::uint64_t seed = 1;
};

/// One cell. Errors are of the camera point and heading, along and across the line of sight: m, m, rad.
struct AccuracyCell {
  double distance = 0.0, bearing = 0.0, place = 0.0;
  int frames = 0;
  int seen = 0;          ///< frames with a pose
  int mirrored = 0;      ///< of those, with the other pose of a flat tag or far off: heading wrong by over 3 degrees
  Pose2 mean;            ///< what stays over the frames, without the mirrored ones
  Pose2 sigma;           ///< from frame to frame
  Pose2 claimed;         ///< rms of the sigma that was told, from frame to frame
  int tags_in_view = 0;  ///< whole

  /// Root of the mean square error.
  [[nodiscard]] Pose2 rms() const;
};

/// Renders every cell and looks at it with the real detector. Cells without a whole tag in view stay empty.
/// @param wish.bearings  empty: 0, 5, 10, 20, 30, 45, 60 degrees
std::vector<AccuracyCell> measure_accuracy(const AccuracyMapWish& wish,
                                           const std::function<void(int done, int wanted)>& progress);

/// accuracy_map.csv: a line a cell.
std::string accuracy_csv(const std::vector<AccuracyCell>& cells);

/// The sensor errors that the estimator and the planner read (`detection.sensor_errors`), as YAML.
std::string accuracy_yaml(const AccuracyMapWish& wish, const std::vector<AccuracyCell>& cells);

/// accuracy_map.html: a coloured table for each quantity and place in the image.
std::string accuracy_html(const AccuracyMapWish& wish, const std::vector<AccuracyCell>& cells,
                          const std::string& title);

}  // namespace tagdock
