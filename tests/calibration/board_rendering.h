#pragma once

#include <cstdint>
#include <random>
#include <string>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "calibration/calibration_target.h"
#include "calibration/camera_model.h"

namespace tagdock::testing {

/// A picture of a calibration board that is to be drawn.
struct BoardScene {
  CameraModel camera;
  Eigen::Isometry3d T_camera_board = Eigen::Isometry3d::Identity();  ///< board frame: the drawing's
  double bow = 0.0;       ///< height of the middle over the rim, towards the viewer negative z [m]
  double bow_skew = 0.0;  ///< share of the bow that is a twist
  double white = 200.0, black = 30.0, wall = 110.0;
  double blur_px = 0.6;                              ///< sigma of the lens, the pixel's box not included
  Eigen::Vector2d motion = Eigen::Vector2d::Zero();  ///< of the image during exposure [px]
  double gain = 1.0;                                 ///< over 1: overexposed
  double noise = 2.0;                                ///< grey levels
  bool black_top_left = true;                        ///< ChArUco: colour of the top left square
  bool rows_from_above = false;                      ///< grids: where tag 0 stands
};

/// Draws it: 8 x 8 rays through every pixel that holds an edge, Gaussian blur, noise, 8 bits. Independent of what it
/// tests: the board's surface is met ray by ray.
cv::Mat1b render_board(const CalibrationTarget& target, const BoardScene& scene, std::mt19937_64& random);

/// A camera with a lens of some random distortion, 1280 x 1024.
CameraModel random_camera(std::mt19937_64& random);

/// Views as a careful person takes them: near and far, tilted to all sides by up to 45 degrees, all over the picture.
/// @param poor  nearly frontal and in the middle instead
std::vector<Eigen::Isometry3d> views_of(const CalibrationTarget& target, const CameraModel& camera, int count,
                                        std::mt19937_64& random, bool poor = false);

/// The boards of the tests: ChArUco 10 x 7 squares of 40 mm, 6 x 6 tags of 60 mm.
CalibrationTarget charuco_board();
CalibrationTarget tag_board(CalibrationTarget::Type type);

}  // namespace tagdock::testing
