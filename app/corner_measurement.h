#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "app/simulation/corner_errors.h"
#include "app/simulation/renderer.h"
#include "detection/tag_locator.h"

namespace tagdock {

/// What is rendered to measure the errors of corners.
struct CornerMeasurementWish {
  CornerMethod method = CornerMethod::tanh;
  Rig rig = default_rig();
  Board board = default_board(0.35);
  Sensor sensor;
  std::vector<double> distances = {0.95, 1.4, 2.0, 2.8, 3.9, 5.5};  ///< m, lens before the board
  int poses = 8;         ///< at each distance: beside the axis and turned, as a docking robot is
  int frames = 5;        ///< of each pose, with new noise
  double blur_px = 2.0;  ///< motion during the exposure, where its share is measured
  std::uint64_t seed = 1;
};

/// What was found at one distance.
struct CornerMeasurement {
  double side_px = 0.0;          ///< geometric mean of the tags' shortest sides
  double noise_px = 0.0;         ///< sigma of a coordinate from frame to frame
  double bias_px = 0.0;          ///< rms of what stays
  double claimed_px = 0.0;       ///< rms of the sigma that was told
  double moving_noise_px = 0.0;  ///< as noise_px, with motion blur
  int corners = 0;               ///< coordinates over all frames at rest
  int missed = 0;                ///< tags that were in view and not found
};

/// Renders the board and refines what the detector finds, against the true corners.
/// @param progress  called after every distance
std::vector<CornerMeasurement> measure_corners(const CornerMeasurementWish& wish,
                                               const std::function<void(int done, int wanted)>& progress);

/// The error model that says the same.
CornerErrors errors_from(const std::vector<CornerMeasurement>& measured, double blur_px);

}  // namespace tagdock
