#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include <Eigen/Geometry>

#include "calibration/board_pose.h"
#include "calibration/camera_model.h"
#include "calibration/rig.h"

namespace tagdock {

/// One standstill of the robot before the board.
struct HandEyeStop {
  int id = 0;
  /// Of all frames taken here, so an id may come more than once; empty: the robot passed without seeing the board.
  std::vector<SeenPoint> corners;
  std::optional<Eigen::Isometry3d> T_tracker_base;    ///< as measured, with a tracker
  std::vector<std::array<double, 2>> wheels_to_next;  ///< wheel angles left, right [rad] of the arcs to the next stop
};

/// A pose known from a survey.
struct SurveyedPose {
  Eigen::Isometry3d T_tracker_board = Eigen::Isometry3d::Identity();
  double sigma_m = 0.001;    ///< of each coordinate
  double sigma_rad = 0.001;  ///< about each axis
};

/// A value measured by hand.
struct Measured {
  double value = 0.0;
  double sigma = 1.0;
};

/// What the robot saw and how it moved: from a tracker beside the camera, or from its wheels.
struct HandEyeProblem {
  CameraModel camera;
  /// Of fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6, as `calibrate_intrinsics` claims it; zero: the camera is taken as exact.
  Eigen::Matrix<double, 12, 12> camera_covariance = Eigen::Matrix<double, 12, 12>::Zero();
  std::vector<HandEyeStop> stops;  ///< in the order driven
  bool by_wheels = false;
  double tracker_sigma_m = 0.001;
  double tracker_sigma_rad = 0.001;
  std::optional<SurveyedPose> board;
  OdometryModel nominal;  ///< wheels as in the drawing
  double wheel_noise_rad_per_sqrt_rad = 0.002;
  double wheel_noise_floor_rad = 0.0005;
  std::optional<Measured> camera_height;  ///< above the base's origin, by tape [m]
  /// Use no view of a single tag from within 25 degrees of its normal, as the paper; else only start values do without.
  bool leave_out_frontal = false;
};

/// A direction that the drive does not determine: the word of CONTRACTS.md and what would cure it.
struct Unobservable {
  std::string word;  ///< height, roll, pitch, yaw, tx, ty, track, r_left, r_right, odometry_scale
  std::string cure;
};

/// The camera on the base by ViSP's AX = XB, to compare with.
struct VispHandEye {
  bool solved = false;
  Eigen::Isometry3d T_base_camera = Eigen::Isometry3d::Identity();
};

/// What one stop leaves.
struct StopResidual {
  int id = 0;
  double corner_rms_px = 0.0;
  double base_mm = 0.0;  ///< tracker or wheels against the solution
  double base_deg = 0.0;
  double bearing_deg = 0.0;  ///< between the board's normal and the line of sight
  double distance = 0.0;     ///< m
  bool used = true;
  bool frontal = false;  ///< within the cone in which a single tag's pose is not trusted
  std::string reason;    ///< why it was not used
  int corners = 0;
  int corners_set_aside = 0;
  Eigen::Isometry3d T_board_camera = Eigen::Isometry3d::Identity();  ///< by the solution
};

struct HandEyeResult {
  Eigen::Isometry3d T_base_camera = Eigen::Isometry3d::Identity();
  Eigen::Isometry3d T_reference_board = Eigen::Isometry3d::Identity();  ///< in the tracker's or the first stop's frame
  OdometryModel odometry;                                               ///< with wheels
  /// [x y z roll pitch yaw (r_left r_right track)] of T_base_camera: translation, and turns about the base's axes on
  /// the left; m, rad. Wheels only with wheels.
  Eigen::MatrixXd covariance;
  double xy_sigma = 0.0;               ///< per axis, m
  double z_sigma = 0.0;                ///< m
  double rotation_sigma = 0.0;         ///< of the whole angle, rad
  double camera_xy_sigma = 0.0;        ///< what of xy_sigma the camera's own uncertainty makes, m
  double camera_rotation_sigma = 0.0;  ///< and of rotation_sigma, rad
  double chi2_per_residual = 0.0;      ///< over the redundancy, after the noise was scaled
  double corner_scale = 1.0;           ///< measured corner noise over that stated
  double motion_scale = 1.0;           ///< measured tracker or wheel noise over that stated
  double floor_tilt_sigma = 0.0;       ///< of the base on the floor, estimated [rad]; wheels only
  std::vector<Unobservable> unobservable;
  std::vector<double> direction_ratios;      ///< posterior over prior of the nine or six directions, ascending
  std::vector<std::string> direction_words;  ///< of each of them: what it is made of most
  std::vector<StopResidual> stops;
  VispHandEye visp;
  double heading_spread = 0.0;          ///< largest difference of headings between stops [rad]
  double travel = 0.0;                  ///< largest distance between stops [m]
  std::vector<std::string> complaints;  ///< why the result is refused; empty if it is good
};

/// The camera's pose on the base, jointly with the board's pose, the stops and (with wheels) radii and track, from all
/// corner pixels at once. Solved by Ceres from start values of a closed form for planar motion and of ViSP's
/// vpHandEyeCalibration. Directions that the drive does not determine are found from the eigenvalues of the
/// information, whitened by weak priors (1 m, 30 degrees, 5 %): notes on calibration, sections 3 and 4. Throws
/// std::invalid_argument when there are fewer than three stops that see the board.
HandEyeResult calibrate_hand_eye(const HandEyeProblem& problem);

}  // namespace tagdock
