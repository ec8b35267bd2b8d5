#include "servo/pose_filter.h"

#include <array>
#include <cmath>
#include <limits>
#include <random>

#include <Eigen/LU>
#include <catch2/catch.hpp>

#include "planar_world.h"

using namespace tagdock;
using namespace tagdock::test;

namespace {

const Rig rig = default_rig();

BoardSighting sighting_at(const Pose2& T_station_base, nanoseconds time, double sigma = 1e-3) {
  BoardSighting sighting;
  sighting.time = time;
  sighting.T_camera_station = level_view(rig, T_station_base);
  sighting.covariance = Matrix6::Identity() * sigma * sigma;
  sighting.log_odds = std::numeric_limits<double>::infinity();
  return sighting;
}

// Gives a filter odometry at rest and as many sightings of one pose as it wants.
nanoseconds acquire(PoseFilter& filter, const Pose2& T_station_base, nanoseconds time = nanoseconds(0)) {
  for (int i = 0; i < 20; ++i) {
    filter.predict({time, {}, {}});
    const FilterUpdate update = filter.update(sighting_at(T_station_base, time));
    time += milliseconds(20);
    if (update.use == SightingUse::acquired) break;
  }
  return time;
}

double distance(const Pose2& a, const Pose2& b) { return std::hypot(a.x - b.x, a.y - b.y); }

}  // namespace

TEST_CASE("a sighting reduced to the plane is the pose it was made from, whatever the camera's mounting") {
  std::mt19937 random(3);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  for (int i = 0; i < 100; ++i) {
    Rig mounted = rig;
    mounted.T_base_camera.linear() =
        rig.T_base_camera.linear() *
        Eigen::AngleAxisd(0.2 * uniform(random), Eigen::Vector3d(uniform(random), uniform(random), 1.0).normalized())
            .toRotationMatrix();
    mounted.T_base_camera.translation() << 0.35, 0.1 * uniform(random), 0.4;
    const Pose2 pose{-2.0 + uniform(random), uniform(random), uniform(random)};
    const PlanarSighting planar =
        planar_sighting(mounted, nanoseconds(0), level_view(mounted, pose), Matrix6::Identity(), 0.0);
    // 1e-12: rounding of a few rotations.
    CHECK(distance(planar.T_station_base, pose) < 1e-12);
    CHECK(std::abs(wrap_angle(planar.T_station_base.yaw - pose.yaw)) < 1e-12);
  }
}

TEST_CASE("the planar covariance is what small motions of the camera do") {
  const Pose2 pose{-1.9, 0.4, -0.3};
  const Eigen::Isometry3d T_camera_station = level_view(rig, pose);
  Matrix6 root;  // any; its square is a covariance
  std::mt19937 random(4);
  std::uniform_real_distribution<double> uniform(-1.0, 1.0);
  for (int row = 0; row < 6; ++row) {
    for (int column = 0; column < 6; ++column) root(row, column) = 1e-3 * uniform(random);
  }
  // By differences: column i of the Jacobian is what a motion h along axis i does.
  constexpr double h = 1e-6;
  Eigen::Matrix<double, 3, 6> jacobian;
  for (int i = 0; i < 6; ++i) {
    Eigen::Matrix<double, 6, 1> motion = Eigen::Matrix<double, 6, 1>::Zero();
    motion[i] = h;
    const Pose2 plus =
        planar_sighting(rig, nanoseconds(0), small_motion(motion) * T_camera_station, Matrix6::Zero(), 0.0)
            .T_station_base;
    const Pose2 minus =
        planar_sighting(rig, nanoseconds(0), small_motion(-motion) * T_camera_station, Matrix6::Zero(), 0.0)
            .T_station_base;
    jacobian.col(i) = Eigen::Vector3d(plus.x - minus.x, plus.y - minus.y, plus.yaw - minus.yaw) / (2.0 * h);
  }
  const Matrix6 covariance = root * root.transpose();
  const Eigen::Matrix3d expected = jacobian * covariance * jacobian.transpose();
  const Eigen::Matrix3d found = planar_sighting(rig, nanoseconds(0), T_camera_station, covariance, 0.0).covariance;
  CHECK((found - expected).norm() < 1e-6 * expected.norm());  // central differences: h^2 and rounding over h
}

TEST_CASE("pitch and roll of the chassis hardly move the axle's place") {
  const Pose2 pose{-1.35, 0.0, 0.0};
  Eigen::Isometry3d tilt = Eigen::Isometry3d::Identity();
  tilt.linear() = Eigen::AngleAxisd(radians(0.5), Eigen::Vector3d::UnitX()).toRotationMatrix() *
                  Eigen::AngleAxisd(radians(0.5), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  const PlanarSighting planar =
      planar_sighting(rig, nanoseconds(0), tilt * level_view(rig, pose), Matrix6::Identity(), 0.0);
  // Taken through the tilted base frame the axle would move by 0.35 m * 0.5 degrees = 3 mm.
  CHECK(distance(planar.T_station_base, pose) < 2e-4);
}

TEST_CASE("the estimate begins with five agreeing sightings at standstill, not earlier and not while moving") {
  const Pose2 pose{-3.0, 0.2, 0.05};
  PoseFilter filter(rig, {});
  nanoseconds time{0};
  for (int i = 1; i <= 5; ++i) {
    filter.predict({time, {}, {}});
    CHECK_FALSE(filter.estimate(time));
    const FilterUpdate update = filter.update(sighting_at(pose, time));
    CHECK(update.use == (i < 5 ? SightingUse::collected : SightingUse::acquired));
    time += milliseconds(20);
  }
  REQUIRE(filter.estimate(time));
  CHECK(distance(filter.estimate(time)->T_station_base, pose) < 1e-9);

  PoseFilter moving(rig, {});
  for (int i = 0; i < 30; ++i) {
    const Pose2 driven{0.004 * i, 0.0, 0.0};
    moving.predict({milliseconds(20) * i, driven, {0.2, 0.0}});
    moving.update(sighting_at(pose * driven, milliseconds(20) * i));
  }
  CHECK_FALSE(moving.estimate(milliseconds(600)));
}

TEST_CASE("sightings that do not agree with each other never make an estimate") {
  PoseFilter filter(rig, {});
  for (int i = 0; i < 100; ++i) {
    filter.predict({milliseconds(20) * i, {}, {}});
    const Pose2 pose{-3.0 + 0.1 * (i % 3), 0.0, 0.0};  // three places by turns
    CHECK(filter.update(sighting_at(pose, milliseconds(20) * i)).use != SightingUse::acquired);
  }
}

TEST_CASE("a sighting acts at its image time: latency alone moves nothing") {
  // Driven on an arc with exact odometry and exact sightings; whatever the latency, the estimate stays on the truth.
  const Pose2 start{-3.0, 0.3, -0.1};
  for (const int latency_ms : {0, 10, 80, 250, 1000}) {
    CAPTURE(latency_ms);
    PoseFilterConfig no_castors;
    no_castors.castors.front = no_castors.castors.rear = 0.0;
    PoseFilter filter(rig, no_castors);
    nanoseconds time = acquire(filter, start);
    const nanoseconds begin = time;
    const Twist2 velocity{0.2, 0.15};
    const auto truth = [&](nanoseconds at) {
      const double t = std::max(0.0, seconds(at - begin));
      return pose_along({}, {0.2 * t, velocity.angular / velocity.linear, 0.0}, 0.2 * t);
    };
    double worst = 0.0;
    for (int i = 0; i < 250; ++i) {
      filter.predict({time, truth(time), velocity});
      const nanoseconds stamp = time - milliseconds(latency_ms) - nanoseconds(3000001);  // between two readings
      if (i % 3 == 0 && stamp > begin) {
        const FilterUpdate update = filter.update(sighting_at(start * truth(stamp), stamp));
        CHECK(update.use == SightingUse::fused);
      }
      worst = std::max(worst, distance(filter.estimate(time)->T_station_base, start * truth(time)));
      time += milliseconds(20);
    }
    // 0.01 mm: the velocity between two readings is taken as a chord at half the turn, and linearisation.
    CHECK(worst < 1e-5);
  }
}

TEST_CASE("the delayed update is the update in time: the same posterior as a filter that got the frame at once") {
  std::mt19937 random(11);
  std::normal_distribution<double> normal;
  PoseFilter prompt(rig, {});
  PoseFilter late(rig, {});
  const Pose2 start{-3.0, 0.3, -0.1};
  const nanoseconds begin = acquire(prompt, start);
  acquire(late, start);
  std::deque<BoardSighting> waiting;
  nanoseconds time = begin;
  for (int i = 0; i < 200; ++i) {
    const double t = seconds(time - begin);
    const Pose2 driven = pose_along({}, {0.15 * t, 0.5, 0.0}, 0.15 * t);
    prompt.predict({time, driven, {0.15, 0.075}});
    late.predict({time, driven, {0.15, 0.075}});
    if (i % 3 == 1) {
      Pose2 seen = start * driven;
      seen.x += 1e-3 * normal(random);
      seen.y += 1e-3 * normal(random);
      seen.yaw += 1e-3 * normal(random);
      prompt.update(sighting_at(seen, time));
      waiting.push_back(sighting_at(seen, time));
    }
    if (!waiting.empty() && time - waiting.front().time >= milliseconds(240)) {
      late.update(waiting.front());
      waiting.pop_front();
    }
    time += milliseconds(20);
  }
  for (const BoardSighting& rest : waiting) late.update(rest);
  const PoseEstimate a = *prompt.estimate(time);
  const PoseEstimate b = *late.estimate(time);
  CHECK(distance(a.T_station_base, b.T_station_base) < 1e-12);  // the same operations in the same order
  CHECK((a.covariance - b.covariance).norm() < 1e-15);
}

TEST_CASE("the filter knows how wrong it is: NEES of simulated runs with 80 and 250 ms of latency") {
  // The truth drifts as the filter expects it to: this checks the arithmetic of the covariance, not the choice of
  // noise.
  for (const int latency_ms : {80, 250}) {
    CAPTURE(latency_ms);
    double sum = 0.0;
    int count = 0;
    for (unsigned seed = 1; seed <= 60; ++seed) {
      std::mt19937_64 random(seed);
      std::normal_distribution<double> normal;
      const PoseFilterConfig config;
      PoseFilter filter(rig, config);
      const double sigma = 2e-3;
      Pose2 truth{-3.3, 0.25, -0.08};
      Pose2 odometry;
      std::deque<BoardSighting> waiting;
      for (int i = 0; i < 700; ++i) {
        const nanoseconds time = milliseconds(20) * i;
        const bool drives = i > 50;
        const double distance_driven = drives ? 0.15 * 0.02 : 0.0;
        const double turn = drives ? 0.3 * distance_driven * std::sin(0.01 * i) : 0.0;
        if (i > 0) {
          const Pose2 motion{distance_driven, 0.0, turn};
          odometry = odometry * motion;
          Pose2 real = motion;
          const double root = std::sqrt(distance_driven);
          real.x += config.forward_noise * root * normal(random);
          real.y += config.sideways_noise * root * normal(random);
          real.yaw +=
              config.yaw_noise * root * normal(random) + std::sqrt(2.0) * config.turn_noise * turn * normal(random);
          truth = truth * real;
        }
        filter.predict({time, odometry, drives ? Twist2{0.15, 0.0} : Twist2{}});
        if (i % 3 == 0) {
          BoardSighting seen = sighting_at(truth, time, sigma);
          Eigen::Matrix<double, 6, 1> error;
          for (int k = 0; k < 6; ++k) error[k] = sigma * normal(random);
          seen.T_camera_station = small_motion(error) * seen.T_camera_station;
          waiting.push_back(seen);
        }
        while (!waiting.empty() && time - waiting.front().time >= milliseconds(latency_ms)) {
          filter.update(waiting.front());
          waiting.pop_front();
        }
        const std::optional<PoseEstimate> estimate = filter.estimate(time);
        if (i % 50 != 49 || !estimate || !drives) continue;
        const Pose2& found = estimate->T_station_base;
        const Eigen::Vector3d error(found.x - truth.x, found.y - truth.y, wrap_angle(found.yaw - truth.yaw));
        sum += error.dot(estimate->covariance.inverse() * error);
        ++count;
      }
    }
    // NEES of a consistent filter is 3 on average. 60 runs of 12 samples, of which neighbours are correlated over about
    // a second: the mean of at least 60 * 3 independent ones has a sigma of sqrt(2 * 3 / 180) = 0.18.
    REQUIRE(count >= 700);
    const double mean = sum / count;
    CHECK(mean > 3.0 - 4.0 * 0.18);
    CHECK(mean < 3.0 + 4.0 * 0.18);
  }
}

TEST_CASE("a wild sighting is rejected, five in a row drop the estimate, and one that fits resets the count") {
  const Pose2 pose{-2.0, 0.0, 0.0};
  const Pose2 wild{-2.0, 0.3, 0.2};
  PoseFilter filter(rig, {});
  nanoseconds time = acquire(filter, pose);
  const auto give = [&](const Pose2& seen) {
    filter.predict({time, {}, {}});
    const SightingUse use = filter.update(sighting_at(seen, time)).use;
    time += milliseconds(50);
    return use;
  };
  for (int i = 0; i < 4; ++i) CHECK(give(wild) == SightingUse::rejected);
  CHECK(give(pose) == SightingUse::fused);
  CHECK(distance(filter.estimate(time)->T_station_base, pose) < 1e-6);
  for (int i = 0; i < 4; ++i) CHECK(give(wild) == SightingUse::rejected);
  CHECK(give(wild) == SightingUse::lost);
  CHECK_FALSE(filter.estimate(time));
  CHECK(filter.predicted_view(time));  // the locator still knows where to look
  for (int i = 0; i < 4; ++i) CHECK(give(wild) == SightingUse::collected);
  CHECK(give(wild) == SightingUse::acquired);
}

TEST_CASE("of the two poses of a flat tag the prediction picks the one it believes") {
  const Pose2 pose{-2.0, 0.5, -0.2};
  const Pose2 mirror{-2.0, -0.5, 0.3};
  PoseFilter filter(rig, {});
  nanoseconds time = acquire(filter, pose);
  filter.predict({time, {}, {}});
  BoardSighting flipped = sighting_at(mirror, time);  // the image prefers the wrong one a little
  flipped.log_odds = 1.0;
  flipped.T_camera_station_mirrored = level_view(rig, pose);
  CHECK(filter.update(flipped).use == SightingUse::fused);
  CHECK(distance(filter.estimate(time)->T_station_base, pose) < 1e-3);
}

TEST_CASE("where prediction and image do not tell the two poses apart, the yaw is left to odometry") {
  const Pose2 pose{-2.0, 0.0, 0.0};
  PoseFilter filter(rig, {});
  nanoseconds time = acquire(filter, pose);
  const double before = filter.estimate(time)->T_station_base.yaw;
  for (int i = 0; i < 50; ++i) {
    filter.predict({time, {}, {}});
    // Two mirrored poses that both lie within the noise: 20 mrad to either side, noise of 20 mrad.
    BoardSighting seen = sighting_at(Pose2{0.0, 0.0, 0.02} * pose, time, 0.02);
    seen.T_camera_station_mirrored = level_view(rig, Pose2{0.0, 0.0, -0.02} * pose);
    seen.log_odds = 0.5;
    CHECK(filter.update(seen).use == SightingUse::fused_without_yaw);
    time += milliseconds(50);
  }
  // Had the yaw been used, 50 sightings would have drawn it towards 20 mrad.
  CHECK(std::abs(filter.estimate(time)->T_station_base.yaw - before) < 1e-3);
}

TEST_CASE("an ambiguous sighting alone never starts an estimate") {
  PoseFilter filter(rig, {});
  for (int i = 0; i < 50; ++i) {
    filter.predict({milliseconds(20) * i, {}, {}});
    BoardSighting seen = sighting_at({-2.0, 0.0, 0.02}, milliseconds(20) * i);
    seen.log_odds = 0.3;
    seen.T_camera_station_mirrored = level_view(rig, {-2.0, 0.0, -0.02});
    CHECK(filter.update(seen).use == SightingUse::ambiguous);
  }
  CHECK_FALSE(filter.estimate(milliseconds(1000)));
}

TEST_CASE("what is not a number, old, repeated or without a covariance changes nothing") {
  const Pose2 pose{-2.0, 0.1, 0.0};
  PoseFilter filter(rig, {});
  const nanoseconds time = acquire(filter, pose) - milliseconds(20);
  const PoseEstimate before = *filter.estimate(time);
  BoardSighting bad = sighting_at(pose, time + milliseconds(1));
  bad.T_camera_station.translation().x() = std::numeric_limits<double>::quiet_NaN();
  CHECK(filter.update(bad).use == SightingUse::invalid);
  bad = sighting_at(pose, time + milliseconds(1));
  bad.covariance(3, 3) = std::numeric_limits<double>::infinity();
  CHECK(filter.update(bad).use == SightingUse::invalid);
  bad = sighting_at(pose, time + milliseconds(1));
  bad.covariance.setZero();
  CHECK(filter.update(bad).use == SightingUse::invalid);
  CHECK(filter.update(sighting_at(pose, time)).use == SightingUse::too_old);  // the same stamp again
  CHECK(filter.update(sighting_at(pose, time - std::chrono::hours(1))).use == SightingUse::too_old);  // before odometry
  filter.predict({time + milliseconds(20), {std::numeric_limits<double>::quiet_NaN(), 0.0, 0.0}, {}});
  const PoseEstimate after = *filter.estimate(time);
  CHECK(after.T_station_base == before.T_station_base);
  CHECK(after.covariance == before.covariance);
}

TEST_CASE("lasting corner errors stay in the covariance however long the robot stands") {
  const Pose2 pose{-1.35, 0.0, 0.0};
  PoseFilterConfig config;
  config.corner_bias_px = 0.05;
  config.camera_yaw_sigma = 0.0;  // the same for a camera that may have been turned; here it is the corners' alone
  PoseFilter filter(rig, config);
  nanoseconds time{0};
  for (int i = 0; i < 500; ++i) {
    filter.predict({time, {}, {}});
    BoardSighting seen = sighting_at(pose, time);
    RefinedTag tag;
    tag.covariance_px2 = Eigen::Matrix<double, 8, 8>::Identity() * 0.1 * 0.1;
    seen.tags.push_back(tag);
    filter.update(seen);
    time += milliseconds(50);
  }
  const PlanarSighting one = planar_sighting(rig, time, level_view(rig, pose), Matrix6::Identity() * 1e-6, 0.0);
  // Bias of half the noise: a quarter of one sighting's variance cannot be averaged away.
  CHECK(filter.estimate(time)->covariance(1, 1) > 0.25 * one.covariance(1, 1));
  CHECK(filter.estimate(time)->covariance(1, 1) < 0.30 * one.covariance(1, 1));
}

namespace {

// A robot that drives straight by its odometry past the station while something lasting is wrong: sightings of where it
// truly is, through a camera whose yaw may be wrong.
PoseEstimate after_drive(double pull, double stretch, double camera_yaw, const PoseFilterConfig& config) {
  PoseFilter filter(rig, config);
  const Pose2 ahead = camera_point(rig);
  Pose2 truth{-4.0, 0.05, 0.02};
  Pose2 odometry;
  nanoseconds time{0};
  for (int i = 0; i < 400; ++i) {
    const double distance = i < 50 ? 0.0 : 0.004;  // stands for a second, then drives 1.4 m
    const double turn = pull * distance;
    truth = truth * Pose2{(1.0 + stretch) * distance, 0.0, turn};
    odometry = odometry * Pose2{distance, 0.0, 0.0};
    filter.predict({time, odometry, {distance / 0.02, 0.0}});
    if (i % 2 == 0) {
      const Pose2 camera = truth * ahead;
      const Pose2 seen = Pose2{camera.x, camera.y, camera.yaw + camera_yaw} * inverse(ahead);
      filter.update(sighting_at(seen, time));
    }
    time += milliseconds(20);
  }
  PoseEstimate result = *filter.estimate(time - milliseconds(20));
  const Pose2 error = between(truth, result.T_station_base);
  CHECK(std::hypot(error.x, error.y) < 0.002);
  return result;
}

}  // namespace

TEST_CASE("lasting errors of wheels and camera are found in motion, no farther off than claimed") {
  // A floor without slip of its own, so that what is planted is what can be found: 3 sigma of the filter's own claim,
  // and the claim itself at most two thirds of what was known before.
  PoseFilterConfig config;
  config.castors.front = config.castors.rear = 0.0;
  config.yaw_noise = 0.001;
  config.sideways_noise = 0.0005;
  config.forward_noise = 0.001;
  for (const double sign : {-1.0, 1.0}) {
    CAPTURE(sign);
    const PoseEstimate unequal = after_drive(sign * 0.008, 0.0, 0.0, config);
    CHECK(std::abs(unequal.pull - sign * 0.008) < 3.0 * unequal.pull_sigma);
    CHECK(unequal.pull_sigma < config.pull_sigma / 1.5);
    const PoseEstimate worn = after_drive(0.0, sign * 0.005, 0.0, config);
    CHECK(std::abs(worn.stretch - sign * 0.005) < 3.0 * worn.stretch_sigma);
    CHECK(worn.stretch_sigma < config.stretch_sigma / 1.5);
    const PoseEstimate knocked = after_drive(0.0, 0.0, sign * 0.0035, config);
    CHECK(std::abs(knocked.camera_yaw - sign * 0.0035) < 3.0 * knocked.camera_yaw_sigma);
    CHECK(knocked.camera_yaw_sigma < config.camera_yaw_sigma / 1.5);
  }
}

TEST_CASE("at standstill nothing lasting is claimed to be known better than before") {
  PoseFilterConfig config;
  PoseFilter filter(rig, config);
  nanoseconds time{0};
  for (int i = 0; i < 300; ++i) {
    filter.predict({time, {}, {}});
    filter.update(sighting_at({-3.0, 0.1, 0.05}, time));
    time += milliseconds(40);
  }
  const PoseEstimate estimate = *filter.estimate(time);
  CHECK(estimate.pull_sigma == Approx(config.pull_sigma).epsilon(1e-6));
  CHECK(estimate.stretch_sigma == Approx(config.stretch_sigma).epsilon(1e-6));
  CHECK(estimate.camera_yaw_sigma == Approx(config.camera_yaw_sigma).epsilon(0.01));
}
