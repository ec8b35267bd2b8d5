#pragma once

#include <optional>
#include <string>
#include <vector>

#include "calibration/rig.h"
#include "calibration/target.h"
#include "detection/edge_refiner.h"
#include "detection/frame.h"
#include "detection/photometric_refiner.h"
#include "detection/tag_detector.h"
#include "detection/tag_pose.h"

namespace tagdock {

/// How corners are made: the library's own, the paper's tanh fit, the paper's with its pre-blur, AEF, or ours.
enum class CornerMethod { apriltag, tanh, filter, erf, best };

/// By its word ("apriltag", "tanh", ...); none if unknown.
std::optional<CornerMethod> corner_method(const std::string& word);
std::string_view word(CornerMethod method);

/// Refines one detection by the method; the library's own corners come back with a covariance that is true of them
/// (0.1 px), with `terms` "apriltag".
Refinement refine(const cv::Mat1b& gray, const std::string& family, const TagDetection& coarse, CornerMethod method,
                  const std::optional<CameraModel>& camera);

/// Is a fit of the whole tag, by its own covariance, finer than the library's corners? Where not, `refine` tries the
/// sides alone.
bool fine_enough(const RefinedTag& whole);

struct TagLocatorConfig {
  CornerMethod method = CornerMethod::best;
  TagDetectorConfig detector;
  /// Fit the board's pose to the pixels of all its tags together instead of to their corners. The corners with their
  /// covariances hold all that the pixels know of the pose, but for a blur that is common to the tags.
  bool joint = false;
  bool follow = true;          ///< look for borders where the prediction has them before searching
  double region_margin = 0.5;  ///< the searched region is the predicted board enlarged by this share of its size
  double sigma_roll_deg = 0.1;
  double sigma_pitch_deg = 0.2;
  double sigma_height_mm = 2.0;
};

/// How the camera stands over the floor, as far as the rig and the configuration tell.
GroundPrior ground_prior(const Rig& rig, const TagLocatorConfig& config);

/// The spine of seeing: Frame -> Sighting. Steps, in order: following the prediction or else region and detection;
/// refinement; board pose; if asked for, the pose again from the pixels of all tags.
class TagLocator {
 public:
  TagLocator(const Rig& rig, const Board& board, const TagLocatorConfig& config);

  /// @param predicted  where the camera is expected to see the station (T_camera_station): its tags are followed there;
  ///                   if one of them is missing that part of the image is searched, and the whole frame if the board
  ///                   is not there
  [[nodiscard]] Sighting locate(const Frame& frame, const std::optional<Eigen::Isometry3d>& predicted) const;

  [[nodiscard]] const TagLocatorConfig& config() const { return config_; }

 private:
  Rig rig_;
  Board board_;
  TagLocatorConfig config_;
  TagDetector detector_;
};

}  // namespace tagdock
