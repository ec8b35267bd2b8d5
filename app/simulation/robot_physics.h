#pragma once

#include <array>
#include <chrono>
#include <cstdint>
#include <deque>
#include <vector>

#include "app/simulation/draws.h"
#include "app/simulation/scenario.h"
#include "planning/pose2.h"
#include "servo/robot.h"

namespace tagdock {

/// How the robot truly is. The station frame's axes: x towards the wall, y left when facing it.
struct RobotTruth {
  std::chrono::nanoseconds time{0};
  Pose2 T_station_base;
  Twist2 wheels;                          ///< as the wheels turn: what encoders see
  Twist2 motion;                          ///< of the base over the floor, without sideways creep
  std::array<double, 4> castor_angles{};  ///< rad, 0 trails in forward travel
  double travelled = 0.0;                 ///< m, what the random fields are indexed by
};

/// A differential drive with four castors on a real floor: notes/docking.md sections 4.1 to 4.4, in steps of 5 ms.
/// The encoders' odometry integrates the wheels' turning and sees no slip.
class RobotPhysics {
 public:
  static constexpr std::chrono::nanoseconds step = std::chrono::milliseconds(5);

  /// @param camera_ahead  of the axle [m]: the start is drawn for the camera point
  /// @param seed          of the run; start, floor and drive have random numbers of their own
  RobotPhysics(const StartScenario& start, const DriveScenario& drive, double camera_ahead, std::uint64_t seed);

  /// A command that reaches the drive's electronics at a time, not before earlier ones. The drive acts on it after its
  /// dead time, and stops when no newer one follows within its time-out.
  void command(const Twist2& wanted, std::chrono::nanoseconds now);

  /// Runs all steps that end at `now` or before.
  void advance(std::chrono::nanoseconds now);

  [[nodiscard]] const RobotTruth& truth() const { return truth_; }

  /// T_odom_base is the identity at the start.
  [[nodiscard]] Odometry odometry() const { return {truth_.time, T_odom_base_, truth_.wheels}; }

 private:
  struct Command {
    std::chrono::nanoseconds time;
    Twist2 wanted;
  };
  /// Unit variance, correlated along the travelled way, one number every centimetre.
  struct Series {
    Draws draws;
    double value = 0.0;  ///< at the place where the robot is
  };
  /// Numbers of one run. Those along the way are drawn as it is travelled: a run needs a tenth of them.
  struct Field {
    double turn_scale = 0.0, speed_scale = 0.0, wheel_difference = 0.0, floor = 0.0;
    double keep = 0.0;      ///< share of a series' value in the next one
    std::size_t place = 0;  ///< cm
    std::vector<Series> over_turn_and_castors;
    std::array<double, 4> castor{};    ///< normal number of each castor
    std::array<double, 4> friction{};  ///< of each castor, here
  };

  void draw_field(std::uint64_t seed);
  void travel_to(std::size_t place);
  void find_friction();
  void draw_start(const StartScenario& start, double camera_ahead, std::uint64_t seed);
  [[nodiscard]] Twist2 wanted_at(std::chrono::nanoseconds time);
  [[nodiscard]] bool is_forsaken() const;
  void take_step();

  DriveScenario drive_;
  std::uint64_t walk_key_;
  std::uint64_t steps_ = 0;
  Field field_;
  RobotTruth truth_;
  Pose2 T_odom_base_;
  std::deque<Command> commands_;
};

}  // namespace tagdock
