#pragma once

#include <array>
#include <optional>

#include <Eigen/Core>
#include <opencv2/core.hpp>

#include "calibration/camera_model.h"

namespace tagdock {

/// Where the pixels of one rectangle would lie if the lens did not bend straight lines: in px, with the camera's own
/// focal lengths and principal point. Exact inversion of the lens costs about a microsecond a pixel, so it is done at
/// 7 x 7 places and interpolated by Chebyshev polynomials; where these miss the exact place by more than 1e-4 px, every
/// pixel is inverted after all.
class StraightPixels {
 public:
  /// @param camera     none: pixels are taken to be straight already
  /// @param rectangle  [px] not empty
  StraightPixels(const std::optional<CameraModel>& camera, const cv::Rect& rectangle);

  /// The straight place of a pixel; none where the lens model folds over.
  [[nodiscard]] std::optional<Eigen::Vector2d> straight(const Eigen::Vector2d& pixel) const;

  /// A row of pixels at once: their straight places, NaN where the lens model folds over.
  /// @param first, last  first and last column, within the rectangle
  void row(int y, int first, int last, Eigen::ArrayXd& straight_x, Eigen::ArrayXd& straight_y) const;

  /// The way back for any point: pixel of a straight place, and its derivative.
  struct Bent {
    Eigen::Vector2d pixel;
    Eigen::Matrix2d by_straight;
  };
  [[nodiscard]] Bent bent(const Eigen::Vector2d& straight) const;

  /// Whether the lens bends at all.
  [[nodiscard]] bool bends() const { return camera_.has_value(); }

 private:
  static constexpr int nodes = 7;
  using Coefficients = Eigen::Matrix<double, nodes, nodes>;

  [[nodiscard]] Eigen::Vector2d interpolated(const Eigen::Vector2d& pixel) const;
  [[nodiscard]] bool interpolates() const;

  std::optional<CameraModel> camera_;  ///< only if it bends
  cv::Rect rectangle_;
  bool exact_ = false;
  std::array<Coefficients, 2> shift_;  ///< straight minus bent [px], x and y, by Chebyshev order in (y, x)
};

}  // namespace tagdock
