#include "app/step_response.h"

#include <filesystem>
#include <fstream>
#include <sstream>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "app/failure.h"

using namespace tagdock;

namespace {

StepResponseSettings with_dead_time(double dead_time) {
  StepResponseSettings settings;
  settings.drive.dead_time = dead_time;
  settings.runs = 2;
  return settings;
}

}  // namespace

TEST_CASE("dead time and lag of a drive are measured from its own odometry") {
  for (const double dead_time : {0.02, 0.06, 0.2}) {
    for (const double lag : {0.06, 0.12, 0.25}) {
      DriveScenario drive;
      drive.dead_time = dead_time;
      drive.lag = lag;
      const DriveLag measured = measure_drive(drive, 3);
      CAPTURE(dead_time, lag, measured.dead_time, measured.lag);
      // The robot is simulated in steps of 5 ms.
      CHECK(measured.dead_time == Approx(dead_time).margin(0.006));
      CHECK(measured.lag == Approx(lag).margin(0.006));
    }
  }
}

TEST_CASE("the heading swings without end above the damping that dead time and lag foretell, and dies down below it") {
  for (const double dead_time : {0.06, 0.12, 0.2}) {
    StepResponseSettings settings = with_dead_time(dead_time);
    settings.step = 0.002;  // m; so small that no command is cut
    const double foretold = swinging_damping(measure_drive(settings.drive, 1), 0.02);
    CAPTURE(dead_time, foretold);
    CHECK(step_response(settings, 0.8 * foretold, 1).swing < 0.3);
    CHECK(step_response(settings, 1.25 * foretold, 1).swing > 0.8);
  }
}

TEST_CASE("the paper's dampings: 0.2 swings where 0.075 does not, with 0.12 s of dead time and the drive's lag") {
  const StepResponseSettings settings = with_dead_time(0.12);
  CHECK(step_response(settings, 0.2, 1).swing > 0.8);
  const StepResponse optimal = step_response(settings, 0.075, 1);
  CHECK(optimal.swing < 0.05);
  CHECK(std::abs(optimal.samples.back().lateral) < 0.05 * settings.step);
  // Too low: deviations are not taken back fast enough.
  CHECK(step_response(settings, 0.01, 1).cost > 5.0 * optimal.cost);
}

TEST_CASE("the damping that is found costs less than half of it and than twice, and falls with the dead time") {
  double before = 1.0;
  for (const double dead_time : {0.02, 0.06, 0.12, 0.2}) {
    const StepResponseSettings settings = with_dead_time(dead_time);
    const DampingSearch search = find_damping(settings, {0.01, 0.02, 0.04, 0.075, 0.14, 0.28});
    CAPTURE(dead_time, search.best);
    CHECK(search.best < before);
    before = search.best;
    const double cost = step_response(settings, search.best, 1).cost;
    CHECK(step_response(settings, 0.5 * search.best, 1).cost > cost);
    CHECK(step_response(settings, 2.0 * search.best, 1).cost > cost);
  }
}

TEST_CASE("step-response writes picture and tables, and refuses what it cannot try") {
  const std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("tagdock_step_response_test_" + std::to_string(getpid()));
  const auto run = [&](std::vector<std::string> arguments) {
    CLI::App program("test");
    Action action;
    add_evaluate(program, action);
    arguments.insert(arguments.begin(), {"evaluate", "step-response"});
    std::reverse(arguments.begin(), arguments.end());
    program.parse(arguments);
    return action();
  };
  CHECK(run({"--dampings", "0.02,0.075,0.2", "--runs", "1", "--dead-times-ms", "120", "--output", folder.string()}) ==
        0);
  for (const char* file : {"step_response.svg", "step_response.csv", "dampings.csv"}) {
    std::ostringstream text;
    text << std::ifstream(folder / file).rdbuf();
    CAPTURE(file);
    CHECK(text.str().size() > 200);
    CHECK(text.str().find("nan") == std::string::npos);
  }
  std::filesystem::remove_all(folder);
  CHECK_THROWS_AS(run({"--dampings", "0.02,-1", "--output", folder.string()}), Failure);
  CHECK_THROWS_AS(run({"--step", "5", "--output", folder.string()}), Failure);
  CHECK_THROWS_AS(run({}), Failure);
}
