#include "calibration/visp_hand_eye.h"

#include <cstdio>
#include <fcntl.h>
#include <iostream>
#include <unistd.h>

#include <visp3/vision/vpHandEyeCalibration.h>

namespace tagdock {
namespace {

vpHomogeneousMatrix to_visp(const Eigen::Isometry3d& T) {
  vpHomogeneousMatrix M;
  for (unsigned row = 0; row < 3; ++row)
    for (unsigned column = 0; column < 4; ++column)
      M[row][column] = T.matrix()(static_cast<Eigen::Index>(row), static_cast<Eigen::Index>(column));
  return M;
}

/// While one lives, nothing reaches stdout or stderr: ViSP prints its residuals there, which belong to our results.
class Quiet {
 public:
  Quiet() {
    std::cout.flush();
    std::fflush(stdout);
    const int nowhere = open("/dev/null", O_WRONLY | O_CLOEXEC);
    for (const int stream : {STDOUT_FILENO, STDERR_FILENO}) {
      kept_[stream] = dup(stream);
      if (kept_[stream] >= 0 && nowhere >= 0) dup2(nowhere, stream);
    }
    if (nowhere >= 0) close(nowhere);
  }
  ~Quiet() {
    std::cout.flush();
    std::fflush(stdout);
    for (const int stream : {STDOUT_FILENO, STDERR_FILENO}) {
      if (kept_[stream] < 0) continue;
      dup2(kept_[stream], stream);
      close(kept_[stream]);
    }
  }
  Quiet(const Quiet&) = delete;
  Quiet& operator=(const Quiet&) = delete;

 private:
  int kept_[3] = {-1, -1, -1};  // by descriptor
};

}  // namespace

VispHandEye visp_hand_eye(const std::vector<Eigen::Isometry3d>& T_camera_board,
                          const std::vector<Eigen::Isometry3d>& T_reference_base) {
  std::vector<vpHomogeneousMatrix> boards;
  std::vector<vpHomogeneousMatrix> bases;
  for (const Eigen::Isometry3d& T : T_camera_board) boards.push_back(to_visp(T));
  for (const Eigen::Isometry3d& T : T_reference_base) bases.push_back(to_visp(T));
  VispHandEye result;
  try {
    const Quiet quiet;
    vpHomogeneousMatrix T;
    result.solved = vpHandEyeCalibration::calibrate(boards, bases, T) == 0;
    for (unsigned row = 0; row < 3; ++row)
      for (unsigned column = 0; column < 4; ++column)
        result.T_base_camera.matrix()(static_cast<Eigen::Index>(row), static_cast<Eigen::Index>(column)) =
            T[row][column];
  } catch (const vpException&) {
    result.solved = false;
  }
  if (!result.T_base_camera.matrix().allFinite() ||
      (result.T_base_camera.linear() * result.T_base_camera.linear().transpose() - Eigen::Matrix3d::Identity()).norm() >
          1e-3)
    result = VispHandEye{};
  return result;
}

}  // namespace tagdock
