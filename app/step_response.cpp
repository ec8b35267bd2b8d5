#include "app/step_response.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "app/simulation/robot_physics.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;

double seconds(nanoseconds time) { return std::chrono::duration<double>(time).count(); }

/// A robot whose castors trail, so that what is measured is the loop and not their turning round.
StartScenario straight_start() {
  StartScenario start;
  start.castor_angle = start.castor_sigma = 0.0;
  return start;
}

void judge(StepResponse& response, double step, double length) {
  const std::vector<ResponseSample>& samples = response.samples;
  const double whole = samples.back().time;
  double weighed = 0.0;
  double largest_first = 0.0;
  double largest_last = 0.0;
  for (std::size_t i = 0; i < samples.size(); ++i) {
    const ResponseSample& sample = samples[i];
    const double dt = i > 0 ? sample.time - samples[i - 1].time : sample.time;
    weighed += dt * sample.time * std::abs(sample.heading + sample.lateral / length);
    response.overshoot = std::max(response.overshoot, sample.lateral / step);  // the step is to the right
    if (std::abs(sample.lateral) > 0.1 * std::abs(step)) response.settled = sample.time;
    double& largest = sample.time < 0.25 * whole ? largest_first : largest_last;
    if (sample.time < 0.25 * whole || sample.time > 0.75 * whole) largest = std::max(largest, std::abs(sample.heading));
  }
  response.cost = weighed / (0.5 * whole * whole * std::abs(step) / length);
  response.swing = largest_first > 0.0 ? largest_last / largest_first : 0.0;
}

}  // namespace

StepResponse step_response(const StepResponseSettings& settings, double damping, std::uint64_t seed) {
  RobotPhysics robot(straight_start(), settings.drive, 0.0, seed);
  OdometryControllerConfig controller = settings.controller;
  controller.damping = damping;
  controller.end_speed = controller.max_speed;  // what is measured ends before the robot brakes
  const Pose2 T_station_start = robot.truth().T_station_base;
  const Path straight{{}, {{settings.before + settings.after, 0.0, 0.0}}};
  // The path jumps to the left, the robot is then beside it to the right by the step.
  const Path beside{{0.0, settings.step, 0.0}, straight.segments};
  StepResponse response{damping, settings.drive.dead_time, seed, {}, 0.0, 0.0, 0.0, 0.0};
  const nanoseconds period = controller.nominal_period;
  FollowState state;
  std::optional<nanoseconds> since;
  double travelled_before = 0.0;
  for (nanoseconds now = period;; now += period) {
    robot.advance(now);
    const Pose2 pose = robot.odometry().T_odom_base;
    if (!since && pose.x >= settings.before) {
      since = now;
      travelled_before = pose.x;
    }
    if (since) {
      const Pose2 true_pose = between(T_station_start, robot.truth().T_station_base);
      response.samples.push_back({seconds(now - *since), pose.x - travelled_before, pose.y - settings.step,
                                  true_pose.y - settings.step, wrap_angle(pose.yaw)});
    }
    const FollowStep driven = follow(since ? beside : straight, state, pose, period, controller);
    state = driven.next;
    if (driven.remaining <= 0.02 || seconds(now) > 600.0) break;
    robot.command(driven.command, now);
  }
  if (response.samples.empty()) response.samples.emplace_back();
  judge(response, settings.step, controller.lateral_length);
  return response;
}

DriveLag measure_drive(const DriveScenario& drive, std::uint64_t seed) {
  constexpr double wanted = 0.03;  // rad/s; slow enough that the drive's acceleration does not count
  constexpr nanoseconds lasts = std::chrono::seconds(3);
  RobotPhysics robot(straight_start(), drive, 0.0, seed);
  std::vector<std::pair<double, double>> turning;
  for (nanoseconds now{0}; now < lasts; now += RobotPhysics::step) {
    if (now.count() % std::chrono::nanoseconds(std::chrono::milliseconds(20)).count() == 0)
      robot.command({0.0, wanted}, now);
    robot.advance(now);
    turning.emplace_back(seconds(now), robot.odometry().velocity.angular);
  }
  const double end = turning.back().second;
  const auto reaches = [&](double share) {
    for (std::size_t i = 1; i < turning.size(); ++i) {
      const auto& [time, rate] = turning[i];
      if (rate < share * end) continue;
      const auto& [time_before, rate_before] = turning[i - 1];
      return time_before + (share * end - rate_before) / (rate - rate_before) * (time - time_before);
    }
    return turning.back().first;
  };
  const double third = reaches(1.0 - std::exp(-1.0 / 3.0));
  const double whole = reaches(1.0 - std::exp(-1.0));
  const double lag = 1.5 * (whole - third);
  return {std::max(0.0, whole - lag), lag};
}

double swinging_damping(const DriveLag& lag, double period) {
  // Phase of dead time, lag and the hold of a command reaches -90 degrees beside the integrator's own 90.
  const double dead = lag.dead_time + 0.5 * period;
  double low = 0.0;
  double high = 0.5 * std::numbers::pi / std::max(dead, 1e-6);
  for (int i = 0; i < 100; ++i) {
    const double middle = 0.5 * (low + high);
    (middle * dead + std::atan(middle * lag.lag) < 0.5 * std::numbers::pi ? low : high) = middle;
  }
  return period * low * std::hypot(1.0, low * lag.lag);
}

DampingSearch find_damping(const StepResponseSettings& settings, const std::vector<double>& dampings) {
  DampingSearch search;
  search.dead_time = settings.drive.dead_time;
  search.measured = measure_drive(settings.drive, settings.seed);
  const auto tried = [&](double damping) {
    DampingResult result{damping, 0.0, 0.0, 0.0, 0.0};
    for (int i = 0; i < settings.runs; ++i) {
      const StepResponse response = step_response(settings, damping, settings.seed + static_cast<std::uint64_t>(i));
      const double share = 1.0 / settings.runs;
      result.cost += share * response.cost;
      result.overshoot += share * response.overshoot;
      result.settled += share * response.settled;
      result.swing += share * response.swing;
    }
    return result;
  };
  for (const double damping : dampings) search.tried.push_back(tried(damping));
  std::sort(search.tried.begin(), search.tried.end(),
            [](const DampingResult& a, const DampingResult& b) { return a.damping < b.damping; });
  const auto cheapest = [&] {
    return static_cast<std::size_t>(
        std::min_element(search.tried.begin(), search.tried.end(),
                         [](const DampingResult& a, const DampingResult& b) { return a.cost < b.cost; }) -
        search.tried.begin());
  };
  // Between the neighbours of the best, twice: to a few percent, which is what the measure is worth.
  for (int round = 0; round < 2; ++round) {
    const std::size_t best = cheapest();
    std::vector<DampingResult> more;
    if (best > 0) more.push_back(tried(std::sqrt(search.tried[best].damping * search.tried[best - 1].damping)));
    if (best + 1 < search.tried.size())
      more.push_back(tried(std::sqrt(search.tried[best].damping * search.tried[best + 1].damping)));
    search.tried.insert(search.tried.end(), more.begin(), more.end());
    std::sort(search.tried.begin(), search.tried.end(),
              [](const DampingResult& a, const DampingResult& b) { return a.damping < b.damping; });
  }
  search.best = search.tried[cheapest()].damping;
  constexpr double lasting = 0.5;  // of the first swings: what has not halved after three quarters of the way
  for (const DampingResult& result : search.tried) {
    if (result.damping < search.best || result.swing < lasting) continue;
    search.swings_from = result.damping;
    break;
  }
  return search;
}

}  // namespace tagdock
