#include "planning/time_law.h"

#include <limits>
#include <random>

#include <catch2/catch.hpp>

#include "planning/docking_plan.h"

using namespace tagdock;

namespace {

std::optional<Path> docking_path(const Pose2& start, bool arcs, int steps) {
  DockingPlanConfig config;
  config.arcs = arcs;
  config.arc_wish = {steps, 0.0, 0.0};
  config.list_candidates = false;
  DockingPlanResult result = plan_docking(start, {-1.0, 0.0, 0.0}, config);
  if (auto* plan = std::get_if<DockingPlan>(&result)) return plan->path;
  return std::nullopt;
}

/// Distance by the rule of the trapezoid, fine enough for 1e-9 m: speeds are piecewise linear in time.
double driven(const Path& path, const TimeLaw& law) {
  double sum = 0.0;
  const int steps = static_cast<int>(std::lround(law.duration() / law.period)) * 50;
  const double dt = law.duration() / steps;
  for (int i = 0; i < steps; ++i) sum += dt * std::abs(twist_at(path, law, (i + 0.5) * dt).linear);
  return sum;
}

}  // namespace

TEST_CASE("every segment takes whole periods, and wheels stay within speed and acceleration at every command") {
  std::mt19937 random(50);
  std::uniform_real_distribution<double> ahead(-6.0, -3.5);
  std::uniform_real_distribution<double> aside(-0.8, 0.8);
  const WheelLimits limits;
  int timed = 0;
  for (int i = 0; i < 60; ++i) {
    const double y = aside(random);
    const Pose2 start{ahead(random), y, -0.2 * y};
    const auto path = docking_path(start, i % 2 == 0, 4 + i % 3);
    if (!path) continue;
    const auto law = time_law(*path, limits);
    REQUIRE(law.has_value());
    ++timed;
    REQUIRE(law->segments.size() == path->segments.size());
    for (std::size_t s = 0; s < law->segments.size(); ++s) {
      const SegmentTiming& timing = law->segments[s];
      CHECK(timing.periods >= 1);
      CHECK(timing.cruise <= limits.speed * (1.0 + 1e-12));
    }
    CHECK(driven(*path, *law) == Approx(length(*path)).epsilon(1e-4));
    // Wheel commands of a clothoid path keep the jerk limit; those of arcs jump at their steps, the speed does not.
    const bool arcs = i % 2 == 0;
    double remaining = length(*path);
    Twist2 before{};
    Twist2 earlier{};
    for (double t = 0.5 * limits.period; t < law->duration() + 2.0 * limits.period; t += limits.period) {
      const Twist2 now = twist_at(*path, *law, t);
      for (const double side : {-0.5, 0.5}) {
        const double wheel = now.linear + side * limits.track_width * now.angular;
        const double wheel_before = before.linear + side * limits.track_width * before.angular;
        CHECK(std::abs(wheel) <= limits.wheel_speed * (1.0 + 1e-9));
        CHECK(std::abs(wheel - wheel_before) <= limits.wheel_acceleration * limits.period * (1.0 + 1e-9));
        const double wheel_earlier = earlier.linear + side * limits.track_width * earlier.angular;
        const double jerk =
            arcs ? now.linear - 2.0 * before.linear + earlier.linear : wheel - 2.0 * wheel_before + wheel_earlier;
        CHECK(std::abs(jerk) <= limits.wheel_jerk * limits.period * limits.period * (1.0 + 1e-9));
      }
      // Speed shrinks with what remains; what remains is known to 10 um by summing up.
      for (int k = 0; k < 20; ++k)
        remaining -=
            0.05 * limits.period * std::abs(twist_at(*path, *law, t - (k + 0.5) * 0.05 * limits.period).linear);
      CHECK(now.linear <= std::sqrt(2.0 * limits.approach_deceleration * (std::max(0.0, remaining) + 1e-5)));
      earlier = before;
      before = now;
    }
    CHECK(before == Twist2{});
  }
  CHECK(timed >= 40);
}

TEST_CASE("the robot stands still where it changes direction") {
  const Path path{{}, {{0.5, 0.0, 0.0}, {-0.4, 0.0, 0.0}}};
  const auto law = time_law(path, {});
  REQUIRE(law.has_value());
  CHECK(law->segments[0].exit == 0.0);
  CHECK(law->segments[1].entry == 0.0);
  CHECK(twist_at(path, *law, law->duration() - 0.5).linear < 0.0);
}

TEST_CASE("limits that are not positive numbers give no time law") {
  const Path path{{}, {{1.0, 0.0, 0.0}}};
  for (const double bad :
       {0.0, -1.0, std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    WheelLimits limits;
    limits.wheel_acceleration = bad;
    CHECK_FALSE(time_law(path, limits).has_value());
    limits = {};
    limits.wheel_jerk = bad;
    CHECK_FALSE(time_law(path, limits).has_value());
    limits = {};
    limits.period = bad;
    CHECK_FALSE(time_law(path, limits).has_value());
  }
}
