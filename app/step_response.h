#pragma once

#include <cstdint>
#include <vector>

#include "app/simulation/scenario.h"
#include "app/verbs.h"
#include "servo/odometry_controller.h"

namespace tagdock {

/// What is measured: how a robot takes back a deviation that appears at once while it drives straight.
struct StepResponseSettings {
  DriveScenario drive;
  OdometryControllerConfig controller;
  double step = 0.02;      ///< m to the side; small enough that no command is cut
  double before = 0.8;     ///< m driven until it appears: the robot has its speed
  double after = 4.0;      ///< m driven from there
  std::uint64_t seed = 1;  ///< of the first robot and floor
  int runs = 5;            ///< robots and floors for each setting
};

struct ResponseSample {
  double time = 0.0;          ///< s since the step
  double travelled = 0.0;     ///< m since the step
  double lateral = 0.0;       ///< m beside the path as odometry says, positive to the left
  double true_lateral = 0.0;  ///< m, the same as a tracker would see it: slip and castors included
  double heading = 0.0;       ///< rad against the path, as odometry says
};

/// One run with one damping.
struct StepResponse {
  double damping = 0.0;
  double dead_time = 0.0;  ///< s
  std::uint64_t seed = 0;
  std::vector<ResponseSample> samples;
  double cost = 0.0;       ///< integral of t |heading + lateral / L| dt over that of a step that stays [1]
  double overshoot = 0.0;  ///< share of the step that the robot swings to the other side
  double settled = 0.0;    ///< s until it stays within a tenth of the step; the whole run if it never does
  double swing = 0.0;      ///< largest heading in the last quarter of the run over the largest in the first; about 1 or
                           ///< more does not die down
};

StepResponse step_response(const StepResponseSettings& settings, double damping, std::uint64_t seed);

/// What a drive does with a command, read from its own odometry: dead time and first-order lag [s].
struct DriveLag {
  double dead_time = 0.0;
  double lag = 0.0;
};
/// From a small step of the turning rate: the times at which 28.3 % and 63.2 % of it are there (Smith's two points).
DriveLag measure_drive(const DriveScenario& drive, std::uint64_t seed);

/// Damping at which the heading's loop of dead time, lag and integrator swings without end, a command counting half a
/// period later and a reading up to one.
double swinging_damping(const DriveLag& lag, double period);

/// Mean figures of one damping over several robots.
struct DampingResult {
  double damping = 0.0;
  double cost = 0.0;
  double overshoot = 0.0;
  double settled = 0.0;
  double swing = 0.0;
};

/// Dampings tried on a robot, and the one with which deviations cost least.
struct DampingSearch {
  double dead_time = 0.0;
  DriveLag measured;
  std::vector<DampingResult> tried;  ///< by rising damping
  double best = 0.0;
  double swings_from = 0.0;  ///< smallest damping tried whose swings do not die down; 0: none
};
DampingSearch find_damping(const StepResponseSettings& settings, const std::vector<double>& dampings);

/// Adds `step-response` below `evaluate`.
void add_step_response(CLI::App& evaluate, Action& action);

}  // namespace tagdock
