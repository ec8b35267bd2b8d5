#include "servo/odometry_controller.h"

#include <random>

#include <catch2/catch.hpp>

#include "s_curve.h"

using namespace tagdock;
using namespace tagdock::test;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

namespace {

double seconds(nanoseconds time) { return std::chrono::duration<double>(time).count(); }

// A robot that does what it is told after a dead time of whole cycles; gives the worst deviation of the second half.
struct Drive {
  double worst_lateral = 0.0;
  double worst_heading = 0.0;
  bool arrived = false;
  Pose2 end;
  nanoseconds time{0};
};

Drive drive(const Path& path, const Pose2& start, const OdometryControllerConfig& config, int dead_cycles) {
  constexpr nanoseconds step = milliseconds(20);
  Pose2 pose = start;
  FollowState state;
  std::vector<Twist2> pending(static_cast<std::size_t>(dead_cycles), Twist2{});
  Drive result;
  const double half = 0.5 * length(path);
  for (int i = 0; i < 5000 && !result.arrived; ++i) {
    const FollowStep driven = follow(path, state, pose, step, config);
    state = driven.next;
    result.arrived = driven.arrived;
    pending.push_back(driven.command);
    const Twist2 now = pending.front();
    pending.erase(pending.begin());
    const double distance = now.linear * seconds(step);
    const double turn = now.angular * seconds(step);
    pose = pose * Pose2{distance * std::cos(0.5 * turn), distance * std::sin(0.5 * turn), turn};
    result.time += step;
    if (state.reference > half) {
      result.worst_lateral = std::max(result.worst_lateral, std::abs(driven.deviation.y));
      result.worst_heading = std::max(result.worst_heading, std::abs(driven.deviation.yaw));
    }
  }
  result.end = between(end_pose(path), pose);
  return result;
}

}  // namespace

TEST_CASE("eq. 6: exactly n periods fill the segment's time, and the next would begin after it") {
  std::mt19937_64 random(6);
  std::uniform_int_distribution<std::int64_t> times(1, 30'000'000'000);
  const nanoseconds nominal = milliseconds(20);
  for (int i = 0; i < 20000; ++i) {
    const nanoseconds whole(times(random));
    const nanoseconds period = control_period(whole, nominal);
    const auto n = std::max<std::int64_t>(1, whole.count() / nominal.count());
    CAPTURE(whole.count(), n);
    // Loop as the robot's: runs while the time is not used up.
    std::int64_t iterations = 0;
    if (n < 200) {
      for (nanoseconds t{0}; t < whole; t += period) ++iterations;
      REQUIRE(iterations == n);
    }
    REQUIRE(period * n >= whole);
    REQUIRE((period * n - whole).count() < n);  // less than a nanosecond a period too long
    if (whole >= nominal) {
      REQUIRE(period >= nominal);
      REQUIRE(period.count() * n <= nominal.count() * (n + 1) + n);  // rate in (50 n/(n+1), 50] Hz, and the rounding
    } else {
      REQUIRE(period == whole);
    }
  }
}

TEST_CASE("eq. 6: from sixteen periods on the rate is above 47 Hz, by rounding within 3.3 percent of 50 Hz") {
  for (std::int64_t t = 320'000'000; t < 3'000'000'000; t += 1'234'567) {
    REQUIRE(1.0 / seconds(control_period(nanoseconds(t), milliseconds(20))) > 47.0);
    const double rate = 1.0 / seconds(control_period(nanoseconds(t), milliseconds(20), StepRounding::nearest));
    REQUIRE(std::abs(rate - 50.0) < 0.033 * 50.0);
  }
  CHECK(1.0 / seconds(control_period(nanoseconds(39'900'000), milliseconds(20))) == Approx(25.06).epsilon(1e-3));
}

TEST_CASE("a perfect robot stays on a clothoid path and ends where it ends") {
  const Path path = std::get<Path>(s_curve({-3.8, -0.3, 0.09}, {-2.25, 0.0, 0.0}));
  const Drive driven = drive(path, path.start, {}, 0);
  CHECK(driven.arrived);
  // 0.5 mm: the curvature of a cycle is taken at its end, half a cycle (2 mm) along a sharpness of 2.6 1/m^2.
  CHECK(driven.worst_lateral < 5e-4);
  CHECK(std::abs(driven.end.x) < 1e-3);  // arrival is declared within 0.8 mm
  CHECK(std::abs(driven.end.y) < 5e-4);
  // The reference's own time, and the hold at the end.
  CHECK(seconds(driven.time) < seconds(travel_time(length(path), {})) + 3.0);
}

TEST_CASE("a start beside the path is taken back by the damping, forward and in reverse") {
  for (const double direction : {1.0, -1.0}) {
    CAPTURE(direction);
    const Path line{{}, {{direction * 3.0, 0.0, 0.0}}};
    const Drive driven = drive(line, {0.0, 0.03, 0.0}, {}, 3);
    CHECK(driven.arrived);
    CHECK(std::abs(driven.end.y) < 0.001);
    CHECK(std::abs(driven.end.yaw) < 0.005);
  }
}

TEST_CASE("the paper's damping bears a dead time of 200 ms, 0.2 swings up as the paper found") {
  // An integrator with dead time T is stable for gain T < pi/2: 0.42 s for a = 0.075, 0.157 s for a = 0.2.
  const Path line{{}, {{6.0, 0.0, 0.0}}};
  OdometryControllerConfig calm;
  OdometryControllerConfig hasty;
  hasty.damping = 0.2;
  CHECK(drive(line, {0.0, 0.0, 0.02}, calm, 10).worst_heading < 0.005);
  // Twice the start's 0.02 rad in the second half: it grows.
  CHECK(drive(line, {0.0, 0.0, 0.02}, hasty, 10).worst_heading > 0.04);
  CHECK(drive(line, {0.0, 0.0, 0.02}, hasty, 2).worst_heading < 0.005);
}

TEST_CASE("travel time of the trapezoid") {
  OdometryControllerConfig config;
  config.max_speed = 0.2;
  config.acceleration = 0.1;
  config.braking = 0.2;
  // 2 s up over 0.2 m, 1 s down over 0.1 m, 0.7 m at 0.2 m/s.
  CHECK(seconds(travel_time(1.0, config)) == Approx(2.0 + 1.0 + 3.5));
  CHECK(travel_time(0.0, config) == nanoseconds(0));
  // Too short for the top speed: v^2 (1/0.2 + 1/0.4) = d.
  const double top = std::sqrt(0.075 / 7.5);
  CHECK(seconds(travel_time(0.075, config)) == Approx(top / 0.1 + top / 0.2));
}
