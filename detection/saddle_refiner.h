#pragma once

#include <optional>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "calibration/camera_model.h"

namespace tagdock {

/// Where a chessboard corner is expected, and how far its two edges can be trusted.
struct SaddleGuess {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  /// Image of the board's x and y direction: columns, px per unit of the drawing.
  Eigen::Matrix2d pixel_by_drawn = Eigen::Matrix2d::Identity();
  double reach = 1.0;      ///< along the edges, in units of the drawing
  double clearance = 0.5;  ///< beside them
};

/// A corner where four fields meet, two dark and two bright ones.
struct Saddle {
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Eigen::Matrix2d covariance_px2 = Eigen::Matrix2d::Zero();
  double mean = 0.0;       ///< grey level between dark and bright
  double amplitude = 0.0;  ///< half the contrast; positive if the fields along +x+y and -x-y are bright
  /// Unit normals of the two edges and the blur across each [px].
  Eigen::Vector2d normal[2] = {Eigen::Vector2d::UnitX(), Eigen::Vector2d::UnitY()};
  double blur_px[2] = {0.0, 0.0};
  double residual_rms = 0.0;  ///< grey levels
  double clipped = 0.0;       ///< share of the pixels used that are at 254 or above
};

/// Fits two blurred edges that cross: I = mean + amplitude S(n1 . d / s1) S(n2 . d / s2) + slope . d, d = pixel -
/// corner, S = erf(. / sqrt 2). Blur that is the same to both sides, slopes of light and growth of ink leave the corner
/// in place. Levenberg-Marquardt on the pixels beside the edges.
/// @param camera  if given, pixels are first straightened through the lens, which bends the edges of a window of 14 px
///                by some hundredths of a pixel and moves corners by 0.001 to 0.002 px towards or from the middle, all
///                alike; the corner comes back as seen
/// @return none if the window leaves the image, is too small, or no corner explains it
std::optional<Saddle> refine_saddle(const cv::Mat1b& gray, const SaddleGuess& guess,
                                    const std::optional<CameraModel>& camera = std::nullopt);

}  // namespace tagdock
