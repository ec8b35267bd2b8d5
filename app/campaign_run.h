#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "app/config.h"
#include "app/run_trace.h"
#include "app/simulation/scenario.h"
#include "app/simulation/sighting_model.h"

namespace tagdock {

/// How the robot is brought to the dock.
enum class Strategy {
  servo,  ///< tagdock's: path, then closed loop on what the camera sees, fix, retries
  paper   ///< Richter et al.: one pose of one flat tag, then the path by odometry alone, no look at the result
};

/// One campaign: the same for all of its runs.
struct RunSettings {
  Config config;  ///< what the robot knows
  Scenario scenario;
  std::string scenario_text;  ///< of its file, to tell campaigns apart; empty: the built-in one
  Strategy strategy = Strategy::servo;
  /// The robot was put at the dock once, and keeps as docking pose what it saw there: what calibration and survey leave
  /// cancels. Without, it believes the nominal pose of its configuration.
  bool teach = true;
  bool images = false;  ///< rendered and seen by the real detector, or corners with drawn errors
  CornerErrors corner_errors = tagdock::corner_errors("tanh");
  bool limits_lifted = false;  ///< one attempt, and no refusal because the pose is uncertain
  // For people, and to tell campaigns apart:
  std::string start_name = "scenario";
  std::string rig_name = "default";
  std::string board_name = "v_convex_centre";
  std::string corners_name = "tanh";
};

/// A line of runs.csv (CONTRACTS.md).
struct RunRecord {
  std::uint64_t seed = 0;
  std::string scenario;
  std::string result;  ///< docked, failed, stopped; `arrived` for the paper's strategy, which does not look
  std::string reason;
  Pose2 true_error;                ///< of the camera point against the docking pose, station frame: m, m, rad
  std::optional<Pose2> estimated;  ///< the same as the robot claims it
  double duration_s = 0.0;
  int attempts = 1;
  double stop_latency_ms = 0.0;  ///< from the last command to move until the wheels stand
  std::optional<Pose2> sigma;    ///< of `estimated`
  // Where the scenario breaks something on the way:
  std::string fault;                        ///< frames, odometry or link; empty: nothing broke
  std::optional<double> fault_to_zero_ms;   ///< from the last good input (frame: mid-exposure) to a zero command
  std::optional<double> fault_to_stand_ms;  ///< the same until the wheels stand
  /// At the first standstill; `run_campaign` takes it from the trace.
  std::optional<StartLook> start;
};

/// One docking in a world of its own. The same settings and seed give the same record to the last bit.
/// @param trace  receives the way, if given
RunRecord run_once(const RunSettings& settings, std::uint64_t seed, RunTrace* trace = nullptr);

/// The docking pose as a robot measures it that stands exactly there, in the same world as the run of that seed but
/// before somebody moves the dock or touches the camera. None if it does not see the board well enough from there.
std::optional<Fix> taught_pose(const RunSettings& settings, std::uint64_t seed);

/// The rig with which the paper's strategy is evaluated (notes on docking, 4.8): 2448x2048 pixels of 3.45 um behind an
/// 8 mm lens without distortion, on the default robot.
Rig five_megapixel_rig();

/// One tag of 0.16 m flat on the wall, its centre at `height`.
Board single_tag_board(double height);

}  // namespace tagdock
