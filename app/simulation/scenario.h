#pragma once

#include <array>
#include <filesystem>
#include <string>
#include <vector>

#include "app/simulation/renderer.h"
#include "planning/pose2.h"

namespace tagdock {

/// Where a run begins. The camera stands at a range and bearing from the board's centre, and the robot's heading is the
/// bearing (it looks at the board) plus a deviation. Each of the three is its mean plus sigma times a normal number
/// plus spread times an even one of -1..1.
struct StartScenario {
  double range = 3.85;                   ///< m, from the board's centre to the camera point
  double range_sigma = 0.01;             ///< m
  double bearing = 0.0;                  ///< rad; positive starts right of the axis, as seen when facing the wall
  double bearing_sigma = radians(0.4);   ///< rad
  double bearing_spread = radians(5.0);  ///< rad
  double heading = 0.0;                  ///< rad; mean deviation from looking at the board
  double heading_sigma = radians(0.3);   ///< rad
  double heading_spread = radians(2.0);  ///< rad
  double castor_angle = 0.0;             ///< rad; 0 trails in forward travel, 3.1 is reversed
  double castor_sigma = 0.02;            ///< rad

  bool operator==(const StartScenario&) const = default;
};

/// The drive and the floor, notes/docking.md sections 4.2 to 4.4 and 4.8: dead time, lag and limits; castors that scrub
/// while they swivel and push the robot aside; over-turn of the drive wheels; random fields along the travelled way.
struct DriveScenario {
  double dead_time = 0.060;           ///< s, from command to drive
  double lag = 0.120;                 ///< s, first order
  double acceleration = 0.3;          ///< m/s^2, largest
  double angular_acceleration = 0.6;  ///< rad/s^2, largest
  double command_timeout = 0.2;       ///< s; without a newer command the drive stops
  /// m/s^2 of a wheel, when a moving drive has heard nothing for its time-out: then it stops by itself, without dead
  /// time and lag. A guess, in want of a drive's data sheet: half of what the drive wheels hold on the floor (load
  /// share times friction times g is 4.1 m/s^2).
  double stop_deceleration = 2.0;
  double dead_band = 0.0;  ///< m/s at a wheel; a slower command does not move it

  double mass = 710.0;             ///< kg
  double drive_load_share = 0.60;  ///< of the weight on the two drive wheels, the rest on the four castors
  double track = 0.60;             ///< m
  double castor_ahead = 0.45;      ///< m, pivots before and behind the axle
  double castor_aside = 0.25;      ///< m, pivots left and right of the middle
  double castor_trail = 0.05;      ///< m
  double scrub_radius = 0.040;     ///< m, lever of the friction under a castor
  double scrub_factor = 1.0;       ///< on every scrub moment
  double friction = 0.7;           ///< castor on floor, mean
  double friction_cap = 1.2;
  double creepage = 1.5;          ///< 1/m, spin at which the scrub is at tanh(1) of its limit
  double creep_stiffness = 5.47;  ///< 1/rad, force by load of the drive wheels

  double over_turn = 0.0028;  ///< relative, mean
  double over_turn_field_sigma = 0.0155;
  double field_length = 0.54;              ///< m, of the fields along the way
  double over_turn_exponent = 1.69;        ///< of the curvature in 1/m
  double floor_coupling = 0.05;            ///< over-turn lost per unit of ln friction
  double friction_run_sigma = 0.456;       ///< of ln friction, one number a run: how clean the floor is
  double friction_castor_sigma = 0.05;     ///< one number a run and castor
  double friction_field_sigma = 0.05;      ///< along the way
  double turn_scale_sigma = 0.001;         ///< relative, one number a run: what odometry calibration leaves
  double speed_scale_sigma = 0.0005;       ///< the same for straight travel
  double wheel_difference_sigma = 0.0002;  ///< relative difference of the wheel diameters
  double yaw_walk = 0.001;                 ///< rad per sqrt(m)
  double left_radius_error = 0.0;          ///< relative; the robot does not know of it
  double right_radius_error = 0.0;

  double patch_length = 0.0;      ///< m of every patch_period along the station's x; 0 is a floor without patches
  double patch_period = 0.8;      ///< m
  double patch_friction = 1.7;    ///< factor on castor friction on a patch
  double patch_over_turn = 0.02;  ///< added with the axle on a patch
  // Oil on the right wheel's way, between these distances before the wall:
  double slick_from = 0.0;  ///< m
  double slick_to = 0.0;    ///< m, the nearer end
  double slick_slip = 0.0;  ///< share of the wheel's way that is lost there

  bool operator==(const DriveScenario&) const = default;
};

struct CameraScenario {
  double frame_rate = 25.0;       ///< 1/s
  double exposure = 0.005;        ///< s
  double latency = 0.080;         ///< s, from mid-exposure to arrival
  double latency_jitter = 0.003;  ///< s, half-width of an even distribution
  double loss = 0.0;              ///< probability that a frame never arrives
  Sensor sensor;

  bool operator==(const CameraScenario&) const = default;
};

/// How the chassis shakes, drawn anew for every frame.
struct ChassisScenario {
  double pitch_sigma = radians(0.10);  ///< rad
  double roll_sigma = radians(0.05);   ///< rad
  double height_sigma = 0.001;         ///< m

  bool operator==(const ChassisScenario&) const = default;
};

/// What differs between the instruments as calibrated (the rig and board files) and as they are; sigmas are drawn once
/// a run. Wheels have theirs in DriveScenario.
struct ResidualScenario {
  double camera_place_sigma = 0.001;          ///< m, each axis
  double camera_angle_sigma = radians(0.03);  ///< rad, each axis
  double focal_length_sigma = 0.0003;         ///< relative
  double principal_point_sigma_px = 0.3;
  double tag_place_sigma = 0.0002;         ///< m, each axis and tag
  double tag_angle_sigma = radians(0.05);  ///< rad, each axis and tag
  double camera_bump = 0.0;                ///< rad about the vertical: somebody touched the camera afterwards

  bool operator==(const ResidualScenario&) const = default;
};

/// Dirt on a tag, in the tag's coordinates.
struct Dirt {
  int tag = 0;
  double x = 0.0, y = 0.0;             ///< m from the tag's centre, right and down
  double width = 0.03, height = 0.03;  ///< m
  double angle = 0.0;                  ///< rad
  double reflectance = 0.3;

  bool operator==(const Dirt&) const = default;
};

struct StationScenario {
  Pose2 moved;        ///< of the dock with its board, since teach-in
  double sunk = 0.0;  ///< m, the board alone, since teach-in ...
  double lean = 0.0;  ///< ... and turned about the foot of the wall, its top towards the robot [rad]
  std::vector<Dirt> dirt;
  double lamp_strength = Lamp{}.strength;
  double ambient = Lamp{}.ambient;
  double light_change = 1.0;        ///< factor on all light once the camera has been nearer than light_change_range
  double light_change_range = 0.0;  ///< m, camera before the board; 0 never

  bool operator==(const StationScenario&) const = default;
};

/// What breaks on the way in, once the camera is nearer to the board than a range plus spread times an even number of
/// -1..1; range 0 is never. Nothing comes back.
struct FaultScenario {
  double frames_stop_range = 0.0;     ///< m; no frame is exposed any more
  double odometry_stops_range = 0.0;  ///< m; no reading comes any more, commands still arrive
  double link_silent_range = 0.0;     ///< m; no reading comes, no command arrives
  double range_spread = 0.0;          ///< m

  bool operator==(const FaultScenario&) const = default;
};

/// Everything that the world does to a robot. The robot never reads it.
struct Scenario {
  std::string name = "default";
  StartScenario start;
  DriveScenario drive;
  CameraScenario camera;
  ChassisScenario chassis;
  ResidualScenario residuals;
  StationScenario station;
  FaultScenario faults;

  bool operator==(const Scenario&) const = default;
};

/// Reads a scenario file (data/scenarios/*.yaml). Every key must be there, unless the file names another one in
/// `based_on` (beside it), whose values it then changes. Throws Failure(usage) that names file, line and key for
/// anything unknown, missing, not finite or outside of what can be.
Scenario read_scenario(const std::filesystem::path& file);

}  // namespace tagdock
