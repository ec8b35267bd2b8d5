#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <string_view>

#include "planning/pose2.h"
#include "servo/robot.h"

namespace tagdock {

/// Why a docking ended without success. The shell's exit code follows from it (`app`).
enum class Cause {
  tag_never_seen,     ///< the camera works, but the board was not in any frame
  wrong_tags,         ///< tags were seen, but none of the board's, or not as they stand on the board
  tag_lost,           ///< the board was seen and is not any more
  pose_uncertain,     ///< the board is seen, but its pose is ambiguous or too uncertain to act on
  no_plan,            ///< no path to the dock
  entry_missed,       ///< the path did not end close enough to the dock's line
  swinging,           ///< the heading swings about the line
  drifted,            ///< the lateral error grew on the line, or its uncertainty
  outside_tolerance,  ///< docked, but not where it should be
  not_docked,         ///< asked to leave the dock, but not standing there
  dock_changed,       ///< the board does not hang as it did when the docking pose was taught
  timed_out,          ///< a phase took longer than it may
  camera_lost,        ///< no frames
  camera_slow,        ///< frames are older on arrival than the rig declares
  odometry_stale,     ///< odometry arrives too late
  odometry_invalid,   ///< NaN, infinity, or time running backwards
  odometry_jump,      ///< moved farther than the robot can
  robot_link,         ///< the robot is silent
  stalled,            ///< the robot does not move although commanded to
  slipped,            ///< the wheels turn otherwise than the robot moves
  stopped_by_person,  ///< operator or guard
  cancelled           ///< by the operator, who did not ask for a stop
};
std::string_view word(Cause cause);

struct Reason {
  Cause cause = Cause::timed_out;
  std::string sentence;  ///< for a person, with figures

  bool operator==(const Reason&) const = default;
};

struct OdometryLimits {
  double max_speed = 0.5;                                                 ///< m/s that the robot can drive at all
  double max_turn_rate = 1.5;                                             ///< rad/s that it can turn at all
  double jump_distance = 0.010;                                           ///< m on top of 1.5 times the speed
  double jump_yaw = 0.05;                                                 ///< rad on top of 1.5 times the turn rate
  std::chrono::nanoseconds max_age = std::chrono::milliseconds(100);      ///< older: zero command
  std::chrono::nanoseconds max_silence = std::chrono::milliseconds(200);  ///< longer: stop, latched
  std::chrono::nanoseconds first_reading = std::chrono::seconds(2);       ///< waited for at the start
};

/// Whether a reading can follow another one.
/// @param before  the last good reading, if there was one
/// @return        what is wrong with it, if anything
std::optional<Reason> odometry_fault(const std::optional<Odometry>& before, const Odometry& reading,
                                     const OdometryLimits& limits);

/// Which frames a command relies on.
enum class FrameNeed {
  none,      ///< goes by odometry alone
  frames,    ///< the camera must work
  sightings  ///< the board must be in view
};

struct CommandGateConfig {
  double max_speed = 0.20;         ///< m/s; never above 0.3
  double max_turn_rate = 0.5;      ///< rad/s
  double acceleration = 0.3;       ///< m/s^2; speeding up only, slowing down is never delayed
  double turn_acceleration = 1.5;  ///< rad/s^2; the same
  OdometryLimits odometry;
  /// Time from mid-exposure to arrival that is normal for the camera; ages count beyond it.
  std::chrono::nanoseconds declared_latency = std::chrono::milliseconds(80);
  std::chrono::nanoseconds half_speed_age = std::chrono::milliseconds(150);
  std::chrono::nanoseconds hold_age = std::chrono::milliseconds(250);
  std::chrono::nanoseconds back_off_age = std::chrono::seconds(3);
  std::chrono::nanoseconds give_up_age = std::chrono::seconds(5);
  /// Stall: commanded above this speed, and the wheels below a fifth of it for `stall_time`.
  double stall_speed = 0.02;  ///< m/s
  std::chrono::nanoseconds stall_time = std::chrono::milliseconds(700);
};
/// Throws std::invalid_argument with a sentence when a limit is not positive and finite, or the speed is above 0.3 m/s.
void check(const CommandGateConfig& config);

struct GateInputs {
  std::chrono::nanoseconds now{0};
  std::optional<std::chrono::nanoseconds> odometry_time;  ///< of the newest good reading
  double wheel_speed = 0.0;                               ///< of that reading [m/s]
  std::optional<std::chrono::nanoseconds> frame_time;     ///< mid-exposure of the newest frame
  std::optional<std::chrono::nanoseconds> sighting_time;  ///< mid-exposure of the newest frame that was of use
  FrameNeed need = FrameNeed::sightings;
  std::optional<std::chrono::nanoseconds> declared_latency;  ///< as measured; without, the configuration's
};

/// What the gate did to a command.
enum class GateAction { passed, limited, halved, held };
std::string_view word(GateAction action);

struct GateResult {
  Twist2 command;
  GateAction action = GateAction::held;
  std::string_view why;         ///< words, empty when passed
  std::optional<Reason> fault;  ///< latched: from now on every command is zero
};

/// The last gate before the wheels: passes only finite commands within speed and acceleration, from fresh inputs.
/// Everything else is a zero command. Not a safety function.
class CommandGate {
 public:
  /// Throws as `check`.
  explicit CommandGate(const CommandGateConfig& config);

  GateResult pass(const Twist2& wanted, const GateInputs& inputs);

  /// Zero from now on; the first reason stays.
  void latch(const Reason& reason);
  [[nodiscard]] const Twist2& last() const { return last_; }

 private:
  CommandGateConfig config_;
  Twist2 last_;
  std::optional<std::chrono::nanoseconds> last_time_;
  std::optional<std::chrono::nanoseconds> stalling_since_;
  std::optional<Reason> latched_;
};

}  // namespace tagdock
