#pragma once

#include <string_view>

#include <opencv2/core.hpp>

#include "calibration/target.h"

namespace tagdock {

/// The filters of the paper's pre-blur (section 3.1): OpenCV's GaussianBlur and bilateralFilter in several kernel
/// sizes.
enum class BlurKernel { none, gauss_3, gauss_5, bilateral_5 };

std::string_view word(BlurKernel kernel);

/// What the choice of a filter rests on, measured from the image of one tag.
struct EdgeLook {
  double blur_px = 0.0;       ///< sigma of the edges' spread; 0 where no edge could be measured
  double off_axis = 0.0;      ///< smallest angle between a side of the tag and a pixel row or column [rad]
  double contrast = 0.0;      ///< white minus black [grey levels]
  double least_module = 0.0;  ///< smallest cell, measured square to its side [px]
};

/// Blur and contrast are medians over profiles along the normals of the sides, at 11 places from 25 to 75 % of each.
/// @param modules  cells along a side
EdgeLook look_at_edges(const cv::Mat1b& gray, const Corners& corners_px, int modules);

/// The paper names no rule, so this one is ours; the notes and tests/bench/detection_bench.cpp measure what it does.
/// - A kernel that reaches past the neighbouring cells harms (small and strongly tilted tags): none below 5 px a cell.
/// - Edges sharper than the pixel along the pixel grid are nearly steps, for which the S-function is wrong: gauss_5.
/// - Other sharp edges: gauss_3.
/// - Edges that are blurred already need no more blur, but their noise may be smoothed along flat parts: bilateral_5.
BlurKernel choose_blur(const EdgeLook& look);

/// A filtered part of an image.
struct BlurredPart {
  cv::Mat1f pixels;
  /// Variance of white pixel noise after the filter, in flat parts, for a variance of 1 before.
  double noise_gain = 1.0;
};

/// Applies the filter once to a region.
/// @param region    within the image
/// @param contrast  white minus black [grey levels]: the bilateral filter must not mix the two
BlurredPart blurred(const cv::Mat1b& gray, const cv::Rect& region, BlurKernel kernel, double contrast);

}  // namespace tagdock
