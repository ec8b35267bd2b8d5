#include "calibration/board_pose.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include <Eigen/SVD>
#include <opencv2/calib3d.hpp>

namespace tagdock {
namespace {

bool flat(const std::vector<SeenPoint>& points) {
  Eigen::Matrix3Xd all(3, points.size());
  for (std::size_t i = 0; i < points.size(); ++i) all.col(static_cast<Eigen::Index>(i)) = points[i].point_board;
  all.colwise() -= all.rowwise().mean().eval();
  const Eigen::Vector3d spread = Eigen::JacobiSVD<Eigen::Matrix3Xd>(all).singularValues();
  return spread[2] < 0.02 * spread[0];  // bowed boards are flat for this purpose
}

Eigen::Isometry3d pose_of(const cv::Mat& rotation, const cv::Mat& translation) {
  const Eigen::Vector3d turn(rotation.at<double>(0), rotation.at<double>(1), rotation.at<double>(2));
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  if (turn.norm() > 0.0) T.linear() = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
  T.translation() << translation.at<double>(0), translation.at<double>(1), translation.at<double>(2);
  return T;
}

}  // namespace

double reprojection_rms(const std::vector<SeenPoint>& points, const CameraModel& camera,
                        const Eigen::Isometry3d& T_camera_board) {
  double squares = 0.0;
  for (const SeenPoint& seen : points) {
    const Eigen::Vector3d point_camera = T_camera_board * seen.point_board;
    if (!(point_camera.z() > 1e-6)) return std::numeric_limits<double>::infinity();
    squares += (project(camera, point_camera) - seen.pixel).squaredNorm();
  }
  return std::sqrt(squares / (2.0 * static_cast<double>(points.size())));
}

std::vector<Eigen::Isometry3d> board_poses(const std::vector<SeenPoint>& points, const CameraModel& camera) {
  std::vector<cv::Point3d> object;
  std::vector<cv::Point2d> image;
  for (const SeenPoint& seen : points) {
    const std::optional<Eigen::Vector2d> ideal = unproject(camera, seen.pixel);
    if (!ideal) continue;
    object.emplace_back(seen.point_board.x(), seen.point_board.y(), seen.point_board.z());
    image.emplace_back(ideal->x(), ideal->y());
  }
  if (object.size() < 4) return {};
  std::vector<Eigen::Isometry3d> poses;
  try {
    std::vector<cv::Mat> rotations;
    std::vector<cv::Mat> translations;
    const auto method = flat(points) ? cv::SOLVEPNP_IPPE : cv::SOLVEPNP_SQPNP;
    cv::solvePnPGeneric(object, image, cv::Matx33d::eye(), cv::noArray(), rotations, translations, false, method);
    for (std::size_t i = 0; i < rotations.size(); ++i) {
      cv::solvePnPRefineLM(object, image, cv::Matx33d::eye(), cv::noArray(), rotations[i], translations[i]);
      const Eigen::Isometry3d pose = pose_of(rotations[i], translations[i]);
      if (std::isfinite(reprojection_rms(points, camera, pose))) poses.push_back(pose);
    }
  } catch (const cv::Exception&) {
    return {};  // points on a line, or too few: no pose
  }
  std::stable_sort(poses.begin(), poses.end(), [&](const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
    return reprojection_rms(points, camera, a) < reprojection_rms(points, camera, b);
  });
  return poses;
}

}  // namespace tagdock
