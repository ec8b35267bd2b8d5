#pragma once

#include <optional>
#include <string>
#include <variant>

#include <opencv2/core.hpp>

#include "calibration/camera_model.h"
#include "detection/refined_tag.h"
#include "detection/tag_detector.h"

namespace tagdock {

struct PhotometricConfig {
  int max_iterations = 60;
};

/// Fits the whole decoded tag - every black and white edge, tied by one homography - to the grey values.
/// Source: notes on detection, section 8. Terms that a clean image does not need (ink bleed, tone curve, saturation,
/// robust weights) are switched on by evidence in the image, never by the caller.
/// @param family  of the tag, which tells the pattern of `coarse.id`
/// @param camera  if given, the lens is modelled; corners come back distorted, as seen
Refinement refine_photometric(const cv::Mat1b& gray, const std::string& family, const TagDetection& coarse,
                              const PhotometricConfig& config, const std::optional<CameraModel>& camera = std::nullopt);

/// What a fit of a whole tag sees, for people.
struct PhotometricExplanation {
  RefinedTag tag;
  cv::Rect region;     ///< of the image
  cv::Mat1f modelled;  ///< the model's grey values there; NaN outside of the print
  double white = 0.0;  ///< light at the tag's centre [grey levels]
  double black = 0.0;
  Eigen::Matrix2d blur_px2 = Eigen::Matrix2d::Zero();  ///< the pixel's box and motion included
  double bleed_modules = 0.0;
  double tone_exponent = 1.0;
  double noise_black = 0.0, noise_white = 0.0;  ///< sigma, rounding included [grey levels]
  double inflation = 1.0;                       ///< of the covariance, for what pixels of one view err together
  double rejected = 0.0;                        ///< share of border pixels without weight
};

/// The same fit, with what it sees.
std::variant<PhotometricExplanation, Unrefined> explain_photometric(
    const cv::Mat1b& gray, const std::string& family, const TagDetection& coarse, const PhotometricConfig& config,
    const std::optional<CameraModel>& camera = std::nullopt);

}  // namespace tagdock
