#include "servo/command_gate.h"

#include <cmath>
#include <limits>
#include <random>

#include <catch2/catch.hpp>

using namespace tagdock;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

namespace {

GateInputs fresh(nanoseconds now, double wheel_speed = 0.0) {
  return {now, now, wheel_speed, now - milliseconds(80), now - milliseconds(80), FrameNeed::sightings, std::nullopt};
}

// Ramped up to a speed with everything fresh.
CommandGate gate_at(double speed, nanoseconds& now, const CommandGateConfig& config = {}) {
  CommandGate gate(config);
  for (int i = 0; i < 200; ++i) {
    now += milliseconds(20);
    gate.pass({speed, 0.0}, fresh(now, speed));
  }
  return gate;
}

}  // namespace

TEST_CASE("whatever is asked for, under whatever inputs: finite, within limits, never sped up too fast") {
  const CommandGateConfig config;
  std::mt19937_64 random(17);
  const auto pick = [&](std::initializer_list<double> special, double range) {
    std::uniform_int_distribution<std::size_t> which(0, special.size() + 5);
    const std::size_t i = which(random);
    if (i < special.size()) return *(special.begin() + i);
    return std::uniform_real_distribution<double>(-range, range)(random);
  };
  constexpr double nan = std::numeric_limits<double>::quiet_NaN();
  constexpr double infinity = std::numeric_limits<double>::infinity();
  for (int run = 0; run < 200; ++run) {
    CommandGate gate(config);
    nanoseconds now{0};
    Twist2 last;
    bool latched = false;
    for (int i = 0; i < 200; ++i) {
      const nanoseconds step(static_cast<std::int64_t>(std::abs(pick({0.0, 5e8}, 4e7))));
      now += step;
      GateInputs inputs = fresh(now, pick({nan, infinity, 0.0}, 0.3));
      if (random() % 10 == 0) inputs.odometry_time = now - milliseconds(random() % 400);
      if (random() % 10 == 0) inputs.sighting_time = now - milliseconds(random() % 1000);
      if (random() % 50 == 0) inputs.odometry_time.reset();
      inputs.need = static_cast<FrameNeed>(random() % 3);
      const Twist2 wanted{pick({nan, infinity, -infinity, 1e300, -0.0, 5e-324}, 0.6),
                          pick({nan, infinity, -infinity, 1e300, 0.0}, 2.0)};
      const GateResult result = gate.pass(wanted, inputs);
      const Twist2& command = result.command;
      REQUIRE(is_finite(command));
      REQUIRE(std::abs(command.linear) <= config.max_speed);
      REQUIRE(std::abs(command.angular) <= config.max_turn_rate);
      const double dt = std::min(0.1, std::chrono::duration<double>(i == 0 ? milliseconds(20) : step).count());
      // 1e-12: rounding of the sum.
      REQUIRE(std::abs(command.linear) <= std::abs(last.linear) + config.acceleration * dt + 1e-12);
      REQUIRE(std::abs(command.angular) <= std::abs(last.angular) + config.turn_acceleration * dt + 1e-12);
      // A change of direction goes through zero.
      if (command.linear * last.linear < 0.0) {
        REQUIRE(std::abs(command.linear) <= config.acceleration * dt + 1e-12);
      }
      if (!is_finite(wanted)) REQUIRE(command == Twist2{});
      if (!inputs.odometry_time || now - *inputs.odometry_time > milliseconds(100)) REQUIRE(command == Twist2{});
      if (inputs.need == FrameNeed::sightings && now - *inputs.sighting_time > milliseconds(330)) {
        REQUIRE(command == Twist2{});
      }
      latched = latched || result.fault.has_value();
      if (latched) REQUIRE(command == Twist2{});
      last = command;
    }
  }
}

TEST_CASE("frames: full speed to 150 ms beyond the declared latency, half to 250 ms, then none") {
  nanoseconds now{0};
  const CommandGate moving = gate_at(0.1, now);
  const auto speed_at = [&](int age_ms, FrameNeed need) {
    CommandGate gate = moving;
    GateInputs inputs = fresh(now + milliseconds(20), 0.1);
    inputs.need = need;
    inputs.sighting_time = inputs.now - milliseconds(age_ms);
    inputs.frame_time = inputs.now - milliseconds(age_ms);
    return gate.pass({0.1, 0.0}, inputs).command.linear;
  };
  for (const FrameNeed need : {FrameNeed::frames, FrameNeed::sightings}) {
    CHECK(speed_at(80, need) == 0.1);
    CHECK(speed_at(80 + 150, need) == 0.1);
    CHECK(speed_at(80 + 151, need) == 0.05);
    CHECK(speed_at(80 + 250, need) == 0.05);
    CHECK(speed_at(80 + 251, need) == 0.0);
  }
  CHECK(speed_at(5000, FrameNeed::none) == 0.1);
}

TEST_CASE("odometry: motion to 100 ms, none beyond, and without any") {
  nanoseconds now{0};
  const CommandGate moving = gate_at(0.1, now);
  const auto speed_at = [&](std::optional<int> age_ms) {
    CommandGate gate = moving;
    GateInputs inputs = fresh(now + milliseconds(20), 0.1);
    inputs.odometry_time.reset();
    if (age_ms) inputs.odometry_time = inputs.now - milliseconds(*age_ms);
    return gate.pass({0.1, 0.0}, inputs).command.linear;
  };
  CHECK(speed_at(100) == 0.1);
  CHECK(speed_at(101) == 0.0);
  CHECK(speed_at(std::nullopt) == 0.0);
}

TEST_CASE("slowing down is never delayed") {
  nanoseconds now{0};
  CommandGate gate = gate_at(0.2, now);
  const GateResult result = gate.pass({0.01, 0.0}, fresh(now + milliseconds(20), 0.2));
  CHECK(result.command.linear == 0.01);
  CHECK(gate.pass({}, fresh(now + milliseconds(40), 0.1)).command == Twist2{});
}

TEST_CASE("a speed above the limit is cut with its turn rate, so the curve stays the same") {
  nanoseconds now{0};
  CommandGate gate = gate_at(0.2, now);
  for (int i = 0; i < 50; ++i) {
    now += milliseconds(20);
    gate.pass({0.4, 0.2}, fresh(now, 0.2));
  }
  CHECK(gate.last().linear == Approx(0.2));
  CHECK(gate.last().angular == Approx(0.1));
}

TEST_CASE("a latched stop stays, with the first reason") {
  nanoseconds now{0};
  CommandGate gate = gate_at(0.1, now);
  gate.latch({Cause::robot_link, "first"});
  gate.latch({Cause::stalled, "second"});
  for (int i = 0; i < 10; ++i) {
    now += milliseconds(20);
    const GateResult result = gate.pass({0.1, 0.1}, fresh(now));
    CHECK(result.command == Twist2{});
    REQUIRE(result.fault);
    CHECK(result.fault->sentence == "first");
  }
}

TEST_CASE("wheels that do not turn when told to are a stall; starting up is none") {
  CommandGate gate(CommandGateConfig{});
  nanoseconds now{0};
  std::optional<nanoseconds> stalled;
  for (int i = 0; i < 100 && !stalled; ++i) {
    now += milliseconds(20);
    if (gate.pass({0.1, 0.0}, fresh(now, 0.0)).fault) stalled = now;
  }
  REQUIRE(stalled);
  CHECK(*stalled > milliseconds(700));
  CHECK(*stalled < milliseconds(1000));

  CommandGate good(CommandGateConfig{});
  nanoseconds time{0};
  double wheel = 0.0;
  for (int i = 0; i < 100; ++i) {
    time += milliseconds(20);
    const GateResult result = good.pass({0.1, 0.0}, fresh(time, wheel));
    CHECK_FALSE(result.fault);
    if (i > 20) wheel += 0.1 * (result.command.linear - wheel);  // a drive that takes 0.6 s to answer
  }
}

TEST_CASE("odometry readings: what the robot can do passes, what it cannot is named") {
  const OdometryLimits limits;
  const Odometry before{milliseconds(1000), {1.0, 2.0, 0.5}, {0.2, 0.1}};
  Odometry next{milliseconds(1020), Pose2{1.0, 2.0, 0.5} * Pose2{0.004, 0.0, 0.002}, {0.2, 0.1}};
  CHECK_FALSE(odometry_fault(before, next, limits));
  CHECK_FALSE(odometry_fault(std::nullopt, next, limits));
  const auto cause = [&](const Odometry& reading) {
    const std::optional<Reason> fault = odometry_fault(before, reading, limits);
    REQUIRE(fault);
    return fault->cause;
  };
  Odometry bad = next;
  bad.T_odom_base.y = std::numeric_limits<double>::quiet_NaN();
  CHECK(cause(bad) == Cause::odometry_invalid);
  bad = next;
  bad.velocity.angular = -std::numeric_limits<double>::infinity();
  CHECK(cause(bad) == Cause::odometry_invalid);
  bad = next;
  bad.time = milliseconds(999);
  CHECK(cause(bad) == Cause::odometry_invalid);
  bad = next;
  bad.T_odom_base = {};  // reset to zero
  CHECK(cause(bad) == Cause::odometry_jump);
  bad = next;
  bad.T_odom_base.yaw += 0.2;
  CHECK(cause(bad) == Cause::odometry_jump);
  bad = next;
  bad.T_odom_base.yaw += 2.0 * std::numbers::pi;  // the same heading, counted differently
  CHECK_FALSE(odometry_fault(before, bad, limits));
}

TEST_CASE("limits that no docking may have are refused by name") {
  CommandGateConfig config;
  config.max_speed = 0.31;
  CHECK_THROWS_WITH(CommandGate(config), Catch::Contains("gate.max_speed"));
  config = {};
  config.acceleration = std::numeric_limits<double>::quiet_NaN();
  CHECK_THROWS_WITH(CommandGate(config), Catch::Contains("gate.acceleration"));
  config = {};
  config.hold_age = milliseconds(10);
  CHECK_THROWS_WITH(CommandGate(config), Catch::Contains("hold_age"));
}
