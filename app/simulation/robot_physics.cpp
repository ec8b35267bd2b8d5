#include "app/simulation/robot_physics.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "app/simulation/draws.h"

namespace tagdock {
namespace {

constexpr double gravity = 9.81;           // m/s^2
constexpr double field_step = 0.01;        // m
constexpr std::size_t field_count = 6000;  // 60 m of travel, then the last value stays

}  // namespace

RobotPhysics::RobotPhysics(const StartScenario& start, const DriveScenario& drive, double camera_ahead,
                           std::uint64_t seed)
    : drive_(drive), walk_key_(mixed(mixed(seed) + 2)) {
  draw_field(seed);
  draw_start(start, camera_ahead, seed);
}

void RobotPhysics::draw_field(std::uint64_t seed) {
  Draws draws(seed, 1);
  field_.turn_scale = drive_.turn_scale_sigma * draws.normal();
  field_.speed_scale = drive_.speed_scale_sigma * draws.normal();
  field_.wheel_difference = drive_.wheel_difference_sigma * draws.normal();
  field_.floor = std::clamp(draws.normal(), -2.0, 2.0);
  field_.keep = std::exp(-field_step / drive_.field_length);
  const auto begin_series = [&] {
    Draws series = draws;
    const double first = series.normal();
    field_.over_turn_and_castors.push_back({series, first});
    draws.skip(field_count);
  };
  begin_series();
  for (double& castor : field_.castor) {
    castor = draws.normal();
    begin_series();
  }
  find_friction();
}

void RobotPhysics::travel_to(std::size_t place) {
  if (place <= field_.place) return;
  const double fresh = std::sqrt(1.0 - field_.keep * field_.keep);
  for (; field_.place < place; ++field_.place)
    for (Series& series : field_.over_turn_and_castors)
      series.value = field_.keep * series.value + fresh * series.draws.normal();
  find_friction();
}

void RobotPhysics::find_friction() {
  const double run = drive_.friction_run_sigma;
  const double own = drive_.friction_castor_sigma;
  const double along = drive_.friction_field_sigma;
  const double mean_shift = 0.5 * (run * run + own * own + along * along);  // so that the mean is `friction`
  for (std::size_t i = 0; i < 4; ++i)
    field_.friction[i] =
        std::min(drive_.friction_cap,
                 drive_.friction * std::exp(run * field_.floor + own * field_.castor[i] +
                                            along * field_.over_turn_and_castors[i + 1].value - mean_shift));
}

void RobotPhysics::draw_start(const StartScenario& start, double camera_ahead, std::uint64_t seed) {
  Draws draws(seed, 4);
  double bearing = start.bearing + start.bearing_sigma * draws.normal();
  const double range = start.range + start.range_sigma * draws.normal();
  double heading = start.heading + start.heading_sigma * draws.normal();
  for (double& angle : truth_.castor_angles)
    angle = wrap_angle(start.castor_angle + start.castor_sigma * draws.normal());
  bearing += start.bearing_spread * draws.even();
  heading += bearing + start.heading_spread * draws.even();
  const Pose2 T_station_camera{-range * std::cos(bearing), -range * std::sin(bearing), heading};
  truth_.T_station_base = T_station_camera * Pose2{-camera_ahead, 0.0, 0.0};
}

void RobotPhysics::command(const Twist2& wanted, std::chrono::nanoseconds now) {
  if (!is_finite(wanted)) throw std::invalid_argument("the simulated robot was given a command that is not a number");
  commands_.push_back({now, wanted});
}

void RobotPhysics::advance(std::chrono::nanoseconds now) {
  while (truth_.time + step <= now) take_step();
}

Twist2 RobotPhysics::wanted_at(std::chrono::nanoseconds time) {
  while (commands_.size() > 1 && commands_[1].time <= time) commands_.pop_front();
  const auto timeout = std::chrono::nanoseconds(std::llround(1e9 * drive_.command_timeout));
  if (commands_.empty() || commands_.front().time > time || time - commands_.front().time > timeout) return {};
  const Twist2 wanted = commands_.front().wanted;
  const double faster_wheel = std::abs(wanted.linear) + 0.5 * drive_.track * std::abs(wanted.angular);
  return faster_wheel < drive_.dead_band ? Twist2{} : wanted;
}

// Told to move, and then nothing for the time-out: the drive's electronics notice that without the dead time.
bool RobotPhysics::is_forsaken() const {
  const auto timeout = std::chrono::nanoseconds(std::llround(1e9 * drive_.command_timeout));
  const auto newest = std::find_if(commands_.rbegin(), commands_.rend(),
                                   [this](const Command& command) { return command.time <= truth_.time; });
  return newest != commands_.rend() && newest->wanted != Twist2{} && truth_.time - newest->time > timeout;
}

void RobotPhysics::take_step() {
  constexpr double dt = std::chrono::duration<double>(step).count();
  const bool rested = truth_.wheels == Twist2{};
  const auto dead_time = std::chrono::nanoseconds(std::llround(1e9 * drive_.dead_time));
  const Twist2 wanted = wanted_at(truth_.time - dead_time);

  Twist2& wheels = truth_.wheels;
  if (is_forsaken()) {
    const double change = dt * drive_.stop_deceleration;
    const double turn_change = change / (0.5 * drive_.track);
    wheels.linear -= std::clamp(wheels.linear, -change, change);
    wheels.angular -= std::clamp(wheels.angular, -turn_change, turn_change);
  } else {  // lag and limits
    wheels.linear +=
        dt * std::clamp((wanted.linear - wheels.linear) / drive_.lag, -drive_.acceleration, drive_.acceleration);
    wheels.angular += dt * std::clamp((wanted.angular - wheels.angular) / drive_.lag, -drive_.angular_acceleration,
                                      drive_.angular_acceleration);
  }
  const double v = wheels.linear;
  const double w = wheels.angular;
  if (rested && v == 0.0 && w == 0.0) {  // everything below is a multiple of them
    truth_.motion = {};
    truth_.time += step;
    ++steps_;
    return;
  }
  const double odometry_yaw = T_odom_base_.yaw + 0.5 * w * dt;
  T_odom_base_.x += v * std::cos(odometry_yaw) * dt;
  T_odom_base_.y += v * std::sin(odometry_yaw) * dt;
  T_odom_base_.yaw += w * dt;

  // Over-turn and wheels that are not what the robot believes.
  Pose2& pose = truth_.T_station_base;
  const auto on_patch = [&](double x) {
    return drive_.patch_length > 0.0 &&
           x - drive_.patch_period * std::floor(x / drive_.patch_period) < drive_.patch_length;
  };
  travel_to(std::min(static_cast<std::size_t>(truth_.travelled / field_step), field_count - 1));
  const double curvature = std::min(1.5, std::abs(w) / std::max(0.02, std::abs(v)));  // 1/m
  const double over_turn = drive_.over_turn + (on_patch(pose.x) ? drive_.patch_over_turn : 0.0) + field_.turn_scale -
                           drive_.floor_coupling * drive_.friction_run_sigma * field_.floor +
                           drive_.over_turn_field_sigma * field_.over_turn_and_castors.front().value;
  const double both_radii = 0.5 * (drive_.left_radius_error + drive_.right_radius_error);
  const double difference = field_.wheel_difference + drive_.right_radius_error - drive_.left_radius_error;
  double w1 = w * (1.0 + both_radii + over_turn * std::pow(curvature, drive_.over_turn_exponent)) +
              v * difference / drive_.track;
  double v1 = v * (1.0 + both_radii + field_.speed_scale);
  const double right_wheel = -(pose.x + 0.5 * drive_.track * std::sin(pose.yaw));  // m before the wall
  if (right_wheel < drive_.slick_from && right_wheel > drive_.slick_to) {
    const double lost = drive_.slick_slip * (v1 + 0.5 * drive_.track * w1);
    v1 -= 0.5 * lost;
    w1 -= lost / drive_.track;
  }

  // Castors: each swivels behind its pivot, and scrubs against the floor while it does.
  const double castor_load = drive_.mass * gravity * (1.0 - drive_.drive_load_share) / 4.0;
  const double drive_load = drive_.mass * gravity * drive_.drive_load_share;
  double push_aside = 0.0;
  double push_around = 0.0;
  for (int i = 0; i < 4; ++i) {
    const double x = i < 2 ? drive_.castor_ahead : -drive_.castor_ahead;
    const double y = i % 2 == 0 ? drive_.castor_aside : -drive_.castor_aside;
    double& angle = truth_.castor_angles[i];
    const double pivot_x = v1 - w1 * y;
    const double pivot_y = w1 * x;
    const double sine = std::sin(angle);
    const double cosine = std::cos(angle);
    const double swivel = -w1 + (-pivot_x * sine + pivot_y * cosine) / drive_.castor_trail;
    const double spin = (w1 + swivel) / std::max(0.01, std::hypot(pivot_x, pivot_y));
    double friction = field_.friction[i];
    if (drive_.patch_length > 0.0 && on_patch(pose.x + x * std::cos(pose.yaw) - y * std::sin(pose.yaw)))
      friction *= drive_.patch_friction;
    const double moment =
        drive_.scrub_factor * friction * castor_load * drive_.scrub_radius * std::tanh(spin / drive_.creepage);
    const double force_x = moment / drive_.castor_trail * sine;
    const double force_y = -moment / drive_.castor_trail * cosine;
    push_aside += force_y;
    push_around += x * force_y - y * force_x;
    angle = wrap_angle(angle + swivel * dt);
  }

  // The drive wheels creep under that push, in proportion to how fast they roll.
  const double rolling = std::max(std::abs(v), 0.5 * std::abs(w) * drive_.track);
  const double stiffness = drive_.creep_stiffness * drive_load;
  const double v_aside = rolling * push_aside / stiffness;
  const double w_pushed = 4.0 * rolling * push_around / (drive_.track * drive_.track * stiffness);
  double turned = (w1 + w_pushed) * dt;
  if (v != 0.0) turned += drive_.yaw_walk * std::sqrt(std::abs(v) * dt) * normal_number(walk_key_ + steps_);
  const double yaw = pose.yaw + 0.5 * turned;
  pose.x += (v1 * std::cos(yaw) - v_aside * std::sin(yaw)) * dt;
  pose.y += (v1 * std::sin(yaw) + v_aside * std::cos(yaw)) * dt;
  pose.yaw += turned;
  truth_.motion = {v1, turned / dt};
  truth_.travelled += rolling * dt;
  truth_.time += step;
  ++steps_;
}

}  // namespace tagdock
