#pragma once

#include <chrono>
#include <cstdint>
#include <deque>
#include <memory>
#include <optional>

#include "app/simulation/renderer.h"
#include "app/simulation/robot_physics.h"
#include "app/simulation/scenario.h"
#include "calibration/rig.h"
#include "calibration/target.h"

namespace tagdock {

/// The rig as it truly is, where `calibrated` is what the robot believes: residuals of one run.
Rig true_rig(const Rig& calibrated, const ResidualScenario& residuals, std::uint64_t seed);

/// The board as it truly stands, where `surveyed` is what the robot believes.
Board true_board(const Board& surveyed, const ResidualScenario& residuals, const StationScenario& station,
                 std::uint64_t seed);

/// An exposure with the seed of its noise.
struct TimedExposure {
  Exposure exposure;
  std::uint64_t noise_seed = 0;
};

/// The simulated robot in its room, seen by its camera. Only time that is handed in passes; there are no threads, and
/// callers on several of them lock. The same scenario, seed and calls give the same numbers and bytes.
class World {
 public:
  /// @param calibrated, surveyed  the rig and board files as the robot has them; the world differs from them by what
  ///                              the scenario says
  World(const Scenario& scenario, const Rig& calibrated, const Board& surveyed, std::uint64_t seed);

  /// A command that reaches the robot's drive at a session time.
  void command(const Twist2& wanted, std::chrono::nanoseconds now) { physics_.command(wanted, now); }

  /// Lets time pass; the plant moves in steps of 5 ms.
  void advance(std::chrono::nanoseconds now);

  /// Takes the robot's true place from another process that simulates it: from the first one on the plant in here
  /// stands still, and images are made where the robot was told to be, or would be by now. Older places than the newest
  /// are ignored.
  void place(std::chrono::nanoseconds time, const Pose2& T_station_base);

  [[nodiscard]] std::chrono::nanoseconds now() const { return physics_.truth().time; }
  /// As the robot's encoders tell it; new every 5 ms of session time.
  [[nodiscard]] Odometry odometry() const { return physics_.odometry(); }

  /// The image whose exposure has its middle at a session time within the last two seconds; up to 20 ms ahead of the
  /// world it is made with the motion going on as it is.
  [[nodiscard]] Rendering render(std::chrono::nanoseconds mid_exposure, RenderedRows rows = RenderedRows::all) const;
  /// What `render` hands to the renderer, so that a thread can render without holding up the world.
  [[nodiscard]] TimedExposure exposure_at(std::chrono::nanoseconds mid_exposure) const;
  /// Made at the first call; it is never changed afterwards and may then be used without a lock.
  [[nodiscard]] const Renderer& renderer() const;

  /// Time between frames.
  [[nodiscard]] std::chrono::nanoseconds frame_period() const;
  /// From mid-exposure of a frame to its arrival.
  [[nodiscard]] std::chrono::nanoseconds latency_of(std::uint64_t frame) const;
  /// Whether a frame never arrives.
  [[nodiscard]] bool is_lost(std::uint64_t frame) const;

  // Truth, for evaluation only.

  [[nodiscard]] const RobotTruth& truth() const { return physics_.truth(); }
  /// Camera point (the lens' place on the floor) and heading in the station frame: what an external tracker beside the
  /// lens would see.
  [[nodiscard]] Pose2 T_station_camera_point() const;
  /// Camera point and heading minus the taught docking pose, in the station frame: m, m, rad (CONTRACTS.md).
  [[nodiscard]] Pose2 docking_error(const Pose2& docking_pose) const;
  [[nodiscard]] const Rig& rig() const { return rig_; }
  [[nodiscard]] const Board& board() const { return board_; }
  [[nodiscard]] const Scenario& scenario() const { return scenario_; }

 private:
  struct Moment {
    std::chrono::nanoseconds time;
    Pose2 T_station_base;
  };

  [[nodiscard]] Pose2 T_station_base_at(std::chrono::nanoseconds time) const;
  void remember(std::chrono::nanoseconds time, const Pose2& T_station_base);

  Scenario scenario_;
  std::uint64_t seed_;
  Rig rig_;
  Board board_;
  RobotPhysics physics_;
  Scene scene_;
  mutable std::unique_ptr<const Renderer>
      renderer_;  ///< made for the first image: a campaign without images needs none
  std::deque<Moment> history_;
  bool placed_ = false;  ///< from outside
  std::optional<std::chrono::nanoseconds> light_changed_;
};

}  // namespace tagdock
