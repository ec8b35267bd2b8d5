#pragma once

#include <random>
#include <string>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "calibration/camera_model.h"
#include "calibration/target.h"

namespace tagdock::testing {

/// One tag before an even grey wall, its white margin one cell wide.
struct Scene {
  CameraModel camera{320, 320, 800.0, 800.0, 159.5, 159.5};
  std::string family = "tag36h11";
  int id = 0;
  double size = 0.16;  ///< side of the square that the family's corners belong to [m]
  Eigen::Isometry3d T_camera_tag = Eigen::Isometry3d::Identity();
  double white = 200.0, black = 40.0, wall = 120.0;  ///< grey levels
  double psf_px = 0.7;                               ///< sigma of the lens' spread
};

/// Exact area coverage of the projected cells, Gaussian PSF integrated over the pixel, no noise, not rounded; corners
/// come from the projection alone. Written for the tests; it shares no code with what it tests.
struct Rendering {
  cv::Mat1d grey;
  Corners corners_px;
};
Rendering render(const Scene& scene);

/// The same rendered into an image that may hold other tags already; returns the true corners.
Corners render_into(cv::Mat1d& grey, const Scene& scene);

/// With Gaussian noise of the sigma [grey levels], rounded and clipped to 8 bits.
cv::Mat1b digitised(const cv::Mat1d& grey, double noise, std::mt19937_64& random);

/// A pose that shows the tag about `side_px` large at the image place `centre_px` (without distortion).
/// @param tilt      between tag normal and line of sight [rad]
/// @param tilt_way  direction in the image in which the tag leans [rad]
/// @param roll      of the tag in its own plane [rad]
Eigen::Isometry3d pose_seen(const CameraModel& camera, double size, double side_px, const Eigen::Vector2d& centre_px,
                            double tilt, double tilt_way, double roll);

/// The base condition of the notes: 100 px, contrast 160, PSF 0.7, tilt 30 degrees, random roll, place and id.
Scene base_scene(std::mt19937_64& random, double side_px = 100.0, double tilt_deg = 30.0);

/// Root of the mean square over the eight coordinates of all tags; add tags one by one.
struct CornerError {
  double squares = 0.0;
  double worst_px = 0.0;  ///< largest distance of a corner
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  int corners = 0;

  void add(const Corners& found, const Corners& truth);
  [[nodiscard]] double rms_px() const;
  [[nodiscard]] Eigen::Vector2d mean_px() const;
};

}  // namespace tagdock::testing
