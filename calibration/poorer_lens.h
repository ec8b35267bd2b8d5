#pragma once

#include "calibration/camera_model.h"

namespace tagdock {

/// Which lens a file format can hold.
enum class LensTerms {
  radial1,  ///< k1 (ViSP's kud)
  brown4,   ///< k1 k2 p1 p2 (Kalibr's radtan)
  brown5,   ///< and k3 (ROS plumb_bob)
  all       ///< and k4 k5 k6
};

/// The camera of fewer terms that comes nearest to a richer one, over the whole image: focal lengths, principal point
/// and the terms left are fitted to the lines of sight of its pixels.
CameraModel poorer_lens(const CameraModel& camera, LensTerms terms);

/// What is lost over the image [px]. Lines of sight stay: no turn is allowed between the two.
struct Loss {
  double largest_px = 0.0;
  double rms_px = 0.0;
};
Loss loss_between(const CameraModel& camera, const CameraModel& poorer);

/// ViSP's second coefficient: ideal = seen (1 + kdu r^2) with r of the seen point, fitted over the image to the way
/// back of a lens that has k1 only.
double visp_kdu(const CameraModel& radial);

}  // namespace tagdock
