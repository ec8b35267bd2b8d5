#pragma once

#include <memory>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "calibration/camera_model.h"
#include "calibration/target.h"
#include "detection/tag_pose.h"

namespace tagdock {

/// What a person sees of one cycle.
struct ViewContent {
  cv::Mat1b gray;
  std::vector<RefinedTag> tags;           ///< outlines and corners
  std::vector<Corners> target;            ///< where the board's tags will stand in the image when the robot is docked
  std::vector<std::string> lines;         ///< text: phase, way to go, errors
  std::vector<Eigen::Vector2d> points{};  ///< single corners
};

/// A window with the live image, made with ViSP's display. Called from the loop thread.
class View {
 public:
  /// Throws Failure(usage) with what to do when there is no screen.
  View(const std::string& title, int width, int height);
  ~View();

  void show(const ViewContent& content);

 private:
  struct Window;
  std::unique_ptr<Window> window_;
};

/// Where the board's tags stand in the image of a camera at a pose; tags behind the camera are left out.
std::vector<Corners> projected_board(const Board& board, const CameraModel& camera,
                                     const Eigen::Isometry3d& T_camera_station);

}  // namespace tagdock
