#pragma once

#include <array>
#include <optional>
#include <vector>

#include <Eigen/Core>

#include "calibration/camera_model.h"

namespace tagdock {

/// A part of the image without its lens: undistorted pixels as a polynomial of the pixel, so that no pixel needs
/// Newton's method. Interpolates `undistort` at Chebyshev places; over a few hundred pixels of any lens model that can
/// be inverted there it is exact to far below 1e-4 px.
class LensPatch {
 public:
  struct Place {
    Eigen::Vector2d undistorted;  ///< px: ideal point times focal length plus principal point
    Eigen::Matrix2d by_pixel;
  };

  /// @return none where the lens model folds over inside the patch
  static std::optional<LensPatch> make(const std::optional<CameraModel>& camera, const Eigen::Vector2d& low,
                                       const Eigen::Vector2d& high);

  [[nodiscard]] Eigen::Vector2d undistorted(const Eigen::Vector2d& pixel) const {
    return camera_ ? at(pixel).undistorted : pixel;
  }

  [[nodiscard]] Place at(const Eigen::Vector2d& pixel) const;

  [[nodiscard]] bool bends() const { return camera_.has_value(); }

  /// One row of pixels: its polynomials of the column alone.
  class Row {
   public:
    Row(const LensPatch& patch, double y);
    [[nodiscard]] Eigen::Vector2d undistorted(double x) const;

   private:
    double y_;
    bool bent_;
    double middle_ = 0.0, half_ = 1.0;
    std::array<std::array<double, 7>, 2> shift_{};  ///< by powers of (x - middle) / half
  };

  /// The pixel that an undistorted pixel is seen at.
  [[nodiscard]] Eigen::Vector2d distorted(const Eigen::Vector2d& undistorted) const;

 private:
  static constexpr int degree = 6;                                     // Row has seven powers
  using Coefficients = Eigen::Matrix<double, degree + 1, degree + 1>;  ///< of x^column y^row in [-1, 1]^2

  std::optional<CameraModel> camera_;
  Eigen::Vector2d middle_ = Eigen::Vector2d::Zero();
  Eigen::Vector2d half_ = Eigen::Vector2d::Ones();
  std::array<Coefficients, 2> shift_;  ///< undistorted minus distorted pixel
};

}  // namespace tagdock
