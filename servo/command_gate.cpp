#include "servo/command_gate.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <stdexcept>

namespace tagdock {
namespace {

double seconds(std::chrono::nanoseconds time) { return std::chrono::duration<double>(time).count(); }
double milliseconds(std::chrono::nanoseconds time) { return 1e3 * seconds(time); }

template <typename... Values>
std::string sentence(const char* format, Values... values) {
  std::array<char, 300> text{};
  std::snprintf(text.data(), text.size(), format, values...);
  return text.data();
}

// Speeding up is limited, slowing down is not; a change of direction starts again from zero.
double limited(double wanted, double last, double change) {
  const double start = wanted * last < 0.0 ? 0.0 : std::abs(last);
  return std::copysign(std::min(std::abs(wanted), start + change), wanted);
}

}  // namespace

std::string_view word(Cause cause) {
  switch (cause) {
    case Cause::tag_never_seen:
      return "tag never seen";
    case Cause::wrong_tags:
      return "wrong tags";
    case Cause::tag_lost:
      return "tag lost";
    case Cause::pose_uncertain:
      return "pose uncertain";
    case Cause::no_plan:
      return "no plan";
    case Cause::entry_missed:
      return "entry missed";
    case Cause::swinging:
      return "swinging";
    case Cause::drifted:
      return "drifted";
    case Cause::outside_tolerance:
      return "outside tolerance";
    case Cause::not_docked:
      return "not docked";
    case Cause::dock_changed:
      return "dock changed";
    case Cause::timed_out:
      return "timed out";
    case Cause::camera_lost:
      return "camera lost";
    case Cause::camera_slow:
      return "camera slow";
    case Cause::odometry_stale:
      return "odometry stale";
    case Cause::odometry_invalid:
      return "odometry invalid";
    case Cause::odometry_jump:
      return "odometry jump";
    case Cause::robot_link:
      return "robot link";
    case Cause::stalled:
      return "stalled";
    case Cause::slipped:
      return "slipped";
    case Cause::stopped_by_person:
      return "stopped by a person";
    case Cause::cancelled:
      return "cancelled";
  }
  return "unknown";
}

std::string_view word(GateAction action) {
  switch (action) {
    case GateAction::passed:
      return "passed";
    case GateAction::limited:
      return "limited";
    case GateAction::halved:
      return "halved";
    case GateAction::held:
      return "held";
  }
  return "unknown";
}

std::optional<Reason> odometry_fault(const std::optional<Odometry>& before, const Odometry& reading,
                                     const OdometryLimits& limits) {
  if (!is_finite(reading.T_odom_base) || !is_finite(reading.velocity)) {
    return Reason{Cause::odometry_invalid, "an odometry reading is not a finite number; check the robot's encoders"};
  }
  if (!before) return std::nullopt;
  if (reading.time < before->time) {
    return Reason{Cause::odometry_invalid,
                  sentence("odometry time ran backwards by %.1f ms", milliseconds(before->time - reading.time))};
  }
  const Pose2 motion = between(before->T_odom_base, reading.T_odom_base);
  const double time = seconds(reading.time - before->time);
  const double distance = std::hypot(motion.x, motion.y);
  if (distance > 1.5 * limits.max_speed * time + limits.jump_distance) {
    return Reason{Cause::odometry_jump,
                  sentence("odometry jumped by %.0f mm within %.0f ms; was it reset?", 1e3 * distance, 1e3 * time)};
  }
  if (std::abs(wrap_angle(motion.yaw)) > 1.5 * limits.max_turn_rate * time + limits.jump_yaw) {
    return Reason{Cause::odometry_jump, sentence("odometry turned by %.1f degrees within %.0f ms; was it reset?",
                                                 degrees(wrap_angle(motion.yaw)), 1e3 * time)};
  }
  return std::nullopt;
}

void check(const CommandGateConfig& config) {
  const auto positive = [](double value, const char* name) {
    if (!(std::isfinite(value) && value > 0.0)) {
      throw std::invalid_argument(sentence("%s is %g; it must be a finite number above 0", name, value));
    }
  };
  positive(config.max_speed, "gate.max_speed");
  positive(config.max_turn_rate, "gate.max_turn_rate");
  positive(config.acceleration, "gate.acceleration");
  positive(config.turn_acceleration, "gate.turn_acceleration");
  positive(config.odometry.max_speed, "gate.odometry.max_speed");
  positive(config.odometry.max_turn_rate, "gate.odometry.max_turn_rate");
  if (config.max_speed > 0.3) {
    throw std::invalid_argument(
        sentence("gate.max_speed is %g m/s; a docking never drives faster than 0.3 m/s", config.max_speed));
  }
  if (config.declared_latency.count() < 0 || config.half_speed_age.count() <= 0 ||
      config.hold_age < config.half_speed_age || config.back_off_age < config.hold_age ||
      config.give_up_age < config.back_off_age) {
    throw std::invalid_argument(
        "the ages of the gate must rise: declared_latency >= 0, 0 < half_speed_age <= hold_age <= back_off_age <= "
        "give_up_age");
  }
}

CommandGate::CommandGate(const CommandGateConfig& config) : config_(config) { check(config_); }

void CommandGate::latch(const Reason& reason) {
  if (!latched_) latched_ = reason;
  last_ = {};
}

GateResult CommandGate::pass(const Twist2& wanted, const GateInputs& inputs) {
  // A late cycle may not speed up by more than a tenth of a second's worth.
  constexpr double nominal = 0.02;
  constexpr double longest = 0.1;
  const double dt = last_time_ ? std::clamp(seconds(inputs.now - *last_time_), 0.0, longest) : nominal;
  last_time_ = inputs.now;
  const Twist2 before = last_;
  last_ = {};

  if (latched_) return {{}, GateAction::held, word(latched_->cause), latched_};
  if (!is_finite(wanted)) return {{}, GateAction::held, "the command is not finite", std::nullopt};
  if (!inputs.odometry_time || inputs.now - *inputs.odometry_time > config_.odometry.max_age) {
    stalling_since_.reset();
    return {{}, GateAction::held, "odometry is too old", std::nullopt};
  }

  const bool stalling =
      std::abs(before.linear) > config_.stall_speed && !(std::abs(inputs.wheel_speed) >= 0.2 * std::abs(before.linear));
  if (!stalling) {
    stalling_since_.reset();
  } else if (!stalling_since_) {
    stalling_since_ = inputs.now;
  } else if (inputs.now - *stalling_since_ > config_.stall_time) {
    latch({Cause::stalled, sentence("commanded %.3f m/s, but the wheels turned at %.3f m/s for %.1f s; is the robot "
                                    "blocked or braked?",
                                    before.linear, inputs.wheel_speed, seconds(inputs.now - *stalling_since_))});
    return {{}, GateAction::held, word(Cause::stalled), latched_};
  }

  GateResult result{wanted, GateAction::passed, {}, std::nullopt};
  if (inputs.need != FrameNeed::none) {
    const bool board = inputs.need == FrameNeed::sightings;
    const auto& time = board ? inputs.sighting_time : inputs.frame_time;
    if (!time) {
      return {{}, GateAction::held, board ? "the board was not seen yet" : "there was no frame yet", std::nullopt};
    }
    const std::chrono::nanoseconds age =
        inputs.now - *time - inputs.declared_latency.value_or(config_.declared_latency);
    if (age > config_.hold_age) {
      return {{},
              GateAction::held,
              board ? "the board was seen too long ago" : "the newest frame is too old",
              std::nullopt};
    }
    if (age > config_.half_speed_age) {
      result.command = {0.5 * wanted.linear, 0.5 * wanted.angular};
      result.action = GateAction::halved;
      result.why = board ? "the board was seen a while ago" : "the newest frame is old";
    }
  }

  // Both velocities shrink together, so the curvature stays.
  const double share = std::min({1.0, config_.max_speed / std::max(1e-9, std::abs(result.command.linear)),
                                 config_.max_turn_rate / std::max(1e-9, std::abs(result.command.angular))});
  Twist2 passed{share * result.command.linear, share * result.command.angular};
  passed.linear = limited(passed.linear, before.linear, config_.acceleration * dt);
  passed.angular = limited(passed.angular, before.angular, config_.turn_acceleration * dt);
  passed.linear = std::clamp(passed.linear, -config_.max_speed, config_.max_speed);
  passed.angular = std::clamp(passed.angular, -config_.max_turn_rate, config_.max_turn_rate);
  if (result.action == GateAction::passed && passed != wanted) {
    result.action = GateAction::limited;
    result.why = "speed or acceleration limit";
  }
  result.command = passed;
  last_ = passed;
  return result;
}

}  // namespace tagdock
