#include "app/robots/docking_topics.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

#include <Eigen/LU>
#include <nlohmann/json.hpp>

namespace tagdock {
namespace {

using std::chrono::nanoseconds;

constexpr double path_spacing = 0.05;  // m
constexpr nanoseconds path_period = std::chrono::seconds(1);
constexpr nanoseconds status_period = std::chrono::milliseconds(200);
constexpr nanoseconds diagnostics_period = std::chrono::seconds(1);

ros2::Pose in_space(const Pose2& pose) {
  return {{pose.x, pose.y, 0.0}, {0.0, 0.0, std::sin(0.5 * pose.yaw), std::cos(0.5 * pose.yaw)}};
}

// Row-major map of the square's corners, in AprilTag's order, to four points; h22 = 1.
std::array<double, 9> homography_of(const std::array<ros2::ImagePoint, 4>& corners) {
  const std::array<std::array<double, 2>, 4> square = {{{-1.0, 1.0}, {1.0, 1.0}, {1.0, -1.0}, {-1.0, -1.0}}};
  Eigen::Matrix<double, 8, 8> equations = Eigen::Matrix<double, 8, 8>::Zero();
  Eigen::Matrix<double, 8, 1> right;
  for (int i = 0; i < 4; ++i) {
    const double x = square[i][0];
    const double y = square[i][1];
    const double u = corners[i].x;
    const double v = corners[i].y;
    equations.row(2 * i) << x, y, 1.0, 0.0, 0.0, 0.0, -u * x, -u * y;
    equations.row(2 * i + 1) << 0.0, 0.0, 0.0, x, y, 1.0, -v * x, -v * y;
    right(2 * i) = u;
    right(2 * i + 1) = v;
  }
  const Eigen::Matrix<double, 8, 1> solution = equations.fullPivLu().solve(right);
  std::array<double, 9> homography{};
  std::copy(solution.data(), solution.data() + 8, homography.begin());
  homography[8] = 1.0;
  return homography;
}

ros2::KeyValue entry(const std::string& key, const std::string& value) { return {key, value}; }
ros2::KeyValue entry(const std::string& key, double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.6g", value);
  return {key, text};
}

// Sure of where the dock is and how it is turned.
bool of_use(SightingUse use) {
  return use == SightingUse::fused || use == SightingUse::collected || use == SightingUse::acquired;
}

}  // namespace

ros2::PoseStamped detected_dock_pose(const PlanarSighting& sighting, const Pose2& goal_of_axle, const ros2::Time& stamp,
                                     const std::string& base_frame) {
  return {{stamp, base_frame}, in_space(between(sighting.T_station_base, goal_of_axle))};
}

ros2::AprilTagDetectionArray detections(const BoardSighting& sighting, const std::string& family,
                                        const ros2::Time& stamp, const std::string& camera_frame) {
  ros2::AprilTagDetectionArray array{{stamp, camera_frame}, {}};
  for (const RefinedTag& tag : sighting.tags) {
    ros2::AprilTagDetection one;
    one.family = family;
    one.id = tag.id;
    one.hamming = tag.hamming;
    one.decision_margin = static_cast<float>(tag.margin);
    // Ours run from the top left, clockwise; AprilTag's from the bottom left, the other way round.
    for (std::size_t i = 0; i < 4; ++i) one.corners[i] = {tag.corners_px[3 - i].x(), tag.corners_px[3 - i].y()};
    one.homography = homography_of(one.corners);
    one.centre = {one.homography[2], one.homography[5]};
    array.detections.push_back(one);
  }
  return array;
}

ros2::PathMessage path_message(const Path& path, const Pose2& T_frame_path, const ros2::Time& stamp,
                               const std::string& frame) {
  ros2::PathMessage message{{stamp, frame}, {}};
  const double whole = length(path);
  const int pieces = std::max(1, static_cast<int>(std::ceil(whole / path_spacing)));
  for (int i = 0; i <= pieces; ++i) {
    const Pose2 pose = T_frame_path * point_at(path, whole * i / pieces).pose;
    message.poses.push_back({message.header, in_space(pose)});
  }
  return message;
}

DockingTopics::DockingTopics(const Ros2Robot& robot, const Ros2Config& config, std::string family)
    : link_(robot.link),
      stamp_(robot.stamp),
      health_(robot.health),
      config_(config),
      family_(std::move(family)),
      dock_pose_(link_->publisher<ros2::PoseStamped>(topic(config, config.topics.detected_dock_pose))),
      detections_(link_->publisher<ros2::AprilTagDetectionArray>(topic(config, config.topics.detections))),
      path_(link_->publisher<ros2::PathMessage>(topic(config, config.topics.path))),
      status_(link_->publisher<ros2::String>(topic(config, config.topics.status))),
      diagnostics_(link_->publisher<ros2::DiagnosticArray>(topic(config, config.topics.diagnostics))) {}

void DockingTopics::cycle(const DockingLoop::Inputs& inputs, const DockingLoop::Outputs& outputs, const Docker& docker,
                          const CameraHealth& camera) {
  const TickResult& result = outputs.docking;
  if (outputs.sighting) {
    if (const BoardSighting* board = std::get_if<BoardSighting>(&*outputs.sighting))
      detections_.write(detections(*board, family_, stamp_(board->time), config_.camera_frame));
  }
  if (result.sighting && result.sighting->sighting && of_use(result.sighting->use)) {
    const PlanarSighting& seen = *result.sighting->sighting;
    dock_pose_.write(detected_dock_pose(seen, goal_of_axle(docker.config()), stamp_(seen.time), config_.base_frame));
  }
  publish_path(docker.phase(), inputs.now, result.phase_changed);
  if (result.phase_changed || inputs.now - status_told_ >= status_period) publish_status(inputs, result, docker);
  if (result.over || inputs.now - diagnostics_told_ >= diagnostics_period)
    publish_diagnostics(inputs.now, docker, camera);
}

void DockingTopics::publish_path(const Phase& phase, nanoseconds now, bool changed) {
  if (!changed && now - path_told_ < path_period) return;
  const Following* following = std::get_if<Following>(&phase);
  const RunningIn* running_in = std::get_if<RunningIn>(&phase);
  if (following == nullptr && running_in == nullptr && !path_shown_) return;
  path_told_ = now;
  path_shown_ = following != nullptr || running_in != nullptr;
  ros2::PathMessage message{{stamp_(now), config_.odom_frame}, {}};  // without poses when there is no path any more
  if (following != nullptr)
    message = path_message(following->path, inverse(following->T_station_odom), stamp_(now), config_.odom_frame);
  if (running_in != nullptr) message = path_message(running_in->path_odom, {}, stamp_(now), config_.odom_frame);
  path_.write(message);
}

void DockingTopics::publish_status(const DockingLoop::Inputs& inputs, const TickResult& result, const Docker& docker) {
  status_told_ = inputs.now;
  nlohmann::ordered_json json;
  json["schema"] = "tagdock-status/1";
  json["phase"] = std::string(name(docker.phase()));
  json["over"] = result.over;
  json["attempts"] = job_of(docker.phase()).attempts;
  const std::optional<double> rest = docker.distance_to_go(result);
  json["distance_to_go"] = rest ? nlohmann::ordered_json(*rest) : nullptr;
  if (const auto reason = reason_of(docker.phase()))
    json["reason"] = {{"cause", std::string(word(reason->cause))}, {"sentence", reason->sentence}};
  else
    json["reason"] = nullptr;
  json["gate"] = std::string(word(result.gate));
  json["gate_reason"] = std::string(result.gate_reason);
  json["command"] = {{"linear", result.command.linear}, {"angular", result.command.angular}};
  if (result.estimate)
    json["T_station_base"] = {{"x", result.estimate->T_station_base.x},
                              {"y", result.estimate->T_station_base.y},
                              {"yaw", wrap_angle(result.estimate->T_station_base.yaw)}};
  else
    json["T_station_base"] = nullptr;
  status_.write({json.dump()});
}

void DockingTopics::publish_diagnostics(nanoseconds now, const Docker& docker, const CameraHealth& camera) {
  diagnostics_told_ = now;
  using Status = ros2::DiagnosticStatus;
  ros2::DiagnosticArray array{{stamp_(now), ""}, {}};

  Status docking{Status::ok, "tagdock: docking", std::string(name(docker.phase())), "tagdock", {}};
  if (const auto reason = reason_of(docker.phase())) {
    docking.level = Status::error;
    docking.message = reason->sentence;
    docking.values.push_back(entry("cause", std::string(word(reason->cause))));
  }
  docking.values.push_back(entry("attempts", job_of(docker.phase()).attempts));
  array.status.push_back(docking);

  Status eye{Status::ok, "tagdock: camera", camera.state, "tagdock", {}};
  if (!camera.reason.empty()) {
    eye.level = camera.state == "lost" ? Status::error : Status::warn;
    eye.message = camera.reason;
  }
  eye.values = {entry("frames", static_cast<double>(camera.received)), entry("lost", static_cast<double>(camera.lost)),
                entry("incomplete", static_cast<double>(camera.incomplete)),
                entry("reconnects", static_cast<double>(camera.reconnects))};
  array.status.push_back(eye);

  const RobotLinkHealth health = health_();
  Status link{Status::ok, "tagdock: robot link", health.name, "tagdock", {}};
  if (health.obstacle_stop || health.obstacle_slow || health.starved > 0) link.level = Status::warn;
  if (!health.fault.empty()) {
    link.level = Status::error;
    link.message = health.fault;
  }
  link.values = {entry("odometry", static_cast<double>(health.readings)),
                 entry("commands", static_cast<double>(health.commands)),
                 entry("late_commands", static_cast<double>(health.starved)),
                 entry("largest_gap_ms", static_cast<double>(health.largest_gap.count()) / 1e6),
                 entry("obstacle_stop", health.obstacle_stop ? "true" : "false"),
                 entry("obstacle_slow", health.obstacle_slow ? "true" : "false")};
  array.status.push_back(link);
  diagnostics_.write(array);
}

}  // namespace tagdock
