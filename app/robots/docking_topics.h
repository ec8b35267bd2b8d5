#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>

#include "app/camera.h"
#include "app/docking_loop.h"
#include "app/robots/ros2.h"

namespace tagdock {

/// Where the axle has to go, as seen by one sighting: the docked pose in the base frame at image time. Nav2's docking
/// server takes it unchanged, with all its external_detection_translation and _rotation parameters at 0.
ros2::PoseStamped detected_dock_pose(const PlanarSighting& sighting, const Pose2& goal_of_axle, const ros2::Time& stamp,
                                     const std::string& base_frame);

/// The tags of a sighting. Corners run as AprilTag's own do - bottom left, bottom right, top right, top left of the tag
/// as it is read - in the pixels of sensor_msgs/CameraInfo, where the centre of the first pixel is (0, 0). The
/// homography maps the tag's square of -1..1 (x right, y down) to those pixels; lens distortion is left in.
ros2::AprilTagDetectionArray detections(const BoardSighting& sighting, const std::string& family,
                                        const ros2::Time& stamp, const std::string& camera_frame);

/// Poses of the axle along a path, every 5 cm and at its end.
/// @param T_frame_path  maps the path's frame to the frame that is named
ros2::PathMessage path_message(const Path& path, const Pose2& T_frame_path, const ros2::Time& stamp,
                               const std::string& frame);

/// What a docking says to others over ROS 2 (REP-103 axes, REP-105 frames), beside driving: dock pose and detections
/// with every sighting that is of use, the path when one is planned and once a second, the status as JSON at every
/// change and five times a second, diagnostics once a second.
class DockingTopics {
 public:
  /// @param robot   link, clock and health of the open robot
  /// @param family  of the board's tags
  DockingTopics(const Ros2Robot& robot, const Ros2Config& config, std::string family);

  /// After every cycle of the loop.
  void cycle(const DockingLoop::Inputs& inputs, const DockingLoop::Outputs& outputs, const Docker& docker,
             const CameraHealth& camera);

 private:
  void publish_path(const Phase& phase, std::chrono::nanoseconds now, bool changed);
  void publish_status(const DockingLoop::Inputs& inputs, const TickResult& result, const Docker& docker);
  void publish_diagnostics(std::chrono::nanoseconds now, const Docker& docker, const CameraHealth& camera);

  std::shared_ptr<ros2::Link> link_;
  std::function<ros2::Time(std::chrono::nanoseconds)> stamp_;
  std::function<RobotLinkHealth()> health_;
  Ros2Config config_;
  std::string family_;
  ros2::Publisher<ros2::PoseStamped> dock_pose_;
  ros2::Publisher<ros2::AprilTagDetectionArray> detections_;
  ros2::Publisher<ros2::PathMessage> path_;
  ros2::Publisher<ros2::String> status_;
  ros2::Publisher<ros2::DiagnosticArray> diagnostics_;
  std::chrono::nanoseconds path_told_{0};
  std::chrono::nanoseconds status_told_{0};
  std::chrono::nanoseconds diagnostics_told_{0};
  bool path_shown_ = false;
};

}  // namespace tagdock
