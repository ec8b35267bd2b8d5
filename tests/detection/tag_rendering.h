#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "calibration/camera_model.h"
#include "calibration/target.h"
#include "detection/tag_pattern.h"

namespace tagdock::rendering {

/// A flat thing in the tag's plane that covers what is under it.
struct Patch {
  std::vector<Eigen::Vector2d> outline;  ///< [modules]; right to left or left to right
  double level = 0.0;                    ///< linear grey levels
};

/// A printed tag, the lens in front of it and the light on it. Grey levels are linear.
struct Scene {
  TagPattern pattern;
  Eigen::Matrix3d image_by_tag = Eigen::Matrix3d::Identity();  ///< modules from the tag's centre -> undistorted px
  std::optional<CameraModel> camera;                           ///< bends undistorted pixels
  int width = 0, height = 0;
  double white = 180.0, black = 20.0;
  double surroundings = 100.0;                       ///< beyond the print and on its unknown cells
  double blur_px = 0.7;                              ///< sigma of the optics, the pixel's box not included
  Eigen::Vector2d slope = Eigen::Vector2d::Zero();   ///< of the light, relative to the tag's centre [1/px]
  double bleed = 0.0;                                ///< every black area grows by this [modules]
  Eigen::Vector2d motion = Eigen::Vector2d::Zero();  ///< of the image during exposure [px], centred
  std::vector<Patch> patches;                        ///< on the tag or beside it, blurred with it
};

struct Sensor {
  double read_noise = 2.0;  ///< sigma [grey levels]
  double gain = 0.0;        ///< grey levels^2 of photon noise per grey level
  double tone = 1.0;        ///< exponent: 255 (I/255)^tone
  std::uint64_t seed = 1;
};

/// Tone curve in the place of the sensor's power: share of the range by share of light.
using ToneCurve = double (*)(double);

/// The curves of the sRGB and Rec. 709 standards.
double srgb(double share);
double rec709(double share);

/// Where the black square's corners truly are [px].
Corners true_corners(const Scene& scene);

/// The linear image without noise: exact areas on a grid of 8 (16 for sharp optics) cells a pixel, blurred by the
/// Gaussian times the pixel's box.
cv::Mat1d light(const Scene& scene);

/// The same scene as programs that trace rays make it: so many rays a pixel in both directions, each through another
/// place of a lens whose circle of confusion has the radius `disc_px`; no Gaussian, no exact areas, no light slope.
cv::Mat1d traced_light(const Scene& scene, int rays, double disc_px, std::uint64_t seed);

/// Noise, tone curve, clipping and rounding.
cv::Mat1b expose(const cv::Mat1d& light, const Sensor& sensor, ToneCurve curve = nullptr);

/// A tag whose mean side has `side_px`, seen by a camera of focal length `focal_px`.
/// @param tilt, tilt_axis, roll  [rad]; the axis lies in the image plane
/// @param centre                 of the tag, undistorted px
Eigen::Matrix3d view(const TagPattern& pattern, double side_px, double focal_px, const Eigen::Vector2d& principal,
                     const Eigen::Vector2d& centre, double tilt, double tilt_axis, double roll);

/// Homography from the tag to undistorted pixels whose corners are these.
Eigen::Matrix3d image_by_corners(const TagPattern& pattern, const Corners& undistorted_px);

/// Standard deviation per corner coordinate that no unbiased method can undercut, as an information matrix of the eight
/// coordinates with white, black, blur and two slopes unknown.
/// Source: notes on detection, section 7.
Eigen::Matrix<double, 8, 8> corner_information(const Scene& scene, const Sensor& sensor, ToneCurve curve = nullptr);

}  // namespace tagdock::rendering
