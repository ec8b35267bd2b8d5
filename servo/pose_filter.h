#pragma once

#include <chrono>
#include <deque>
#include <optional>
#include <string_view>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "calibration/rig.h"
#include "detection/tag_pose.h"
#include "planning/pose2.h"
#include "planning/sensor_errors.h"
#include "servo/castors.h"
#include "servo/robot.h"

namespace tagdock {

/// Where the camera stands on the floor, seen from the axle: its place without height, heading of the base.
/// Errors of a docking are those of this point, what an external tracker beside the lens would see.
Pose2 camera_point(const Rig& rig);

/// T_camera_station of a robot that stands level at a planar pose.
Eigen::Isometry3d level_view(const Rig& rig, const Pose2& T_station_base);

/// A sighting brought down to the plane.
struct PlanarSighting {
  std::chrono::nanoseconds time{0};  ///< mid-exposure, since the session began
  Pose2 T_station_base;
  /// [x y yaw] in the station frame, m and rad; from corner noise, independent from frame to frame.
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  /// The same for what stays from frame to frame (corner bias); averaging does not take it out.
  Eigen::Matrix3d bias_covariance = Eigen::Matrix3d::Zero();
  /// What independent errors of 1 px in every corner coordinate would make of it; zero where no tag says its sigma.
  Eigen::Matrix3d covariance_per_px2 = Eigen::Matrix3d::Zero();
  double camera_height = 0.0;                             ///< of the lens above the station's floor [m]
  Eigen::Vector3d up_station = Eigen::Vector3d::UnitZ();  ///< the robot's up direction in the station frame
};

/// Reduces a pose of the camera before the station to the axle's pose on the floor. The camera's own place is taken
/// from the sighting and the axle is put behind it along the heading, so that pitch and roll of the chassis move the
/// axle only by their small effect on the heading.
/// @param covariance  of T_camera_station, as in BoardSighting
/// @param bias_share  variance of the lasting corner error over that of the corner noise
PlanarSighting planar_sighting(const Rig& rig, std::chrono::nanoseconds time, const Eigen::Isometry3d& T_camera_station,
                               const Matrix6& covariance, double bias_share);

struct PoseFilterConfig {
  // Drift of odometry in body axes per square root of the driven distance (notes on docking, 4.6).
  double forward_noise = 0.005;   ///< m per sqrt(m)
  double sideways_noise = 0.003;  ///< m per sqrt(m)
  double yaw_noise = 0.02;        ///< rad per sqrt(m); beside what castors do
  double turn_noise = 0.04;       ///< share of the angle turned between two readings
  CastorConfig castors;
  // What calibration may have left or a knock changed since: first guess 0, and how wrong that may be. 0 leaves one
  // out.
  double pull_sigma = 0.006;         ///< rad/m; turn per driven metre by unequal wheels (0.36 % over a track of 0.6 m)
  double stretch_sigma = 0.003;      ///< driven over measured distance, less 1
  double camera_yaw_sigma = 0.0017;  ///< rad; of the camera on the base, about the vertical (0.1 degrees)
  double gate = 40.0;                ///< largest accepted squared Mahalanobis distance of a sighting, 3 values
  int rejects_until_lost = 5;        ///< in a row
  double doubt = 1.5;                ///< factor on the covariance of the estimate for every reject
  int sightings_to_acquire = 5;      ///< that agree, of the newest `sightings_remembered`, at standstill
  int sightings_remembered = 7;
  /// Two sightings at standstill agree below this squared Mahalanobis distance ...
  double agreement = 25.0;
  double agreement_distance = 0.05;    ///< ... and within this distance [m] ...
  double agreement_yaw = 0.05;         ///< ... and this angle [rad]
  double standstill_distance = 0.002;  ///< odometry may move this much between the sightings that acquire [m]
  double standstill_yaw = 0.0035;      ///< [rad]
  double corner_bias_px = 0.05;        ///< lasting error of a corner coordinate (notes on docking, 8)
  /// Share of a sighting's misfit (chi2 above 1) that is new in every frame; the rest stays. Measured in the simulator
  /// at standstill, 3.85 m: heading scatters by 0.24 mrad where the misfit says 0.80 mrad, so 0.09 of the variance.
  double fresh_share = 0.1;
  /// Odds against the mirrored pose of a flat tag, as a logarithm, above which the question is settled: 1 : 22000.
  double settled_log_odds = 10.0;
  /// What takes the yaw of an unsettled sighting out of the fusion [rad].
  double unsettled_yaw = 0.0873;
  std::size_t readings_remembered = 200;  ///< and fused sightings among them: 2.7 s at 50 Hz and 25 frames a second
  /// How well one frame tells the pose, as measured: a sighting that claims more counts no more than this.
  std::optional<SensorErrors> sensor;
};

/// Where the robot is.
struct PoseEstimate {
  std::chrono::nanoseconds time{0};
  Pose2 T_station_base;
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  ///< [x y yaw] in the station frame, m and rad
  std::chrono::nanoseconds seen{0};                      ///< image time of the newest sighting that was fused
  double castor_scrub = 0.0;                             ///< rad/m; see CastorConfig
  double castor_scrub_sigma = 0.0;
  double held_back = 0.0;  ///< turn that the castors give back when the robot drives straight on [rad]
  // What repeats itself, as far as the drive has shown it: value and standard deviation.
  double pull = 0.0;  ///< rad/m, see PoseFilterConfig
  double pull_sigma = 0.0;
  double stretch = 0.0;
  double stretch_sigma = 0.0;
  double camera_yaw = 0.0;  ///< rad
  double camera_yaw_sigma = 0.0;
};

/// What became of a sighting.
enum class SightingUse {
  fused,              ///< moved the estimate
  fused_without_yaw,  ///< moved the estimate along what is sure; the two poses of a flat tag were not told apart
  rejected,           ///< does not fit the estimate
  lost,               ///< rejected, and that too often: there is no estimate any more
  collected,          ///< there is no estimate yet; kept
  acquired,           ///< agrees with enough others: there is an estimate now
  ambiguous,          ///< there is no estimate yet and the two poses of a flat tag were not told apart
  moving,             ///< there is no estimate yet and the robot does not stand
  too_old,            ///< older than the remembered odometry, or than a sighting that was used already
  invalid             ///< not finite, or no covariance
};
std::string_view word(SightingUse use);

/// What the filter made of a sighting.
struct FilterUpdate {
  SightingUse use = SightingUse::invalid;
  std::optional<PlanarSighting> sighting;  ///< the pose that was fused, collected or rejected
  double distance2 = 0.0;                  ///< squared Mahalanobis distance from the estimate at image time; 0 without
  // In the station frame, of the axle:
  Pose2 innovation;          ///< seen less expected; zero unless fused, rejected or lost
  Pose2 correction;          ///< what the estimate was changed by; zero unless fused
  double castor_turn = 0.0;  ///< rad that the castors are believed to have turned the robot by, either way, so far
};

/// Odometry and sightings -> pose of the axle in the station frame: an extended Kalman filter over x, y, yaw, the
/// castors' scrub, which turns the robot where odometry does not see it, and the lasting errors of wheels and camera
/// yaw. Those show only in motion: unequal wheels as a turn per distance, wrong radii as a distance, a turned camera as
/// a robot that does not drive where it looks.
/// A sighting acts at its image time: the filter goes back to the reading before the stamp, updates there and
/// repeats the odometry since (so latency, once stamped, moves nothing). Method: notes on docking, 4.6 and 8; the
/// tables there shift the measurement forward instead, which neglects the drift since the image.
class PoseFilter {
 public:
  PoseFilter(const Rig& rig, const PoseFilterConfig& config);

  /// Takes the next odometry reading; finite and later than the one before, or it is left out.
  void predict(const Odometry& reading);

  /// Takes a sighting. Needs odometry at or before its image time.
  FilterUpdate update(const BoardSighting& sighting);

  /// The pose at a time, also a past one; after the newest reading it goes on with that reading's velocity.
  /// @return none while there is no estimate, or for times before the remembered odometry
  [[nodiscard]] std::optional<PoseEstimate> estimate(std::chrono::nanoseconds time) const;

  /// Where the camera sees the station at a time: from the estimate, or else from the newest sighting (also one that
  /// was not fused) moved by odometry; none if there is neither.
  [[nodiscard]] std::optional<Eigen::Isometry3d> predicted_view(std::chrono::nanoseconds time) const;

  /// Odometry pose at a time, as `estimate`.
  [[nodiscard]] std::optional<Pose2> T_odom_base(std::chrono::nanoseconds time) const;

  /// Drops the estimate; the next one has to be acquired at standstill.
  void forget();

 private:
  /// [scrub of the castors, pull, stretch, camera yaw]; see PoseFilterConfig.
  using Lasting = Eigen::Vector4d;
  using Matrix7 = Eigen::Matrix<double, 7, 7>;
  struct State {
    Odometry reading;
    CastorAngles castors;
    double castor_turn = 0.0;  ///< rad, either way, all along
    // Only with an estimate:
    Pose2 T_station_base;
    Lasting lasting = Lasting::Zero();
    Matrix7 covariance = Matrix7::Zero();  ///< [x y yaw] and `lasting`
  };
  struct Candidate {
    PlanarSighting sighting;
    Pose2 T_odom_base;
  };

  void no_surer_than_measured(PlanarSighting& sighting) const;
  FilterUpdate acquire(const PlanarSighting& sighting);
  FilterUpdate fuse(const PlanarSighting& sighting, const std::optional<PlanarSighting>& mirrored, double log_odds);
  [[nodiscard]] std::optional<std::size_t> state_before(std::chrono::nanoseconds time) const;
  [[nodiscard]] State state_at(std::size_t before, std::chrono::nanoseconds time) const;
  void propagate_from(std::size_t index);
  /// What a motion by odometry does to the estimated pose.
  struct PoseMotion {
    CastorPush castors;
    // Only with an estimate:
    double cosine = 1.0, sine = 0.0;                 ///< of the chord's heading
    Eigen::Vector2d step = Eigen::Vector2d::Zero();  ///< m, in the station frame
    Pose2 T_station_base;                            ///< after it
  };
  [[nodiscard]] Pose2 motion_until(std::size_t before, std::chrono::nanoseconds time) const;
  [[nodiscard]] PoseMotion pose_motion(const State& before, const Pose2& motion) const;
  [[nodiscard]] State moved_on(const State& before, const Pose2& motion) const;
  /// The pose that a robot seems to have which believes its camera's yaw.
  [[nodiscard]] Pose2 seen_pose(const Pose2& T_station_base, double camera_yaw) const;

  Rig rig_;
  PoseFilterConfig config_;
  std::deque<State> states_;  ///< oldest first
  bool has_estimate_ = false;
  Lasting lasting_;  ///< of the newest estimate, kept where it is lost: the robot and its floor stay
  Lasting lasting_variance_;
  Eigen::Matrix3d bias_covariance_ = Eigen::Matrix3d::Zero();  ///< of the newest fused sighting
  std::chrono::nanoseconds seen_{0};
  int rejects_ = 0;
  std::deque<Candidate> candidates_;
  std::optional<PlanarSighting> last_sighting_;
  std::optional<std::chrono::nanoseconds> last_time_;  ///< image time of the newest sighting that was looked at
};

}  // namespace tagdock
