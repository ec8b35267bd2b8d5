#include "app/annotation.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>

#include <Eigen/Eigenvalues>
#include <opencv2/imgproc.hpp>

namespace tagdock {
namespace {

constexpr int shift = 4;  // OpenCV draws in sixteenths of a pixel
const cv::Scalar outline_colour(0, 220, 255);
const cv::Scalar corner_colour(60, 60, 255);
const cv::Scalar text_colour(255, 120, 0);

cv::Point fixed(const Eigen::Vector2d& pixel) {
  constexpr double far = 30000.0;  // keeps sixteenths within what OpenCV can draw
  return {static_cast<int>(std::lround(std::clamp(pixel.x(), -far, far) * (1 << shift))),
          static_cast<int>(std::lround(std::clamp(pixel.y(), -far, far) * (1 << shift)))};
}

void line(cv::Mat3b& picture, const Eigen::Vector2d& from, const Eigen::Vector2d& to, const cv::Scalar& colour,
          int width) {
  if (from.allFinite() && to.allFinite()) cv::line(picture, fixed(from), fixed(to), colour, width, cv::LINE_AA, shift);
}

void axes(cv::Mat3b& picture, const DrawnTag& tag, const CameraModel& camera) {
  const cv::Scalar colours[] = {{0, 0, 255}, {0, 200, 0}, {255, 60, 0}};
  const Eigen::Isometry3d& T = *tag.T_camera_tag;
  for (int axis = 0; axis < 3; ++axis) {
    const Eigen::Vector3d tip = T * Eigen::Vector3d(0.5 * tag.size * Eigen::Vector3d::Unit(axis));
    if (T.translation().z() > 0.0 && tip.z() > 0.0)
      line(picture, project(camera, T.translation()), project(camera, tip), colours[axis], 2);
  }
}

const cv::Scalar ellipse_colour(80, 200, 0);
const cv::Scalar residual_colour(220, 0, 220);

/// 1, 2 or 5 times a power of ten that makes a length about twelve pixels long, or 1.
double magnification(double length_px) {
  if (!(length_px > 0.0)) return 1.0;
  const double wanted = std::max(1.0, 12.0 / length_px);
  const double power = std::pow(10.0, std::floor(std::log10(wanted)));
  return power * (wanted / power >= 5.0 ? 5.0 : wanted / power >= 2.0 ? 2.0 : 1.0);
}

/// Seen corner less the pose's corner; zero without a pose.
Corners residuals(const DrawnTag& tag, const std::optional<CameraModel>& camera) {
  Corners result;
  result.fill(Eigen::Vector2d::Zero());
  if (!tag.T_camera_tag || !camera || !(tag.size > 0.0)) return result;
  const TagPoints points = tag_corners(tag.size);
  for (std::size_t i = 0; i < 4; ++i) {
    const Eigen::Vector3d corner = *tag.T_camera_tag * points[i];
    if (corner.z() > 0.0) result[i] = tag.corners_px[i] - project(*camera, corner);
  }
  return result;
}

void ellipse(cv::Mat3b& picture, const Eigen::Vector2d& centre, const Eigen::Matrix2d& covariance, double times) {
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d> axes(covariance);
  Eigen::Vector2d before = Eigen::Vector2d::Zero();
  for (int i = 0; i <= 32; ++i) {
    const double angle = 2.0 * std::numbers::pi * i / 32.0;
    const Eigen::Vector2d reach = axes.eigenvalues().cwiseMax(0.0).cwiseSqrt();
    const Eigen::Vector2d point = centre + times * (axes.eigenvectors() * Eigen::Vector2d(reach.x() * std::cos(angle),
                                                                                          reach.y() * std::sin(angle)));
    if (i > 0) line(picture, before, point, ellipse_colour, 1);
    before = point;
  }
}

/// Ellipses and residuals, each magnified alike over the picture.
void uncertainty(cv::Mat3b& picture, const std::vector<DrawnTag>& tags, const std::optional<CameraModel>& camera) {
  double largest_sigma = 0.0;
  double largest_residual = 0.0;
  for (const DrawnTag& tag : tags) {
    largest_sigma = std::max(largest_sigma, std::sqrt(std::max(0.0, tag.covariance_px2.diagonal().maxCoeff())));
    for (const Eigen::Vector2d& residual : residuals(tag, camera))
      largest_residual = std::max(largest_residual, residual.norm());
  }
  if (!(largest_sigma > 0.0)) return;
  const double sigma_times = magnification(largest_sigma);
  const double residual_times = magnification(largest_residual);
  for (const DrawnTag& tag : tags) {
    const Corners shifts = residuals(tag, camera);
    for (std::size_t i = 0; i < 4; ++i) {
      const auto k = 2 * static_cast<Eigen::Index>(i);
      if (!tag.corners_px[i].allFinite()) continue;
      ellipse(picture, tag.corners_px[i], tag.covariance_px2.block<2, 2>(k, k), sigma_times);
      if (largest_residual > 0.0)
        line(picture, tag.corners_px[i], tag.corners_px[i] + residual_times * shifts[i], residual_colour, 2);
    }
  }
  std::string words = "ellipses: 1 sigma x " + std::to_string(std::lround(sigma_times));
  if (largest_residual > 0.0) words += "; residuals x " + std::to_string(std::lround(residual_times));
  const double scale = std::clamp(picture.cols / 900.0, 0.35, 1.0);
  const cv::Point place(4, picture.rows - 5);
  cv::putText(picture, words, place, cv::FONT_HERSHEY_SIMPLEX, scale, {255, 255, 255}, 3, cv::LINE_AA);
  cv::putText(picture, words, place, cv::FONT_HERSHEY_SIMPLEX, scale, {0, 0, 0}, 1, cv::LINE_AA);
}

}  // namespace

cv::Mat3b annotated(const cv::Mat1b& gray, const std::vector<DrawnTag>& tags,
                    const std::optional<CameraModel>& camera) {
  cv::Mat3b picture;
  cv::cvtColor(gray, picture, cv::COLOR_GRAY2BGR);
  for (const DrawnTag& tag : tags) {
    Eigen::Vector2d middle = Eigen::Vector2d::Zero();
    double side = 0.0;
    for (int i = 0; i < 4; ++i) {
      line(picture, tag.corners_px[i], tag.corners_px[(i + 1) % 4], outline_colour, 1);
      middle += 0.25 * tag.corners_px[i];
      side += 0.25 * (tag.corners_px[(i + 1) % 4] - tag.corners_px[i]).norm();
    }
    for (const Eigen::Vector2d& corner : tag.corners_px)
      for (const Eigen::Vector2d& arm : {Eigen::Vector2d(4.0, 0.0), Eigen::Vector2d(0.0, 4.0)})
        line(picture, corner - arm, corner + arm, corner_colour, 1);
    if (tag.corners_px[0].allFinite())
      cv::circle(picture, fixed(tag.corners_px[0]), 6 << shift, corner_colour, 1, cv::LINE_AA, shift);
    if (tag.T_camera_tag && camera) axes(picture, tag, *camera);
    if (!middle.allFinite()) continue;
    const std::string text = std::to_string(tag.id);
    const double scale = std::clamp(side / 120.0, 0.4, 3.0);
    const cv::Point place(static_cast<int>(std::clamp(middle.x() - 10.0 * scale, -1e6, 1e6)),
                          static_cast<int>(std::clamp(middle.y() - 6.0 * scale, -1e6, 1e6)));
    cv::putText(picture, text, place, cv::FONT_HERSHEY_SIMPLEX, scale, {255, 255, 255}, 4, cv::LINE_AA);
    cv::putText(picture, text, place, cv::FONT_HERSHEY_SIMPLEX, scale, text_colour, 2, cv::LINE_AA);
  }
  uncertainty(picture, tags, camera);
  return picture;
}

}  // namespace tagdock
