// Below the verb evaluate: what campaigns rest on, measured; and real dockings that a tracker watched.
#include "app/evaluate_measurements.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>

#include "app/accuracy_map.h"
#include "app/campaign.h"
#include "app/campaign_settings.h"
#include "app/corner_measurement.h"
#include "app/evaluation_limits.h"
#include "app/evaluation_report.h"
#include "app/failure.h"
#include "app/rig_file.h"
#include "app/session_replay.h"
#include "app/tracker.h"

namespace tagdock {
namespace {

void write(const std::filesystem::path& file, const std::string& text) {
  if (file.has_parent_path()) std::filesystem::create_directories(file.parent_path());
  std::ofstream stream(file, std::ios::binary);
  stream << text << std::flush;
  if (!stream) throw Failure(ExitCode::usage, "--output " + file.string() + ": cannot be written");
}

void tell(const char* what, int done, int wanted) { std::fprintf(stderr, "%s %d of %d\n", what, done, wanted); }

// Of rendering and looking.
struct LookOptions {
  std::string method = "tanh";
  std::string rig = "default";
  std::string board = "v_convex_centre";
  int poses = 8;
  int frames = 5;
  std::uint64_t seed = 1;
  std::string output;
};

void add_look_options(CLI::App& verb, LookOptions& options) {
  verb.add_option("--method", options.method, "how corners are made")
      ->check(CLI::IsMember({"apriltag", "tanh", "filter", "erf", "best"}))
      ->capture_default_str();
  verb.add_option("--rig", options.rig, "default, five_megapixel or a file")->capture_default_str();
  verb.add_option("--board", options.board, "one_tag, pair, v_concave, v_convex, v_convex_centre or a file")
      ->capture_default_str();
  verb.add_option("--frames", options.frames, "of each pose or cell")
      ->check(CLI::Range(2, 10000))
      ->capture_default_str();
  verb.add_option("--seed", options.seed, "of the noise")->capture_default_str();
}

// The rig and the board by their words.
Config config_of(const LookOptions& options) {
  CampaignWish wish;
  wish.rig = options.rig;
  wish.board = options.board;
  return settings_of(wish).config;
}

int measure_corner_errors(const LookOptions& options) {
  const Config config = config_of(options);
  CornerMeasurementWish wish;
  wish.method = *corner_method(options.method);
  wish.rig = config.rig;
  wish.board = config.board;
  wish.poses = options.poses;
  wish.frames = options.frames;
  wish.seed = options.seed;
  const std::vector<CornerMeasurement> measured =
      measure_corners(wish, [](int done, int wanted) { tell("distance", done, wanted); });
  if (measured.empty()) throw Failure(ExitCode::failed, "no tag was found at any distance");
  std::string text = "# Errors of corners, measured by: tagdock evaluate corner-errors --method " + options.method +
                     " --rig " + options.rig + " --board " + options.board;
  char line[200];
  std::snprintf(
      line, sizeof line,
      " --poses %d --frames %d --seed %llu\n#   side px  noise px   bias px  claimed  blurred  coordinates  missed\n",
      options.poses, options.frames, static_cast<unsigned long long>(options.seed));
  text += line;
  for (const CornerMeasurement& one : measured) {
    std::snprintf(line, sizeof line, "# %9.1f %9.5f %9.5f %8.5f %8.5f %12d %7d\n", one.side_px, one.noise_px,
                  one.bias_px, one.claimed_px, one.moving_noise_px, one.corners, one.missed);
    text += line;
  }
  text += to_yaml(errors_from(measured, wish.blur_px));
  if (!options.output.empty()) write(options.output, text);
  std::cout << text;
  return static_cast<int>(ExitCode::done);
}

int measure_map(const LookOptions& options) {
  if (options.output.empty()) throw Failure(ExitCode::usage, "--output DIR is missing: where the map goes");
  const Config config = config_of(options);
  AccuracyMapWish wish;
  wish.rig = config.rig;
  wish.board = config.board;
  wish.locator = config.locator;
  wish.locator.method = *corner_method(options.method);
  wish.frames = options.frames;
  wish.seed = options.seed;
  const std::vector<AccuracyCell> cells = measure_accuracy(wish, [](int done, int wanted) {
    if (done % 10 == 0 || done == wanted) tell("cell", done, wanted);
  });
  const std::filesystem::path folder = options.output;
  write(folder / "accuracy_map.csv", accuracy_csv(cells));
  write(folder / "accuracy_map.yaml", accuracy_yaml(wish, cells));
  write(folder / "accuracy_map.html",
        accuracy_html(wish, cells, "tagdock evaluate accuracy-map: " + options.board + ", " + options.rig + " rig"));
  std::printf("%s\n", (folder / "accuracy_map.html").string().c_str());
  return static_cast<int>(ExitCode::done);
}

struct TrackedOptions {
  std::vector<std::string> trackers, sessions;
  std::string station, body;
  std::string output;
};

std::optional<Pose2> pose_option(const std::string& name, const std::string& text) {
  if (text.empty()) return std::nullopt;
  Pose2 pose;
  char rest = 0;
  if (std::sscanf(text.c_str(), "%lf,%lf,%lf%c", &pose.x, &pose.y, &pose.yaw, &rest) != 3)
    throw Failure(ExitCode::usage, name + " is " + text + "; it must be X,Y,YAW_DEG, for example 0.02,-0.1,1.5");
  pose.yaw = radians(pose.yaw);
  return pose;
}

int evaluate_tracked(const TrackedOptions& options) {
  if (options.output.empty()) throw Failure(ExitCode::usage, "--output DIR is missing: where the results go");
  if (options.trackers.empty() || options.trackers.size() != options.sessions.size())
    throw Failure(ExitCode::usage, "give as many --tracker files as --session folders, in the same order");
  std::vector<TrackedWay> ways;
  std::vector<RunRecord> records;
  std::vector<double> ends;
  std::vector<SessionHead> heads;
  for (std::size_t i = 0; i < options.sessions.size(); ++i) {
    const Session session = read_session(options.sessions[i]);
    heads.push_back(read_session_head(session.folder));
    TrackedWay& tracked = ways.emplace_back();
    tracked.tracker = read_tracker(options.trackers[i]);
    tracked.way.odometry = session.odometry;
    tracked.clock = align_clocks(tracked.tracker, session.odometry);
    const ReplayResult replayed = replay(
        session, heads.back().config, [&](const DockingLoop::Inputs& inputs, const DockingLoop::Outputs& outputs) {
          if (outputs.docking.estimate)
            tracked.way.estimates.push_back(
                {std::chrono::duration<double>(inputs.now).count(), outputs.docking.estimate->T_station_base});
          return true;
        });
    ends.push_back(session.ticks.empty() ? 0.0 : std::chrono::duration<double>(session.ticks.back().time).count());
    RunRecord record;
    record.seed = i + 1;
    record.scenario = std::filesystem::path(options.sessions[i]).filename().string();
    record.result = replayed.last_phase;
    record.reason = replayed.reason;
    std::replace(record.reason.begin(), record.reason.end(), ',', ';');
    record.attempts = replayed.attempts;
    record.duration_s = ends.back();
    if (replayed.fix) {
      record.estimated = replayed.fix->error;
      const Eigen::Vector3d sigma = replayed.fix->covariance.diagonal().cwiseSqrt();
      record.sigma = Pose2{sigma.x(), sigma.y(), sigma.z()};
    }
    records.push_back(record);
  }
  const TrackerFit fit =
      fit_frames(ways, pose_option("--tracker-station", options.station), pose_option("--body", options.body));
  const auto words = [](const Pose2& pose) {
    char text[80];
    std::snprintf(text, sizeof text, "%.4f,%.4f,%.4f", pose.x, pose.y, degrees(pose.yaw));
    return std::string(text);
  };
  std::string campaign = "tracked sessions:";
  for (std::size_t i = 0; i < ways.size(); ++i) {
    const Pose2 dock = heads[i].config.docking.dock_pose;
    const std::optional<Pose2> base = tracked_base(ways[i], fit.frames, ends[i]);
    if (!base)
      throw Failure(ExitCode::usage,
                    options.trackers[i] + ": has no reading in the last half second of " + options.sessions[i]);
    const Pose2 reached = *base * camera_point(heads[i].config.rig);
    records[i].true_error = {reached.x - dock.x, reached.y - dock.y, wrap_angle(reached.yaw - dock.yaw)};
    char line[200];
    std::snprintf(line, sizeof line, "  clock offset %.4f s (correlation %.4f)\n", ways[i].clock.seconds,
                  ways[i].clock.correlation);
    campaign += "\n" + options.sessions[i] + " with " + options.trackers[i] + "\n" + line;
  }
  char line[300];
  std::snprintf(line, sizeof line,
                "way of tracker against estimates, rms over %d readings: %.2f mm, %.2f mm, %.3f deg\n", fit.readings,
                1e3 * fit.rms.x, 1e3 * fit.rms.y, degrees(fit.rms.yaw));
  campaign += "tracker to station: " + words(fit.frames.T_tracker_station) +
              (fit.station_fitted ? " (fitted)" : " (given)") +
              "\nbase to tracker's body: " + words(fit.frames.T_base_body) +
              (fit.body_fitted ? " (fitted)" : " (given)") + "\n" + line;
  constexpr double unsure = 0.005;  // m
  if (fit.body_sigma > unsure) {
    std::snprintf(
        line, sizeof line,
        "The body's place is known to %.0f mm only, since the robot hardly turned: give --body, or sessions that "
        "turn more.\n",
        1e3 * fit.body_sigma);
    campaign += line;
  }
  if (fit.station_fitted || fit.body_fitted)
    campaign +=
        "What is fitted comes from the robot's own estimates: their constant errors do not show here, only the "
        "scatter between dockings. Give --tracker-station and --body from a survey to see them.\n";
  const std::filesystem::path folder = options.output;
  std::string runs = runs_header() + "\n";
  for (const RunRecord& record : records) runs += tagdock::line(record) + "\n";
  write(folder / "runs.csv", runs);
  const Evaluation evaluation = evaluate(records);
  RunSettings settings;
  settings.scenario.name = "tracked";
  settings.images = true;
  write(folder / "summary.json", to_json(evaluation, settings).dump(2) + "\n");
  FigureData data;
  data.name = "tracked dockings";
  data.style = "#2b6cb0";
  data.records = records;
  for (const TrackedWay& tracked : ways) {
    RunTrace& trace = data.traces.emplace_back();
    for (const TrackerReading& reading : tracked.tracker) {
      const Pose2 base =
          inverse(fit.frames.T_tracker_station) * reading.T_tracker_body * inverse(fit.frames.T_base_body);
      trace.push_back({reading.time_s + tracked.clock.seconds, base * camera_point(heads.front().config.rig), {}, {}});
    }
  }
  CampaignPage page;
  page.title = "tagdock evaluate: dockings that a tracker watched";
  page.campaign = campaign;
  page.truth = "as the tracker saw them";
  page.limits = html_limits({.simulated = false});
  write(folder / "report.html", to_html(evaluation, data, page));
  std::cout << campaign << summary(evaluation);
  return static_cast<int>(ExitCode::done);
}

}  // namespace

void add_measurements(CLI::App& evaluate, Action& action) {
  auto corners = std::make_shared<LookOptions>();
  CLI::App* verb = evaluate.add_subcommand(
      "corner-errors", "Renders the board and measures how wrong the corners are that the detector gives.");
  add_look_options(*verb, *corners);
  verb->add_option("--poses", corners->poses, "at each of six distances")
      ->check(CLI::Range(1, 10000))
      ->capture_default_str();
  verb->add_option("--output", corners->output, "file that `evaluate --corners` reads (YAML)");
  verb->callback([corners, &action] { action = [corners] { return measure_corner_errors(*corners); }; });

  auto map = std::make_shared<LookOptions>();
  verb =
      evaluate.add_subcommand("accuracy-map",
                              "Measures how well one frame tells the robot's pose, over distance, bearing and place in "
                              "the image, with rendered images and the real detector.");
  add_look_options(*verb, *map);
  verb->add_option("--output", map->output, "folder for accuracy_map.html, accuracy_map.csv, accuracy_map.yaml");
  verb->callback([map, &action] { action = [map] { return measure_map(*map); }; });

  auto tracked = std::make_shared<TrackedOptions>();
  verb =
      evaluate.add_subcommand("tracked",
                              "Judges recorded dockings by an external tracker: aligns its clock and frames, and makes "
                              "the same report.");
  verb->add_option("--tracker", tracked->trackers,
                   "CSV of the tracker: time_s or time_ns; x, y; yaw, yaw_deg or qx..qw");
  verb->add_option("--session", tracked->sessions, "recording (`dock --record`) of the same docking");
  verb->add_option("--tracker-station", tracked->station,
                   "X,Y,YAW_DEG of the station in the tracker's frame, from a survey; without, it is fitted");
  verb->add_option("--body", tracked->body,
                   "X,Y,YAW_DEG of the tracker's body on the base (hand-eye); without, it is fitted");
  verb->add_option("--output", tracked->output, "folder for runs.csv, summary.json, report.html");
  verb->footer(
      "Examples:\n  tagdock evaluate tracked --tracker igps1.csv igps2.csv --session run1 run2 --output tracked");
  verb->callback([tracked, &action] { action = [tracked] { return evaluate_tracked(*tracked); }; });
}

}  // namespace tagdock
