#include "servo/odometry_controller.h"

#include <algorithm>
#include <cassert>
#include <cmath>

namespace tagdock {
namespace {

double seconds(std::chrono::nanoseconds time) { return std::chrono::duration<double>(time).count(); }

double toward(double value, double target, double up, double down) {
  return value + std::clamp(target - value, -down, up);
}

// What the wheels have to drive for the robot to be on the path: its heading, and what the castors hold back of it.
struct Steering {
  double heading = 0.0;    // rad
  double curvature = 0.0;  // 1/m
};

Steering steering_at(const Path& path, double distance, const PathPoint& here, double whole,
                     const OdometryControllerConfig& config) {
  if (config.castor_scrub <= 0.0 || here.direction < 0) return {here.pose.yaw, here.curvature};
  const auto curvature = [&](double at) { return curvature_at(path, std::clamp(at, 0.0, whole)); };
  const auto held = [&](double at) { return config.castor_scrub * held_back_in_turn(curvature(at), config.castors); };
  constexpr double beside = 0.03;  // m; castors do not follow faster
  const double later = distance + config.steer_ahead;
  return {here.pose.yaw + held(distance),
          curvature(later) + (held(later + beside) - held(later - beside)) / (2.0 * beside)};
}

}  // namespace

std::chrono::nanoseconds control_period(std::chrono::nanoseconds segment_time, std::chrono::nanoseconds nominal,
                                        StepRounding rounding) {
  assert(segment_time.count() > 0 && nominal.count() > 0);
  const auto whole = segment_time.count();
  const auto wanted = nominal.count();
  const auto steps = std::max<std::chrono::nanoseconds::rep>(
      1, rounding == StepRounding::down ? whole / wanted : (whole + wanted / 2) / wanted);
  return std::chrono::nanoseconds((whole + steps - 1) / steps);
}

std::chrono::nanoseconds travel_time(double distance, const OdometryControllerConfig& config) {
  // Up with `acceleration`, down with `braking`; the top speed may not be reached.
  const double both = 0.5 / config.acceleration + 0.5 / config.braking;
  const double top = std::min(config.max_speed, std::sqrt(distance / both));
  const double time =
      top > 0.0 ? top / config.acceleration + top / config.braking + (distance - top * top * both) / top : 0.0;
  return std::chrono::nanoseconds(std::llround(time * 1e9));
}

FollowStep follow(const Path& path, const FollowState& state, const Pose2& pose, std::chrono::nanoseconds step,
                  const OdometryControllerConfig& config, std::optional<double> passed) {
  const double dt = seconds(step);
  const double whole = length(path);
  FollowStep result;
  result.next = state;

  // What the gate held back the reference does not run ahead of.
  PathWalk walk(path);
  const PathPoint last = walk.at(state.reference);
  double speed_before = state.reference_speed;
  if (passed && std::abs(*passed) < std::abs(state.wanted))
    speed_before = std::min(speed_before, std::max(0.0, last.direction * *passed));
  // The reference moves first, as far as this cycle lasts.
  const double rest = std::max(0.0, whole - state.reference);
  double target = std::min(config.max_speed, std::sqrt(2.0 * config.braking * rest));
  if (rest < config.end_length) target = std::max(target, config.end_speed);
  const double behind = -last.direction * between(last.pose, pose).x;
  target *= std::clamp((config.wait_at - behind) / (config.wait_at - config.wait_from), 0.0, 1.0);
  result.next.reference_speed = toward(speed_before, target, config.acceleration * dt, config.deceleration * dt);
  result.next.reference = std::min(whole, state.reference + result.next.reference_speed * dt);
  result.remaining = whole - result.next.reference;

  const PathPoint wanted = walk.at(result.next.reference);
  result.deviation = between(wanted.pose, pose);
  result.deviation.yaw = wrap_angle(result.deviation.yaw);
  const double along_error = -result.deviation.x;  // ahead is positive for the direction the robot faces
  const double lateral_error = -result.deviation.y;
  const Steering steering = steering_at(path, result.next.reference, wanted, whole, config);
  const double heading_error = wrap_angle(steering.heading - pose.yaw);

  if (result.remaining < 0.001 && config.end_speed == 0.0) {
    // Creep to the end, then hold it.
    const bool near = std::abs(along_error) < config.arrival;
    result.command.linear = near ? 0.0 : std::clamp(1.2 * along_error, -0.02, 0.02);
    result.next.wanted = result.command.linear;
    result.next.rested = near ? state.rested + step : std::chrono::nanoseconds(0);
    result.arrived = result.next.rested >= config.rest;
    return result;
  }
  if (result.remaining <= 0.0) result.arrived = true;

  // Share of a deviation per nominal cycle, as a rate.
  const double gain = config.damping / seconds(config.nominal_period);
  const double speed = wanted.direction * result.next.reference_speed;
  // In reverse a lateral deviation is taken back by the opposite turn.
  result.command.linear =
      std::clamp(speed + config.along_share * gain * along_error, -config.max_command, config.max_command);
  result.next.wanted = result.command.linear;
  result.command.angular = std::clamp(
      speed * steering.curvature + gain * (heading_error + wanted.direction * lateral_error / config.lateral_length),
      -config.max_turn_rate, config.max_turn_rate);
  return result;
}

}  // namespace tagdock
