#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "calibration/rig.h"
#include "planning/docking_plan.h"
#include "planning/path.h"
#include "servo/command_gate.h"
#include "servo/line_following.h"
#include "servo/marker_centering.h"
#include "servo/odometry_controller.h"
#include "servo/pose_filter.h"
#include "servo/rest_smoother.h"
#include "servo/slip_watch.h"

namespace tagdock {

/// THE SPINE OF MOVING: step(phase, inputs, config) -> next phase, command. The paper's Fig. 2, extended (notes on
/// docking, 9).

/// Path of the axle from one pose to another, both in the station frame, or a sentence why there is none. For those who
/// bring their own; plan_docking is what is used without.
using Planner = std::function<std::variant<Path, std::string>(const Pose2& from, const Pose2& to)>;

/// What a job is for.
enum class Errand {
  dock,
  undock  ///< straight back from the dock
};

/// Which law drives the last part.
enum class ServoLaw {
  line,      ///< the line law: lateral error, heading, distance
  centering  ///< ViSP's (x, log Z/Z*): bearing and distance only
};

struct AcquireConfig {
  double bearing = 0.0087;  ///< rad; the board is centred below this (0.5 degrees)
  int sightings = 10;       ///< fused at standstill
  /// m, of the axle; 2.3 mm of it are what the camera yaw may be wrong by, at 1.35 m.
  double max_sigma_y = 0.010;
  double max_sigma_yaw = 0.0035;                                     ///< rad (0.2 degrees)
  double sweep = 0.35;                                               ///< rad to either side, when nothing is seen
  double sweep_rate = 0.2;                                           ///< rad/s
  std::chrono::nanoseconds unseen = std::chrono::seconds(5);         ///< before a sweep, and again after it
  std::chrono::nanoseconds settle = std::chrono::milliseconds(300);  ///< standing before sightings count
  std::chrono::nanoseconds timeout = std::chrono::seconds(45);
};

struct EntryConfig {
  double run_in = 0.9;          ///< m of straight line before the dock, wanted; more where castors lag much
  double min_run_in = 0.6;      ///< m, at least
  double lateral_left = 0.005;  ///< m; largest lateral error that the line law would leave at the dock
  double max_heading = 0.14;    ///< rad against the line
  /// After a back-off there is no room for another path; both limits count this much looser, since every pass shrinks
  /// the error and the fix decides.
  double retry_share = 3.0;
  /// Where no path keeps the board in view: drive blind to this much before the dock, and back off.
  bool blind_entry = true;
  double blind_run_in = 0.25;  ///< m
  /// The path must keep the board's middle within this of the view's edge [rad].
  double view_margin = 0.07;
};

struct ServoConfig {
  ServoLaw law = ServoLaw::line;
  /// m; where the law would leave more beside the line than this the attempt ends. (The notes end it where the error
  /// has grown by 10 mm, which castors that turn round do for a while.)
  double max_left = 0.03;
  double max_sigma_y = 0.003;                                      ///< m, of the camera point
  double sigma_within = 0.5;                                       ///< m to go from which `max_sigma_y` counts
  double centering_end = 0.002;                                    ///< m from Z* at which the centring law is done
  std::chrono::nanoseconds rest = std::chrono::milliseconds(500);  ///< standing at the goal
  std::chrono::nanoseconds timeout = std::chrono::seconds(40);
};

/// How the sightings of a standstill become one pose. The average is the default: it weighs corners as the filter does
/// that the robot is steered by. The smoothed pose repeats better (0.001 against 0.008 mm), but where the board's
/// survey is wrong it is another one, and the robot comes to rest by that much beside it (sigma y 0.6 instead of 0.3
/// mm).
enum class FixMethod {
  average,  ///< weighted mean of the frames' poses
  smoothed  ///< least squares over the corners of all frames; the average where that is not possible
};

struct FixConfig {
  FixMethod method = FixMethod::average;
  RestSmootherConfig smoother;
  int sightings = 20;
  double tolerance_x = 0.003;     ///< m
  double tolerance_y = 0.003;     ///< m
  double tolerance_yaw = 0.0087;  ///< rad (0.5 degrees)
  /// Success is claimed only if the error and this many standard deviations are within the tolerance.
  double sigmas = 2.0;
  /// What the calibration leaves, 1 sigma, the same in every sighting; averaging does not take it out.
  double calibration_position = 0.0;  ///< m
  double calibration_yaw = 0.0;       ///< rad
  /// What does not cancel against a taught docking pose: an edge's error depends on how it lies on the pixels, and the
  /// robot does not come to rest on the very same. For `average` 0.004 px, which twelve rendered dockings confirmed
  /// (0.037 mm rms in y); for `smoothed` the 0.001 px that stay at a corner where nothing moves
  /// (data/corner_errors/best.yaml) would do.
  double untaught_corner_px = 0.004;
  std::chrono::nanoseconds timeout = std::chrono::seconds(6);
};

struct BackOffConfig {
  int retries = 2;
  double camera_distance = 2.5;  ///< m before the board ...
  double farther = 0.4;  ///< ... and so much more for each attempt that failed, up to where the robot came from [m]
  /// Share of the lateral miss that the next attempt aims against, and its largest value; the line law leaves a
  /// constant offset under a constant disturbance (notes on docking, 5.3), which another attempt alone would repeat.
  double learning = 1.0;
  double max_aim = 0.015;  ///< m
  /// After the last attempt drive back to `camera_distance` before giving up, out of the station's way; otherwise the
  /// robot rests where that attempt ended.
  bool safe_pose = false;
  std::chrono::nanoseconds rest = std::chrono::milliseconds(600);
  std::chrono::nanoseconds timeout = std::chrono::seconds(60);
};

struct UndockConfig {
  double camera_distance = 2.2;  ///< m before the board, where the robot is out of the station
  double near = 0.10;            ///< m from the docking pose that count as docked ...
  double near_yaw = 0.17;        ///< ... and rad
  std::chrono::nanoseconds timeout = std::chrono::seconds(60);
};

/// How the board hangs, seen by a robot that stands at the dock.
struct BoardHang {
  double camera_height = 0.0;  ///< of the lens in the station frame [m]
  double roll = 0.0;           ///< of the robot in the station frame [rad] ...
  double pitch = 0.0;          ///< ... forward end down is positive

  bool operator==(const BoardHang&) const = default;
};

struct HangLimits {
  double height = 0.010;  ///< m; load and tyres lift a robot by some millimetres
  double tilt = 0.0087;   ///< rad (0.5 degrees)
};

/// Straight forward driving that turns reversed castors, where the start leaves room for it.
struct RunInConfig {
  double distance = 1.5;            ///< m
  double min_distance_after = 3.3;  ///< m between camera and board that must remain
  double max_bearing = 0.10;        ///< rad; the board must be straight ahead
  std::chrono::nanoseconds timeout = std::chrono::seconds(30);
};

/// Limits of the path to the entry pose: no straights of its own, since the run-in follows it.
DockingPlanConfig entry_plan();

struct DockingConfig {
  Errand errand = Errand::dock;
  Rig rig = default_rig();          ///< Docker puts its own here
  Board board;                      ///< for FixMethod::smoothed and the planner's view; without tags neither is used
  Pose2 dock_pose{-1.0, 0.0, 0.0};  ///< of the camera point in the station frame
  /// The docking pose was measured by this robot standing there: what calibration and survey leave is in it too, and
  /// cancels. Otherwise those count as uncertainty of the fix.
  bool dock_pose_taught = false;
  Eigen::Matrix3d dock_pose_covariance = Eigen::Matrix3d::Zero();  ///< of that measurement [x y yaw], m and rad
  /// How the board hung then. One that hangs otherwise was moved, and the docking pose with it: no success is claimed.
  std::optional<BoardHang> taught_hang;
  HangLimits hang_limits;
  double board_width = 0.6;  ///< m, board and clearance
  PoseFilterConfig filter;
  CommandGateConfig gate;
  OdometryControllerConfig segments;
  /// Deviations from the path are taken from the filter (odometry and sightings) or from odometry alone, as the paper.
  bool fuse_in_segments = true;
  /// Damping a where deviations come from the filter.
  double fused_damping = 0.08;
  /// The line law's L is at least this many of the robot's heading lag: castors that scrub harder get a softer law.
  /// At twice the scrub 0.7 docked 98.3 % at the first attempt, 0.8 97.3 % (seeds 20001 to 21500), 0.5
  /// 96.8 % and 1.0 94.8 % (seeds 10001 to 10600). The
  /// reported seeds are others.
  double lengths_per_lag = 0.7;
  LineLawConfig line;
  SwingConfig swing;
  SlipConfig slip;
  MarkerCenteringConfig centering;
  AcquireConfig acquire;
  EntryConfig entry;
  ServoConfig servo;
  FixConfig fix;
  BackOffConfig back_off;
  UndockConfig undock;
  RunInConfig run_in;
  std::chrono::nanoseconds pause_timeout = std::chrono::minutes(10);
  /// For plan_docking; its view wish is made from the rig, the board and `entry`.
  DockingPlanConfig plan = entry_plan();
  Planner planner;  ///< instead of plan_docking
};
/// Throws std::invalid_argument with a sentence that names the setting.
void check(const DockingConfig& config);

/// Pose of the axle when docked.
Pose2 goal_of_axle(const DockingConfig& config);

// ---------------------------------------------------------------------------------------------------------- inputs

enum class Request {
  none,
  pause,
  resume,
  cancel,  ///< stop the job, the robot stays where it is
  stop     ///< by a person or the guard: latched
};

/// What one cycle knows.
struct Inputs {
  std::chrono::nanoseconds now{0};
  std::chrono::nanoseconds step{0};      ///< since the cycle before
  Odometry odometry;                     ///< newest, checked
  std::optional<PoseEstimate> estimate;  ///< for now
  std::optional<MarkerView> view;        ///< of the board's middle: newest sighting, carried on by odometry
  std::optional<FilterUpdate> sighting;  ///< of this cycle
  std::optional<RestSighting> rest;      ///< the same with its corners, where it was fused at the dock
  std::optional<Unseen> unseen;          ///< a frame of this cycle that showed no board
  std::optional<std::chrono::nanoseconds> frame_age;     ///< of the newest frame; none before the first
  std::optional<std::chrono::nanoseconds> sighting_age;  ///< of the newest sighting; none before the first
  std::optional<std::chrono::nanoseconds> latency;       ///< least age on arrival of the last frames
  std::chrono::nanoseconds declared_latency{0};          ///< that is expected; ages count from there
  std::string camera_sentence;                           ///< why the camera is lost
  Request request = Request::none;
  Twist2 last_command;  ///< after the gate
};

// ---------------------------------------------------------------------------------------------------------- phases

/// Where the robot stands, averaged over sightings at standstill.
struct Fix {
  Pose2 T_station_base;
  /// Of the camera point and heading against the docking pose, in the station frame: m, m, rad.
  Pose2 error;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  ///< of `error`
  BoardHang hang;
  int sightings = 0;
  double chi2 = 0.0;  ///< scatter of the sightings against their covariance, per value; about 1
};

/// What goes with a job from phase to phase.
struct Job {
  int attempts = 1;                   ///< the running one included
  std::optional<Reason> first_cause;  ///< of the first attempt that failed
  bool ran_in = false;                ///< the castors have had their straight run
  bool turn_allowed = true;           ///< in place; not any more once a path was driven
  double came_from = 0.0;             ///< camera before the board where it was first measured [m]; 0 before
  /// Beside the dock's line (left positive) where the next run aims [m]: what the last one missed by, against what
  /// repeats itself (camera yaw, unequal wheels, a floor that pulls).
  double aim = 0.0;
  bool went_blind = false;          ///< the one path without the board in view was driven
  std::optional<Reason> giving_up;  ///< on the way to the safe pose: why
  std::optional<Fix> last_fix;      ///< of an attempt that was not good enough
};

/// Turn until the board is in the middle, then stand and collect sightings.
struct Acquiring {
  Job job;
  std::chrono::nanoseconds since{0};
  enum class Stage { looking, sweeping, centering, standing } stage = Stage::looking;
  std::chrono::nanoseconds stage_since{0};
  double yaw_at_sweep = 0.0;  ///< odometry yaw where the sweep began
  int sweep_leg = 0;          ///< 0 to the left, 1 to the right, 2 back to the middle; 3 done
  int fused = 0;              ///< sightings, standing
  std::optional<Unseen> last_unseen;
};
/// Straight ahead, so that the castors trail.
struct RunningIn {
  Job job;
  std::chrono::nanoseconds since{0};
  Path path_odom;
  FollowState follow;
};
/// Choose: servo, path, or back off.
struct Validating {
  Job job;
  std::chrono::nanoseconds since{0};
};
/// Drive the path.
struct Following {
  Job job;
  std::chrono::nanoseconds since{0};
  Path path;             ///< of the axle, in the station frame
  Pose2 T_station_odom;  ///< taken once, when the path was planned
  bool blind = false;    ///< the board may leave the view; ends in a back-off
  FollowState follow;
};
/// Drive along the dock's line until the goal.
struct Servoing {
  Job job;
  std::chrono::nanoseconds since{0};
  double travelled = 0.0;  ///< m
  SwingWatch swing;
  bool slow = false;  ///< swinging was seen once
  std::optional<std::chrono::nanoseconds> reached;
};
/// Stand and average sightings.
struct Fixing {
  Job job;
  std::chrono::nanoseconds since{0};
  std::vector<RestSighting> sightings;
};
/// Drive backwards along the dock's line.
struct BackingOff {
  Job job;
  std::chrono::nanoseconds since{0};
  std::optional<std::chrono::nanoseconds> reached;
};
/// Straight back along the dock's line, away from the station.
struct Undocking {
  Job job;
  std::chrono::nanoseconds since{0};
  std::optional<std::chrono::nanoseconds> reached;
};
/// Zero command until resumed.
struct Paused {
  Job job;
  std::chrono::nanoseconds since{0};
  std::string_view from;  ///< name of the phase that was left
};

struct Docked {
  Job job;
  Fix fix;
};
/// Out of the station.
struct Undocked {
  Job job;
};
/// The docking failed; the robot rests.
struct Failed {
  Job job;
  Reason reason;
  std::optional<Fix> fix;  ///< the last one, if there was one
};
/// Stopped for a fault or by a person; latched.
struct Stopped {
  Job job;
  Reason reason;
};

using Phase = std::variant<Acquiring, RunningIn, Validating, Following, Servoing, Fixing, BackingOff, Undocking, Paused,
                           Docked, Undocked, Failed, Stopped>;

std::string_view name(const Phase& phase);
const Job& job_of(const Phase& phase);
/// Docked, Undocked, Failed or Stopped: nothing follows.
bool is_over(const Phase& phase);
/// Failed's or Stopped's.
std::optional<Reason> reason_of(const Phase& phase);
/// What its commands rely on.
FrameNeed frame_need(const Phase& phase);

/// Where a job begins.
Phase first_phase(Errand errand, std::chrono::nanoseconds now);

/// A row of the table of phases: what the program prints and draws, and what the tests hold `step` to.
struct Transition {
  std::string_view from;
  std::string_view to;
  std::string_view word;  ///< why, in a few words
};
std::span<const Transition> transitions();

struct Step {
  Phase next;
  Twist2 command;
  std::string reason;  ///< why the phase changed, with figures; empty if it did not
};

/// One cycle. Pure: the same arguments give the same result to the last bit.
Step step(const Phase& now, const Inputs& inputs, const DockingConfig& config);

/// One pose from the sightings of a standstill (FixConfig::method), with what more of them do not take out.
/// @param T_odom_base  newest odometry: where the robot rests, which may still have rolled when it was seen
/// @return none without sightings
std::optional<Fix> fix_from(std::span<const RestSighting> sightings, const Pose2& T_odom_base,
                            const DockingConfig& config);

/// Way left to the goal, for showing [m].
std::optional<double> distance_to_go(const Phase& phase, const std::optional<PoseEstimate>& estimate,
                                     const DockingConfig& config);

}  // namespace tagdock
