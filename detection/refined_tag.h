#pragma once

#include <string>
#include <string_view>
#include <variant>

#include <Eigen/Core>

#include "calibration/target.h"

namespace tagdock {

/// A tag whose corners were fitted to the grey values.
struct RefinedTag {
  int id = 0;
  int hamming = 0;
  double margin = 0.0;
  Corners corners_px;  ///< as seen (distorted), our convention and order
  /// [x0 y0 x1 y1 .. y3], px^2; marginal over everything else that was fitted.
  Eigen::Matrix<double, 8, 8> covariance_px2 = Eigen::Matrix<double, 8, 8>::Zero();
  double residual_rms = 0.0;    ///< grey levels
  double chi2_per_pixel = 0.0;  ///< about 1 when the model explains the pixels; 0 when the method cannot tell
  double blur_px = 0.0;         ///< sigma of the edge's spread, 0 when the method cannot tell
  /// Which terms of the model were on, as words joined by '+': for example "tanh" or "homography+slope+bleed".
  std::string terms;
};

/// Why corners could not be refined.
enum class Unrefined {
  too_few_pixels,       ///< the tag is too small for its band of pixels
  left_the_edge,        ///< a corner moved farther than a coarse corner can be wrong
  did_not_converge,     ///< no minimum was reached
  not_a_quadrilateral,  ///< the corners found do not form a convex quadrilateral
  other_pattern         ///< black and white do not lie as the decoded tag has them
};

std::string_view word(Unrefined reason);

using Refinement = std::variant<RefinedTag, Unrefined>;

}  // namespace tagdock
