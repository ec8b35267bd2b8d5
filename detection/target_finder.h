#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "calibration/board_pose.h"
#include "calibration/calibration_target.h"
#include "calibration/camera_model.h"

namespace tagdock {

/// What one picture shows of a calibration board.
struct TargetView {
  std::vector<SeenPoint> corners;
  std::size_t layout = 0;     ///< which of `layouts_of` the picture shows
  int marks_found = 0;        ///< decoded marks of the board
  int marks_elsewhere = 0;    ///< decoded marks that are not where the board has them
  int corners_expected = 0;   ///< that lie inside the picture
  double blur_px = 0.0;       ///< of the edges' spread, in its worst direction
  double sharpest_px = 0.0;   ///< in its best direction; motion makes the two differ
  double clipped = 0.0;       ///< share of the pixels beside the corners at the sensor's end
  double contrast = 0.0;      ///< grey levels between dark and bright
  double residual_rms = 0.0;  ///< grey levels, of the corner fits
};

/// Finds a calibration board: decodes marks (OpenCV's aruco for ChArUco and for touching squares, which AprilTag cannot
/// separate; AprilTag for free tags), predicts every corner of the board from them, and refines it - saddles where
/// squares touch, our own whole-tag fit where tags stand free.
class TargetFinder {
 public:
  /// Throws std::invalid_argument when the description, dictionary or family makes no sense.
  explicit TargetFinder(const CalibrationTarget& target);
  ~TargetFinder();
  TargetFinder(TargetFinder&&) noexcept;
  TargetFinder& operator=(TargetFinder&&) noexcept;

  /// @param camera  if known, free tags are refined through the lens
  [[nodiscard]] TargetView find(const cv::Mat1b& gray, const std::optional<CameraModel>& camera = std::nullopt) const;

 private:
  struct Parts;
  std::unique_ptr<Parts> parts_;
};

}  // namespace tagdock
