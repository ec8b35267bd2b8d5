#pragma once

#include <filesystem>
#include <functional>
#include <string>

#include "calibration/camera_model.h"

namespace tagdock {

/// A camera model read from a file of any known format, told apart by content: ROS camera_info (the calibrator's file
/// or a printed message), OpenCV YAML, ViSP XML, Kalibr camchain (its cam0), mrcal .cameramodel, tagdock rig YAML.
/// All of them put the centre of the first pixel at (0, 0), as we do.
/// Files are untrusted: nothing of OpenCV or ViSP parses them. Every refusal is a Failure(usage) that names file, line
/// and key: a missing key, a value that is not a finite number, a lens model that we do not have.
class CameraFile {
 public:
  static CameraFile load(const std::filesystem::path& file);
  static CameraFile parse(const std::string& text, const std::string& name);

  [[nodiscard]] const CameraModel& camera() const { return camera_; }

  /// Of fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6, where `calibrate intrinsics` wrote it; zero for any other file.
  [[nodiscard]] const Eigen::Matrix<double, 12, 12>& covariance() const { return covariance_; }

  /// Throws Failure(usage) with file, line and key if the image has another size than the camera.
  void require_size(int width, int height, const std::string& image) const;

 private:
  using Refuse = std::function<void(const std::string&)>;
  CameraFile(const CameraModel& camera, Refuse refuse_size);

  CameraModel camera_;
  Eigen::Matrix<double, 12, 12> covariance_ = Eigen::Matrix<double, 12, 12>::Zero();
  Refuse refuse_size_;  ///< throws with the place of the size's key before the sentence
};

}  // namespace tagdock
