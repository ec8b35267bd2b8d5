#pragma once

#include <array>
#include <vector>

#include <Eigen/Core>

#include "detection/tag_pattern.h"

namespace tagdock {

/// What an image of one tag depends on. Image places (x, y) are undistorted pixels from the tag's centre over the tag's
/// side; (u, v) are modules from the tag's centre.
struct TagAppearance {
  /// Homography from image to tag, last entry 1: u = (g0 x + g1 y + g2)/w, v = (g3 x + g4 y + g5)/w, w = g6 x + g7 y+1.
  /// Then light W0 + W1 x + W2 y of white, its drop C0 + C1 x + C2 y to black [grey levels], the blur's covariance with
  /// the pixel's own box included [px^2], the spread of ink [modules] and the exponent of the tone curve.
  enum Index {
    homography = 0,
    white = 8,
    drop = 11,
    blur_xx = 14,
    blur_xy = 15,
    blur_yy = 16,
    bleed = 17,
    tone = 18,
    count = 19
  };
  using Vector = Eigen::Matrix<double, count, 1>;
  using Matrix = Eigen::Matrix<double, count, count>;

  Vector value = Vector::Zero();
};

/// A pixel that the model explains.
struct TagPixel {
  double x = 0.0, y = 0.0;                        ///< image place, see TagAppearance
  double xx = 1.0, xy = 0.0, yx = 0.0, yy = 1.0;  ///< d(undistorted px)/d(px)
  double grey = 0.0;                              ///< as measured
  int column = 0, row = 0;                        ///< in the image
};

/// The grey value that the model gives a pixel.
struct ModelledPixel {
  double grey = 0.0;         ///< grey levels, tone curve included, not clipped
  double light = 0.0;        ///< before the tone curve
  double whiteness = 0.0;    ///< 0 on black, 1 on white
  double node = 0.0;         ///< how much of a cell corner's blur reaches the pixel; 0 along a straight edge
  TagAppearance::Vector by;  ///< d(grey)/d(appearance)
};

/// The image of a tag: all its black-white borders through one homography, a Gaussian blur integrated over the pixel,
/// exact at cell corners under any tilt, light that changes linearly over the tag.
/// Source: notes on detection, section 8, in the form over grid nodes: with every border moved by the ink's spread
/// towards white, a cell pattern is a sum of quarter planes, and each quarter plane seen through a Gaussian is a
/// bivariate normal distribution of its two signed distances.
class TagImageModel {
 public:
  TagImageModel(const TagPattern& pattern, double side_px);

  /// Prepares the lines of the grid for one appearance; must be called before the queries below.
  void set(const TagAppearance& appearance);
  [[nodiscard]] const TagAppearance& appearance() const { return appearance_; }

  [[nodiscard]] Eigen::Vector2d to_tag(double x, double y) const;

  /// Model and derivatives at a pixel.
  [[nodiscard]] ModelledPixel at(const TagPixel& pixel) const;

  /// Is a black-white border within `reach_px` of the pixel?
  [[nodiscard]] bool near_border(const TagPixel& pixel, double reach_px) const;

  /// Distance of a place of the tag from the nearest unknown cell or from what lies outside of the print [px]; 1e9 if
  /// that is more than a module away.
  /// @param modules_per_pixel  how fast u and v change there
  [[nodiscard]] double distance_from_unknown(const Eigen::Vector2d& place,
                                             const Eigen::Vector2d& modules_per_pixel) const;

  [[nodiscard]] double half_border() const { return 0.5 * pattern_.border_cells; }
  [[nodiscard]] const TagPattern& pattern() const { return pattern_; }

 private:
  /// A grid line, moved by the ink's spread: l x = (a x + b y + c), positive to its right or below.
  struct Line {
    double a = 0.0, b = 0.0, c = 0.0;
    double place = 0.0;   ///< u or v [modules]
    double fourth = 0.0;  ///< kappa4 / 24 of the box across this line, in units of the blur
  };
  /// Lines [direction][grid line][0: ink spreads to lower, 1: to higher coordinates].
  using Lines = std::array<std::vector<std::array<Line, 2>>, 2>;

  /// A corner of the white area: adds `sign` times the quarter plane to its right and below.
  struct Vertex {
    int sign = 0;
    int side_u = 0, side_v = 0;  ///< index into Line pairs
  };

  [[nodiscard]] int cell(int column, int row) const;  ///< 1 white; beyond the print as at its rim

  TagPattern pattern_;
  double side_px_;
  double middle_;  ///< cells from the print's rim to its centre
  std::vector<std::int8_t> cells_;
  std::vector<std::array<Vertex, 2>> vertices_;
  TagAppearance appearance_;
  Lines lines_;
};

}  // namespace tagdock
