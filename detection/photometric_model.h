#pragma once

#include <algorithm>
#include <array>
#include <cmath>
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
  /// tone curve, see tone_toe.
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
  /// Way of the image while it was exposed [px]; the blur above is what is left without it.
  Eigen::Vector2d motion_px = Eigen::Vector2d::Zero();
  /// Excess kurtosis of that blur across any border: -1 for the disc of a defocused lens, positive for long tails. To
  /// first order, as an Edgeworth series has it.
  double excess = 0.0;

  /// Sigma of the whole spread, motion included, its mean over directions [px].
  [[nodiscard]] double blur_px() const {
    return std::sqrt(0.5 * (value[blur_xx] + value[blur_yy] + motion_px.squaredNorm() / 12.0));
  }
};

/// Where a pixel lies among the grid lines of a tag: which of them reach it through the blur.
struct PixelView {
  enum Kind : std::uint8_t { flat, line, general };

  Kind kind = flat;
  std::int8_t white = 0;               ///< of the cell above and left of all lines that reach the pixel
  std::array<std::int8_t, 2> first{};  ///< of the lines across u, across v; none reaches it if last < first
  std::array<std::int8_t, 2> last{};
  std::int8_t direction = 0, index = 0, step = 0;  ///< of the one line of kind `line`; step +1 from black to white
};

/// Whether two pixels see the same lines, and so the same sum of terms.
inline bool alike(const PixelView& a, const PixelView& b) {
  return a.kind == b.kind && a.white == b.white &&
         (a.kind == PixelView::general
              ? a.first == b.first && a.last == b.last
              : a.kind == PixelView::flat || (a.direction == b.direction && a.index == b.index && a.step == b.step));
}

/// The grey value that the model gives a pixel.
struct ModelledPixel {
  double grey = 0.0;         ///< grey levels, tone curve included, not clipped
  double light = 0.0;        ///< before the tone curve
  double whiteness = 0.0;    ///< 0 on black, 1 on white
  TagAppearance::Vector by;  ///< d(grey)/d(appearance)
};

/// A pixel as measured, with its part in the fit. Single precision: places are exact to 1e-5 px.
struct TagSample {
  float x = 0.0F, y = 0.0F;          ///< image place, see TagAppearance
  float grey = 0.0F;                 ///< as measured
  std::int16_t column = 0, row = 0;  ///< in the region
  PixelView view;
  bool leaks = false;      ///< its variance is mostly what may shine in from beyond the print
  float beyond_px = 1e9F;  ///< distance from what is beyond the print, where anything may be
  float weight = 1.0F;     ///< of robustness, 0 to 1
  float variance = 1.0F;   ///< of the pixel [grey levels^2]
  // What the model last gave it:
  float modelled = 0.0F;
  float whiteness = 0.0F;
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
};

/// How the slopes of the cost scatter at the minimum: the middle of a sandwich covariance.
struct Scatter {
  TagAppearance::Matrix pixels = TagAppearance::Matrix::Zero();  ///< if every pixel errs by itself
  /// Each view's slope: its pixels err together along a border that the model does not describe.
  std::vector<TagAppearance::Vector> views;
};

/// The image of a tag: all its black-white borders through one homography, a Gaussian blur integrated over the pixel,
/// exact at cell corners under any tilt, light that changes linearly over the tag.
/// Source: notes on detection, section 8, in the form over grid nodes: with every border moved by the ink's spread
/// towards white, a cell pattern is a sum of quarter planes, and each quarter plane seen through a Gaussian is a
/// bivariate normal distribution of its two signed distances. The pixel's box enters by its variance and, along
/// borders, by its fourth cumulant. Motion at an even speed is the mean of that over its way, by Gauss-Legendre nodes.
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

  /// The lines within `reach_px` of a place on the print, or of the print's nearest one.
  [[nodiscard]] PixelView view(double x, double y, double reach_px) const;

  /// Is there a black-white border on a piece of a grid line?
  /// @param direction  0: the line is across u, 1: across v
  /// @param line       1 to cells - 1
  /// @param piece      0 to cells - 1, along the line
  [[nodiscard]] bool border(int direction, int line, int piece) const {
    return direction == 0 ? cell(line, piece) != cell(line - 1, piece) : cell(piece, line) != cell(piece, line - 1);
  }

  /// What `view` gives, for many pixels of one appearance: a table of what a cell and the lines reached around it make.
  class Views {
   public:
    Views(const TagImageModel& model, double reach_px);

    struct Entry {
      PixelView view;
      std::array<std::uint16_t, 2> borders{};  ///< bit i: line i has a black-white border here
      std::uint16_t group = 0;                 ///< the same for all views that are alike
    };
    /// @param at  the place in cells from the print's upper left corner, on the print
    /// @param w   of the homography there
    /// @return    valid until the next call
    [[gnu::always_inline]] const Entry& at(const std::array<double, 2>& at, double w) {
      std::array<int, 2> here;
      std::array<int, 2> before;
      std::array<int, 2> after;
      int most = 0;
      const double reach = reach_px_ / w;
      for (std::size_t direction = 0; direction < 2; ++direction) {
        const int cell = std::min(static_cast<int>(at[direction]), model_.pattern_.cells - 1);
        const double* const px = px_per_cell_[direction].data() + most_reached + cell;
        const double low = at[direction] - cell;
        const double high = 1.0 - low;
        // Sums of truths, since no branch could be foretold.
        before[direction] = static_cast<int>(low * px[0] < reach) + static_cast<int>((low + 1.0) * px[-1] < reach) +
                            static_cast<int>((low + 2.0) * px[-2] < reach);
        after[direction] = static_cast<int>(high * px[1] < reach) + static_cast<int>((high + 1.0) * px[2] < reach) +
                           static_cast<int>((high + 2.0) * px[3] < reach);
        here[direction] = cell;
        most = std::max({most, before[direction], after[direction]});
      }
      if (most > most_reached) {
        for (std::size_t direction = 0; direction < 2; ++direction) {
          const double low = at[direction] - here[direction];
          const double high = 1.0 - low;
          const double* const px = px_per_cell_[direction].data() + most_reached + here[direction];
          before[direction] = after[direction] = 0;
          while ((low + before[direction]) * px[-before[direction]] < reach) ++before[direction];
          while ((high + after[direction]) * px[1 + after[direction]] < reach) ++after[direction];
        }
        rare_ = entry(here, before, after);
        return rare_;
      }
      const auto index = static_cast<std::size_t>(
          ((((here[1] * model_.pattern_.cells + here[0]) * cases + before[0]) * cases + after[0]) * cases + before[1]) *
              cases +
          after[1]);
      if (table_[index] == 0) {
        entries_.push_back(entry(here, before, after));
        table_[index] = static_cast<std::uint16_t>(entries_.size());
      }
      return entries_[table_[index] - 1U];
    }
    /// Distance of the nearest black-white border among the lines that are reached [px].
    [[nodiscard]] double border_px(const std::array<double, 2>& at, double w, const Entry& entry) const {
      double nearest = 1e9;
      for (std::size_t direction = 0; direction < 2; ++direction)
        for (int i = entry.view.first[direction]; i <= entry.view.last[direction]; ++i)
          if ((entry.borders[direction] >> i & 1) != 0)
            nearest = std::min(nearest, std::abs(at[direction] - i) *
                                            px_per_cell_[direction][static_cast<std::size_t>(most_reached + i)]);
      return nearest * w;
    }
    /// Distance from the print's nearest rim [px].
    [[nodiscard]] double beyond_px(const std::array<double, 2>& at, double w) const {
      const double cells = model_.pattern_.cells;
      return w * std::min(std::min(at[0] * rim_px_[0][0], (cells - at[0]) * rim_px_[0][1]),
                          std::min(at[1] * rim_px_[1][0], (cells - at[1]) * rim_px_[1][1]));
    }
    /// The views by their groups' numbers.
    [[nodiscard]] const std::vector<PixelView>& groups() const { return groups_; }

   private:
    static constexpr int most_reached = 2;  ///< lines on one side of a cell that the table knows
    static constexpr int cases = most_reached + 1;

    [[nodiscard]] Entry entry(const std::array<int, 2>& here, const std::array<int, 2>& before,
                              const std::array<int, 2>& after);

    const TagImageModel& model_;
    double reach_px_;
    /// Across a line, where the homography's w is 1; the print's own rims and what is beyond are never near.
    std::array<std::array<double, 14 + 2 * most_reached>, 2> px_per_cell_;  ///< line i at most_reached + i
    std::array<std::array<double, 2>, 2> rim_px_;                           ///< the same of these
    std::vector<std::uint16_t> table_;  ///< one more than the place among the entries; 0: not made yet
    std::vector<Entry> entries_;
    std::vector<PixelView> groups_;
    Entry rare_;
  };

  /// Has the print no cells that may be anything?
  [[nodiscard]] bool all_known() const { return all_known_; }

  /// Is there an unknown cell, or the outside of the print, among a place's own cell and its eight neighbours?
  [[nodiscard]] bool unknown_within_a_module(double u, double v) const {
    const int column = std::clamp(static_cast<int>(u + middle_), 0, pattern_.cells - 1);
    const int row = std::clamp(static_cast<int>(v + middle_), 0, pattern_.cells - 1);
    return beside_unknown_[static_cast<std::size_t>(row * pattern_.cells + column)];
  }

  /// Distance of a place of the tag from the nearest unknown cell or from what lies outside of the print [px]; only
  /// cells next to the place's own are looked at (1e9 if they are all known).
  /// @param modules_per_pixel  how fast u and v change there
  [[nodiscard]] double distance_from_unknown(const Eigen::Vector2d& place,
                                             const Eigen::Vector2d& modules_per_pixel) const;

  /// Model and derivatives at a place, seen as `view` says.
  [[nodiscard]] ModelledPixel at(double x, double y, const PixelView& view) const;

  /// Normal equations over the samples; leaves in these what was modelled. Any order will do, but samples of one view
  /// side by side are summed many times faster.
  /// @param noise  if given, the samples' variances are set from it on the way
  Equations equations(std::vector<TagSample>& samples, const PixelNoise* noise = nullptr) const;

  /// The slopes' scatter over the same samples; those of one view must be side by side.
  Scatter scatter(std::vector<TagSample>& samples) const;

 private:
  friend class TagSums;

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

  /// Where the image stood for a part of the exposure.
  struct Stop {
    double x = 0.0, y = 0.0;  ///< added to image places
    double share = 1.0;
  };

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
  std::vector<Stop> stops_ = {Stop{}};
};

/// Twice the negative log likelihood of a pixel and its derivatives by the model's grey value; a pixel at an end of the
/// range says only that the light was beyond it.
struct Misfit {
  double cost = 0.0;
  double slope = 0.0;      ///< half the derivative of the cost
  double curvature = 0.0;  ///< half its second derivative
};
Misfit misfit(double modelled, double measured, double variance);

/// Tone curves of cameras (Rec. 709, sRGB) are powers of the light with a straight piece near black:
/// grey = 255 ((light/255 + toe)^exponent - toe^exponent) / ((1 + toe)^exponent - toe^exponent).
/// The straight pieces of these two have a slope of 4.5 and 13; this toe has 7 at their exponents.
inline constexpr double tone_toe = 0.01;

/// d(grey)/d(light) of the tone curve, squared.
double stretch(double light, double exponent);

/// Rounding to whole grey levels.
inline constexpr double rounding_variance = 1.0 / 12.0;

/// Grey values from here outwards are an end of the range.
inline constexpr double lowest_grey = 0.5;
inline constexpr double highest_grey = 254.5;

}  // namespace tagdock
