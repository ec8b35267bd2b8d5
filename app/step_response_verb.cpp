// Verb: evaluate step-response. How fast deviations may be taken back: the paper's Fig. 5 for a given robot.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>

#include <nlohmann/json.hpp>

#include "app/config.h"
#include "app/failure.h"
#include "app/step_response.h"
#include "app/svg.h"

namespace tagdock {
namespace {

using Eigen::Vector2d;
using nlohmann::json;

struct StepResponseOptions {
  std::string scenario;
  std::string config;
  std::vector<double> dampings = {0.01, 0.015, 0.02, 0.03, 0.04, 0.055, 0.075, 0.1, 0.14, 0.2, 0.28, 0.4};
  std::vector<double> dead_times_ms;
  double step = StepResponseSettings{}.step;
  std::uint64_t seed = StepResponseSettings{}.seed;
  int runs = StepResponseSettings{}.runs;
  std::string output;
  bool as_json = false;
};

void write(const std::filesystem::path& file, const std::string& text) {
  std::ofstream stream(file, std::ios::binary);
  stream << text << std::flush;
  if (!stream) throw Failure(ExitCode::usage, "--output " + file.string() + ": cannot be written");
}

std::string number(double value) {
  char text[40];
  std::snprintf(text, sizeof text, "%.17g", value);
  return text;
}

std::string rounded(double value) {
  char text[40];
  std::snprintf(text, sizeof text, "%.3g", value);
  return text;
}

std::string csv(const std::vector<StepResponse>& responses) {
  std::string text = "damping,dead_time,seed,time,travelled,lateral,true_lateral,heading\n";
  for (const StepResponse& response : responses)
    for (const ResponseSample& sample : response.samples)
      text += number(response.damping) + ',' + number(response.dead_time) + ',' + std::to_string(response.seed) + ',' +
              number(sample.time) + ',' + number(sample.travelled) + ',' + number(sample.lateral) + ',' +
              number(sample.true_lateral) + ',' + number(sample.heading) + '\n';
  return text;
}

std::string csv(const std::vector<DampingSearch>& searches) {
  std::string text = "dead_time,damping,cost,overshoot,settled_s,swing,best\n";
  for (const DampingSearch& search : searches)
    for (const DampingResult& result : search.tried)
      text += number(search.dead_time) + ',' + number(result.damping) + ',' + number(result.cost) + ',' +
              number(result.overshoot) + ',' + number(result.settled) + ',' + number(result.swing) + ',' +
              (result.damping == search.best ? '1' : '0') + '\n';
  return text;
}

constexpr const char* colours[] = {"#c05010", "#2060c0", "#108030", "#8030a0", "#806010", "#108080"};

std::string style(std::size_t i) { return std::string("stroke:") + colours[i % 6] + ";stroke-width:1.4"; }

/// Above, the paper's Fig. 5: the way of the robot with the default damping, one too low, and the one found. Below,
/// what each damping costs for each dead time, and the swings.
std::string picture(const std::vector<StepResponse>& shown, const std::vector<DampingSearch>& searches) {
  Svg svg(1300, 760);
  svg.text({30, 34}, "Step response of the odometry controller: a path that jumps aside while the robot drives", 18);
  double left = 60;
  constexpr double panel = 360;
  for (std::size_t i = 0; i < shown.size(); ++i) {
    const StepResponse& response = shown[i];
    Curve way{{}, style(1), "odometry"};
    Curve truth{{}, style(0), "true"};
    Curve path{{{0.0, 0.0}, {response.samples.back().travelled, 0.0}}, "stroke:#606060;stroke-dasharray:5 4", ""};
    for (const ResponseSample& sample : response.samples) {
      way.points.emplace_back(sample.travelled, 1e3 * sample.lateral);
      truth.points.emplace_back(sample.travelled, 1e3 * sample.true_lateral);
    }
    const char* letter[] = {"(a)", "(b)", "(c)"};
    svg.text({left + 14, 76},
             std::string(letter[i % 3]) + " damping a = " + rounded(response.damping) + ": within a tenth after " +
                 rounded(response.settled) + " s",
             14);
    draw_diagram(svg, {left, 84}, panel, 260, "", "travelled since the step [m]", "beside the path [mm]",
                 {path, way, truth});
    left += panel + 65;
  }
  std::vector<Curve> costs;
  std::vector<Curve> swings;
  for (std::size_t i = 0; i < searches.size(); ++i) {
    const std::string name = rounded(1e3 * searches[i].dead_time) + " ms: " + rounded(searches[i].best);
    costs.push_back({{}, style(i), name});
    swings.push_back({{}, style(i), rounded(1e3 * searches[i].dead_time) + " ms"});
    for (const DampingResult& result : searches[i].tried) {
      // Where swings grow the figures leave every scale.
      costs.back().points.emplace_back(std::log10(result.damping), std::log10(std::clamp(result.cost, 1e-4, 10.0)));
      swings.back().points.emplace_back(std::log10(result.damping), std::min(result.swing, 2.0));
    }
  }
  svg.text({74, 420}, "What deviations cost, for each dead time of the drive: the damping with the least", 14);
  draw_diagram(svg, {60, 428}, 570, 290, "", "log10 of the damping a", "log10 of cost", costs);
  svg.text({724, 420}, "Swings that are left after three quarters of the way, as a share of the first", 14);
  draw_diagram(svg, {710, 428}, 570, 290, "", "log10 of the damping a", "share", swings);
  return svg.text();
}

std::string sentence(const DampingSearch& search, double period) {
  char text[400];
  std::snprintf(
      text, sizeof text,
      "dead time %3.0f ms (measured %3.0f ms, lag %3.0f ms): damping %.3f takes deviations back best; "
      "the loop swings without end from %.3f by its delay, and %s by trial",
      1e3 * search.dead_time, 1e3 * search.measured.dead_time, 1e3 * search.measured.lag, search.best,
      swinging_damping(search.measured, period),
      search.swings_from > 0.0 ? ("from " + rounded(search.swings_from)).c_str() : "with none of those tried");
  return text;
}

int run(const StepResponseOptions& options) {
  if (options.output.empty()) throw Failure(ExitCode::usage, "--output DIR is missing: where picture and tables go");
  const auto positive = [](const std::vector<double>& values, const char* name, double most) {
    for (const double value : values)
      if (!(value > 0.0 && value <= most))
        throw Failure(ExitCode::usage, std::string(name) + " has " + rounded(value) +
                                           "; its numbers must be above 0 and at most " + rounded(most));
  };
  positive(options.dampings, "--dampings", 1.0);
  positive(options.dead_times_ms, "--dead-times-ms", 1000.0);
  if (!(options.step > 0.0 && options.step <= 0.2))
    throw Failure(ExitCode::usage, "--step is " + rounded(options.step) + "; it must be above 0 and at most 0.2 m");

  StepResponseSettings settings;
  if (!options.config.empty()) settings.controller = read_config(options.config).docking.segments;
  if (!options.scenario.empty()) settings.drive = read_scenario(options.scenario).drive;
  settings.step = options.step;
  settings.seed = options.seed;
  settings.runs = options.runs;
  const double own_dead_time = settings.drive.dead_time;
  std::vector<double> dead_times = {own_dead_time};
  for (const double milliseconds : options.dead_times_ms)
    if (std::abs(1e-3 * milliseconds - own_dead_time) > 1e-9) dead_times.push_back(1e-3 * milliseconds);

  std::vector<DampingSearch> searches;
  for (const double dead_time : dead_times) {
    settings.drive.dead_time = dead_time;
    searches.push_back(find_damping(settings, options.dampings));
  }
  settings.drive.dead_time = own_dead_time;
  const double best = searches.front().best;
  // As in the paper: its default, one that is too low, and the one found.
  std::vector<StepResponse> shown;
  for (const double damping : {0.2, 0.25 * best, best})
    shown.push_back(step_response(settings, damping, settings.seed));

  const std::filesystem::path folder = options.output;
  std::error_code fault;
  std::filesystem::create_directories(folder, fault);
  if (fault) throw Failure(ExitCode::usage, "--output " + folder.string() + ": " + fault.message());
  write(folder / "step_response.csv", csv(shown));
  write(folder / "dampings.csv", csv(searches));
  write(folder / "step_response.svg", picture(shown, searches));
  const double period = std::chrono::duration<double>(settings.controller.nominal_period).count();
  if (options.as_json) {
    json all = json::array();
    for (const DampingSearch& search : searches)
      all.push_back({{"dead_time", search.dead_time},
                     {"measured_dead_time", search.measured.dead_time},
                     {"measured_lag", search.measured.lag},
                     {"best_damping", search.best},
                     {"swings_by_delay", swinging_damping(search.measured, period)},
                     {"swings_by_trial", search.swings_from > 0.0 ? json(search.swings_from) : json()}});
    std::cout << json{{"damping", best}, {"robots", std::move(all)}}.dump(2) << '\n';
  } else {
    for (const DampingSearch& search : searches) std::cout << sentence(search, period) << '\n';
  }
  return static_cast<int>(ExitCode::done);
}

}  // namespace

void add_step_response(CLI::App& evaluate, Action& action) {
  auto options = std::make_shared<StepResponseOptions>();
  CLI::App* verb = evaluate.add_subcommand(
      "step-response", "Finds the odometry controller's damping for a robot: how it takes back a deviation.");
  verb->add_option("--scenario", options->scenario, "the robot (YAML, see data/scenarios); default: the simulated one");
  verb->add_option("--config", options->config, "controller settings (YAML, see `dock --write-config`)");
  verb->add_option("--dampings", options->dampings, "to try, separated by commas")
      ->delimiter(',')
      ->capture_default_str();
  verb->add_option("--dead-times-ms", options->dead_times_ms,
                   "further dead times of the drive, beside the robot's own, separated by commas")
      ->delimiter(',');
  verb->add_option("--step", options->step, "m to the side")->capture_default_str();
  verb->add_option("--runs", options->runs, "robots and floors for each damping")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  verb->add_option("--seed", options->seed, "of the first of them")->capture_default_str();
  verb->add_option("--output", options->output, "folder for step_response.svg, step_response.csv, dampings.csv");
  verb->add_flag("--json", options->as_json, "what was found as JSON");
  verb->footer(
      "While the robot drives straight at its top speed its path jumps aside; what is left of the deviation, weighed "
      "as\n"
      "the controller weighs it (heading + lateral / lateral_length) and by time, is the cost: the damping with the\n"
      "least is printed first and goes into `segments: damping` of the configuration. Dead time and lag are measured\n"
      "from the robot's own odometry. step_response.csv: damping,dead_time,seed,time,travelled,lateral,true_lateral,\n"
      "heading of the three ways drawn (s, m, rad); dampings.csv: "
      "dead_time,damping,cost,overshoot,settled_s,swing,best.\n"
      "Example:\n  tagdock evaluate step-response --dead-times-ms 30,120,200 --output damping");
  verb->callback([options, &action] { action = [options] { return run(*options); }; });
}

}  // namespace tagdock
