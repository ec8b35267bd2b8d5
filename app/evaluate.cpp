// Verb: evaluate. Campaigns of simulated dockings, and what they come to.
#include <array>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <optional>
#include <thread>

#include "app/campaign_agreement.h"
#include "app/campaign_progress.h"
#include "app/campaign_set.h"
#include "app/evaluate_measurements.h"
#include "app/evaluation_limits.h"
#include "app/evaluation_report.h"
#include "app/failure.h"
#include "app/option_checks.h"
#include "app/paper_tables.h"
#include "app/set_report.h"
#include "app/step_response.h"
#include "app/verbs.h"

namespace tagdock {
namespace {

// Members of the set that --images both makes.
constexpr const char* with_images = "images";
constexpr const char* with_drawn_corners = "drawn_corners";

struct EvaluateOptions {
  CampaignWish wish;
  int runs = 100;
  std::uint64_t seed = 1;
  std::vector<std::string> scenarios;
  std::vector<std::string> rigs;
  std::string teach = "on";
  std::string images = "off";
  int image_runs = 20;
  bool ablation = false;
  int jobs = 0;
  std::string shard;
  std::vector<std::string> join;
  bool partial = false;
  bool runs_given = false;
  std::string output;
  bool json = false;
};

void write(const std::filesystem::path& file, const std::string& text) {
  std::ofstream stream(file, std::ios::binary);
  stream << text << std::flush;
  if (!stream) throw Failure(ExitCode::usage, "--output " + file.string() + ": cannot be written");
}

CampaignShare share_of(const EvaluateOptions& options) {
  CampaignShare share;
  share.first_seed = options.seed;
  share.runs = options.runs;
  if (share.first_seed + static_cast<std::uint64_t>(options.runs - 1) < share.first_seed)
    throw Failure(ExitCode::usage, "--seed " + std::to_string(options.seed) + ": the seeds of " +
                                       std::to_string(options.runs) +
                                       " runs would pass the largest number; take a smaller one");
  share.jobs = options.jobs > 0 ? options.jobs : static_cast<int>(std::max(1U, std::thread::hardware_concurrency()));
  if (options.shard.empty()) return share;
  char rest = 0;
  if (std::sscanf(options.shard.c_str(), "%d/%d%c", &share.shard, &share.shards, &rest) != 2 || share.shards < 1 ||
      share.shard < 0 || share.shard >= share.shards)
    throw Failure(ExitCode::usage,
                  "--shard is " + options.shard + "; it must be i/n with i from 0 to n - 1, for example 0/4");
  return share;
}

// What a campaign.yaml says of itself, as far as reports name it.
RunSettings settings_told(const std::string& campaign) {
  RunSettings settings;
  settings.strategy = campaign_value(campaign, "strategy") == "paper" ? Strategy::paper : Strategy::servo;
  settings.images = campaign_value(campaign, "images") == "on";
  settings.scenario.name = campaign_value(campaign, "scenario_name");
  settings.start_name = campaign_value(campaign, "start");
  settings.rig_name = campaign_value(campaign, "rig_name");
  settings.board_name = campaign_value(campaign, "board_name");
  settings.corners_name = campaign_value(campaign, "corners");
  return settings;
}

// Writes the results of one campaign beside its runs.
nlohmann::ordered_json write_results(const std::filesystem::path& folder, const SetResult& result) {
  const RunSettings settings = settings_told(result.campaign);
  nlohmann::ordered_json json = to_json(result.evaluation, settings);
  if (const nlohmann::ordered_json part = json_of_part(result); !part.is_null()) json["partial"] = part;
  write(folder / "summary.json", json.dump(2) + "\n");
  const FigureData data = settings.strategy == Strategy::servo ? figure_data(result, "servo", "#2b6cb0")
                                                               : figure_data(result, "paper's strategy", "#c53030");
  CampaignPage page;
  page.title = std::string("tagdock evaluate: ") + (settings.strategy == Strategy::servo ? "servo" : "paper") +
               ", scenario " + settings.scenario.name;
  page.campaign = result.campaign;
  page.first = html_of_part({result});
  page.limits = html_limits(evidence_of({result}));
  write(folder / "report.html", to_html(result.evaluation, data, page));
  return json;
}

// Of a set that --images both made.
std::optional<std::array<SigmaRatio, 3>> agreement_of(const std::vector<SetResult>& results) {
  if (results.size() != 2 || results[0].name != with_images || results[1].name != with_drawn_corners)
    return std::nullopt;
  return sigma_ratios(results[0].records, results[1].records);
}

void write_set(const EvaluateOptions& options, const std::vector<SetResult>& whole) {
  std::vector<SetResult> results;
  std::vector<std::string> never_ran;
  for (const SetResult& result : whole)
    if (result.records.empty() && !result.missing.empty())
      never_ran.insert(never_ran.end(), result.missing.begin(), result.missing.end());
    else
      results.push_back(result);
  const std::filesystem::path folder = options.output;
  nlohmann::ordered_json all;
  all["schema"] = "tagdock-evaluation-set/1";
  for (const SetResult& result : results) {
    nlohmann::ordered_json one = write_results(folder / result.name, result);
    one.erase("schema");
    all["campaigns"][result.name] = std::move(one);
  }
  if (!never_ran.empty()) all["missing"] = never_ran;
  std::string words = set_summary(results);
  if (const auto ratios = agreement_of(results)) {
    const std::array<const char*, 3> names = {"x", "y", "yaw"};
    for (std::size_t i = 0; i < 3; ++i)
      all["sigma_with_images_over_drawn"][names[i]] = {{"ratio", (*ratios)[i].ratio},
                                                       {"low", (*ratios)[i].low},
                                                       {"high", (*ratios)[i].high},
                                                       {"pairs", (*ratios)[i].pairs}};
    words += agreement_words(*ratios);
  }
  write(folder / "summary.json", all.dump(2) + "\n");
  write(folder / "report.html", set_to_html(results, never_ran));
  std::cout << (options.json ? all.dump(2) + "\n" : words);
}

void write_one(const EvaluateOptions& options, const SetResult& result) {
  const nlohmann::ordered_json json = write_results(options.output, result);
  std::cout << (options.json ? json.dump(2) + "\n" : summary(result.evaluation));
}

// CPU time of this process.
double cpu_seconds() {
  timespec time{};
  ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

int join(const EvaluateOptions& options) {
  const std::vector<std::filesystem::path> folders(options.join.begin(), options.join.end());
  for (const std::filesystem::path& folder : folders)
    if (!std::filesystem::is_directory(folder))
      throw Failure(ExitCode::usage, "--join " + folder.string() + ": is no folder; it takes those of shards");
  JoinWish wish;
  wish.partial = options.partial;
  wish.image_runs = options.image_runs;
  if (options.runs_given) {
    wish.told.emplace();
    wish.told->first_seed = options.seed;
    wish.told->runs = options.runs;
  }
  const auto warn = [](const std::vector<std::string>& missing) {
    for (const std::string& one : missing) std::cerr << "tagdock: partial: " << one << "\n";
  };
  if (is_set(folders.front())) {
    const std::vector<SetResult> results = join_sets(folders, options.output, wish);
    for (const SetResult& result : results) warn(result.missing);
    write_set(options, results);
    return static_cast<int>(ExitCode::done);
  }
  JoinedCampaign joined = join_campaigns(folders, options.output, wish);
  warn(joined.missing);
  const SetResult result{.name = "",
                         .campaign = joined.campaign,
                         .records = joined.records,
                         .evaluation = evaluate(joined.records),
                         .traces = read_traces(options.output),
                         .looks = read_looks(std::filesystem::path(options.output) / looks_file),
                         .share = {},
                         .missing = joined.missing,
                         .wanted = joined.wanted};
  write_one(options, result);
  return static_cast<int>(ExitCode::done);
}

// What an ablation goes through itself cannot be asked for beside it.
void check_ablation(const EvaluateOptions& options) {
  const CampaignWish& wish = options.wish;
  const std::pair<const char*, bool> fixed[] = {
      {"--strategy", wish.strategy != "servo"}, {"--law", !wish.law.empty()},
      {"--board", !wish.board.empty()},         {"--corners", !wish.corners.empty()},
      {"--method", !wish.method.empty()},       {"--start", wish.start != "scenario"},
      {"--images", options.images != "off"},
  };
  for (const auto& [name, given] : fixed)
    if (given)
      throw Failure(ExitCode::usage, std::string(name) +
                                         " does not go with --ablation, which goes through paths, laws, boards and " +
                                         "(drawn) corner errors itself; leave one of the two out");
  if (options.rigs.size() > 1) throw Failure(ExitCode::usage, "--ablation takes one --rig");
}

// The campaigns that the options ask for; more than one make a set.
std::vector<SetMember> members_of(const EvaluateOptions& options) {
  SetWish wish;
  wish.common = options.wish;
  wish.common.teach = options.teach == "on";
  wish.common.images = options.images == "on";
  wish.runs = options.runs;
  wish.image_runs = options.image_runs;
  wish.rigs = options.rigs;
  if (options.rigs.size() == 1) wish.common.rig = options.rigs.front();
  if (options.ablation) check_ablation(options);
  for (const std::string& word : options.scenarios)
    for (const std::filesystem::path& file : scenario_files(word)) wish.scenarios.push_back(file.string());
  if (options.ablation) {
    if (wish.scenarios.size() > 1)
      throw Failure(ExitCode::usage, "--ablation takes one --scenario file: the world in which everything is compared");
    return ablation_set(wish);
  }
  const bool both = options.wish.strategy == "both";
  // The straight start beside it, without which the path's gain and the loop's cannot be told apart.
  if (both && wish.scenarios.empty())
    for (const char* name : {"default.yaml", "straight_start.yaml"})
      wish.scenarios.push_back(scenario_files("all").front().parent_path() / name);
  const bool one_campaign = !both && wish.scenarios.size() <= 1 && options.rigs.size() <= 1;
  if (options.images == "both" && !one_campaign)
    throw Failure(ExitCode::usage,
                  "--images both compares one campaign with itself: give one strategy, scenario and rig");
  if (one_campaign) {
    CampaignWish one = wish.common;
    if (!wish.scenarios.empty()) one.scenario = wish.scenarios.front();
    if (options.images == "both") {
      CampaignWish seen = one;
      seen.images = true;
      return {{with_images, settings_of(seen), options.runs}, {with_drawn_corners, settings_of(one), options.runs}};
    }
    return {{"", settings_of(one), options.runs}};
  }
  wish.strategies = both ? std::vector<std::string>{"paper", "servo"} : std::vector<std::string>{options.wish.strategy};
  if (both && wish.rigs.empty()) wish.rigs = {"default", "five_megapixel"};
  return scenario_set(wish);
}

int evaluate_campaign(const EvaluateOptions& options) {
  if (options.output.empty()) throw Failure(ExitCode::usage, "--output DIR is missing: where the results go");
  if (!options.join.empty()) return join(options);
  if (options.images == "on" && !options.wish.corners.empty())
    throw Failure(ExitCode::usage,
                  "--corners are the errors drawn without images; with --images on the detector makes the corners "
                  "(--method)");
  if (options.partial) throw Failure(ExitCode::usage, "--partial goes with --join");
  const std::vector<SetMember> members = members_of(options);
  const CampaignShare share = share_of(options);
  const bool alone = members.size() == 1 && members.front().name.empty();
  std::vector<SetResult> results;
  {
    Progress progress(options.json);
    const double cpu_before = cpu_seconds();
    results = run_set(members, share, options.output, [&](int done, int wanted) { progress(done, wanted); });
    double simulated = 0.0;
    int runs = 0;
    for (const SetResult& result : results)
      for (const RunRecord& record : result.records) {
        simulated += record.duration_s;
        ++runs;
      }
    const double cpu = cpu_seconds() - cpu_before;
    if (progress.here() == runs && runs > 0)
      std::fprintf(stderr, "%.0f s simulated in %.1f s, %.1f s of a core: %.0f times as fast\n", simulated,
                   progress.seconds(), cpu, simulated / cpu);
  }
  if (!alone) {
    write_set(options, results);
    return static_cast<int>(ExitCode::done);
  }
  write_one(options, results.front());
  return static_cast<int>(ExitCode::done);
}

}  // namespace

void add_evaluate(CLI::App& program, Action& action) {
  auto options = std::make_shared<EvaluateOptions>();
  CLI::App* verb = program.add_subcommand(
      "evaluate", "Docks many simulated robots, each in a world of its own, and says what that comes to.");
  verb->add_option("--runs", options->runs, "dockings")->check(CLI::Range(1, 10000000))->capture_default_str();
  verb->add_option("--seed", options->seed, "of the first; each has the next")
      ->check(not_negative())
      ->capture_default_str();
  CampaignWish& wish = options->wish;
  verb->add_option("--strategy", wish.strategy,
                   "servo: ours; paper: Richter et al., one flat tag, 3.45 m and 26 degrees, then odometry alone; both")
      ->check(CLI::IsMember({"servo", "paper", "both"}))
      ->capture_default_str();
  verb->add_option("--scenario", options->scenarios,
                   "the world: files (YAML, see data/scenarios), folders of them, or all: those that are shipped");
  verb->add_option("--start", wish.start,
                   "where it begins: as the scenario says; paper: as the paper did, 3.45 m and 26 degrees; straight: "
                   "3.45 m and 5 degrees")
      ->check(CLI::IsMember({"scenario", "paper", "straight"}))
      ->capture_default_str();
  verb->add_option("--config", wish.config, "what the robot knows (YAML, see `dock --write-config`)");
  verb->add_option("--rig", options->rigs, "default, five_megapixel or files; overrides the configuration's");
  verb->add_option("--board", wish.board,
                   "one_tag, pair, v_concave, v_convex, v_convex_centre or a file; overrides the configuration's");
  verb->add_option("--method", wish.method, "how corners are made, and whose errors are drawn without images")
      ->check(CLI::IsMember({"apriltag", "tanh", "filter", "erf", "best"}));
  verb->add_option("--corners", wish.corners,
                   "without images: errors of a corner method, paper, poor, or a file of `evaluate corner-errors`");
  verb->add_option("--law", wish.law, "of the last phase: line, or ViSP's centering")
      ->check(CLI::IsMember({"line", "centering"}));
  verb->add_flag("--ablation", options->ablation,
                 "path x law x board x corners on the same seeds, in one world (--scenario)");
  verb->add_option("--teach", options->teach,
                   "on: the robot was put at the dock once and keeps what it saw there; off: it believes the nominal "
                   "docking pose, and what calibration and survey leave stays in the error")
      ->check(CLI::IsMember({"on", "off"}))
      ->capture_default_str();
  verb->add_option(
          "--images", options->images,
          "on: rendered and seen by the detector; off: true corners with drawn errors, a hundred times faster; "
          "both: the same seeds both ways, and how well they agree")
      ->check(CLI::IsMember({"on", "off", "both"}))
      ->capture_default_str();
  verb->add_option("--image-runs", options->image_runs,
                   "in a set: dockings in scenarios with dirt or other light, which always have images")
      ->check(CLI::Range(1, 10000000))
      ->capture_default_str();
  verb->add_option("--jobs", options->jobs, "runs at a time; 0: one a core")->check(CLI::Range(0, 1024));
  verb->add_option("--shard", options->shard, "i/n: only every n-th run, from i (0 to n - 1)");
  verb->add_option("--join", options->join,
                   "folders of shards: joined into --output; refused, with what is missing, if runs are");
  verb->add_flag("--partial", options->partial, "with --join: also where runs are missing; the report says which");
  verb->add_option("--output", options->output, "folder for runs.csv, summary.json, report.html, campaign.yaml");
  verb->add_flag("--json", options->json, "the summary as JSON on stdout");
  add_step_response(*verb, action);
  add_paper_tables(*verb, action);
  add_measurements(*verb, action);
  // After the subcommands, which would inherit it.
  verb->footer(
      "A campaign that was stopped goes on when the same command is given again. Several strategies, scenarios or "
      "rigs\n"
      "make a set: a folder for each, and a report over all. In a set the paper's strategy starts where the paper did\n"
      "and has its rig; the servo's is reported for both rigs. --shard and --join work for sets, too.\n"
      "runs.csv: one line a run; errors of the camera point and heading against the docking pose, station frame, m\n"
      "and rad; stop_latency_ms from the last command to move until the wheels stand; sigma_* of the robot's own fix.\n"
      "Examples:\n  tagdock evaluate --runs 1000 --output servo\n"
      "  tagdock evaluate --runs 1000 --strategy paper --output paper\n"
      "  tagdock evaluate --runs 1000 --strategy both --scenario all --output everything\n"
      "  tagdock evaluate --runs 200 --ablation --output ablation\n"
      "  tagdock evaluate --runs 20 --images on --output seen\n"
      "  tagdock evaluate --runs 100 --images both --output agreement");
  verb->callback([options, verb, &action] {
    if (!verb->get_subcommands().empty()) return;  // it has an action of its own
    options->runs_given = verb->count("--runs") > 0;
    action = [options] { return evaluate_campaign(*options); };
  });
}

}  // namespace tagdock
