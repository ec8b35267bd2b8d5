#pragma once

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdint>
#include <deque>
#include <functional>
#include <optional>
#include <random>
#include <utility>
#include <variant>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/Core>

#include "calibration/rig.h"
#include "calibration/target.h"
#include "servo/docker.h"

namespace tagdock::test {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;

inline double seconds(nanoseconds time) { return std::chrono::duration<double>(time).count(); }

// A small truth for the tests of servo, apart from the product's simulator: a unicycle with dead time, lag and slip
// that odometry does not see, and sightings drawn about the true pose with the covariance that corner noise of `noise`
// px has on the default board. It shares no integrator and no noise model with the filter.
struct WorldConfig {
  double noise_px = 0.10;
  double bias_px = 0.05;                        // drawn once per run
  nanoseconds latency = milliseconds(80);       // from mid-exposure to the tick that gets the frame
  nanoseconds frame_period = milliseconds(50);  // 20 frames a second
  double dead_time = 0.06;                      // s
  double lag = 0.12;                            // s
  double turn_slip = 0.01;                      // turns come out this share larger than odometry says
  double drift = 0.01;                          // rad per m of straight driving, sign drawn per run
  double forward_slip = 0.002;                  // share
  double yaw_walk = 0.002;                      // rad per sqrt(m)
};

// 6-dof motion on the left of a pose.
inline Eigen::Isometry3d small_motion(const Eigen::Matrix<double, 6, 1>& motion) {
  Eigen::Isometry3d result = Eigen::Isometry3d::Identity();
  const Eigen::Vector3d turn = motion.tail<3>();
  if (turn.norm() > 0.0) result.linear() = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
  result.translation() = motion.head<3>();
  return result;
}

class PlanarWorld {
 public:
  PlanarWorld(const Rig& rig, const WorldConfig& config, const Pose2& T_station_base, unsigned seed)
      : rig_(rig),
        config_(config),
        board_(default_board(rig.T_base_camera.translation().z())),
        random_(seed),
        pose_(T_station_base) {
    for (double& value : bias_px_) value = config_.bias_px * normal();
    drift_ = config_.drift * (normal() < 0.0 ? -1.0 : 1.0);
  }

  [[nodiscard]] const Pose2& pose() const { return pose_; }
  [[nodiscard]] const Pose2& odometry() const { return T_odom_base_; }
  [[nodiscard]] const Twist2& velocity() const { return velocity_; }
  void shift(const Pose2& motion) { pose_ = pose_ * motion; }  // pushed, unseen by odometry

  // Drives for one tick in steps of 5 ms.
  void drive(const Twist2& command, nanoseconds step) {
    commands_.push_back({time_, command});
    constexpr double dt = 0.005;
    const int steps = static_cast<int>(std::lround(seconds(step) / dt));
    for (int i = 0; i < steps; ++i) {
      const double now = seconds(time_) + i * dt;
      while (commands_.size() > 1 && seconds(commands_[1].first) + config_.dead_time <= now + 1e-9) {
        commands_.pop_front();
      }
      const bool arrived = seconds(commands_.front().first) + config_.dead_time <= now + 1e-9;
      const Twist2 wanted = arrived ? commands_.front().second : Twist2{};
      velocity_.linear += std::clamp((wanted.linear - velocity_.linear) / config_.lag, -0.3, 0.3) * dt;
      velocity_.angular += std::clamp((wanted.angular - velocity_.angular) / config_.lag, -0.6, 0.6) * dt;
      if (std::abs(velocity_.linear) < 1e-4 && wanted.linear == 0.0) velocity_.linear = 0.0;
      if (std::abs(velocity_.angular) < 1e-4 && wanted.angular == 0.0) velocity_.angular = 0.0;
      move(T_odom_base_, velocity_.linear * dt, velocity_.angular * dt);
      const double distance = velocity_.linear * dt;
      move(pose_, distance * (1.0 - config_.forward_slip),
           velocity_.angular * dt * (1.0 + config_.turn_slip) + drift_ * std::abs(distance) +
               config_.yaw_walk * std::sqrt(std::abs(distance)) * normal());
    }
    time_ += step;
  }

  // What a frame taken now shows.
  Sighting look() {
    const Eigen::Isometry3d T_camera_station = level_view(rig_, pose_);
    Matrix6 information = Matrix6::Zero();
    Eigen::Matrix<double, 6, 1> pull = Eigen::Matrix<double, 6, 1>::Zero();
    BoardSighting sighting;
    ++frame_;
    std::size_t tag_number = 0;
    for (const BoardTag& tag : board_.tags) {
      std::size_t coordinate = 8 * tag_number++;
      const TagPoints corners = corners_station(tag);
      Matrix6 of_tag = Matrix6::Zero();
      Eigen::Matrix<double, 6, 1> pull_of_tag = Eigen::Matrix<double, 6, 1>::Zero();
      bool inside = true;
      for (const Eigen::Vector3d& corner : corners) {
        const Eigen::Vector3d point = T_camera_station * corner;
        inside = inside && point.z() > 0.15;
        if (!inside) break;
        const Projection seen = project_with_jacobian(rig_.camera, point);
        inside = seen.pixel.x() > 5 && seen.pixel.y() > 5 && seen.pixel.x() < rig_.camera.width - 6 &&
                 seen.pixel.y() < rig_.camera.height - 6;
        Eigen::Matrix<double, 3, 6> by_motion;
        by_motion.leftCols<3>().setIdentity();
        by_motion.rightCols<3>() << 0, point.z(), -point.y(), -point.z(), 0, point.x(), point.y(), -point.x(), 0;
        const Eigen::Matrix<double, 2, 6> row = seen.by_point * by_motion;
        of_tag += row.transpose() * row;
        pull_of_tag += row.transpose() * Eigen::Vector2d(bias_px_.at(coordinate), bias_px_.at(coordinate + 1));
        coordinate += 2;
      }
      if (!inside) continue;
      information += of_tag;
      pull += pull_of_tag;
      RefinedTag refined;
      refined.id = tag.id;
      refined.covariance_px2.setIdentity();
      refined.covariance_px2 *= config_.noise_px * config_.noise_px;
      sighting.tags.push_back(refined);
    }
    if (sighting.tags.empty() || hidden) return Unseen::no_tag;
    sighting.frame_number = frame_;
    sighting.time = time_;
    sighting.covariance = config_.noise_px * config_.noise_px * information.inverse();
    sighting.log_odds = 100.0;
    Eigen::Matrix<double, 6, 1> noise;
    for (int i = 0; i < 6; ++i) noise[i] = normal();
    const Eigen::Matrix<double, 6, 1> error =
        sighting.covariance.llt().matrixL() * noise + information.ldlt().solve(pull);
    sighting.T_camera_station = small_motion(error) * T_camera_station;
    return sighting;
  }

  [[nodiscard]] nanoseconds time() const { return time_; }
  double normal() { return distribution_(random_); }

  bool hidden = false;  // the board is covered

 private:
  static void move(Pose2& pose, double distance, double turn) {
    pose.x += distance * std::cos(pose.yaw + 0.5 * turn);
    pose.y += distance * std::sin(pose.yaw + 0.5 * turn);
    pose.yaw += turn;
  }

  Rig rig_;
  WorldConfig config_;
  Board board_;
  std::mt19937_64 random_;
  std::normal_distribution<double> distribution_;
  std::array<double, 24> bias_px_{};
  double drift_ = 0.0;
  Pose2 pose_;
  Pose2 T_odom_base_;
  Twist2 velocity_;
  nanoseconds time_{0};
  std::deque<std::pair<nanoseconds, Twist2>> commands_;
  std::uint64_t frame_ = 0;
};

}  // namespace tagdock::test
