#pragma once

#include <array>
#include <optional>
#include <vector>

#include <opencv2/core.hpp>

#include "calibration/target.h"
#include "detection/lens_patch.h"
#include "detection/photometric_model.h"

namespace tagdock {

/// The part of an image around a tag, in the model's image places.
struct TagRegion {
  cv::Rect pixels;
  LensPatch lens;
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();  ///< of the tag, undistorted px
  double side_px = 1.0;

  /// Image place of an undistorted pixel.
  [[nodiscard]] Eigen::Vector2d place(const Eigen::Vector2d& undistorted) const {
    return (undistorted - centre) / side_px;
  }
  [[nodiscard]] TagImageModel::Lens tag_lens() const;
};

/// Sigma of the edges' spread [px], from the steepest slope along normals of the sides: a start value.
double start_blur(const cv::Mat1b& gray, const Corners& corners_px);

/// The pixels that the model explains: those on borders, some hundreds of the flat ones, and of what surrounds the
/// print only what its margin makes sure; those of one view side by side.
/// @param every    takes every so many-th column and row
/// @param slack_px how far borders may still move
std::vector<TagSample> select_samples(const cv::Mat1b& gray, const TagImageModel& model, const TagRegion& region,
                                      double blur_px, int every, double slack_px);

/// Noise of flat cells by their light, where no model of edges can be wrong.
PixelNoise measure_noise(const TagImageModel& model, const std::vector<TagSample>& samples, double side_px);

/// What rounding to whole grey levels makes of the covariance where pixels are rounded alike.
struct RoundedTogether {
  Eigen::Matrix<double, 8, 8> covariance = Eigen::Matrix<double, 8, 8>::Zero();  ///< of the homography
  double share = 0.0;  ///< of the pixels' own scatter that is in it
};

/// Rounding errs by a sawtooth of the grey value, so two pixels of a quiet image err together as the fraction by which
/// their grey values differ tells: under an unknown offset that is common to them, their covariance is the sum over k
/// of cos(2 pi k difference) / (2 pi^2 k^2), and noise of variance s^2 takes exp(-4 pi^2 k^2 s^2) of each term (Widrow
/// and Kollar, Quantization Noise, ch. 9). Common it is to pixels that a border crosses alike; along borders that run
/// with the pixel grid nothing averages out. A noise of half a grey level leaves nothing of it all.
/// @param samples    at the minimum, with what the model gives them; those of one view side by side
/// @param influence  how the homography follows the slopes of the cost (columns: all parameters)
RoundedTogether rounded_together(const TagImageModel& model, const std::vector<TagSample>& samples,
                                 const Eigen::Matrix<double, 8, TagAppearance::count>& influence);

/// How well the model explains the pixels that count.
struct FitQuality {
  double chi2_per_pixel = 0.0;
  double rms = 0.0;       ///< grey levels
  double clipped = 0.0;   ///< share of pixels at an end of the range
  double rejected = 0.0;  ///< share of border pixels that the robust weights threw out
  double largest = 0.0;   ///< residual [sigma]
  double scale = 1.0;     ///< 1.4826 times the median residual of border pixels [sigma], at least 1
  double spread = 1.0;    ///< rms residual of border pixels that were not thrown out [sigma], at least 1
  int count = 0;
};
FitQuality quality(const std::vector<TagSample>& samples, std::size_t parameters);

/// How the weights fall with the residual: Tukey's curve on the way, all or nothing for the last fit, whose normal
/// equations are then its information.
enum class Weighing { tukey, all_or_nothing };

/// Robust weights; a patch of rejected pixels is something in front of the tag, and goes with the rim that its blur
/// reaches.
/// @param cut  residual at which a pixel's weight ends [sigma]
void weigh(std::vector<TagSample>& samples, const cv::Size& region, double blur_px, double cut, Weighing weighing);

}  // namespace tagdock
