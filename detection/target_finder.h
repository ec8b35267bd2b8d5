#pragma once

#include <memory>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "calibration/board_pose.h"
#include "calibration/calibration_target.h"
#include "calibration/camera_model.h"
#include "detection/tag_detector.h"

namespace tagdock {

/// What one picture shows of a calibration board.
struct TargetView {
  std::vector<SeenPoint> corners;
  std::size_t layout = 0;          ///< which of `layouts_of` the picture shows
  int marks_found = 0;             ///< decoded marks of the board
  int marks_elsewhere = 0;         ///< decoded marks that are not where the board has them
  int corners_expected = 0;        ///< that lie inside the picture
  double blur_px = 0.0;            ///< of the edges' spread, in its worst direction
  double sharpest_px = 0.0;        ///< in its best direction; motion makes the two differ
  double clipped = 0.0;            ///< share of the pixels beside the corners at the sensor's end
  double contrast = 0.0;           ///< grey levels between dark and bright
  double residual_rms = 0.0;       ///< grey levels, of the corner fits
  std::vector<TagDetection> tags;  ///< as detected, where tags stand free
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

  /// Without the lens, whose bend within a tag or beside a corner stays in the corners: up to 0.05 px for free tags,
  /// 0.002 px where squares touch, the same way all over a picture's side, so that no claimed sigma shows it.
  [[nodiscard]] TargetView find(const cv::Mat1b& gray) const;

  /// Enough to learn the lens from, and quickly: free tags with the detector's own corners, without blur. What squares
  /// touch is as in `find`.
  [[nodiscard]] TargetView find_coarsely(const cv::Mat1b& gray) const;

  /// The corners of a picture in which the board was found, again through the lens.
  /// @param seen  of the same picture
  [[nodiscard]] TargetView refine(const cv::Mat1b& gray, const TargetView& seen, const CameraModel& camera) const;

 private:
  [[nodiscard]] TargetView find(const cv::Mat1b& gray, bool coarsely) const;

  struct Parts;
  std::unique_ptr<Parts> parts_;
};

}  // namespace tagdock
