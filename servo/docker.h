#pragma once

#include <chrono>
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "calibration/rig.h"
#include "detection/tag_pose.h"
#include "servo/command_gate.h"
#include "servo/docking.h"
#include "servo/pose_filter.h"

namespace tagdock {

/// What the world said since the last cycle.
struct Tick {
  std::chrono::nanoseconds now{0};
  std::vector<Odometry> odometry;    ///< oldest first
  std::optional<Sighting> sighting;  ///< of the newest frame, if one came
  /// Mid-exposure of that frame; needed with Unseen, which has no time of its own.
  std::optional<std::chrono::nanoseconds> frame_time;
  std::string camera_sentence;  ///< why it is lost, for a person
  bool robot_linked = true;     ///< false: the link is known to be broken
  std::string robot_sentence;   ///< why it is broken, for a person
  Request request = Request::none;
};

/// Something worth a line in the log.
struct Event {
  std::chrono::nanoseconds time{0};
  std::string text;
};

struct TickResult {
  Twist2 command;  ///< for the robot, after the gate
  GateAction gate = GateAction::held;
  std::string_view gate_reason;          ///< words, when the gate did something
  std::vector<Event> events;             ///< of this cycle
  std::optional<PoseEstimate> estimate;  ///< for now
  std::optional<FilterUpdate> sighting;  ///< what the filter made of this cycle's sighting
  bool phase_changed = false;
  bool over = false;                      ///< the phase is docked, failed or stopped
  std::chrono::nanoseconds next_tick{0};  ///< wanted time until the next cycle (eq. 6 while a path is driven)
};

/// Sightings and odometry in, safe commands out: pose filter -> docking::step -> command gate. The same object drives
/// the live robot, a replay and an evaluation; the same ticks give bit-equal results.
class Docker {
 public:
  /// Throws std::invalid_argument with a sentence when a setting is out of range.
  Docker(const Rig& rig, const DockingConfig& config);

  TickResult tick(const Tick& tick);

  [[nodiscard]] const Phase& phase() const { return phase_; }
  [[nodiscard]] const DockingConfig& config() const { return config_; }

  /// Where the camera sees the station at a time (a frame's mid-exposure, also a past one), for the locator's region.
  [[nodiscard]] std::optional<Eigen::Isometry3d> predicted_view(std::chrono::nanoseconds time) const;

  /// What remains of the way after a cycle [m], for people; none where the phase has no end that can be measured.
  [[nodiscard]] std::optional<double> distance_to_go(const TickResult& result) const;

  /// Where the robot is at a time; none while there is no estimate.
  [[nodiscard]] std::optional<PoseEstimate> estimate(std::chrono::nanoseconds time) const;

 private:
  std::optional<Reason> take_odometry(const Tick& tick);
  void take_sighting(const Tick& tick, TickResult& result);
  [[nodiscard]] Inputs inputs_of(const Tick& tick, const TickResult& result) const;
  void enter(Phase next, const std::string& reason, std::chrono::nanoseconds now, TickResult& result);

  DockingConfig config_;
  PoseFilter filter_;
  CommandGate gate_;
  Phase phase_;
  std::optional<std::chrono::nanoseconds> started_;
  std::optional<std::chrono::nanoseconds> last_tick_;
  std::optional<Odometry> odometry_;
  std::optional<std::chrono::nanoseconds> odometry_arrived_;
  double travelled_ = 0.0;  ///< by the wheels without a change of direction [m]; negative backwards
  SlipWatch slip_;
  std::optional<Reason> slipped_;
  std::optional<RestSighting> rest_;  ///< of this cycle
  std::optional<std::chrono::nanoseconds> frame_time_;
  std::optional<std::chrono::nanoseconds> sighting_time_;
  std::chrono::nanoseconds declared_latency_;          ///< of the configuration, or as measured standing
  std::deque<std::chrono::nanoseconds> arrival_ages_;  ///< of the last frames
  bool tags_dirty_told_ = false;
  std::deque<bool> seen_lately_;  ///< of the last frames: was the board in it
  std::string_view held_told_;
};

}  // namespace tagdock
