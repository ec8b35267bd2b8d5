#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "app/robots/ros2/link.h"
#include "servo/command_gate.h"
#include "servo/robot.h"

namespace tagdock {

/// Names of the topics; a name without a leading / lies below the namespace. Changing one is ROS 2's remapping.
struct Ros2Topics {
  std::string cmd_vel = "cmd_vel";                        ///< out: geometry_msgs/Twist or TwistStamped
  std::string odom = "odom";                              ///< in: nav_msgs/Odometry
  std::string obstacle_stop = "obstacle_stop";            ///< in: std_msgs/Bool; true holds the robot
  std::string obstacle_slow = "obstacle_slow";            ///< in: std_msgs/Bool; true halves its speed
  std::string detected_dock_pose = "detected_dock_pose";  ///< out: geometry_msgs/PoseStamped, for Nav2
  std::string detections = "detections";                  ///< out: apriltag_msgs/AprilTagDetectionArray
  std::string path = "docking_path";                      ///< out: nav_msgs/Path
  std::string status = "docking_status";                  ///< out: std_msgs/String, JSON
  std::string diagnostics = "/diagnostics";               ///< out: diagnostic_msgs/DiagnosticArray
  std::string ground_truth = "/simulation/ground_truth";  ///< simulation only: nav_msgs/Odometry in the station frame
};

/// A robot that is driven by ROS 2 topics.
struct Ros2Config {
  int domain = -1;  ///< 0..101; -1 takes ROS_DOMAIN_ID, or 0
  std::string name_space;
  std::string interface = "lo";          ///< network interface; lo keeps every packet on this machine
  std::string peers;                     ///< addresses, with spaces between, where multicast does not reach
  std::string cmd_vel_type = "auto";     ///< Twist, TwistStamped, or auto: what the robot subscribes
  std::string odom_frame = "odom";       ///< of what is published (REP-105)
  std::string base_frame = "base_link";  ///< the axle's middle on the floor, x forward, y left, z up (REP-103)
  std::string camera_frame = "camera_optical_frame";  ///< x right, y down, z out of the lens
  double wait_s = 5.0;                                ///< for the robot to be found
  Ros2Topics topics;
};

/// The domain that is meant.
int domain_of(const Ros2Config& config);
ros2::LinkConfig link_config(const Ros2Config& config, const std::string& process);
/// The full name of a topic.
std::string topic(const Ros2Config& config, const std::string& name);
/// Remaps as ROS 2 does on the command line: "odom:=/base/odom".
/// Throws Failure(usage) when the left side is no topic of ours, naming those that are.
void remap(Ros2Config& config, const std::string& rule);

/// How the link does, for diagnostics.
struct RobotLinkHealth {
  std::string name;                         ///< domain and interface, for people
  std::uint64_t readings = 0;               ///< odometry messages that were used
  std::uint64_t commands = 0;               ///< sent by the loop
  std::uint64_t starved = 0;                ///< zeros sent because the loop was late with its command
  std::chrono::nanoseconds largest_gap{0};  ///< between odometry messages while driving
  bool obstacle_stop = false;
  bool obstacle_slow = false;
  std::string fault;  ///< latched; empty while all is well
};

/// A robot over ROS 2 topics, and what else is done over the same link.
struct Ros2Robot {
  std::unique_ptr<Robot> robot;
  std::shared_ptr<ros2::Link> link;
  std::function<ros2::Time(std::chrono::nanoseconds session_time)> stamp;  ///< in the robot's clock
  std::function<RobotLinkHealth()> health;
};

/// Finds the robot and takes it over; sends nothing before the first command.
/// A thread of its own watches the link: where odometry stays away for as long as `limits` say, jumps, freezes, is not
/// finite or runs backwards in time, where a second process publishes commands or odometry, it sends zero at once,
/// latches, and `read` throws with the reason. Where the loop is late with its command by 200 ms it sends zero, too.
/// @param start  when the session began
/// Throws Failure: usage for names and interfaces, robot_link when nobody answers, with what is missing.
Ros2Robot open_ros2(const Ros2Config& config, const OdometryLimits& limits,
                    std::chrono::steady_clock::time_point start);

/// What can be told of a robot without taking it over.
struct Ros2Look {
  std::string missing;                      ///< why it could not be driven, as a sentence; empty where it could
  std::uint64_t readings = 0;               ///< odometry messages that came while listening
  std::chrono::nanoseconds largest_gap{0};  ///< between two of them
};

/// Looks for the robot and listens to its odometry. Sends nothing and publishes no topic, so that a docking that goes
/// on elsewhere is not disturbed. Throws Failure as open_ros2, but not for what is missing.
Ros2Look look_for_ros2(const Ros2Config& config, std::chrono::nanoseconds wait, std::chrono::nanoseconds listen);

}  // namespace tagdock
