#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include <Eigen/Core>

#include "detection/normal_distribution.h"
#include "detection/tag_pattern.h"

namespace tagdock {

/// What an image of one tag depends on. Image places (x, y) are undistorted pixels from the tag's centre over the tag's
/// side; (u, v) are modules from the tag's centre.
struct TagAppearance {
  /// Homography from image to tag, last entry 1: u = (g0 x + g1 y + g2)/w, v = (g3 x + g4 y + g5)/w,
  /// w = g6 x + g7 y + 1. Then light W0 + W1 x + W2 y of white, its drop C0 + C1 x + C2 y to black [grey levels], the
  /// blur's covariance with the pixel's own box included [px^2], the spread of ink [modules] and the exponent of the
  /// tone curve, grey = 255 (light/255)^exponent.
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

/// Where a pixel lies among the grid lines of a tag: which of them reach it through the blur.
struct PixelView {
  enum Kind : std::uint8_t { flat, line, general };

  Kind kind = flat;
  std::int8_t white = 0;               ///< of the cell above and left of all lines that reach the pixel
  std::array<std::int8_t, 2> first{};  ///< of the lines across u, across v; none reaches it if last < first
  std::array<std::int8_t, 2> last{};
  std::int8_t direction = 0, index = 0, step = 0;  ///< of the one line of kind `line`; step +1 from black to white
  double border_px = 1e9;                          ///< distance of the nearest line with a black-white border
};

/// The grey value that the model gives a pixel.
struct ModelledPixel {
  double grey = 0.0;         ///< grey levels, tone curve included, not clipped
  double light = 0.0;        ///< before the tone curve
  double whiteness = 0.0;    ///< 0 on black, 1 on white
  TagAppearance::Vector by;  ///< d(grey)/d(appearance)
};

/// A pixel as measured, with its part in the fit.
struct TagSample {
  double x = 0.0, y = 0.0;  ///< image place, see TagAppearance
  double grey = 0.0;        ///< as measured
  int column = 0, row = 0;  ///< in the image
  PixelView view;
  double beyond_px = 1e9;  ///< distance from what is beyond the print, where anything may be
  double weight = 1.0;     ///< of robustness, 0 to 1
  double variance = 1.0;   ///< of the pixel [grey levels^2]
  bool leaks = false;      ///< its variance is mostly what may shine in from beyond the print
  // What the model last gave it:
  double modelled = 0.0;
  double light = 0.0;
  double whiteness = 0.0;
};

/// Normal equations of the fit, over all parameters.
struct Equations {
  double cost = 0.0;  ///< twice the negative log likelihood
  TagAppearance::Vector gradient = TagAppearance::Vector::Zero();
  TagAppearance::Matrix hessian = TagAppearance::Matrix::Zero();
};

/// What varies a pixel besides the model: noise by the light, and what may shine in from beyond the print.
struct PixelNoise {
  double black = 1.0, white = 1.0;  ///< variance in linear light [grey levels^2], without rounding
  double exponent = 1.0;            ///< of the tone curve, which stretches it
  double blur_px = 1.0;
  double contrast = 0.0;  ///< linear
  double side_px = 1.0;

  /// Sets a sample's variance from what the model last gave it.
  void apply(TagSample& sample) const;
};

/// How a pixel's misfit enters the sums: as information, or squared, as the middle of a sandwich covariance.
enum class Sum { information, squared_gradient };

/// The image of a tag: all its black-white borders through one homography, a Gaussian blur integrated over the pixel,
/// exact at cell corners under any tilt, light that changes linearly over the tag.
/// Source: notes on detection, section 8, in the form over grid nodes: with every border moved by the ink's spread
/// towards white, a cell pattern is a sum of quarter planes, and each quarter plane seen through a Gaussian is a
/// bivariate normal distribution of its two signed distances. The pixel's box enters by its variance and, along
/// borders, by its fourth cumulant.
class TagImageModel {
 public:
  /// d(undistorted px)/d(px) about the tag: at its centre, and how it changes with x and y.
  struct Lens {
    Eigen::Matrix2d centre = Eigen::Matrix2d::Identity();
    Eigen::Matrix2d by_x = Eigen::Matrix2d::Zero();
    Eigen::Matrix2d by_y = Eigen::Matrix2d::Zero();
  };

  TagImageModel(const TagPattern& pattern, double side_px, const Lens& lens);

  /// Prepares the lines of the grid for one appearance; must be called before the queries below.
  void set(const TagAppearance& appearance);
  [[nodiscard]] const TagAppearance& appearance() const { return appearance_; }
  [[nodiscard]] const TagPattern& pattern() const { return pattern_; }

  [[nodiscard]] Eigen::Vector2d to_tag(double x, double y) const;

  /// The lines within `reach_px` of a place.
  /// @param on_tag  the same place in modules
  [[nodiscard]] PixelView view(double x, double y, const Eigen::Vector2d& on_tag, double reach_px) const;
  [[nodiscard]] PixelView view(double x, double y, double reach_px) const { return view(x, y, to_tag(x, y), reach_px); }

  /// Is there an unknown cell, or the outside of the print, among a place's own cell and its eight neighbours?
  [[nodiscard]] bool unknown_within_a_module(double u, double v) const {
    const int column = std::clamp(static_cast<int>(u + middle_), 0, pattern_.cells - 1);
    const int row = std::clamp(static_cast<int>(v + middle_), 0, pattern_.cells - 1);
    return beside_unknown_[static_cast<std::size_t>(row * pattern_.cells + column)];
  }

  /// Distance of a place of the tag from the nearest unknown cell or from what lies outside of the print [px]; where
  /// the print has unknown cells, only those next to the place's own are looked at (1e9 if there are none).
  /// @param modules_per_pixel  how fast u and v change there
  [[nodiscard]] double distance_from_unknown(const Eigen::Vector2d& place,
                                             const Eigen::Vector2d& modules_per_pixel) const;

  /// Model and derivatives at a place, seen as `view` says.
  [[nodiscard]] ModelledPixel at(double x, double y, const PixelView& view) const;

  /// Normal equations over the samples, every `stride`-th of them; leaves in these what was modelled.
  /// @param noise  if given, the samples' variances are set from it on the way
  Equations equations(std::vector<TagSample>& samples, Sum sum, std::size_t stride = 1,
                      const PixelNoise* noise = nullptr) const;

 private:
  /// A grid line, moved by the ink's spread: its value a x + b y + c is positive to its right or below.
  struct Line {
    double a = 0.0, b = 0.0, c = 0.0;
    double place = 0.0;                             ///< u or v [modules]
    double unit = 0.0, unit_x = 0.0, unit_y = 0.0;  ///< 1 / (value per sigma of blur across it), and how that changes
    double per_px = 0.0;                            ///< 1 / (value per pixel across it)
    double nx = 0.0, ny = 0.0;                      ///< d(value)/d(px)
    double ba = 0.0, bb = 0.0;                      ///< half of d(value per sigma, squared)/d(a, b)
    double fourth = 0.0;                            ///< kappa4 / 24 of the pixel's box across it, in units of the blur
  };
  /// [direction][grid line][0: borders from white to black, 1: from black to white].
  using Lines = std::array<std::array<std::array<Line, 2>, 13>, 2>;

  /// A corner of the white area: adds `sign` times the quarter plane to its right and below.
  struct Vertex {
    int sign = 0;
    int side_u = 0, side_v = 0;  ///< which of each pair of lines
    double correlation = 0.0;    ///< of the blurred distances from its two lines
    BivariateNormal integral;
  };

  /// 1 white; beyond the print as at its rim.
  [[nodiscard]] int cell(int column, int row) const {
    const int last = pattern_.cells - 1;
    return cells_[static_cast<std::size_t>(std::clamp(row, 0, last) * pattern_.cells + std::clamp(column, 0, last))];
  }
  [[nodiscard]] std::size_t node(int i, int j) const { return static_cast<std::size_t>(j * (pattern_.cells + 1) + i); }

  TagPattern pattern_;
  double side_px_;
  Lens lens_;
  double middle_;  ///< cells from the print's rim to its centre
  std::vector<std::int8_t> cells_;
  std::vector<std::uint8_t> beside_unknown_;
  bool all_known_ = true;
  /// Per node; corners where only opposite cells are alike have two. Ink that spreads joins the black ones ([0]), ink
  /// that shrinks the white ones ([1]).
  std::array<std::vector<std::array<Vertex, 2>>, 2> vertices_;
  TagAppearance appearance_;
  Lines lines_;
};

/// Twice the negative log likelihood of a pixel and its derivatives by the model's grey value; a pixel at an end of the
/// range says only that the light was beyond it.
struct Misfit {
  double cost = 0.0;
  double slope = 0.0;      ///< half the derivative of the cost
  double curvature = 0.0;  ///< half its second derivative
};
Misfit misfit(double modelled, double measured, double variance);

/// d(grey)/d(light) of the tone curve, squared.
double stretch(double light, double exponent);

/// Rounding to whole grey levels.
inline constexpr double rounding_variance = 1.0 / 12.0;

/// Grey values from here outwards are an end of the range.
inline constexpr double lowest_grey = 0.5;
inline constexpr double highest_grey = 254.5;

}  // namespace tagdock
