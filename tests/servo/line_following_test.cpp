#include "servo/line_following.h"

#include <cmath>

#include <catch2/catch.hpp>

using namespace tagdock;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

namespace {

// The line is the x axis, the goal the origin.
const LineTarget target{{0.0, 0.0, 0.0}, 0.35, 0.48, 0.6};

// The board stands 1.35 m behind the axle's goal; the goal frame is the station frame moved by that.
LineTarget station_target() {
  LineTarget result = target;
  result.T_station_goal = {-1.35, 0.0, 0.0};
  return result;
}

struct Ride {
  std::vector<double> distance, lateral, heading;
  Pose2 end;
  double top_speed = 0.0;
  bool reached = false;
  nanoseconds time{0};
};

Ride ride(Pose2 pose, bool forward, double camera_distance, const LineLawConfig& config, double speed_limit = 1.0) {
  constexpr nanoseconds step = milliseconds(20);
  constexpr double dt = 0.02;
  Ride result;
  Twist2 last;
  double driven = 0.0;
  for (int i = 0; i < 5000; ++i) {
    const LineCommand line =
        forward ? follow_line(station_target(), pose, last, last.linear, step, false, config)
                : back_along_line(station_target(), pose, camera_distance, last, last.linear, step, config);
    result.distance.push_back(driven);
    result.lateral.push_back(line.lateral);
    result.heading.push_back(line.heading);
    if (line.reached) {
      result.reached = true;
      break;
    }
    last = line.command;
    last.linear = std::clamp(last.linear, -speed_limit, speed_limit);
    result.top_speed = std::max(result.top_speed, std::abs(last.linear));
    const double distance = last.linear * dt;
    const double turn = last.angular * dt;
    pose = pose * Pose2{distance * std::cos(0.5 * turn), distance * std::sin(0.5 * turn), turn};
    driven += std::abs(distance);
    result.time += step;
  }
  result.end = between(station_target().T_station_goal, pose);
  return result;
}

}  // namespace

TEST_CASE("lateral error decays with the double pole 1/L over distance, forward and in reverse, at any speed") {
  LineLawConfig config;
  config.turning_speed = 1e-6;  // the law itself, without its floor for the turn rate
  for (const bool forward : {true, false}) {
    for (const double speed : {0.15, 0.05}) {
      CAPTURE(forward, speed);
      config.max_speed = speed;
      config.acceleration = 1e3;  // starts at full speed
      // From rest the first centimetres would be at no speed; small errors keep the law linear.
      const double y0 = 0.005;
      const double psi0 = forward ? -0.004 : 0.004;
      const Ride driven =
          forward ? ride({-1.35 - 2.0, y0, psi0}, true, 0.0, config) : ride({-1.35, y0, psi0}, false, 3.0, config);
      REQUIRE(driven.reached);
      for (std::size_t i = 0; i < driven.distance.size(); ++i) {
        const double expected = lateral_left(y0, forward ? psi0 : -psi0, driven.distance[i], config.length);
        // 0.05 mm: one percent; a cycle of 3 mm against L = 0.4 m, and the sine of small headings.
        REQUIRE(std::abs(driven.lateral[i] - expected) < 5e-5);
      }
    }
  }
}

TEST_CASE("with castors that lag both poles stay at 1/L, whatever the lag") {
  // theta' = kappa, y' = theta - K kappa, integrated in steps of a tenth of a millimetre.
  for (const double lag : {0.0, 0.1, 0.2, 0.4}) {
    for (const double length : {0.2, 0.4}) {
      CAPTURE(lag, length);
      LineLawConfig law;
      law.length = length;
      law.lag = lag;
      law.max_curvature = 100.0;
      law.max_turn_rate = 100.0;
      LineTarget target;
      double y = 0.004;
      double theta = 0.002;
      const double y0 = y;
      const double theta0 = theta;
      constexpr double step = 1e-4;
      for (double driven = 0.0; driven < 1.0 - 1e-9; driven += step) {
        const Pose2 pose = target.T_station_goal * Pose2{-3.0, y, theta};
        const LineCommand line = follow_line(target, pose, {0.1, 0.0}, 0.1, milliseconds(1), false, law);
        const double curvature = line.command.angular / line.command.linear;
        y += step * (theta - lag * curvature);
        theta += step * curvature;
        const double expected = lateral_left(y0, theta0, driven + step, length, lag);
        REQUIRE(std::abs(y - expected) < 2e-5);
      }
    }
  }
}

TEST_CASE("the formula of what is left: its value, slope and double pole by algebra") {
  const double L = 0.4;
  CHECK(lateral_left(0.01, 0.02, 0.0, L) == Approx(0.01));
  CHECK(lateral_left(0.015, 0.0, 1.2, L) == Approx(0.015 * 4.0 * std::exp(-3.0)));  // the notes' 15 mm -> 3 mm
  constexpr double h = 1e-4;
  for (const double s : {0.1, 0.5, 1.0}) {
    const double y = lateral_left(0.01, 0.02, s, L);
    const double before = lateral_left(0.01, 0.02, s - h, L);
    const double after = lateral_left(0.01, 0.02, s + h, L);
    const double slope = (after - before) / (2.0 * h);
    const double bend = (after - 2.0 * y + before) / (h * h);
    CHECK(std::abs(bend + 2.0 / L * slope + y / (L * L)) < 1e-5);
  }
}

TEST_CASE("the goal is reached within half a millimetre and never passed, from rest and from full speed") {
  for (const double start : {-2.6, -1.9, -1.36}) {
    CAPTURE(start);
    LineLawConfig config;
    config.response_time = 0.0;  // this robot obeys at once
    const Ride driven = ride({start, 0.0, 0.0}, true, 0.0, config);
    REQUIRE(driven.reached);
    CHECK(driven.end.x <= 0.0);
    CHECK(driven.end.x > -0.001);
    CHECK(driven.top_speed <= 0.15);
  }
}

TEST_CASE("reached stays reached, and past the goal no motion is commanded") {
  const LineCommand past =
      follow_line(station_target(), {-1.30, 0.01, 0.02}, {0.1, 0.0}, 0.1, milliseconds(20), false, {});
  CHECK(past.reached);
  CHECK(past.command == Twist2{});
}

TEST_CASE("the back-off ends within a centimetre of its distance, on the line") {
  const Ride driven = ride({-1.35, 0.04, 0.03}, false, 2.5, {});
  REQUIRE(driven.reached);
  const double camera = -(Pose2{-1.35, 0.0, 0.0} * driven.end * Pose2{0.35, 0.0, 0.0}).x;
  // 1 cm is where it stops; the response time of 0.18 s at the speed there adds up to 6 mm before it.
  CHECK(camera < 2.505);
  CHECK(camera > 2.47);
  CHECK(std::abs(driven.end.y) < 0.011);  // 0.04 m over 1.5 m: (1 + 3.75) exp(-3.75) = 11 %, more for the heading
}

TEST_CASE("the heading never leaves what keeps the whole board in view") {
  const LineLawConfig config;
  for (const double y0 : {-0.3, 0.3, 0.6}) {
    CAPTURE(y0);
    const Ride driven = ride({-1.35 - 2.5, y0, 0.0}, true, 0.0, config);
    for (std::size_t i = 0; i < driven.heading.size(); ++i) {
      const double rest = 2.5 - driven.distance[i];
      const double allowed = heading_limit(station_target(), std::max(0.4, 1.0 + rest), config);
      REQUIRE(std::abs(driven.heading[i]) < allowed + 0.02);  // 0.02 rad: the law follows the sinking limit with L/2
    }
  }
}

TEST_CASE("heading limits are the notes' figures for a 55.6 degree lens and a board of 0.6 m") {
  LineTarget notes = station_target();
  notes.half_view = radians(27.8);
  const auto limit_deg = [&](double distance) { return degrees(heading_limit(notes, distance, {})); };
  CHECK(limit_deg(2.5) == Approx(18.0).margin(0.1));
  CHECK(limit_deg(2.0) == Approx(16.0).margin(0.5));
  CHECK(limit_deg(1.0) == Approx(8.0).margin(0.2));
  CHECK(limit_deg(0.4) == Approx(3.0).margin(0.01));
  CHECK(degrees(heading_limit(notes, 0.4, {}, true)) < 0.0);
  // A dock beside the board's middle has less.
  notes.T_station_goal.y = 0.2;
  CHECK(limit_deg(2.0) < 11.0);
}

TEST_CASE("three changes of side within a metre are swinging; slow ones and small ones are not") {
  const SwingConfig config;
  const auto run = [&](double wavelength, double amplitude) {
    SwingWatch seen;
    bool swung = false;
    for (double s = 0.0; s < 3.0; s += 0.003) {
      seen = watch(seen, s, amplitude * std::sin(2.0 * std::numbers::pi * s / wavelength), config);
      swung = swung || swings(seen, config);
    }
    return swung;
  };
  CHECK(run(0.6, radians(2.0)));
  CHECK_FALSE(run(0.6, radians(0.4)));
  CHECK_FALSE(run(2.0, radians(2.0)));
}

TEST_CASE("turned onto the line the law needs no more than the usual curvature and turn rate") {
  const LineLawConfig config;
  for (double y = -1.0; y <= 1.0; y += 0.1) {
    for (double psi = -1.0; psi <= 1.0; psi += 0.1) {
      const LineCommand line =
          follow_line(station_target(), {-3.0, y, psi}, {0.15, 0.0}, 0.15, milliseconds(20), false, config);
      REQUIRE(std::abs(line.command.angular) <= config.max_turn_rate);
      REQUIRE(std::abs(line.command.angular) <= config.max_curvature * 0.1501);
      REQUIRE(line.command.linear <= config.max_speed);
    }
  }
}
