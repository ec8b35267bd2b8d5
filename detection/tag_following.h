#pragma once

#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "calibration/camera_model.h"
#include "calibration/target.h"
#include "detection/tag_detector.h"

namespace tagdock {

/// What was found of a board where it was expected.
struct FollowedTags {
  int expected = 0;                ///< tags that should be wholly in the image, facing the camera and large enough
  std::vector<TagDetection> tags;  ///< of these, those whose code is there; by id
  Eigen::Isometry3d T_camera_station = Eigen::Isometry3d::Identity();  ///< that the borders were brought to
};

/// Finds a board's tags again without searching: from a predicted pose, the borders of all tags are looked for along
/// their normals, no farther than a cell; virtual visual servoing (ViSP) brings the pose to them; then every tag's code
/// is read at the places of its cells. Corners come from that pose and are as coarse as a detector's.
/// Source: Comport, Marchand, Pressigout and Chaumette, IEEE TVCG 2006, with borders known from the tags' codes.
/// @param predicted    T_camera_station; right to within about a cell of the tags
/// @param max_hamming  cells that may read otherwise than the code says
/// @param border_px    tags with a corner nearer to the image border are not expected
FollowedTags follow_tags(const cv::Mat1b& gray, const Board& board, const CameraModel& camera,
                         const Eigen::Isometry3d& predicted, int max_hamming, double border_px);

}  // namespace tagdock
