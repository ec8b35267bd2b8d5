#include "detection/blur_filter.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <optional>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/imgproc.hpp>

#include "planning/pose2.h"

namespace tagdock {
namespace {

constexpr double sigma_space_3 = 0.8;  // OpenCV's own choice for kernels of 3 and 5: 0.3 ((n - 1) / 2 - 1) + 0.8
constexpr double sigma_space_5 = 1.1;
/// The bilateral filter's sigma of grey values as a share of the contrast: a tenth smooths noise and keeps edges.
constexpr double sigma_grey_share = 0.1;

constexpr double smallest_module_px = 5.0;  // the width of the largest kernel
constexpr double sharp_px = 0.75;           // below: less than two pixels between 10 and 90 %
constexpr double blurred_px = 1.1;          // above: as wide as the widest Gaussian would make a step
constexpr double along_the_grid = radians(10.0);

double bilinear(const cv::Mat1b& gray, double x, double y) {
  const int left = static_cast<int>(std::floor(x));
  const int top = static_cast<int>(std::floor(y));
  const double u = x - left;
  const double v = y - top;
  return (1 - v) * ((1 - u) * gray(top, left) + u * gray(top, left + 1)) +
         v * ((1 - u) * gray(top + 1, left) + u * gray(top + 1, left + 1));
}

double median(std::vector<double>& values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

struct Spread {
  double sigma_px;
  double contrast;
};

/// Of one profile across an edge: a Gaussian's step of height C and spread sigma has the slope C / (sqrt(2 pi) sigma).
std::optional<Spread> spread(const cv::Mat1b& gray, const Eigen::Vector2d& place, const Eigen::Vector2d& normal) {
  constexpr double reach = 3.0;
  constexpr double step = 0.5;
  if (!(place.x() > reach + 1 && place.y() > reach + 1 && place.x() < gray.cols - reach - 2 &&
        place.y() < gray.rows - reach - 2))
    return std::nullopt;
  double lowest = 255.0;
  double highest = 0.0;
  double steepest = 0.0;
  double before = 0.0;
  for (int i = 0; i <= static_cast<int>(2.0 * reach / step); ++i) {
    const Eigen::Vector2d point = place + (i * step - reach) * normal;
    const double grey = bilinear(gray, point.x(), point.y());
    lowest = std::min(lowest, grey);
    highest = std::max(highest, grey);
    if (i > 0) steepest = std::max(steepest, std::abs(grey - before) / step);
    before = grey;
  }
  if (steepest <= 0.0) return std::nullopt;
  return Spread{(highest - lowest) / (steepest * std::sqrt(2.0 * std::numbers::pi)), highest - lowest};
}

}  // namespace

std::string_view word(BlurKernel kernel) {
  switch (kernel) {
    case BlurKernel::none:
      return "none";
    case BlurKernel::gauss_3:
      return "gauss3";
    case BlurKernel::gauss_5:
      return "gauss5";
    case BlurKernel::bilateral_5:
      return "bilateral5";
  }
  return "unknown";
}

EdgeLook look_at_edges(const cv::Mat1b& gray, const Corners& corners_px, int modules) {
  constexpr int places = 11;
  std::vector<double> sigmas;
  std::vector<double> contrasts;
  EdgeLook look;
  look.off_axis = std::numbers::pi;
  look.least_module = std::numeric_limits<double>::infinity();
  for (int side = 0; side < 4; ++side) {
    const Eigen::Vector2d& from = corners_px[side];
    const Eigen::Vector2d& to = corners_px[(side + 1) % 4];
    const Eigen::Vector2d along = (to - from).normalized();
    const Eigen::Vector2d normal(along.y(), -along.x());
    for (int i = 0; i < places; ++i)
      if (const auto one = spread(gray, from + (0.25 + 0.5 * i / (places - 1)) * (to - from), normal)) {
        sigmas.push_back(one->sigma_px);
        contrasts.push_back(one->contrast);
      }
    const double angle = std::atan2(std::abs(along.y()), std::abs(along.x()));
    look.off_axis = std::min({look.off_axis, angle, 0.5 * std::numbers::pi - angle});
    for (const int opposite : {(side + 2) % 4, (side + 3) % 4})
      look.least_module = std::min(look.least_module, std::abs(normal.dot(corners_px[opposite] - from)) / modules);
  }
  look.blur_px = median(sigmas);
  look.contrast = median(contrasts);
  return look;
}

BlurKernel choose_blur(const EdgeLook& look) {
  if (look.blur_px <= 0.0 || look.least_module < smallest_module_px) return BlurKernel::none;
  if (look.blur_px < sharp_px && look.off_axis < along_the_grid) return BlurKernel::gauss_5;
  if (look.blur_px < blurred_px) return BlurKernel::gauss_3;
  return BlurKernel::bilateral_5;
}

BlurredPart blurred(const cv::Mat1b& gray, const cv::Rect& region, BlurKernel kernel, double contrast) {
  // The filter sees a rim around the region, so that it does not invent pixels at the region's own border.
  const cv::Rect rimmed =
      cv::Rect(region.x - 3, region.y - 3, region.width + 6, region.height + 6) & cv::Rect(0, 0, gray.cols, gray.rows);
  cv::Mat1f source;
  gray(rimmed).convertTo(source, CV_32F);
  const auto gain = [](int size, double sigma) {
    const cv::Mat1d weights = cv::getGaussianKernel(size, sigma, CV_64F);
    const double squares = weights.dot(weights);
    return squares * squares;
  };
  BlurredPart part;
  cv::Mat1f whole;
  switch (kernel) {
    case BlurKernel::none:
      whole = source;
      break;
    case BlurKernel::gauss_3:
      cv::GaussianBlur(source, whole, {3, 3}, sigma_space_3);
      part.noise_gain = gain(3, sigma_space_3);
      break;
    case BlurKernel::gauss_5:
      cv::GaussianBlur(source, whole, {5, 5}, sigma_space_5);
      part.noise_gain = gain(5, sigma_space_5);
      break;
    case BlurKernel::bilateral_5:
      cv::bilateralFilter(source, whole, 5, std::max(1.0, sigma_grey_share * contrast), sigma_space_5);
      part.noise_gain = gain(5, sigma_space_5);
      break;
  }
  part.pixels = whole(region - rimmed.tl());
  return part;
}

}  // namespace tagdock
