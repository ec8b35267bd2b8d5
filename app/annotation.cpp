#include "app/annotation.h"

#include <algorithm>
#include <cmath>
#include <string>

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
  return picture;
}

}  // namespace tagdock
