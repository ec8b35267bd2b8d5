#include "servo/docking.h"

#include <algorithm>
#include <limits>
#include <set>
#include <utility>

#include <catch2/catch.hpp>

#include "docking_run.h"

using namespace tagdock;
using namespace tagdock::test;

namespace {

const Rig rig = default_rig();

// The usual start: 3.45 m, 5 degrees to the side, looking at the board to 1 degree.
Pose2 usual_start() { return start_pose(rig, 3.45, radians(5.0), radians(1.0)); }

Outcome docking(unsigned seed, const Fault& fault = {}, const DockingConfig& config = test_config(),
                const WorldConfig& physics = {}, const Pose2& start = usual_start()) {
  PlanarWorld world(rig, physics, start, seed);
  return run_docking(world, rig, config, physics, fault);
}

bool entered(const Outcome& outcome, std::string_view phase) {
  return std::find(outcome.phases.begin(), outcome.phases.end(), phase) != outcome.phases.end();
}

std::string story(const Outcome& outcome) {
  std::string all;
  for (const std::string& event : outcome.events) all += event + "\n";
  return all;
}

// What every run owes: only transitions of the table, commands within limits, and no wrong claim.
void check_promises(const Outcome& outcome, const DockingConfig& config) {
  for (std::size_t i = 1; i < outcome.phases.size(); ++i) {
    const std::string& from = outcome.phases[i - 1];
    const std::string& to = outcome.phases[i];
    const auto table = transitions();
    const bool known = std::any_of(table.begin(), table.end(), [&](const Transition& row) {
      return (row.from == from || row.from == "any") && row.to == to;
    });
    CAPTURE(from, to);
    CHECK(known);
  }
  for (const Twist2& command : outcome.commands) {
    REQUIRE(is_finite(command));
    REQUIRE(std::abs(command.linear) <= config.gate.max_speed);
    REQUIRE(std::abs(command.angular) <= config.gate.max_turn_rate);
  }
  if (is_over(outcome.phase)) CHECK(outcome.commands.back() == Twist2{});
  if (std::holds_alternative<Docked>(outcome.phase)) {
    // A claim of 3 mm and 0.5 degrees may be off by what the test's world hides from the fix: 0.05 px of corner bias,
    // which is some 0.4 mm in y at 1 m.
    CHECK(std::abs(outcome.true_error.x) < 0.0035);
    CHECK(std::abs(outcome.true_error.y) < 0.0035);
    CHECK(std::abs(outcome.true_error.yaw) < radians(0.55));
  }
}

Cause cause_of(const Outcome& outcome) {
  const std::optional<Reason> reason = reason_of(outcome.phase);
  REQUIRE(reason);
  INFO(reason->sentence);
  CHECK(reason->sentence.size() > 10);
  return reason->cause;
}

}  // namespace

TEST_CASE("twenty robots that slip, lag and drift dock within 10 mm and 1 degree from 3.45 m") {
  int first_attempts = 0;
  for (unsigned seed = 1; seed <= 20; ++seed) {
    CAPTURE(seed);
    const Outcome outcome = docking(seed);
    INFO(story(outcome));
    check_promises(outcome, test_config());
    REQUIRE(name(outcome.phase) == "docked");
    CHECK(std::abs(outcome.true_error.x) < 0.010);
    CHECK(std::abs(outcome.true_error.y) < 0.010);
    CHECK(std::abs(outcome.true_error.yaw) < radians(1.0));
    CHECK(outcome.time < std::chrono::seconds(30));
    if (job_of(outcome.phase).attempts == 1) ++first_attempts;
  }
  CHECK(first_attempts == 20);
}

TEST_CASE("the fix that is reported agrees with the truth within its own three sigma and a tenth of a millimetre") {
  for (unsigned seed = 21; seed <= 30; ++seed) {
    CAPTURE(seed);
    const Outcome outcome = docking(seed);
    const Docked* docked = std::get_if<Docked>(&outcome.phase);
    REQUIRE(docked != nullptr);
    const Eigen::Vector3d sigma = docked->fix.covariance.diagonal().cwiseSqrt();
    // 0.1 mm and 0.01 degrees: what the robot creeps on while its wheels count as still.
    CHECK(std::abs(docked->fix.error.x - outcome.true_error.x) < 3.0 * sigma.x() + 1e-4);
    CHECK(std::abs(docked->fix.error.y - outcome.true_error.y) < 3.0 * sigma.y() + 1e-4);
    CHECK(std::abs(docked->fix.error.yaw - outcome.true_error.yaw) < 3.0 * sigma.z() + radians(0.01));
    CHECK(docked->fix.sightings == 20);
  }
}

TEST_CASE("the same world gives bit-equal commands") {
  const Outcome first = docking(7);
  const Outcome second = docking(7);
  CHECK(first.commands == second.commands);
  CHECK(first.events == second.events);
  CHECK(first.true_error == second.true_error);
}

TEST_CASE("starts to both sides, near the axis, turned away and far off all dock or say why") {
  struct Start {
    double range, bearing_deg, heading_deg;
  };
  for (const Start& start :
       {Start{3.45, -5.0, 1.0}, Start{3.45, 0.0, 0.0}, Start{3.45, 1.0, -2.0}, Start{3.85, 5.0, 12.0},
        Start{3.45, -8.0, -15.0}, Start{2.6, 1.0, 0.0}, Start{4.2, 4.0, 0.0}}) {
    CAPTURE(start.range, start.bearing_deg, start.heading_deg);
    const Outcome outcome =
        docking(11, {}, test_config(), {},
                start_pose(rig, start.range, radians(start.bearing_deg), radians(start.heading_deg)));
    INFO(story(outcome));
    check_promises(outcome, test_config());
    CHECK(name(outcome.phase) == "docked");
  }
}

TEST_CASE("with tagdock's own planner the robot docks from both sides, and from the paper's start by a back-off") {
  struct Start {
    double range, bearing_deg;
  };
  for (const Start& start :
       {Start{3.45, 5.0}, Start{3.45, -5.0}, Start{3.45, 3.0}, Start{3.85, 8.0}, Start{3.45, 26.0}}) {
    CAPTURE(start.range, start.bearing_deg);
    const Outcome outcome =
        docking(17, {}, DockingConfig{}, {}, start_pose(rig, start.range, radians(start.bearing_deg)));
    INFO(story(outcome));
    check_promises(outcome, DockingConfig{});
    CHECK(name(outcome.phase) == "docked");
  }
}

TEST_CASE("from the paper's start the robot drives in blind, backs off and docks on the line") {
  const Outcome outcome = docking(12, {}, test_config(), {}, start_pose(rig, 3.45, radians(26.0)));
  INFO(story(outcome));
  check_promises(outcome, test_config());
  CHECK(entered(outcome, "backing off"));
  CHECK(name(outcome.phase) == "docked");
}

TEST_CASE("where the start leaves room the castors get a straight run first") {
  const Outcome outcome = docking(13, {}, test_config(), {}, start_pose(rig, 5.0, radians(3.0)));
  INFO(story(outcome));
  check_promises(outcome, test_config());
  CHECK(entered(outcome, "castor run-in"));
  CHECK(name(outcome.phase) == "docked");
}

TEST_CASE("a latency of 250 ms docks, declared or measured at standstill; one of 400 ms is refused by name") {
  WorldConfig physics;
  physics.latency = milliseconds(250);
  DockingConfig declared = test_config();
  declared.gate.declared_latency = milliseconds(250);
  const Outcome docks = docking(14, {}, declared, physics);
  INFO(story(docks));
  check_promises(docks, declared);
  CHECK(name(docks.phase) == "docked");
  const Outcome measured = docking(14, {}, test_config(), physics);
  INFO(story(measured));
  check_promises(measured, test_config());
  CHECK(name(measured.phase) == "docked");

  physics.latency = milliseconds(400);
  const Outcome refused = docking(14, {}, test_config(), physics);
  CHECK(name(refused.phase) == "failed");
  CHECK(cause_of(refused) == Cause::camera_slow);
}

TEST_CASE("stop points do not move with the latency, once it is declared") {
  // 0.5 mm: a fifth of the tolerance. The same seeds; a stop that used sightings as if they were new would move by
  // 0.15 m/s times the latency.
  for (const unsigned seed : {31U, 32U, 33U}) {
    std::vector<double> stops;
    for (const auto latency : {milliseconds(0), milliseconds(80), milliseconds(250)}) {
      WorldConfig physics;
      physics.latency = latency;
      physics.noise_px = 0.02;
      physics.bias_px = 0.0;
      DockingConfig config = test_config();
      config.gate.declared_latency = latency;
      const Outcome outcome = docking(seed, {}, config, physics);
      REQUIRE(name(outcome.phase) == "docked");
      stops.push_back(outcome.true_error.x);
    }
    CAPTURE(seed, stops[0], stops[1], stops[2]);
    CHECK(std::abs(stops[1] - stops[0]) < 0.0005);
    CHECK(std::abs(stops[2] - stops[0]) < 0.0005);
  }
}

TEST_CASE("a third of the frames lost does not keep the robot from docking") {
  std::mt19937 random(5);
  const Fault fault = [&](Tick& tick, PlanarWorld&, const Docker&) {
    if (random() % 3 == 0) tick.sighting.reset();
  };
  const Outcome outcome = docking(15, fault);
  INFO(story(outcome));
  check_promises(outcome, test_config());
  CHECK(name(outcome.phase) == "docked");
}

TEST_CASE("ViSP's centring law brings the robot to the dock's distance with the board ahead") {
  DockingConfig config = test_config();
  config.servo.law = ServoLaw::centering;
  // Lateral error and heading are whatever the entry left: this law is for docks that need no heading.
  config.fix.tolerance_x = 0.010;
  config.fix.tolerance_y = 0.010;
  config.fix.tolerance_yaw = radians(1.0);
  const Outcome outcome = docking(16, {}, config);
  INFO(story(outcome));
  CHECK(name(outcome.phase) == "docked");
  CHECK(std::abs(outcome.true_error.x) < 0.010);
}

// ------------------------------------------------------------------------------------------------ stops and failures

TEST_CASE("no tag ever in view: the robot looks around, and fails with that reason") {
  const Fault fault = [](Tick& tick, PlanarWorld&, const Docker&) {
    if (tick.sighting) tick.sighting.emplace(Unseen::no_tag);
  };
  const Outcome outcome = docking(1, fault);
  CHECK(name(outcome.phase) == "failed");
  CHECK(cause_of(outcome) == Cause::tag_never_seen);
  double widest = 0.0;
  for (const Twist2& command : outcome.commands) {
    CHECK(command.linear == 0.0);
    widest = std::max(widest, std::abs(command.angular));
  }
  CHECK(widest > 0.1);  // it did sweep
}

TEST_CASE("tags of another station are refused by name") {
  const Fault fault = [](Tick& tick, PlanarWorld&, const Docker&) {
    if (tick.sighting) tick.sighting.emplace(Unseen::other_tags);
  };
  const Outcome outcome = docking(1, fault);
  CHECK(name(outcome.phase) == "failed");
  CHECK(cause_of(outcome) == Cause::wrong_tags);

  // Also where the time is over first, as with a robot that cannot look around.
  DockingConfig config = test_config();
  config.acquire.timeout = std::chrono::seconds(4);
  CHECK(cause_of(docking(1, fault, config)) == Cause::wrong_tags);
}

TEST_CASE("a board out of view at first is found by the sweep") {
  const Outcome outcome = docking(1, {}, test_config(), {}, start_pose(rig, 3.45, radians(4.0), radians(30.0)));
  INFO(story(outcome));
  CHECK(name(outcome.phase) == "docked");
}

TEST_CASE("a camera that dies while the robot drives: held within 250 ms, given up within 5 s with that reason") {
  for (const std::string phase : {"following", "servoing"}) {
    CAPTURE(phase);
    std::optional<nanoseconds> died;
    double speed_late = 0.0;
    const Fault fault = [&](Tick& tick, PlanarWorld& world, const Docker& docker) {
      if (!died && name(docker.phase()) == phase && world.velocity().linear > 0.1) died = tick.now;
      if (!died) return;
      tick.sighting.reset();
      tick.camera_sentence = "the stream ended";
      // Held after 250 ms beyond the declared 80 ms; one frame period and the drive's response later it stands.
      if (tick.now - *died > milliseconds(1200) && tick.now - *died < milliseconds(2500)) {
        speed_late = std::max(speed_late, std::abs(world.velocity().linear));
      }
    };
    const Outcome outcome = docking(2, fault);
    INFO(story(outcome));
    CHECK(name(outcome.phase) == "failed");
    CHECK(cause_of(outcome) == Cause::camera_lost);
    CHECK(speed_late < 0.005);
    REQUIRE(died);
    CHECK(outcome.time - *died < milliseconds(5600));
    check_promises(outcome, test_config());
  }
}

TEST_CASE(
    "frames that stay away while a path is driven: the path waits for the robot, which docks at the first attempt") {
  for (const int missing_ms : {1000, 2000, 4000}) {
    CAPTURE(missing_ms);
    for (unsigned seed = 2; seed < 5; ++seed) {
      CAPTURE(seed);
      std::optional<nanoseconds> gone;
      const Fault fault = [&](Tick& tick, PlanarWorld& world, const Docker& docker) {
        if (!gone && name(docker.phase()) == "following" && world.velocity().linear > 0.19) gone = tick.now;
        if (gone && tick.now - *gone < milliseconds(missing_ms)) tick.sighting.reset();
      };
      const Outcome outcome = docking(seed, fault);
      INFO(story(outcome));
      CHECK(gone);
      CHECK(name(outcome.phase) == "docked");
      CHECK(job_of(outcome.phase).attempts == 1);
      check_promises(outcome, test_config());
    }
  }
}

TEST_CASE("no frame at all from the camera: given up after 5 s") {
  const Fault fault = [](Tick& tick, PlanarWorld&, const Docker&) { tick.sighting.reset(); };
  const Outcome outcome = docking(2, fault);
  CHECK(cause_of(outcome) == Cause::camera_lost);
  CHECK(outcome.time < std::chrono::seconds(6));
}

TEST_CASE("the board covered on the line: the robot holds, backs off, and docks when it is free again") {
  std::optional<nanoseconds> covered;
  const Fault fault = [&](Tick& tick, PlanarWorld& world, const Docker& docker) {
    if (!covered && name(docker.phase()) == "servoing" && world.pose().x > -1.8) covered = tick.now;
    world.hidden = covered && tick.now - *covered < milliseconds(5000);
  };
  const Outcome outcome = docking(3, fault);
  INFO(story(outcome));
  check_promises(outcome, test_config());
  CHECK(entered(outcome, "backing off"));
  CHECK(name(outcome.phase) == "docked");
  CHECK(job_of(outcome.phase).attempts == 2);
}

TEST_CASE("the board covered for good: failed with the first cause") {
  const Fault fault = [](Tick&, PlanarWorld& world, const Docker& docker) {
    if (name(docker.phase()) == "servoing") world.hidden = true;
  };
  const Outcome outcome = docking(3, fault);
  INFO(story(outcome));
  check_promises(outcome, test_config());
  CHECK(name(outcome.phase) == "failed");
  CHECK(cause_of(outcome) == Cause::tag_lost);
}

TEST_CASE("odometry that is not a number stops the robot at once") {
  for (const int field : {0, 1, 2, 3}) {
    CAPTURE(field);
    std::optional<nanoseconds> broke;
    const Fault fault = [&](Tick& tick, PlanarWorld&, const Docker& docker) {
      if (name(docker.phase()) != "following" || seconds(tick.now) < 5.0) return;
      broke = broke.value_or(tick.now);
      Odometry& reading = tick.odometry.back();
      const double bad =
          field == 3 ? std::numeric_limits<double>::infinity() : std::numeric_limits<double>::quiet_NaN();
      (field == 0   ? reading.T_odom_base.x
       : field == 1 ? reading.T_odom_base.yaw
       : field == 2 ? reading.velocity.linear
                    : reading.velocity.angular) = bad;
    };
    const Outcome outcome = docking(4, fault);
    CHECK(name(outcome.phase) == "stopped");
    CHECK(cause_of(outcome) == Cause::odometry_invalid);
    CHECK(outcome.time == broke);  // in the very cycle
    CHECK(outcome.commands.back() == Twist2{});
    check_promises(outcome, test_config());
  }
}

TEST_CASE("every other fault stops the robot with its reason") {
  struct Case {
    Cause cause;
    std::function<void(Tick&, PlanarWorld&)> fault;
  };
  const std::vector<Case> cases = {
      {Cause::odometry_jump, [](Tick& tick, PlanarWorld&) { tick.odometry.back().T_odom_base.x += 0.1; }},
      {Cause::odometry_jump, [](Tick& tick, PlanarWorld&) { tick.odometry.back().T_odom_base.yaw += 0.3; }},
      {Cause::odometry_invalid, [](Tick& tick, PlanarWorld&) { tick.odometry.back().time -= milliseconds(100); }},
      {Cause::robot_link, [](Tick& tick, PlanarWorld&) { tick.odometry.clear(); }},
      {Cause::robot_link, [](Tick& tick, PlanarWorld&) { tick.robot_linked = false; }},
      {Cause::stopped_by_person, [](Tick& tick, PlanarWorld&) { tick.request = Request::stop; }},
      {Cause::stalled, [](Tick& tick, PlanarWorld&) { tick.odometry.back().velocity = {}; }},
  };
  for (std::size_t i = 0; i < cases.size(); ++i) {
    CAPTURE(i);
    std::optional<nanoseconds> began;
    const Fault fault = [&](Tick& tick, PlanarWorld& world, const Docker& docker) {
      if (!began && name(docker.phase()) == "following" && world.velocity().linear > 0.15) began = tick.now;
      if (began) cases[i].fault(tick, world);
    };
    const Outcome outcome = docking(5, fault);
    INFO(story(outcome));
    CHECK(name(outcome.phase) == "stopped");
    CHECK(cause_of(outcome) == cases[i].cause);
    REQUIRE(began);
    // The stall is watched for 0.7 s, the silent link for 0.2 s; the rest stops in the cycle that saw it.
    CHECK(outcome.time - *began < milliseconds(800));
    check_promises(outcome, test_config());
    // From 0.2 m/s: dead time, lag and 0.3 m/s^2 need 0.15 m.
    CHECK(std::hypot(outcome.rest.x, outcome.rest.y) < 0.15);
  }
}

TEST_CASE("a wheel that spins while the robot drives stops it within 0.3 m, with that reason") {
  std::optional<nanoseconds> began;
  double slipped = 0.0;
  const Fault fault = [&](Tick& tick, PlanarWorld& world, const Docker& docker) {
    if (!began && name(docker.phase()) == "servoing" && world.velocity().linear > 0.1) began = tick.now;
    if (!began) return;
    const double way = 0.02 * world.velocity().linear;  // of one tick
    slipped += way;
    world.shift({0.0, 0.0, way});  // 1 rad per metre that the encoders do not see
  };
  const Outcome outcome = docking(5, fault);
  INFO(story(outcome));
  CHECK(name(outcome.phase) == "stopped");
  CHECK(cause_of(outcome) == Cause::slipped);
  check_promises(outcome, test_config());
  CHECK(slipped < 0.3);
}

TEST_CASE("odometry that keeps coming but is old: no motion after 100 ms, stopped after 200 ms") {
  std::optional<Odometry> frozen;
  std::optional<nanoseconds> began;
  const Fault fault = [&](Tick& tick, PlanarWorld& world, const Docker& docker) {
    if (!frozen && name(docker.phase()) == "following" && world.velocity().linear > 0.15) {
      frozen = tick.odometry.back();
      began = tick.now;
    }
    if (!frozen) return;
    frozen->time += milliseconds(1);  // runs twenty times too slow
    tick.odometry = {*frozen};
  };
  const Outcome outcome = docking(5, fault);
  CHECK(name(outcome.phase) == "stopped");
  CHECK(cause_of(outcome) == Cause::odometry_stale);
  CHECK(outcome.time - *began < milliseconds(260));
  CHECK(outcome.commands[outcome.commands.size() - 4] == Twist2{});
}

TEST_CASE("a robot without odometry from the start is a broken link") {
  const Fault fault = [](Tick& tick, PlanarWorld&, const Docker&) { tick.odometry.clear(); };
  const Outcome outcome = docking(5, fault);
  CHECK(cause_of(outcome) == Cause::robot_link);
  CHECK(outcome.time < milliseconds(2100));
}

TEST_CASE("a robot that is pushed aside loses its estimate, finds it again at rest and docks or fails, never claims") {
  for (const double push : {0.08, 0.3}) {
    CAPTURE(push);
    bool pushed = false;
    const Fault fault = [&](Tick&, PlanarWorld& world, const Docker& docker) {
      if (!pushed && name(docker.phase()) == "servoing" && world.pose().x > -2.0) {
        world.shift({0.0, push, 0.0});
        pushed = true;
      }
    };
    const Outcome outcome = docking(6, fault);
    INFO(story(outcome));
    CHECK(pushed);
    CHECK(is_over(outcome.phase));
    check_promises(outcome, test_config());
  }
}

TEST_CASE("a tolerance that cannot be met fails with that reason after three attempts") {
  DockingConfig config = test_config();
  config.fix.tolerance_y = 1e-6;
  const Outcome outcome = docking(8, {}, config);
  INFO(story(outcome));
  CHECK(name(outcome.phase) == "failed");
  CHECK(cause_of(outcome) == Cause::outside_tolerance);
  CHECK(job_of(outcome.phase).attempts == 3);
  REQUIRE(std::get<Failed>(outcome.phase).fix);
  check_promises(outcome, config);
}

TEST_CASE("what repeats itself is missed once and hit by the second attempt") {
  // 0.1 rad of pull per metre leave 0.1 * 0.2^2 m = 4 mm beside the line (notes on docking, 5.3), in every attempt that
  // does not learn from the last one.
  WorldConfig physics;
  physics.drift = 0.1;
  DockingConfig stubborn = test_config();
  stubborn.back_off.learning = 0.0;
  for (const unsigned seed : {1U, 2U, 3U}) {
    CAPTURE(seed);
    const Outcome learns = docking(seed, {}, test_config(), physics);
    INFO(story(learns));
    check_promises(learns, test_config());
    CHECK(name(learns.phase) == "docked");
    CHECK(job_of(learns.phase).attempts == 2);
    const Outcome repeats = docking(seed, {}, stubborn, physics);
    CHECK(name(repeats.phase) == "failed");
    CHECK(cause_of(repeats) == Cause::outside_tolerance);
  }
}

TEST_CASE("no path: the reason is the planner's") {
  DockingConfig config = test_config();
  config.planner = [](const Pose2&, const Pose2&) -> std::variant<Path, std::string> { return "walls everywhere"; };
  const Outcome outcome = docking(8, {}, config);
  CHECK(cause_of(outcome) == Cause::no_plan);
  CHECK(reason_of(outcome.phase)->sentence.find("walls everywhere") != std::string::npos);
}

TEST_CASE("a dock from which the sensor cannot tell the pose as well as the tolerance asks is refused when planning") {
  DockingConfig config = test_config();
  SensorErrors sensor;
  sensor.distances = {0.8, 6.0};
  sensor.bearings = {0.0, radians(60.0)};
  sensor.places = {0.0, 0.9};
  sensor.cells.assign(8, SensorErrors::Sigma{0.0005, 0.001, radians(0.1)});
  config.filter.sensor = sensor;
  const Rig rig = default_rig();
  PlanarWorld able(rig, {}, start_pose(rig, 3.45, radians(5.0)), 2);
  CHECK(name(run_docking(able, rig, config, {}).phase) == "docked");

  config.filter.sensor->cells.assign(8, SensorErrors::Sigma{0.0005, 0.006, radians(0.1)});
  PlanarWorld unable(rig, {}, start_pose(rig, 3.45, radians(5.0)), 2);
  const Outcome outcome = run_docking(unable, rig, config, {});
  INFO(story(outcome));
  CHECK(cause_of(outcome) == Cause::no_plan);
  CHECK_THAT(reason_of(outcome.phase)->sentence, Catch::Matchers::Contains("6.0 mm"));
  for (const std::string& phase : outcome.phases) CHECK(phase != "following");  // nothing was driven
}

TEST_CASE("sightings too noisy to plan on are refused by name") {
  WorldConfig physics;
  physics.noise_px = 3.0;
  DockingConfig config = test_config();
  config.acquire.max_sigma_y = 0.002;
  const Outcome outcome = docking(9, {}, config, physics);
  CHECK(cause_of(outcome) == Cause::pose_uncertain);
}

TEST_CASE("paused in any phase the robot stands, resumed it docks") {
  for (const std::string phase : {"acquiring", "following", "servoing", "fixing"}) {
    CAPTURE(phase);
    std::optional<nanoseconds> paused;
    double late_speed = 0.0;
    const Fault fault = [&](Tick& tick, PlanarWorld& world, const Docker& docker) {
      if (!paused && name(docker.phase()) == phase && seconds(tick.now) > 1.0 &&
          (world.velocity().linear > 0.12 || phase == "acquiring" || phase == "fixing")) {
        paused = tick.now;
        tick.request = Request::pause;
      }
      if (!paused) return;
      if (tick.now - *paused > milliseconds(1500) && tick.now - *paused < milliseconds(3000)) {
        late_speed = std::max(late_speed, std::abs(world.velocity().linear));
      }
      if (tick.now - *paused == milliseconds(3000)) tick.request = Request::resume;
    };
    const Outcome outcome = docking(10, fault);
    INFO(story(outcome));
    CHECK(entered(outcome, "paused"));
    CHECK(late_speed < 0.005);
    CHECK(name(outcome.phase) == "docked");
    check_promises(outcome, test_config());
  }
}

TEST_CASE("paused on the way out of the station the robot goes on out of it, and is not asked whether it is docked") {
  DockingConfig config = test_config();
  config.errand = Errand::undock;
  std::optional<nanoseconds> paused;
  const Fault fault = [&](Tick& tick, PlanarWorld& world, const Docker& docker) {
    if (!paused && name(docker.phase()) == "undocking" && world.velocity().linear < -0.05 && world.pose().x < -1.8) {
      paused = tick.now;
      tick.request = Request::pause;
    }
    if (paused && tick.now - *paused == milliseconds(3000)) tick.request = Request::resume;
  };
  const Outcome outcome = docking(10, fault, config, {}, goal_of_axle(config));
  INFO(story(outcome));
  CHECK(outcome.phases == std::vector<std::string>{"acquiring", "undocking", "paused", "undocking", "undocked"});
  check_promises(outcome, config);
}

TEST_CASE("paused on the way to the safe pose the robot still gives up there, and keeps what it measured") {
  DockingConfig config = test_config();
  config.fix.tolerance_y = 1e-6;
  config.back_off.safe_pose = true;
  config.back_off.retries = 0;
  std::optional<nanoseconds> paused;
  const Fault fault = [&](Tick& tick, PlanarWorld& world, const Docker& docker) {
    if (!paused && name(docker.phase()) == "backing off" && world.velocity().linear < -0.05) {
      paused = tick.now;
      tick.request = Request::pause;
    }
    if (paused && tick.now - *paused == milliseconds(3000)) tick.request = Request::resume;
  };
  const Outcome outcome = docking(8, fault, config);
  INFO(story(outcome));
  REQUIRE(outcome.phases.size() > 4);
  CHECK(std::vector<std::string>(outcome.phases.end() - 4, outcome.phases.end()) ==
        std::vector<std::string>{"backing off", "paused", "backing off", "failed"});
  CHECK(cause_of(outcome) == Cause::outside_tolerance);
  CHECK(outcome.true_error.x == Approx(1.0 - config.back_off.camera_distance).margin(0.03));
  REQUIRE(std::get<Failed>(outcome.phase).fix);
  CHECK(std::abs(std::get<Failed>(outcome.phase).fix->error.y) < 0.010);
}

TEST_CASE("paths that can only be driven blind, and never end on the line, come to an end") {
  DockingConfig config = test_config();
  config.entry.lateral_left = 1e-9;  // no entry is ever good
  config.planner = [&](const Pose2& from, const Pose2& to) -> std::variant<Path, std::string> {
    if (to.x < goal_of_axle(config).x - 0.3) return std::string("no room");
    return s_curve(from, to);
  };
  const Outcome outcome = docking(8, {}, config);
  INFO(story(outcome));
  CHECK(cause_of(outcome) == Cause::no_plan);
  CHECK(std::count(outcome.phases.begin(), outcome.phases.end(), "following") <= 1 + config.back_off.retries);
}

TEST_CASE("cancelled: failed with that reason, the robot at rest") {
  const Fault fault = [](Tick& tick, PlanarWorld& world, const Docker&) {
    if (world.pose().x > -2.5) tick.request = Request::cancel;
  };
  const Outcome outcome = docking(10, fault);
  CHECK(cause_of(outcome) == Cause::cancelled);
  check_promises(outcome, test_config());
}

TEST_CASE("a robot that stands at the dock already is only measured") {
  const Outcome outcome = docking(10, {}, test_config(), {}, goal_of_axle(test_config()));
  CHECK(outcome.phases == std::vector<std::string>{"acquiring", "validating", "fixing", "docked"});
}

TEST_CASE("undocking drives straight back and rests out of the station; whoever is not docked is told so") {
  DockingConfig config = test_config();
  config.errand = Errand::undock;
  const Outcome outcome = docking(10, {}, config, {}, goal_of_axle(config));
  INFO(story(outcome));
  CHECK(outcome.phases == std::vector<std::string>{"acquiring", "undocking", "undocked"});
  check_promises(outcome, config);
  CHECK(outcome.true_error.x == Approx(1.0 - config.undock.camera_distance).margin(0.03));
  CHECK(std::abs(outcome.true_error.y) <
        0.02);  // straight: no wall of the station stands nearer than the line's own error
  for (const Twist2& command : outcome.commands) REQUIRE(command.linear <= 0.0);

  const Outcome elsewhere = docking(10, {}, config);
  CHECK(cause_of(elsewhere) == Cause::not_docked);
  CHECK(reason_of(elsewhere.phase)->sentence.find("does not stand at the dock: -2.4") != std::string::npos);
  for (const Twist2& command : elsewhere.commands) REQUIRE(command == Twist2{});
}

TEST_CASE("a board that hangs otherwise than when the docking pose was taught is no dock to claim") {
  DockingConfig config = test_config();
  const Outcome before = docking(10, {}, config);
  REQUIRE(std::holds_alternative<Docked>(before.phase));
  config.taught_hang = std::get<Docked>(before.phase).fix.hang;
  CHECK(std::holds_alternative<Docked>(docking(11, {}, config).phase));

  for (const BoardHang& change : {BoardHang{0.012, 0.0, 0.0}, BoardHang{0.0, 0.01, 0.0}, BoardHang{0.0, 0.0, -0.01}}) {
    CAPTURE(change.camera_height, change.roll, change.pitch);
    DockingConfig changed = config;
    changed.taught_hang->camera_height += change.camera_height;
    changed.taught_hang->roll += change.roll;
    changed.taught_hang->pitch += change.pitch;
    const Outcome outcome = docking(11, {}, changed);
    CHECK(cause_of(outcome) == Cause::dock_changed);
    check_promises(outcome, changed);
  }
}

TEST_CASE("after the last attempt the robot leaves the station's way if it is asked to") {
  DockingConfig config = test_config();
  config.fix.tolerance_y = 1e-6;
  config.back_off.safe_pose = true;
  const Outcome outcome = docking(8, {}, config);
  INFO(story(outcome));
  CHECK(cause_of(outcome) == Cause::outside_tolerance);
  CHECK(job_of(outcome.phase).attempts == 3);
  CHECK(outcome.true_error.x == Approx(1.0 - config.back_off.camera_distance).margin(0.03));
  check_promises(outcome, config);
}

TEST_CASE("settings that cannot work are refused with a sentence that names them") {
  const auto refusal = [](const std::function<void(DockingConfig&)>& change) {
    DockingConfig config = test_config();
    change(config);
    try {
      const Docker docker(rig, config);
    } catch (const std::invalid_argument& error) {
      return std::string(error.what());
    }
    return std::string("accepted");
  };
  CHECK(refusal([](DockingConfig&) {}) == "accepted");
  CHECK(refusal([](DockingConfig& config) { config.gate.max_speed = 0.5; }).find("gate.max_speed") == 0);
  CHECK(refusal([](DockingConfig& config) { config.line.max_speed = 0.5; }).find("line.max_speed") == 0);
  CHECK(refusal([](DockingConfig& config) { config.dock_pose.x = 1.0; }).find("docking pose") != std::string::npos);
  CHECK(refusal([](DockingConfig& config) { config.dock_pose.x = -0.4; }).find("view") != std::string::npos);
  CHECK(refusal([](DockingConfig& config) { config.segments.damping = 0.0; }).find("segments.damping") == 0);
  CHECK(refusal([](DockingConfig& config) { config.entry.min_run_in = 2.0; }).find("run_in.least_m") == 0);
}

TEST_CASE("the table of phases has every phase, and only phases that exist") {
  const std::set<std::string_view> names = {"acquiring", "castor run-in", "validating", "following", "servoing",
                                            "fixing",    "backing off",   "paused",     "docked",    "failed",
                                            "stopped",   "undocking",     "undocked"};
  std::set<std::string_view> reached;
  for (const Transition& row : transitions()) {
    CAPTURE(row.from, row.to);
    CHECK((row.from == "any" || names.count(row.from) == 1));
    CHECK(names.count(row.to) == 1);
    CHECK_FALSE(row.word.empty());
    reached.insert(row.to);
  }
  CHECK(reached == names);
}
