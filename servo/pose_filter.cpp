#include "servo/pose_filter.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/LU>

namespace tagdock {
namespace {

using Clock = std::chrono::nanoseconds;

double seconds(Clock time) { return std::chrono::duration<double>(time).count(); }

Eigen::Vector3d difference(const Pose2& a, const Pose2& b) { return {a.x - b.x, a.y - b.y, wrap_angle(a.yaw - b.yaw)}; }

Pose2 pose_of(const Eigen::Vector3d& values) { return {values.x(), values.y(), values.z()}; }

// Motion at constant velocity.
Pose2 moved(const Pose2& start, const Twist2& velocity, double time) {
  const double turn = velocity.angular * time;
  const double distance = velocity.linear * time;
  return start * Pose2{distance * std::cos(0.5 * turn), distance * std::sin(0.5 * turn), turn};
}

// The part of a motion that is done after a share of its time, along an arc.
Pose2 share_of(const Pose2& motion, double share) {
  const double turn = share * motion.yaw;
  const double half = 0.5 * motion.yaw;
  // The chord of the arc points along half the turn; its length shrinks with the angle by sin(share half)/sin(half).
  const double ratio = std::abs(half) < 1e-6 ? share : std::sin(share * half) / std::sin(half);
  const double c = std::cos(share * half - half);
  const double s = std::sin(share * half - half);
  return {ratio * (c * motion.x - s * motion.y), ratio * (s * motion.x + c * motion.y), turn};
}

// Drift of odometry over one motion, in the body axes of its middle (notes on docking, 4.6).
Eigen::Matrix3d drift(const Pose2& motion, double heading, const PoseFilterConfig& config) {
  const double distance = std::hypot(motion.x, motion.y);
  const double forward = config.forward_noise * config.forward_noise * distance;
  const double sideways = config.sideways_noise * config.sideways_noise * distance;
  const double turned = config.turn_noise * motion.yaw;
  const double c = std::cos(heading + 0.5 * motion.yaw);
  const double s = std::sin(heading + 0.5 * motion.yaw);
  Eigen::Matrix3d noise = Eigen::Matrix3d::Zero();
  noise(0, 0) = c * c * forward + s * s * sideways;
  noise(1, 1) = s * s * forward + c * c * sideways;
  noise(0, 1) = noise(1, 0) = c * s * (forward - sideways);
  noise(2, 2) = config.yaw_noise * config.yaw_noise * distance + 2.0 * turned * turned;
  return noise;
}

// Takes the heading out of a sighting: a turn about the station's origin, which leaves bearing and distance.
Eigen::Matrix3d without_yaw(const PlanarSighting& sighting, double sigma) {
  const Eigen::Vector3d turn(-sighting.T_station_base.y, sighting.T_station_base.x, 1.0);
  return sighting.covariance + sigma * sigma * turn * turn.transpose();
}

double distance2(const Eigen::Vector3d& error, const Eigen::Matrix3d& covariance) {
  return error.dot(covariance.ldlt().solve(error));
}

bool is_usable(const Eigen::Matrix3d& covariance) {
  return covariance.allFinite() && covariance.diagonal().minCoeff() > 0.0 &&
         covariance.ldlt().vectorD().minCoeff() > 0.0;
}

// How the seen pose changes with the state: one to one with the pose, and a turned camera turns it about the camera.
Eigen::Matrix<double, 3, 7> seen_by_state(const Pose2& seen, const Pose2& ahead) {
  Eigen::Matrix<double, 3, 7> result = Eigen::Matrix<double, 3, 7>::Zero();
  result.leftCols<3>().setIdentity();
  const double c = std::cos(seen.yaw);
  const double s = std::sin(seen.yaw);
  result.col(6) << s * ahead.x + c * ahead.y, -c * ahead.x + s * ahead.y, 1.0;
  return result;
}

// Mean square of the corners' standard deviations [px^2]; 0 without tags.
double corner_variance(const BoardSighting& sighting) {
  double sum = 0.0;
  for (const RefinedTag& tag : sighting.tags) sum += tag.covariance_px2.trace() / 8.0;
  return sighting.tags.empty() ? 0.0 : sum / static_cast<double>(sighting.tags.size());
}

}  // namespace

Pose2 camera_point(const Rig& rig) {
  return {rig.T_base_camera.translation().x(), rig.T_base_camera.translation().y(), 0.0};
}

Eigen::Isometry3d level_view(const Rig& rig, const Pose2& T_station_base) {
  Eigen::Isometry3d T_station_base_3d = Eigen::Isometry3d::Identity();
  T_station_base_3d.translation() << T_station_base.x, T_station_base.y, 0.0;
  T_station_base_3d.linear() = Eigen::AngleAxisd(T_station_base.yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  return (T_station_base_3d * rig.T_base_camera).inverse();
}

PlanarSighting planar_sighting(const Rig& rig, std::chrono::nanoseconds time, const Eigen::Isometry3d& T_camera_station,
                               const Matrix6& covariance, double bias_share) {
  const Eigen::Isometry3d T_station_camera = T_camera_station.inverse();
  const Eigen::Matrix3d R_station_camera = T_station_camera.linear();
  const Eigen::Vector3d forward_camera = rig.T_base_camera.linear().transpose() * Eigen::Vector3d::UnitX();
  const Eigen::Vector3d forward_station = R_station_camera * forward_camera;
  const Eigen::Vector3d camera_station = T_station_camera.translation();
  const double level2 = forward_station.head<2>().squaredNorm();

  const Pose2 ahead = camera_point(rig);
  const double yaw = std::atan2(forward_station.y(), forward_station.x());
  PlanarSighting sighting;
  sighting.time = time;
  sighting.T_station_base = Pose2{camera_station.x(), camera_station.y(), yaw} * inverse(ahead);

  // A small motion [rho theta] on the left of T_camera_station moves the camera by -R rho and turns its forward
  // direction b to R (b + b x theta).
  Eigen::Matrix<double, 3, 3> forward_by_turn;
  forward_by_turn << 0.0, -forward_camera.z(), forward_camera.y(),  //
      forward_camera.z(), 0.0, -forward_camera.x(),                 //
      -forward_camera.y(), forward_camera.x(), 0.0;
  forward_by_turn = R_station_camera * forward_by_turn;
  Eigen::Matrix<double, 3, 6> camera_by_motion = Eigen::Matrix<double, 3, 6>::Zero();
  camera_by_motion.topLeftCorner<2, 3>() = -R_station_camera.topRows<2>();
  camera_by_motion.bottomRightCorner<1, 3>() =
      (forward_station.x() * forward_by_turn.row(1) - forward_station.y() * forward_by_turn.row(0)) / level2;
  Eigen::Matrix3d base_by_camera = Eigen::Matrix3d::Identity();
  base_by_camera(0, 2) = std::sin(yaw) * ahead.x + std::cos(yaw) * ahead.y;
  base_by_camera(1, 2) = -std::cos(yaw) * ahead.x + std::sin(yaw) * ahead.y;
  const Eigen::Matrix<double, 3, 6> by_motion = base_by_camera * camera_by_motion;
  sighting.covariance = by_motion * covariance * by_motion.transpose();
  sighting.covariance = 0.5 * (sighting.covariance + sighting.covariance.transpose()).eval();
  sighting.bias_covariance = bias_share * sighting.covariance;
  sighting.camera_height = camera_station.z();
  sighting.up_station = R_station_camera * (rig.T_base_camera.linear().transpose() * Eigen::Vector3d::UnitZ());
  return sighting;
}

std::string_view word(SightingUse use) {
  switch (use) {
    case SightingUse::fused:
      return "fused";
    case SightingUse::fused_without_yaw:
      return "fused without yaw";
    case SightingUse::rejected:
      return "rejected";
    case SightingUse::lost:
      return "lost";
    case SightingUse::collected:
      return "collected";
    case SightingUse::acquired:
      return "acquired";
    case SightingUse::ambiguous:
      return "ambiguous";
    case SightingUse::moving:
      return "moving";
    case SightingUse::too_old:
      return "too old";
    case SightingUse::invalid:
      return "invalid";
  }
  return "unknown";
}

PoseFilter::PoseFilter(const Rig& rig, const PoseFilterConfig& config)
    : rig_(rig),
      config_(config),
      lasting_(config.castors.scrub, 0.0, 0.0, 0.0),
      lasting_variance_(
          Lasting(config.castors.scrub_sigma, config.pull_sigma, config.stretch_sigma, config.camera_yaw_sigma)
              .cwiseAbs2()) {}

void PoseFilter::predict(const Odometry& reading) {
  if (!is_finite(reading.T_odom_base) || !is_finite(reading.velocity)) return;
  if (!states_.empty() && reading.time <= states_.back().reading.time) return;
  State newest;
  newest.reading = reading;
  states_.push_back(newest);
  if (states_.size() > 1) propagate_from(states_.size() - 2);
  while (states_.size() > config_.readings_remembered) states_.pop_front();
}

PoseFilter::PoseMotion PoseFilter::pose_motion(const State& before, const Pose2& motion) const {
  PoseMotion result;
  result.castors = push(before.castors, motion, rig_.odometry.track, config_.castors);
  if (!has_estimate_) return result;
  // What odometry does not see bends the chord by half of it.
  const double scrub = before.lasting(0);
  const double pull = before.lasting(1);
  const double ahead = (1.0 + before.lasting(2)) * motion.x;
  const double turned = scrub * result.castors.around + pull * motion.x;
  const double heading = before.T_station_base.yaw + 0.5 * turned;
  result.cosine = std::cos(heading);
  result.sine = std::sin(heading);
  const double aside = motion.y + scrub * result.castors.aside;
  result.step = {result.cosine * ahead - result.sine * aside, result.sine * ahead + result.cosine * aside};
  result.T_station_base = {before.T_station_base.x + result.step.x(), before.T_station_base.y + result.step.y(),
                           wrap_angle(before.T_station_base.yaw + motion.yaw + turned)};
  return result;
}

PoseFilter::State PoseFilter::moved_on(const State& before, const Pose2& motion) const {
  State after = before;
  after.reading.T_odom_base = before.reading.T_odom_base * motion;
  const PoseMotion moved = pose_motion(before, motion);
  const CastorPush& castors = moved.castors;
  after.castors = castors.after;
  after.castor_turn += std::abs(before.lasting(0) * castors.around);
  if (!has_estimate_) return after;
  after.T_station_base = moved.T_station_base;

  // Only the pose moves: the lasting values and their covariance stay as they are. How it does, by heading and the
  // lasting values; x by x, y by y and yaw by yaw are one, the rest is zero.
  const double c = moved.cosine;
  const double s = moved.sine;
  Eigen::Matrix<double, 3, 4> by_state;  // columns: yaw, scrub, pull, stretch
  const Eigen::Vector2d by_heading(-moved.step.y(), moved.step.x());
  by_state.block<2, 1>(0, 0) = by_heading;
  by_state.block<2, 1>(0, 1) = 0.5 * castors.around * by_heading + castors.aside * Eigen::Vector2d(-s, c);
  by_state.block<2, 1>(0, 2) = 0.5 * motion.x * by_heading;
  by_state.block<2, 1>(0, 3) = motion.x * Eigen::Vector2d(c, s);
  by_state.row(2) << 1.0, castors.around, motion.x, 0.0;
  // Rows of products in the order in which Eigen sums them, so that replays of older sessions stay bit-equal.
  const auto in_turn = [&](int row, double own, double yaw, double of_scrub, double of_pull, double of_stretch) {
    return own + by_state(row, 0) * yaw + by_state(row, 1) * of_scrub + by_state(row, 2) * of_pull +
           by_state(row, 3) * of_stretch;
  };
  const auto in_pairs = [&](int row, double own, double yaw, double of_scrub, double of_pull, double of_stretch) {
    return (own + by_state(row, 0) * yaw) +
           ((by_state(row, 1) * of_scrub + by_state(row, 2) * of_pull) + by_state(row, 3) * of_stretch);
  };
  const Matrix7& old = before.covariance;
  Eigen::Matrix<double, 3, 7> by_pose;  // covariance of the moved pose with the state before
  for (int k = 0; k < 7; ++k) {
    for (int row = 0; row < 2; ++row)
      by_pose(row, k) = in_turn(row, old(row, k), old(2, k), old(3, k), old(4, k), old(5, k));
    by_pose(2, k) = in_pairs(2, 0.0, old(2, k), old(3, k), old(4, k), old(5, k));
  }
  Eigen::Matrix3d of_pose;
  for (int i = 0; i < 3; ++i) {
    const auto row_of = [&](int row, double own) {
      return i < 2 ? in_turn(row, own, by_pose(i, 2), by_pose(i, 3), by_pose(i, 4), by_pose(i, 5))
                   : in_pairs(row, own, by_pose(i, 2), by_pose(i, 3), by_pose(i, 4), by_pose(i, 5));
    };
    of_pose.row(i) << row_of(0, by_pose(i, 0)), row_of(1, by_pose(i, 1)), row_of(2, 0.0);
  }
  after.covariance.topLeftCorner<3, 3>() = 0.5 * (of_pose + of_pose.transpose());
  after.covariance.topRightCorner<3, 4>() = by_pose.rightCols<4>();
  after.covariance.bottomLeftCorner<4, 3>() = by_pose.rightCols<4>().transpose();
  after.covariance.topLeftCorner<3, 3>() += drift(motion, before.T_station_base.yaw, config_);
  after.covariance(3, 3) +=
      config_.castors.scrub_wander * config_.castors.scrub_wander * std::hypot(motion.x, motion.y);
  return after;
}

Pose2 PoseFilter::seen_pose(const Pose2& T_station_base, double camera_yaw) const {
  const Pose2 ahead = camera_point(rig_);
  const Pose2 camera = T_station_base * ahead;
  return Pose2{camera.x, camera.y, wrap_angle(camera.yaw + camera_yaw)} * inverse(ahead);
}

void PoseFilter::propagate_from(std::size_t index) {
  for (std::size_t i = index; i + 1 < states_.size(); ++i) {
    const Odometry reading = states_[i + 1].reading;
    states_[i + 1] = moved_on(states_[i], between(states_[i].reading.T_odom_base, reading.T_odom_base));
    states_[i + 1].reading = reading;
  }
}

std::optional<std::size_t> PoseFilter::state_before(std::chrono::nanoseconds time) const {
  const auto after = std::upper_bound(states_.begin(), states_.end(), time,
                                      [](Clock value, const State& state) { return value < state.reading.time; });
  if (after == states_.begin()) return std::nullopt;
  return static_cast<std::size_t>(after - states_.begin()) - 1;
}

Pose2 PoseFilter::motion_until(std::size_t before, std::chrono::nanoseconds time) const {
  const State& state = states_[before];
  if (before + 1 >= states_.size()) return moved({}, state.reading.velocity, seconds(time - state.reading.time));
  const State& next = states_[before + 1];
  const double share = seconds(time - state.reading.time) / seconds(next.reading.time - state.reading.time);
  return share_of(between(state.reading.T_odom_base, next.reading.T_odom_base), share);
}

PoseFilter::State PoseFilter::state_at(std::size_t before, std::chrono::nanoseconds time) const {
  State result = moved_on(states_[before], motion_until(before, time));
  result.reading.time = time;
  return result;
}

FilterUpdate PoseFilter::update(const BoardSighting& seen) {
  if (!seen.T_camera_station.matrix().allFinite() || !seen.covariance.allFinite() || std::isnan(seen.log_odds)) {
    return {SightingUse::invalid, std::nullopt, 0.0, {}, {}, 0.0};
  }
  // The sighting's covariance is already as wide as its misfit. Most of a misfit is the same in every frame (survey of
  // the board, lens model), so averaging must not take it out; only a share of it is new each time.
  const double inflated = std::max(1.0, seen.chi2_per_coordinate);
  const Matrix6 by_noise = seen.covariance / inflated;
  const double fresh = 1.0 + config_.fresh_share * (inflated - 1.0);
  const double variance = corner_variance(seen);
  const double declared = variance > 0.0 ? config_.corner_bias_px * config_.corner_bias_px / variance : 0.0;
  const double bias_share = std::max(declared, inflated - 1.0) / fresh;
  const Matrix6 covariance = fresh * by_noise;
  PlanarSighting sighting = planar_sighting(rig_, seen.time, seen.T_camera_station, covariance, bias_share);
  if (variance > 0.0) sighting.covariance_per_px2 = sighting.covariance / (fresh * variance);
  if (!is_finite(sighting.T_station_base) || !is_usable(sighting.covariance)) {
    return {SightingUse::invalid, std::nullopt, 0.0, {}, {}, 0.0};
  }
  no_surer_than_measured(sighting);
  if (!state_before(seen.time) || (last_time_ && seen.time <= *last_time_))
    return {SightingUse::too_old, sighting, 0.0, {}, {}, 0.0};
  last_time_ = seen.time;
  last_sighting_ = sighting;

  std::optional<PlanarSighting> mirrored;
  if (seen.T_camera_station_mirrored && seen.log_odds < config_.settled_log_odds) {
    mirrored = planar_sighting(rig_, seen.time, *seen.T_camera_station_mirrored, covariance, bias_share);
    if (!is_finite(mirrored->T_station_base) || !is_usable(mirrored->covariance)) mirrored.reset();
  }
  if (has_estimate_) return fuse(sighting, mirrored, seen.log_odds);
  if (mirrored) return {SightingUse::ambiguous, sighting, 0.0, {}, {}, 0.0};
  return acquire(sighting);
}

void PoseFilter::no_surer_than_measured(PlanarSighting& sighting) const {
  if (!config_.sensor) return;
  const Pose2 ahead = camera_point(rig_);
  const Pose2 lens = sighting.T_station_base * ahead;
  const std::optional<Eigen::Matrix3d> measured =
      lens_covariance(*config_.sensor, lens, 0.5 * horizontal_view(rig_.camera));
  if (!measured) return;
  Eigen::Matrix3d lens_by_base = Eigen::Matrix3d::Identity();
  lens_by_base(0, 2) = -(lens.y - sighting.T_station_base.y);
  lens_by_base(1, 2) = lens.x - sighting.T_station_base.x;
  const Eigen::Matrix3d claimed =
      lens_by_base * (sighting.covariance + sighting.bias_covariance) * lens_by_base.transpose();
  const Eigen::Vector3d missing = (measured->diagonal() - claimed.diagonal()).cwiseMax(0.0);
  const Eigen::Matrix3d base_by_lens = lens_by_base.inverse();
  // It is not known to be new in every frame; so it is taken to stay.
  sighting.bias_covariance += base_by_lens * missing.asDiagonal() * base_by_lens.transpose();
}

FilterUpdate PoseFilter::acquire(const PlanarSighting& sighting) {
  const std::size_t before = *state_before(sighting.time);
  const Pose2 T_odom_base = states_[before].reading.T_odom_base * motion_until(before, sighting.time);
  const auto stood = [&](const Pose2& other) {
    const Pose2 motion = between(other, T_odom_base);
    return std::hypot(motion.x, motion.y) < config_.standstill_distance &&
           std::abs(motion.yaw) < config_.standstill_yaw;
  };
  if (!candidates_.empty() && !stood(candidates_.back().T_odom_base)) {
    candidates_.clear();
    candidates_.push_back({sighting, T_odom_base});
    return {SightingUse::moving, sighting, 0.0, {}, {}, 0.0};
  }
  candidates_.push_back({sighting, T_odom_base});
  while (candidates_.size() > static_cast<std::size_t>(config_.sightings_remembered)) candidates_.pop_front();

  std::vector<const PlanarSighting*> agreeing;
  for (const Candidate& candidate : candidates_) {
    const Eigen::Vector3d error = difference(candidate.sighting.T_station_base, sighting.T_station_base);
    if (stood(candidate.T_odom_base) && error.head<2>().norm() < config_.agreement_distance &&
        std::abs(error.z()) < config_.agreement_yaw &&
        distance2(error, candidate.sighting.covariance + sighting.covariance) < config_.agreement) {
      agreeing.push_back(&candidate.sighting);
    }
  }
  if (agreeing.size() < static_cast<std::size_t>(config_.sightings_to_acquire)) {
    return {SightingUse::collected, sighting, 0.0, {}, {}, 0.0};
  }

  // Weighted by information, about the newest one.
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  Eigen::Vector3d weighted = Eigen::Vector3d::Zero();
  for (const PlanarSighting* agreed : agreeing) {
    const Eigen::Matrix3d inverse_covariance = agreed->covariance.inverse();
    information += inverse_covariance;
    weighted += inverse_covariance * difference(agreed->T_station_base, sighting.T_station_base);
  }
  const Eigen::Vector3d mean = information.ldlt().solve(weighted);
  State& state = states_[before];
  const Pose2 now{sighting.T_station_base.x + mean.x(), sighting.T_station_base.y + mean.y(),
                  sighting.T_station_base.yaw + mean.z()};
  // What was seen is the pose with the camera's yaw in it.
  const Pose2 ahead = camera_point(rig_);
  const Pose2 camera = now * ahead;
  const Pose2 true_now = Pose2{camera.x, camera.y, camera.yaw - lasting_(3)} * inverse(ahead);
  state.T_station_base = true_now * between(T_odom_base, state.reading.T_odom_base);
  state.lasting = lasting_;
  const Eigen::Matrix3d noise = information.inverse();
  state.covariance.setZero();
  state.covariance.diagonal().tail<4>() = lasting_variance_;
  // seen = pose + column * camera yaw, so pose = seen - column * camera yaw.
  const Eigen::Vector3d column = seen_by_state(now, ahead).col(6);
  state.covariance.topLeftCorner<3, 3>() = noise + lasting_variance_(3) * column * column.transpose();
  state.covariance.block<3, 1>(0, 6) = -lasting_variance_(3) * column;
  state.covariance.block<1, 3>(6, 0) = -lasting_variance_(3) * column.transpose();
  has_estimate_ = true;
  // Older readings are not described by the new estimate.
  states_.erase(states_.begin(), states_.begin() + static_cast<std::ptrdiff_t>(before));
  propagate_from(0);
  bias_covariance_ = sighting.bias_covariance;
  seen_ = sighting.time;
  rejects_ = 0;
  candidates_.clear();
  return {SightingUse::acquired, sighting, 0.0, {}, {}, 0.0};
}

FilterUpdate PoseFilter::fuse(const PlanarSighting& first, const std::optional<PlanarSighting>& mirrored,
                              double log_odds) {
  const std::size_t before = *state_before(first.time);
  const State prior = state_at(before, first.time);
  const Pose2 expected = seen_pose(prior.T_station_base, prior.lasting(3));
  const Eigen::Matrix<double, 3, 7> by_state = seen_by_state(expected, camera_point(rig_));
  const Eigen::Matrix<double, 7, 3> by_seen = prior.covariance * by_state.transpose();
  const Eigen::Matrix3d spread = by_state * by_seen;
  const auto to_estimate = [&](const PlanarSighting& sighting, const Eigen::Matrix3d& covariance) {
    return distance2(difference(sighting.T_station_base, expected), spread + covariance + sighting.bias_covariance);
  };

  PlanarSighting sighting = first;
  bool settled = true;
  if (mirrored) {
    // What the prediction says of the two poses is added to what the image says.
    const double odds =
        log_odds + 0.5 * (to_estimate(*mirrored, mirrored->covariance) - to_estimate(first, first.covariance));
    if (odds < 0.0) sighting = *mirrored;
    settled = std::abs(odds) >= config_.settled_log_odds;
  }
  if (!settled) sighting.covariance = without_yaw(sighting, config_.unsettled_yaw);

  const double d2 = to_estimate(sighting, sighting.covariance);
  if (!(d2 < config_.gate)) {
    if (++rejects_ >= config_.rejects_until_lost) {
      forget();
      return {SightingUse::lost, sighting, d2, pose_of(difference(sighting.T_station_base, expected)), {}, 0.0};
    }
    // One of the two is wrong; the estimate is believed less from now on (notes on docking, 4.6).
    for (State& state : states_) state.covariance *= config_.doubt;
    return {SightingUse::rejected, sighting, d2, pose_of(difference(sighting.T_station_base, expected)), {},
            prior.castor_turn};
  }
  rejects_ = 0;

  const Eigen::Matrix3d noise = sighting.covariance + sighting.bias_covariance;
  const Eigen::Matrix3d innovation = spread + noise;
  const Eigen::Matrix<double, 7, 3> gain = innovation.ldlt().solve(by_seen.transpose()).transpose();
  const Eigen::Vector3d innovated = difference(sighting.T_station_base, expected);
  const Eigen::Matrix<double, 7, 1> change = gain * innovated;
  const Matrix7 rest = Matrix7::Identity() - gain * by_state;
  State updated = prior;
  updated.T_station_base = {prior.T_station_base.x + change(0), prior.T_station_base.y + change(1),
                            prior.T_station_base.yaw + change(2)};
  updated.lasting += change.tail<4>();
  updated.lasting(0) = std::max(0.0, updated.lasting(0));
  updated.covariance = rest * prior.covariance * rest.transpose() + gain * noise * gain.transpose();  // Joseph
  lasting_ = updated.lasting;
  lasting_variance_ = updated.covariance.diagonal().tail<4>();

  // The updated state stands between two readings; it takes its place among them as one more.
  const auto place = states_.begin() + static_cast<std::ptrdiff_t>(before);
  if (place->reading.time == updated.reading.time) {
    *place = updated;
    propagate_from(before);
  } else if (before + 1 < states_.size()) {
    states_.insert(place + 1, updated);
    propagate_from(before + 1);
  } else {
    states_.push_back(updated);
  }
  bias_covariance_ = sighting.bias_covariance;
  seen_ = sighting.time;
  return {settled ? SightingUse::fused : SightingUse::fused_without_yaw,
          sighting,
          d2,
          pose_of(innovated),
          pose_of(change.head<3>()),
          prior.castor_turn};
}

std::optional<PoseEstimate> PoseFilter::estimate(std::chrono::nanoseconds time) const {
  if (!has_estimate_) return std::nullopt;
  const std::optional<std::size_t> before = state_before(time);
  if (!before) return std::nullopt;
  const State state = state_at(*before, time);
  PoseEstimate estimate;
  estimate.time = time;
  estimate.T_station_base = state.T_station_base;
  estimate.covariance = state.covariance.topLeftCorner<3, 3>() + bias_covariance_;
  estimate.seen = seen_;
  estimate.castor_scrub = state.lasting(0);
  estimate.castor_scrub_sigma = std::sqrt(state.covariance(3, 3));
  estimate.held_back = state.lasting(0) * held_back(state.castors, config_.castors);
  estimate.pull = state.lasting(1);
  estimate.pull_sigma = std::sqrt(state.covariance(4, 4));
  estimate.stretch = state.lasting(2);
  estimate.stretch_sigma = std::sqrt(state.covariance(5, 5));
  estimate.camera_yaw = state.lasting(3);
  estimate.camera_yaw_sigma = std::sqrt(state.covariance(6, 6));
  return estimate;
}

std::optional<Pose2> PoseFilter::T_odom_base(std::chrono::nanoseconds time) const {
  const std::optional<std::size_t> before = state_before(time);
  if (!before) return std::nullopt;
  return states_[*before].reading.T_odom_base * motion_until(*before, time);
}

std::optional<Eigen::Isometry3d> PoseFilter::predicted_view(std::chrono::nanoseconds time) const {
  if (const std::optional<std::size_t> before = has_estimate_ ? state_before(time) : std::nullopt)
    return level_view(rig_, seen_pose(pose_motion(states_[*before], motion_until(*before, time)).T_station_base,
                                      states_[*before].lasting(3)));
  if (!last_sighting_) return std::nullopt;
  const std::optional<Pose2> then = T_odom_base(last_sighting_->time);
  const std::optional<Pose2> now = T_odom_base(time);
  if (!then || !now) return std::nullopt;
  return level_view(rig_, last_sighting_->T_station_base * between(*then, *now));
}

void PoseFilter::forget() {
  has_estimate_ = false;
  rejects_ = 0;
  candidates_.clear();
}

}  // namespace tagdock
