#pragma once

#include <vector>

#include "calibration/hand_eye.h"

namespace tagdock {

/// The camera on the base by ViSP's vpHandEyeCalibration: Tsai, Procrustes, then virtual visual servoing. On a planar
/// base its height is arbitrary, and it does not say so.
VispHandEye visp_hand_eye(const std::vector<Eigen::Isometry3d>& T_camera_board,
                          const std::vector<Eigen::Isometry3d>& T_reference_base);

}  // namespace tagdock
