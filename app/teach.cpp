// Verb: teach. The robot stands at the dock; what it sees there becomes the docking pose.
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>
#include <stdexcept>

#include <nlohmann/json.hpp>

#include "app/config.h"
#include "app/devices.h"
#include "app/dock_database.h"
#include "app/failure.h"
#include "app/output_file.h"
#include "app/print.h"
#include "app/rig_file.h"
#include "app/ros2_options.h"
#include "app/stop_signal.h"
#include "app/verbs.h"
#include "detection/tag_locator.h"
#include "servo/pose_filter.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;

struct TeachOptions {
  std::string config;
  std::string camera;
  std::string robot;
  std::optional<int> domain;
  std::string name_space;
  std::vector<std::string> remaps;
  std::string rig;
  std::string board;
  std::string dock_pose;
  std::string docks;
  std::string dock_name;
  std::string scenario;
  std::uint64_t seed = 1;
  std::optional<double> speedup;
  double seconds = 4.0;
  std::string output;
  bool json = false;
};

// As `dock` will read it, without what was taught before.
Config configuration(const TeachOptions& options) {
  Config config = options.config.empty() ? Config{} : read_config(options.config);
  if (const auto dock = chosen_dock(options.docks, options.dock_name)) {
    if (!dock->board.empty())
      config.board = read_board(std::filesystem::path(options.docks).parent_path() / dock->board);
    if (dock->dock_pose) config.docking.dock_pose = *dock->dock_pose;
  }
  if (!options.rig.empty()) config.rig = read_rig(options.rig);
  if (!options.board.empty()) config.board = read_board(options.board);
  if (!options.camera.empty()) config.camera.source = options.camera;
  if (!options.robot.empty()) config.robot = options.robot;
  if (options.domain) config.ros2.domain = *options.domain;
  if (!options.name_space.empty()) config.ros2.name_space = options.name_space;
  for (const std::string& rule : options.remaps) remap(config.ros2, rule);
  if (!options.scenario.empty()) config.simulation.scenario = options.scenario;
  if (!options.dock_pose.empty()) {
    Pose2& pose = config.docking.dock_pose;
    double yaw_deg = 0.0;
    char rest = 0;
    if (std::sscanf(options.dock_pose.c_str(), "%lf,%lf,%lf%c", &pose.x, &pose.y, &yaw_deg, &rest) != 3 ||
        !is_finite(pose) || !std::isfinite(yaw_deg) || pose.x >= 0.0)
      throw Failure(ExitCode::usage, "--dock-pose is " + options.dock_pose +
                                         "; it must be X,Y,YAW_DEG with X below 0, for example -1.0,0,0");
    pose.yaw = radians(yaw_deg);
  }
  config.docking.dock_pose_taught = false;
  config.docking.dock_pose_covariance.setZero();
  config.docking.taught_hang.reset();
  config.docking.errand = Errand::dock;
  config.simulation.taught_at_known = false;
  return parse_config(to_yaml(config), "(configuration of this teaching)");
}

// What was seen while the robot stood.
struct Stand {
  std::vector<RestSighting> sightings;
  Pose2 T_odom_base;
  int frames = 0;
  double rms_px = 0.0;  ///< of the corners against the board file, mean over the frames
  std::optional<Pose2> truth;
};

// Looks for a time without ever driving; refuses where the robot does not stand.
Stand look(const Config& config, Devices& devices, double seconds) {
  const StopSignal stop_signal;
  Config seen_with = config;  // frames may come as a part of the sensor, or coarser
  seen_with.rig.camera = devices.camera_model;
  seen_with.locator.detector.decimate = std::max(1, config.locator.detector.decimate / devices.binning);
  const TagLocator locator(seen_with.rig, seen_with.board, seen_with.locator);
  PoseFilter filter(seen_with.rig, config.docking.filter);
  constexpr double wait_s = 15.0;  // for the first frame: a camera may take its time to open
  Stand stand;
  std::optional<Pose2> first;
  std::optional<Unseen> unseen;
  const nanoseconds begin = devices.clock->now();
  std::optional<nanoseconds> first_frame;
  while (true) {
    const nanoseconds now = devices.clock->now();
    if (stop_signal.requested()) throw Failure(ExitCode::interrupted, "interrupted; nothing was written");
    for (const Odometry& reading : devices.robot->read()) {
      filter.predict(reading);
      if (!first) first = reading.T_odom_base;
      stand.T_odom_base = reading.T_odom_base;
      const Pose2 moved = between(*first, reading.T_odom_base);
      if (std::hypot(moved.x, moved.y) > 0.002 || std::abs(moved.yaw) > radians(0.2))
        throw Failure(ExitCode::failed, print("the robot moved by %.1f mm and %.2f degrees; let it stand still at the "
                                              "dock and teach again",
                                              1e3 * std::hypot(moved.x, moved.y), degrees(std::abs(moved.yaw))));
    }
    const CameraHealth health = devices.camera->health();
    if (health.state == "lost" || health.state == "absent")
      throw Failure(ExitCode::camera, "the camera is " + health.state + ": " + health.reason);
    if (const std::optional<CameraFrame> frame = devices.camera->newest(now)) {
      if (!first_frame) first_frame = now;
      ++stand.frames;
      const Sighting sighting = locator.locate(frame->frame, filter.predicted_view(frame->frame.time));
      if (const BoardSighting* board = std::get_if<BoardSighting>(&sighting)) {
        const FilterUpdate update = filter.update(*board);
        const std::optional<Pose2> T_odom_base = filter.T_odom_base(board->time);
        if (T_odom_base && (update.use == SightingUse::fused || update.use == SightingUse::acquired)) {
          stand.sightings.push_back(rest_sighting(*update.sighting, *board, *T_odom_base));
          stand.rms_px += board->reprojection_rms_px;
        }
      } else {
        unseen = std::get<Unseen>(sighting);
      }
    }
    const double looked = first_frame ? std::chrono::duration<double>(now - *first_frame).count() : 0.0;
    if (looked >= seconds || health.state == "ended") break;
    if (!first_frame && std::chrono::duration<double>(now - begin).count() > wait_s)
      throw Failure(ExitCode::camera, print("no frame from the camera within %.0f s: ", wait_s) + health.reason);
    devices.clock->sleep_until(now + std::chrono::milliseconds(5));
  }
  if (!stand.sightings.empty()) stand.rms_px /= static_cast<double>(stand.sightings.size());
  if (devices.true_camera_point) stand.truth = devices.true_camera_point();
  constexpr std::size_t enough = 20;
  if (stand.sightings.size() < enough) {
    const std::string why = unseen ? std::string(word(*unseen)) : "the pose was not sure";
    throw Failure(stand.sightings.empty() ? ExitCode::tag_never_seen : ExitCode::failed,
                  print("only %d of %d frames showed the board well enough (%d are needed): ",
                        static_cast<int>(stand.sightings.size()), stand.frames, static_cast<int>(enough)) +
                      why);
  }
  return stand;
}

// The same docks, one of them with what was taught there.
std::vector<DockEntry> with_taught(std::vector<DockEntry> docks, const std::string& name, const DockingConfig& taught) {
  for (DockEntry& dock : docks) {
    if (dock.name != name) continue;
    dock.dock_pose = taught.dock_pose;
    dock.taught = TaughtDock{taught.dock_pose_covariance, taught.taught_hang};
  }
  return docks;
}

int teach(const TeachOptions& options) {
  if (options.output.empty())
    throw Failure(ExitCode::usage,
                  "--output FILE is missing: the configuration for `tagdock dock --config`, or with --docks the docks");
  if (!options.docks.empty()) {
    check_not_an_input("--output", options.output, {options.docks});
    if (!options.board.empty())
      throw Failure(ExitCode::usage, "--board: with --docks the board is the dock's; write it into " + options.docks);
    const auto folder = [](const std::string& file) {
      return std::filesystem::absolute(file).lexically_normal().parent_path();
    };
    if (folder(options.output) != folder(options.docks))
      throw Failure(ExitCode::usage, "--output must be in the folder of --docks: boards are named relative to it");
  }
  Config config = configuration(options);
  Config at_dock = config;
  at_dock.docking.errand = Errand::undock;  // where a simulated robot is put
  Devices devices = open_devices(at_dock, {options.seed, options.speedup, false, true});
  const Stand stand = look(config, devices, options.seconds);
  devices.robot->stop();

  DockingConfig teaching = config.docking;
  teaching.rig.camera = devices.camera_model;
  teaching.dock_pose_taught = true;  // what stays the same at every docking becomes part of the pose
  const std::optional<Fix> fix = fix_from(stand.sightings, stand.T_odom_base, teaching);
  const Pose2 pose = fix->T_station_base * camera_point(config.rig);
  const Eigen::Vector3d sigma = fix->covariance.diagonal().cwiseSqrt();
  std::cerr << print("%d frames: camera point x %.4f m, y %+.4f m, yaw %+.3f deg (sigma %.3f, %.3f mm, %.4f deg)\n",
                     fix->sightings, pose.x, pose.y, degrees(pose.yaw), 1e3 * sigma.x(), 1e3 * sigma.y(),
                     degrees(sigma.z()))
            << print(
                   "board: corners %.2f px beside the board file; lens %.1f mm above the floor of the board file, "
                   "robot rolled %+.2f and pitched %+.2f deg\n",
                   stand.rms_px, 1e3 * fix->hang.camera_height, degrees(fix->hang.roll), degrees(fix->hang.pitch));

  // The board as seen against the board file and the rig.
  constexpr double most_px = 2.0;       // 1.6 mm of a tag's place at 1 m: no survey is as bad
  constexpr double most_height = 0.05;  // m
  const double tilt = std::hypot(fix->hang.roll, fix->hang.pitch);
  const double height = fix->hang.camera_height - config.rig.T_base_camera.translation().z();
  std::string refusal;
  if (stand.rms_px > most_px)
    refusal = print(
        "the tags do not stand to each other as in the board file (%.1f px beside it); survey the board "
        "with `tagdock calibrate station`",
        stand.rms_px);
  else if (std::abs(height) > most_height || tilt > radians(3.0))
    refusal = print(
        "the board hangs %.0f mm and %.1f degrees otherwise than the board file and the rig say; correct "
        "the heights in one of them",
        -1e3 * height, degrees(tilt));
  else if (2.0 * sigma.x() > config.docking.fix.tolerance_x || 2.0 * sigma.y() > config.docking.fix.tolerance_y ||
           2.0 * sigma.z() > config.docking.fix.tolerance_yaw)
    refusal = print(
        "the pose is known to %.1f mm, %.1f mm and %.2f degrees (2 sigma) only, no better than the "
        "tolerance; stand nearer or use a board with turned tags",
        2e3 * sigma.x(), 2e3 * sigma.y(), 2.0 * degrees(sigma.z()));
  DockingConfig& docking = config.docking;
  docking.dock_pose = pose;
  docking.dock_pose_taught = true;
  docking.dock_pose_covariance = fix->covariance;
  docking.taught_hang = fix->hang;
  if (stand.truth) {
    config.simulation.taught_at_known = true;
    config.simulation.taught_at = *stand.truth;
  }
  if (refusal.empty()) {
    try {
      check(docking);
    } catch (const std::invalid_argument& error) {
      refusal = error.what();
    }
  }
  if (options.json) {
    nlohmann::ordered_json json = {{"schema", "tagdock-teach/1"},
                                   {"result", refusal.empty() ? "taught" : "refused"},
                                   {"reason", refusal},
                                   {"frames", fix->sightings},
                                   {"dock_pose", {{"x", pose.x}, {"y", pose.y}, {"yaw", pose.yaw}}},
                                   {"sigma", {{"x", sigma.x()}, {"y", sigma.y()}, {"yaw", sigma.z()}}},
                                   {"camera_height", fix->hang.camera_height},
                                   {"roll", fix->hang.roll},
                                   {"pitch", fix->hang.pitch},
                                   {"corners_beside_board_file_px", stand.rms_px},
                                   {"true_camera_point", nullptr}};
    if (stand.truth)
      json["true_camera_point"] = {{"x", stand.truth->x}, {"y", stand.truth->y}, {"yaw", stand.truth->yaw}};
    std::cout << json.dump(2) << "\n";
  }
  if (!refusal.empty()) throw Failure(ExitCode::calibration_refused, "not taught: " + refusal);
  std::ofstream stream(options.output, std::ios::binary);
  if (options.docks.empty())
    stream
        << "# Taught by `tagdock teach`: docking.dock_pose and docking.taught are what this robot saw standing at the\n"
           "# dock. All other keys are those it will dock with.\n"
        << to_yaml(config) << std::flush;
  else
    stream << docks_yaml(with_taught(read_docks(options.docks), options.dock_name, docking)) << std::flush;
  if (!stream) throw Failure(ExitCode::usage, "--output " + options.output + ": cannot be written");
  std::cerr << "written: tagdock dock "
            << (options.docks.empty() ? "--config " + options.output
                                      : "--docks " + options.output + " --dock " + options.dock_name)
            << "\n";
  return static_cast<int>(ExitCode::done);
}

}  // namespace

void add_teach(CLI::App& program, Action& action) {
  auto options = std::make_shared<TeachOptions>();
  CLI::App* verb = program.add_subcommand(
      "teach", "Takes the place where the robot stands now as its docking pose. Drive it to the dock by hand first.");
  verb->add_option("--output", options->output, "configuration to write, for `tagdock dock --config`");
  verb->add_option("--config", options->config, "configuration (YAML) to start from; its other keys are kept");
  verb->add_option("--docks", options->docks,
                   "docks that are known; --output is then these docks with what is seen at --dock now, for `dock "
                   "--docks`");
  verb->add_option("--dock", options->dock_name, "name of the dock in --docks where the robot stands");
  verb->add_option("--seconds", options->seconds, "how long to look")
      ->check(CLI::Range(1.0, 600.0))
      ->capture_default_str();
  verb->add_option("--camera", options->camera, "sim, gige:127.x.y.z, gige:SERIAL or images:DIR");
  verb->add_option("--robot", options->robot, "where odometry comes from: sim, ros2 or none");
  add_ros2_options(*verb, options->domain, options->name_space, options->remaps);
  verb->add_option("--rig", options->rig, "rig file; overrides the configuration's");
  verb->add_option("--board", options->board, "board file; overrides the configuration's");
  verb->add_option("--dock-pose", options->dock_pose,
                   "simulation: X,Y,YAW_DEG where the robot is put (camera point in the station frame)");
  verb->add_option("--scenario", options->scenario, "simulation: the world (YAML, see data/scenarios)");
  verb->add_option("--seed", options->seed, "simulation: seed")->capture_default_str();
  verb->add_option("--speedup", options->speedup, "simulation: as for dock; 0 as fast as it can");
  verb->add_flag("--json", options->json, "what was seen, as JSON on stdout");
  verb->footer(
      "The robot is not driven. Frames are put together as at a docking; what calibration and survey leave is part of\n"
      "the pose and cancels at every docking, and how the board hangs is kept, so that a board that was moved is\n"
      "noticed. The simulated robot is put at the dock.\n"
      "Examples:\n  tagdock teach --output taught.yaml && tagdock dock --config taught.yaml\n"
      "  tagdock teach --docks docks.yaml --dock home --output taught_docks.yaml\n"
      "Exit codes: 0 taught, 1 moved or seen too seldom, 2 usage or configuration, 3 camera, 4 tag never seen,\n"
      "5 robot link, 7 refused, 130 interrupted.");
  verb->callback([options, &action] { action = [options] { return teach(*options); }; });
}

}  // namespace tagdock
