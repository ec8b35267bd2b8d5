// Verb: evaluate. Campaigns of simulated dockings, and what they come to.
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <sstream>
#include <thread>
#include <unistd.h>

#include "app/campaign.h"
#include "app/evaluation_report.h"
#include "app/failure.h"
#include "app/rig_file.h"
#include "app/step_response.h"
#include "app/verbs.h"

namespace tagdock {
namespace {

struct EvaluateOptions {
  int runs = 100;
  std::uint64_t seed = 1;
  std::string strategy = "servo";
  std::string scenario;
  std::string config;
  std::string rig;
  std::string board;
  std::string method;
  std::string law;
  std::string teach = "on";
  std::string images = "off";
  int jobs = 0;
  std::string shard;
  std::vector<std::string> join;
  std::string output;
  bool json = false;
};

std::string contents(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  return text.str();
}

void write(const std::filesystem::path& file, const std::string& text) {
  std::ofstream stream(file, std::ios::binary);
  stream << text << std::flush;
  if (!stream) throw Failure(ExitCode::usage, "--output " + file.string() + ": cannot be written");
}

bool needs_images(const Scenario& scenario) {
  const StationScenario plain;
  return !scenario.station.dirt.empty() || scenario.station.light_change_range > 0.0 ||
         scenario.station.lamp_strength != plain.lamp_strength || scenario.station.ambient != plain.ambient;
}

RunSettings settings_of(const EvaluateOptions& options) {
  RunSettings settings;
  const bool paper = options.strategy == "paper";
  settings.strategy = paper ? Strategy::paper : Strategy::servo;
  settings.teach = options.teach == "on";
  settings.images = options.images == "on";
  Config config;
  if (paper) {
    config.rig = five_megapixel_rig();
    config.board = single_tag_board(config.rig.T_base_camera.translation().z());
    settings.corner_errors = errors_of_paper();
  }
  if (!options.config.empty()) config = read_config(options.config);
  if (!options.rig.empty()) config.rig = read_rig(options.rig);
  if (!options.board.empty()) config.board = read_board(options.board);
  if (!options.method.empty()) config.locator.method = *corner_method(options.method);
  if (!options.law.empty()) config.docking.servo.law = options.law == "line" ? ServoLaw::line : ServoLaw::centering;
  if (!options.scenario.empty()) config.simulation.scenario = options.scenario;
  const std::string& scenario = config.simulation.scenario;
  if (!scenario.empty()) {
    settings.scenario = read_scenario(scenario);
    settings.scenario_text = contents(scenario);
  } else if (paper) {
    settings.scenario.name = "paper_start";
    settings.scenario.start.range = 3.45;
    settings.scenario.start.bearing = radians(26.0);
    settings.scenario.start.bearing_spread = settings.scenario.start.heading_spread = 0.0;
  }
  if (!settings.images && needs_images(settings.scenario))
    throw Failure(ExitCode::usage, "scenario " + settings.scenario.name +
                                       " has dirt or other light, which only images show: give --images on");
  settings.config = parse_config(to_yaml(config), "(configuration of this campaign)");
  return settings;
}

CampaignShare share_of(const EvaluateOptions& options) {
  CampaignShare share;
  share.first_seed = options.seed;
  share.runs = options.runs;
  share.jobs = options.jobs > 0 ? options.jobs : static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  if (options.shard.empty()) return share;
  char rest = 0;
  if (std::sscanf(options.shard.c_str(), "%d/%d%c", &share.shard, &share.shards, &rest) != 2 || share.shards < 1 ||
      share.shard < 0 || share.shard >= share.shards)
    throw Failure(ExitCode::usage,
                  "--shard is " + options.shard + "; it must be i/n with i from 0 to n - 1, for example 0/4");
  return share;
}

// One line in place on a terminal: done, wanted, time that remains.
class Progress {
 public:
  explicit Progress(bool quiet) : terminal_(!quiet && ::isatty(STDERR_FILENO) != 0) {}
  ~Progress() {
    if (dirty_) std::fprintf(stderr, "\r\033[K");
  }
  void operator()(int done, int wanted) {
    ++here_;
    if (!terminal_) return;
    const double spent = std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
    std::fprintf(stderr, "\r\033[K%d of %d runs, %.0f s to go", done, wanted, spent / here_ * (wanted - done));
    std::fflush(stderr);
    dirty_ = true;
  }
  [[nodiscard]] int here() const { return here_; }
  [[nodiscard]] double seconds() const {
    return std::chrono::duration<double>(std::chrono::steady_clock::now() - start_).count();
  }

 private:
  bool terminal_;
  bool dirty_ = false;
  int here_ = 0;
  std::chrono::steady_clock::time_point start_ = std::chrono::steady_clock::now();
};

void finish(const EvaluateOptions& options, const RunSettings& settings, const std::vector<RunRecord>& records) {
  const Evaluation evaluation = evaluate(records);
  const std::filesystem::path folder = options.output;
  const nlohmann::ordered_json json = to_json(evaluation, settings);
  write(folder / "summary.json", json.dump(2) + "\n");
  const std::string campaign = contents(folder / "campaign.yaml");
  write(folder / "report.html",
        to_html(evaluation, records,
                std::string("tagdock evaluate: ") + (settings.strategy == Strategy::servo ? "servo" : "paper") +
                    ", scenario " + settings.scenario.name,
                campaign));
  if (options.json)
    std::cout << json.dump(2) << "\n";
  else
    std::cout << summary(evaluation);
}

// The campaign of joined folders as their campaign.yaml tells it, as far as the summary names it.
RunSettings settings_of_joined(const std::string& text) {
  RunSettings settings;
  settings.strategy = text.find("\nstrategy: paper\n") != std::string::npos ? Strategy::paper : Strategy::servo;
  settings.images = text.find("\nimages: on\n") != std::string::npos;
  const std::string key = "\nscenario_name: \"";
  if (const std::size_t at = text.find(key); at != std::string::npos)
    settings.scenario.name = text.substr(at + key.size(), text.find('"', at + key.size()) - at - key.size());
  return settings;
}

int evaluate_campaign(const EvaluateOptions& options) {
  if (options.output.empty()) throw Failure(ExitCode::usage, "--output DIR is missing: where the results go");
  if (!options.join.empty()) {
    const std::vector<std::filesystem::path> folders(options.join.begin(), options.join.end());
    const std::vector<RunRecord> records = join_campaigns(folders, options.output);
    finish(options, settings_of_joined(contents(std::filesystem::path(options.output) / "campaign.yaml")), records);
    return static_cast<int>(ExitCode::done);
  }
  const RunSettings settings = settings_of(options);
  std::vector<RunRecord> records;
  {
    Progress progress(options.json);
    records = run_campaign(settings, share_of(options), options.output,
                           [&](int done, int wanted) { progress(done, wanted); });
    double simulated = 0.0;
    for (const RunRecord& record : records) simulated += record.duration_s;
    if (progress.here() == static_cast<int>(records.size()) && progress.here() > 0)
      std::fprintf(stderr, "%.0f s simulated in %.1f s\n", simulated, progress.seconds());
  }
  finish(options, settings, records);
  return static_cast<int>(ExitCode::done);
}

}  // namespace

void add_evaluate(CLI::App& program, Action& action) {
  auto options = std::make_shared<EvaluateOptions>();
  CLI::App* verb = program.add_subcommand(
      "evaluate", "Docks many simulated robots, each in a world of its own, and says what that comes to.");
  verb->add_option("--runs", options->runs, "dockings")->check(CLI::Range(1, 10000000))->capture_default_str();
  verb->add_option("--seed", options->seed, "of the first; each has the next")->capture_default_str();
  verb->add_option("--strategy", options->strategy,
                   "servo: ours; paper: Richter et al., one flat tag, 3.45 m and 26 degrees, then odometry alone")
      ->check(CLI::IsMember({"servo", "paper"}))
      ->capture_default_str();
  verb->add_option("--scenario", options->scenario, "the world (YAML, see data/scenarios)");
  verb->add_option("--config", options->config, "what the robot knows (YAML, see `dock --write-config`)");
  verb->add_option("--rig", options->rig, "rig file; overrides the configuration's");
  verb->add_option("--board", options->board, "board file; overrides the configuration's");
  verb->add_option("--method", options->method, "with images: how corners are made")
      ->check(CLI::IsMember({"apriltag", "tanh", "filter", "erf", "best"}));
  verb->add_option("--law", options->law, "of the last phase: line, or ViSP's centering")
      ->check(CLI::IsMember({"line", "centering"}));
  verb->add_option("--teach", options->teach,
                   "on: the robot was put at the dock once and keeps what it saw there; off: it believes the nominal "
                   "docking pose, and what calibration and survey leave stays in the error")
      ->check(CLI::IsMember({"on", "off"}))
      ->capture_default_str();
  verb->add_option("--images", options->images,
                   "on: rendered and seen by the detector; off: true corners with drawn errors, a hundred times faster")
      ->check(CLI::IsMember({"on", "off"}))
      ->capture_default_str();
  verb->add_option("--jobs", options->jobs, "runs at a time; 0: one a core")->check(CLI::Range(0, 1024));
  verb->add_option("--shard", options->shard, "i/n: only every n-th run, from i (0 to n - 1)");
  verb->add_option("--join", options->join, "folders of shards: joined into --output");
  verb->add_option("--output", options->output, "folder for runs.csv, summary.json, report.html, campaign.yaml");
  verb->add_flag("--json", options->json, "the summary as JSON on stdout");
  verb->footer(
      "A campaign that was stopped goes on when the same command is given again.\n"
      "runs.csv: one line a run; errors of the camera point and heading against the docking pose, station frame, m\n"
      "and rad; stop_latency_ms from the last command to move until the wheels stand; sigma_* of the robot's own fix.\n"
      "Examples:\n  tagdock evaluate --runs 1000 --output servo\n"
      "  tagdock evaluate --runs 1000 --strategy paper --output paper\n"
      "  tagdock evaluate --runs 20 --images on --output seen");
  add_step_response(*verb, action);
  verb->callback([options, verb, &action] {
    if (verb->get_subcommands().empty()) action = [options] { return evaluate_campaign(*options); };
  });
}

}  // namespace tagdock
