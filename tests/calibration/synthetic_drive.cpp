#include "tests/calibration/synthetic_drive.h"

#include <algorithm>
#include <cmath>
#include <random>

#include "planning/pose2.h"

namespace tagdock::testing {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

Isometry3d lifted(const Pose2& pose) {
  Isometry3d T = Isometry3d::Identity();
  T.linear() = Eigen::AngleAxisd(pose.yaw, Vector3d::UnitZ()).toRotationMatrix();
  T.translation() << pose.x, pose.y, 0.0;
  return T;
}

/// Arc of a differential drive, written anew for the tests: the chord of a circle.
Pose2 arc(double left, double right, const OdometryModel& wheels) {
  const double way = 0.5 * (left * wheels.r_left + right * wheels.r_right);
  const double turn = (right * wheels.r_right - left * wheels.r_left) / wheels.track;
  if (std::abs(turn) < 1e-9) return {way, 0.0, turn};
  const double radius = way / turn;
  return {radius * std::sin(turn), radius * (1.0 - std::cos(turn)), turn};
}

std::vector<Vector3d> board_points(Drive::Sees sees) {
  std::vector<Vector3d> points;
  const auto square = [&](double x, double y, double side) {
    points.emplace_back(x, y + side, 0.0);
    points.emplace_back(x + side, y + side, 0.0);
    points.emplace_back(x + side, y, 0.0);
    points.emplace_back(x, y, 0.0);
  };
  if (sees == Drive::Sees::tag) {
    square(-0.1, -0.1, 0.2);
  } else {
    for (int row = 0; row < 6; ++row)
      for (int column = 0; column < 6; ++column) square(0.1144 * column - 0.33, 0.1144 * row - 0.33, 0.088);
  }
  return points;
}

}  // namespace

DriveData drive(const Drive& how) {
  std::mt19937_64 random(how.seed);
  std::normal_distribution<double> normal(0.0, 1.0);
  const auto between = [&](double least, double most) {
    return std::uniform_real_distribution<double>(least, most)(random);
  };
  DriveData data;
  HandEyeProblem& problem = data.problem;
  problem.camera = {1280, 1024, 1155.0, 1156.0, 641.0, 509.0, -0.11, 0.07, 0.0003, -0.0002, 0.0};
  CameraModel truth_camera = problem.camera;
  if (how.camera_error > 0.0) {
    // fx, fy, cx, cy, k1, k2 as a calibration of a dozen views knows them, times camera_error.
    const double sigma[] = {0.5, 0.5, 0.5, 0.5, 5e-4, 2e-3};
    double* const value[] = {&truth_camera.fx, &truth_camera.fy, &truth_camera.cx,
                             &truth_camera.cy, &truth_camera.k1, &truth_camera.k2};
    for (Eigen::Index i = 0; i < 6; ++i) {
      const double own = how.camera_error * sigma[i];
      *value[i] += own * normal(random);
      problem.camera_covariance(i, i) = own * own;
    }
  }
  problem.by_wheels = how.by_wheels;
  problem.leave_out_frontal = how.leave_out_frontal;
  problem.tracker_sigma_m = how.tracker_noise_m;
  problem.tracker_sigma_rad = how.tracker_noise_rad;
  problem.nominal = {0.1, 0.1, 0.6};
  problem.wheel_noise_rad_per_sqrt_rad = how.wheel_noise;
  problem.wheel_noise_floor_rad = 0.0005;
  data.truth.odometry = {0.1 * (1.0 + 0.01 * between(-1, 1)), 0.1 * (1.0 + 0.01 * between(-1, 1)),
                         0.6 * (1.0 + 0.01 * between(-1, 1))};

  Isometry3d& X = data.truth.T_base_camera;
  X = level_camera(0.35 + 0.02 * between(-1, 1), 0.4 + 0.02 * between(-1, 1));
  X.translation().y() = 0.05 * between(-1, 1);
  X.linear() = (Eigen::AngleAxisd(radians(4.0 * between(-1, 1)), Vector3d::UnitZ()) *
                Eigen::AngleAxisd(radians(4.0 * between(-1, 1)), Vector3d::UnitY()) *
                Eigen::AngleAxisd(radians(2.0 * between(-1, 1)), Vector3d::UnitX()))
                   .toRotationMatrix() *
               X.linear();
  if (how.height_by_tape) problem.camera_height = Measured{X.translation().z() + 0.003 * normal(random), 0.003};

  // The board stands at the origin, 0.5 m high, facing -x, not quite upright.
  Isometry3d T_world_board = Isometry3d::Identity();
  T_world_board.linear() << 0, 0, 1, -1, 0, 0, 0, -1, 0;
  T_world_board.linear() =
      Eigen::AngleAxisd(radians(between(-2, 2)), Vector3d::UnitX()).toRotationMatrix() * T_world_board.linear();
  T_world_board.translation() << 0.0, 0.0, 0.5;

  std::vector<Pose2> stops;
  const double standing = between(0.0, 1.0);
  for (int i = 0; i < how.stops; ++i) {
    const double share = how.stops > 1 ? static_cast<double>(i) / (how.stops - 1) : 0.0;
    if (how.way == Drive::Way::straight) {
      stops.push_back({-4.5 + 3.0 * share, 0.3 * standing, radians(-3.0)});
      stops.back().y += std::tan(radians(-3.0)) * (stops.back().x + 4.5);
    } else if (how.way == Drive::Way::spin) {
      stops.push_back({-2.2, 0.5 * standing, radians(-18.0 + 36.0 * share)});
    } else if (how.way == Drive::Way::zigzag) {
      // Two headings at each place: the turn on the spot between them tells of the track and of the lens' place.
      const double along = share < 0.5 ? 2.0 * share : 2.0 - 2.0 * share;
      if (i % 2 == 0) {
        const double bearing = radians(-50.0 + 100.0 * along + between(-2.0, 2.0));
        const double distance = ((i / 2) % 2 == 0 ? 1.25 : 2.75) + between(-0.1, 0.1);
        stops.push_back({-distance * std::cos(bearing), distance * std::sin(bearing), 0.0});
      } else {
        stops.push_back(stops.back());
      }
      const double aim = (i % 4 == 0 || i % 4 == 3 ? 1.0 : -1.0) * radians(between(10.0, 17.0));
      stops.back().yaw = std::atan2(-stops.back().y, -stops.back().x) + aim;
    } else if (how.way == Drive::Way::sweep) {
      // Two arcs, there and back, nearer and farther, looking to the left and to the right of the board in turn.
      const double along = share < 0.5 ? 2.0 * share : 2.0 - 2.0 * share;
      const double bearing = radians(-60.0 + 120.0 * along + between(-2.0, 2.0));
      const double distance = (share < 0.5 ? 1.3 : 1.7) + between(-0.1, 0.1);
      const double aim = (i % 2 == 0 ? 1.0 : -1.0) * radians(between(10.0, 17.0));
      const double x = -distance * std::cos(bearing);
      const double y = distance * std::sin(bearing);
      stops.push_back({x, y, std::atan2(-y, -x) + aim});
    } else {
      const double side = i % 2 == 0 ? 1.0 : -1.0;
      const double bearing =
          how.way == Drive::Way::arc ? side * radians(between(27.0, 60.0)) : radians(between(-60, 60));
      const double distance = how.way == Drive::Way::arc ? between(1.2, 1.8) : between(1.2, 3.5);
      const double aim = radians(how.way == Drive::Way::arc ? between(-15.0, 15.0) : between(-17.0, 17.0));
      const double x = -distance * std::cos(bearing);
      const double y = distance * std::sin(bearing);
      stops.push_back({x, y, std::atan2(-y, -x) + aim});
    }
  }

  // The way from stop to stop: turn towards it, drive, turn; wheels noted with their noise.
  std::vector<std::vector<std::array<double, 2>>> ways(stops.size());
  if (how.by_wheels) {
    const OdometryModel& wheels = data.truth.odometry;
    Pose2 at = stops.front();
    for (std::size_t i = 0; i + 1 < stops.size(); ++i) {
      const auto go = [&](double left, double right) {
        at = at * arc(left, right, wheels);
        const auto noted = [&](double angle) {
          const double sigma = std::hypot(how.wheel_noise * std::sqrt(std::abs(angle)), 0.0005);
          return angle + sigma * normal(random);
        };
        const double noted_left = noted(left);
        ways[i].push_back({noted_left, noted(right)});
      };
      const auto turn = [&](double angle) {
        if (std::abs(angle) > 1e-6)
          go(-0.5 * angle * wheels.track / wheels.r_left, 0.5 * angle * wheels.track / wheels.r_right);
      };
      const Pose2 to = tagdock::between(at, stops[i + 1]);
      const double distance = std::hypot(to.x, to.y);
      const bool back = to.x < 0.0;
      if (distance > 1e-6) {
        turn(wrap_angle(std::atan2(to.y, to.x) + (back ? std::acos(-1.0) : 0.0)));
        go((back ? -distance : distance) / wheels.r_left, (back ? -distance : distance) / wheels.r_right);
      }
      turn(wrap_angle(stops[i + 1].yaw - at.yaw));
      stops[i + 1] = at;
    }
  }

  const std::vector<Vector3d> points = board_points(how.sees);
  for (std::size_t i = 0; i < stops.size(); ++i) {
    HandEyeStop stop;
    stop.id = static_cast<int>(i);
    const Isometry3d T_world_base = lifted(stops[i]);
    const Isometry3d T_camera_board = (T_world_base * X).inverse() * T_world_board;
    for (int frame = 0; frame < how.frames; ++frame)
      for (std::size_t k = 0; k < points.size(); ++k) {
        const Vector3d point = T_camera_board * points[k];
        if (point.z() < 0.1) continue;
        Eigen::Vector2d pixel = project(truth_camera, point);
        if (pixel.x() < 0 || pixel.y() < 0 || pixel.x() > 1279 || pixel.y() > 1023) continue;
        pixel += how.corner_noise_px * Eigen::Vector2d(normal(random), normal(random));
        if (between(0, 1) < how.outliers) pixel += between(3, 20) * Eigen::Vector2d(between(-1, 1), 1.0).normalized();
        stop.corners.push_back({static_cast<int>(k), points[k], pixel, how.corner_noise_px});
      }
    if (!how.by_wheels) {
      Isometry3d measured = T_world_base;
      const Vector3d turn = how.tracker_noise_rad * Vector3d(normal(random), normal(random), normal(random));
      measured.linear() = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix() * measured.linear();
      measured.translation() += how.tracker_noise_m * Vector3d(normal(random), normal(random), normal(random));
      stop.T_tracker_base = measured;
    }
    stop.wheels_to_next = ways[i];
    problem.stops.push_back(stop);
  }
  if (how.surveyed) {
    SurveyedPose survey;
    survey.sigma_m = 0.0005;
    survey.sigma_rad = radians(0.02);
    const Vector3d turn = survey.sigma_rad * Vector3d(normal(random), normal(random), normal(random));
    survey.T_tracker_board = T_world_board;
    survey.T_tracker_board.linear() =
        Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix() * T_world_board.linear();
    survey.T_tracker_board.translation() += survey.sigma_m * Vector3d(normal(random), normal(random), normal(random));
    problem.board = survey;
  }
  return data;
}

HandEyeError error_of(const HandEyeResult& result, const DriveTruth& truth) {
  HandEyeError error;
  error.xy = (result.T_base_camera.translation() - truth.T_base_camera.translation()).head<2>().norm();
  error.rotation =
      Eigen::AngleAxisd(Eigen::Matrix3d(result.T_base_camera.linear() * truth.T_base_camera.linear().transpose()))
          .angle();
  error.radius = std::max(std::abs(result.odometry.r_left / truth.odometry.r_left - 1.0),
                          std::abs(result.odometry.r_right / truth.odometry.r_right - 1.0));
  error.track = std::abs(result.odometry.track / truth.odometry.track - 1.0);
  return error;
}

}  // namespace tagdock::testing
