#pragma once

#include <optional>

#include <opencv2/core.hpp>

#include "calibration/camera_model.h"
#include "detection/refined_tag.h"
#include "detection/tag_detector.h"

namespace tagdock {

/// The S-function of an edge: tanh is the paper's eq. (3), erf Hagara's AEF (the paper's eq. 1).
enum class EdgeProfile { tanh, erf };

struct EdgeRefinerConfig {
  EdgeProfile profile = EdgeProfile::tanh;
  bool pre_blur = false;  ///< the paper's filter method: blur chosen by measured blur and orientation, once per ROI
  int max_iterations = 40;
};

/// The paper's refinement: each side of the tag is a line (eq. 5) across which brightness follows an S-function (eq.
/// 3); the five values of each side (eq. 4) are fitted to the pixels of a mask between the coarse corners, and
/// neighbouring lines are intersected.
/// @param camera  if given, pixels are undistorted so that sides are straight; corners come back distorted, as seen
/// @return        corners with covariance (from the fits' own residuals), or why not
Refinement refine_edges(const cv::Mat1b& gray, const TagDetection& coarse, const EdgeRefinerConfig& config,
                        const std::optional<CameraModel>& camera = std::nullopt);

}  // namespace tagdock
