#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "calibration/camera_model.h"
#include "calibration/target.h"
#include "detection/tag_pose.h"
#include "planning/pose2.h"

namespace tagdock {

/// One moment of a docking, for the picture.
struct DockingMoment {
  std::chrono::nanoseconds time{0};
  std::string phase;
  std::optional<Pose2> estimated;  ///< camera point in the station frame
  std::optional<Pose2> truth;      ///< the same, simulated only
};

struct DockingStory {
  std::vector<DockingMoment> moments;
  Pose2 dock_pose;
  Board board;
  cv::Mat1b last_image;
  std::vector<RefinedTag> last_tags;
  std::vector<std::string> lines;  ///< the summary
};

/// A docking at a glance: the last image with what was found in it, the way from above, and the errors over time.
std::string docking_picture(const DockingStory& story);

}  // namespace tagdock
