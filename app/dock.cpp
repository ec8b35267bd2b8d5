// Verb: dock. Open, loop, stop.
#include <algorithm>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>
#include <unistd.h>
#include <vector>

#include "app/auto_exposure.h"
#include "app/config.h"
#include "app/devices.h"
#include "app/dock_database.h"
#include "app/docking_loop.h"
#include "app/docking_picture.h"
#include "app/docking_report.h"
#include "app/failure.h"
#include "app/fields.h"
#include "app/operator_input.h"
#include "app/option_checks.h"
#include "app/output_file.h"
#include "app/phase_picture.h"
#include "app/recording.h"
#include "app/rig_file.h"
#include "app/ros2_options.h"
#include "app/session.h"
#include "app/stop_signal.h"
#include "app/verbs.h"
#include "app/view.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;

struct DockOptions {
  Errand errand = Errand::dock;
  bool operator_words = false;
  std::string config;
  std::string camera;
  std::string robot;
  std::optional<int> domain;
  std::string name_space;
  std::vector<std::string> remaps;
  std::string docks;
  std::string dock_name;
  std::string rig;
  std::string board;
  std::string dock_pose;
  std::string scenario;
  std::string method;
  std::string record;
  std::string station = "off";
  std::uint64_t seed = 1;
  std::optional<double> speedup;
  std::string report;
  std::string picture;
  std::string write_config;
  bool compress = false;
  std::string phases;
  bool view = false;
  bool json = false;
};

Pose2 parse_dock_pose(const std::string& text) {
  Pose2 pose;
  double yaw_deg = 0.0;
  char rest = 0;
  if (std::sscanf(text.c_str(), "%lf,%lf,%lf%c", &pose.x, &pose.y, &yaw_deg, &rest) != 3 || !is_finite(pose) ||
      !std::isfinite(yaw_deg))
    throw Failure(ExitCode::usage, "--dock-pose is " + text + "; it must be X,Y,YAW_DEG, for example -1.0,0,0");
  if (pose.x >= 0.0 || pose.x < -20.0)
    throw Failure(ExitCode::usage, "--dock-pose has X = " + std::to_string(pose.x) +
                                       " m; the camera stands before the wall, so X must be between -20 and 0");
  pose.yaw = radians(yaw_deg);
  return pose;
}

// What was measured at one docking pose says nothing of another pose or board.
void forget_taught(Config& config) {
  DockingConfig& docking = config.docking;
  docking.dock_pose_taught = false;
  docking.dock_pose_covariance.setZero();
  docking.taught_hang.reset();
  config.simulation.taught_at_known = false;
}

// What was asked, as one configuration that is exactly what a recording will hold.
Config configuration(const DockOptions& options) {
  Config config = options.config.empty() ? Config{} : read_config(options.config);
  if (const auto dock = chosen_dock(options.docks, options.dock_name)) {
    if (!dock->board.empty())
      config.board = read_board(std::filesystem::path(options.docks).parent_path() / dock->board);
    if (dock->dock_pose) config.docking.dock_pose = *dock->dock_pose;
    if (!dock->board.empty() || dock->dock_pose) forget_taught(config);
    if (dock->taught) {
      config.docking.dock_pose_taught = true;
      config.docking.dock_pose_covariance = dock->taught->covariance;
      config.docking.taught_hang = dock->taught->hang;
    }
  }
  if (!options.rig.empty()) config.rig = read_rig(options.rig);
  if (!options.board.empty()) config.board = read_board(options.board);
  if (!options.camera.empty()) config.camera.source = options.camera;
  if (!options.robot.empty()) config.robot = options.robot;
  if (options.domain) config.ros2.domain = *options.domain;
  if (!options.name_space.empty()) config.ros2.name_space = options.name_space;
  for (const std::string& rule : options.remaps) remap(config.ros2, rule);
  if (!options.dock_pose.empty()) config.docking.dock_pose = parse_dock_pose(options.dock_pose);
  if (!options.board.empty() || !options.dock_pose.empty()) forget_taught(config);
  if (!options.scenario.empty()) config.simulation.scenario = options.scenario;
  if (options.errand == Errand::undock) config.docking.errand = Errand::undock;
  if (!options.method.empty()) {
    const auto method = corner_method(options.method);
    if (!method)
      throw Failure(ExitCode::usage,
                    "--method is " + options.method + "; it must be one of apriltag tanh filter erf best");
    config.locator.method = *method;
  }
  return parse_config(to_yaml(config), "(configuration of this docking)");
}

// Also of a camera that is being opened again nothing can be expected.
bool sends_frames(const CameraHealth& health) {
  return health.state == "streaming" || health.state == "silent" || health.state == "ended";
}

// Stops the robot on every way out of the loop.
class StopAtEnd {
 public:
  explicit StopAtEnd(Robot& robot) : robot_(robot) {}
  ~StopAtEnd() { robot_.stop(); }

 private:
  Robot& robot_;
};

// What a person at the terminal sees: one line an event, and one line in place with the progress.
class Talk {
 public:
  explicit Talk(bool quiet) : quiet_(quiet), terminal_(!quiet && ::isatty(STDERR_FILENO) != 0) {}

  void event(nanoseconds time, const std::string& text) {
    if (quiet_) return;
    clear();
    std::fprintf(stderr, "%7.2fs  %s\n", std::chrono::duration<double>(time).count(), text.c_str());
  }

  void progress(nanoseconds time, const std::string& text) {
    if (!terminal_ || time - shown_ < std::chrono::milliseconds(100)) return;
    shown_ = time;
    std::fprintf(stderr, "\r\033[K%7.2fs  %s", std::chrono::duration<double>(time).count(), text.c_str());
    std::fflush(stderr);
    dirty_ = true;
  }

  void clear() {
    if (dirty_) std::fprintf(stderr, "\r\033[K");
    dirty_ = false;
  }

 private:
  bool quiet_;
  bool terminal_;
  bool dirty_ = false;
  nanoseconds shown_{0};
};

std::string progress_words(const Docker& docker, const TickResult& result, const Pose2& T_base_camera) {
  std::string text(name(docker.phase()));
  char part[128];
  if (const std::optional<double> rest = docker.distance_to_go(result)) {
    std::snprintf(part, sizeof part, "  to go %.3f m", *rest);
    text += part;
  }
  if (result.estimate) {
    const Pose2 error = result.estimate->T_station_base * T_base_camera;
    const Pose2& dock = docker.config().dock_pose;
    std::snprintf(part, sizeof part, "  x %+7.1f mm  y %+6.1f mm  yaw %+5.2f deg", 1e3 * (error.x - dock.x),
                  1e3 * (error.y - dock.y), degrees(wrap_angle(error.yaw - dock.yaw)));
    text += part;
  }
  if (result.gate != GateAction::passed && !result.gate_reason.empty())
    text += "  (" + std::string(result.gate_reason) + ")";
  return text;
}

class Docking {
 public:
  Docking(const DockOptions& options, const Config& config, const std::string& config_text, Devices& devices)
      : options_(options),
        config_(config),
        devices_(devices),
        loop_(config),
        T_base_camera_(camera_point(config.rig)),
        talk_(options.json) {
    if (!options.record.empty())
      recorder_ = std::make_unique<SessionRecorder>(
          options.record, session_yaml(config_text, devices.camera_name, devices.camera->actual(), options.seed),
          sensor_yaml(config.rig.camera, config.camera.frame_rate), options.speedup.has_value(),
          RecorderOptions{options.compress, {}});
    if (options.view) view_ = std::make_unique<View>("tagdock", config.rig.camera.width, config.rig.camera.height);
    story_.board = config.board;
    story_.dock_pose = config.docking.dock_pose;
  }

  DockingReport run() {
    DockingReport report;
    report.seed = options_.seed;
    report.taught = config_.docking.dock_pose_taught;
    const StopSignal stop_signal;
    const StopAtEnd stop_at_end(*devices_.robot);
    const nanoseconds begin = devices_.clock->now();
    OperatorInput person(options_.operator_words);
    if (!options_.json && !person.hint().empty()) talk_.event(begin, person.hint());
    if (!person.hint().empty()) keys_ = person.hint() + " (in the terminal)";
    talk_.event(begin, (config_.docking.errand == Errand::dock ? "docking: camera " : "undocking: camera ") +
                           devices_.camera_name + ", robot " + devices_.robot_name);
    for (const std::string& note : devices_.notes) talk_.event(begin, "camera: " + note);
    report.phases.push_back({std::string(name(loop_.docker().phase())), begin, begin});
    bool over = false;
    while (!over) {
      DockingLoop::Inputs inputs;
      std::optional<CameraFrame> camera_frame = devices_.camera->newest(devices_.clock->now());
      try {
        inputs.odometry = devices_.robot->read();
      } catch (const std::runtime_error& error) {
        inputs.robot_linked = false;
        inputs.robot_sentence = error.what();
      }
      const CameraHealth health = devices_.camera->health();
      inputs.now = devices_.clock->now();
      inputs.camera = sends_frames(health) ? CameraState::streaming : CameraState::lost;
      if (inputs.camera == CameraState::lost)
        inputs.camera_sentence = health.reason.empty() ? "the camera is " + health.state : health.reason;
      if (camera_frame) inputs.frame = camera_frame->frame;
      inputs.request = asked(person.next(), inputs.now);
      if (stop_signal.requested()) {
        inputs.request = Request::stop;
        report.interrupted = true;
      }
      const DockingLoop::Outputs outputs = loop_.cycle(inputs);
      // A command that took so long to make was made from odometry that is too old to drive by.
      const bool late = devices_.clock->now() - inputs.now > config_.docking.gate.odometry.max_age;
      if (inputs.robot_linked) devices_.robot->drive(late ? Twist2{} : outputs.docking.command);

      if (camera_frame) watch_exposure(*camera_frame, outputs);
      if (devices_.tell_others) devices_.tell_others(inputs, outputs, loop_.docker(), health);
      record(outputs, camera_frame);
      tell(inputs, outputs, report);
      if (camera_frame) {
        report.frame_ages_ms.push_back(static_cast<double>((inputs.now - camera_frame->frame.time).count()) / 1e6);
        remember(inputs, outputs);
      }
      report.camera = health;
      if (outputs.docking.estimate) report.stands = outputs.docking.estimate->T_station_base * T_base_camera_;
      over = outputs.docking.over;
      if (!over) devices_.clock->sleep_until(inputs.now + outputs.docking.next_tick);
    }
    report.last = loop_.docker().phase();
    const nanoseconds end = devices_.clock->now();
    report.phases.back().end = end;
    report.phases.push_back({std::string(name(report.last)), end, end});
    report.duration = end - begin;
    devices_.robot->stop();
    if (devices_.true_docking_error) {
      // The robot is at rest when the docking is over; what a stop in motion still rolls belongs to the error.
      devices_.clock->sleep_until(end + std::chrono::milliseconds(500));
      (void)devices_.robot->read();
      report.true_error = devices_.true_docking_error(config_.simulation.taught_at_known ? config_.simulation.taught_at
                                                                                         : config_.docking.dock_pose);
    }
    talk_.clear();
    constexpr double sharp_px = 1.0;
    if (largest_blur_px_ > sharp_px) {
      char text[200];
      std::snprintf(text, sizeof text,
                    "the picture moved by up to %.1f px during an exposure of %.0f us: below %.0f us it stays sharp to "
                    "a pixel (camera.exposure_us, or auto_exposure)",
                    largest_blur_px_, blurred_exposure_us_, blurred_exposure_us_ / largest_blur_px_);
      talk_.event(end, std::string("advice: ") + text);
      if (recorder_) recorder_->line(SessionStream::events, std::to_string(end.count()) + "," + one_field(text));
    }
    if (recorder_) {
      recorder_->finish();
      const RecorderHealth health = recorder_->health();
      if (!health.warning.empty()) std::cerr << "recording: " << health.warning << "\n";
      if (health.frames_dropped > 0)
        std::cerr << "recording: " << health.frames_dropped << " frames were dropped because the disk was too slow\n";
    }
    return report;
  }

  [[nodiscard]] const DockingStory& story() const { return story_; }

 private:
  // Motion blur, and with camera.auto_exposure the tags' brightness. Nothing of the docking depends on it.
  void watch_exposure(const CameraFrame& frame, const DockingLoop::Outputs& outputs) {
    const BoardSighting* board = outputs.sighting ? std::get_if<BoardSighting>(&*outputs.sighting) : nullptr;
    if (board == nullptr) {
      last_corners_.clear();
      return;
    }
    std::map<int, Corners> corners;
    std::vector<Corners> tags;
    double moved_px = 0.0;
    for (const RefinedTag& tag : board->tags) {
      corners[tag.id] = tag.corners_px;
      tags.push_back(tag.corners_px);
      if (const auto before = last_corners_.find(tag.id); before != last_corners_.end())
        for (std::size_t i = 0; i < 4; ++i)
          moved_px = std::max(moved_px, (tag.corners_px[i] - before->second[i]).norm());
    }
    const double seconds = std::chrono::duration<double>(frame.frame.time - last_seen_).count();
    constexpr double same_motion_s = 0.2;
    const double speed_px =
        !last_corners_.empty() && seconds > 0.0 && seconds < same_motion_s ? moved_px / seconds : 0.0;
    last_corners_ = std::move(corners);
    last_seen_ = frame.frame.time;
    if (const double blur_px = 1e-6 * frame.exposure_us * speed_px; blur_px > largest_blur_px_) {
      largest_blur_px_ = blur_px;
      blurred_exposure_us_ = frame.exposure_us;
    }
    if (!config_.camera.auto_exposure) return;
    // From here on the edges are measured for the last time: half a metre and the fix itself.
    constexpr double final_approach = 0.5;
    const std::string phase(name(loop_.docker().phase()));
    const std::optional<double> rest = loop_.docker().distance_to_go(outputs.docking);
    const bool frozen = phase == "fixing" || (rest && *rest < final_approach);
    const auto light = meter(frame.frame.gray, tags);
    if (!light) return;
    if (const auto wanted = exposure_.next(*light, {frame.exposure_us, frame.gain}, speed_px, frozen)) {
      devices_.camera->adjust(wanted->exposure_us, wanted->gain_db);
      char text[120];
      std::snprintf(text, sizeof text, "exposure %.0f us; gain %.1f dB (the tags' white was at %.0f %%)",
                    wanted->exposure_us, wanted->gain_db, 100.0 * light->white);
      if (recorder_)
        recorder_->line(SessionStream::events, std::to_string(frame.arrived.count()) + "," + one_field(text));
    }
  }

  // The robot and the person can both make the docking wait; it goes on when neither wants it to. What a person paused
  // only a person lets go on.
  Request asked(Request by_person, nanoseconds now) {
    if (by_person == Request::pause) person_waits_ = true;
    if (by_person == Request::resume) person_waits_ = false;
    const bool hold = devices_.robot->wants_hold();
    if (hold != robot_waits_)
      talk_.event(now, hold ? "robot: something is in the way; waiting" : "robot: the way is free again");
    robot_waits_ = hold;
    if (by_person == Request::cancel || by_person == Request::stop) return by_person;
    const bool paused = std::holds_alternative<Paused>(loop_.docker().phase());
    const bool wait = robot_waits_ || person_waits_;
    if (wait == paused) return Request::none;
    return wait ? Request::pause : Request::resume;
  }

  void record(const DockingLoop::Outputs& outputs, const std::optional<CameraFrame>& frame) {
    if (!recorder_) return;
    if (frame) recorder_->frame(*frame);
    for (const std::string& text : outputs.odometry_lines) recorder_->line(SessionStream::odometry, text);
    if (outputs.sighting_line) recorder_->line(SessionStream::sightings, *outputs.sighting_line);
    recorder_->line(SessionStream::commands, outputs.command_line);
    if (outputs.phase_line) recorder_->line(SessionStream::phases, *outputs.phase_line);
    for (const Event& event : outputs.docking.events)
      recorder_->line(SessionStream::events, std::to_string(event.time.count()) + "," + one_field(event.text));
  }

  void tell(const DockingLoop::Inputs& inputs, const DockingLoop::Outputs& outputs, DockingReport& report) {
    for (const Event& event : outputs.docking.events) talk_.event(event.time, event.text);
    if (outputs.docking.phase_changed && !outputs.docking.over) {
      report.phases.back().end = inputs.now;
      report.phases.push_back({std::string(name(loop_.docker().phase())), inputs.now, inputs.now});
    }
    const std::string words = progress_words(loop_.docker(), outputs.docking, T_base_camera_);
    talk_.progress(inputs.now, words);
    const BoardSighting* board = outputs.sighting ? std::get_if<BoardSighting>(&*outputs.sighting) : nullptr;
    if (board != nullptr) ++report.sightings;
    if (view_ && inputs.frame) {
      const Eigen::Isometry3d T_camera_goal = level_view(config_.rig, goal_of_axle(loop_.docker().config()));
      view_->show({inputs.frame->gray,
                   board != nullptr ? board->tags : std::vector<RefinedTag>{},
                   projected_board(config_.board, config_.rig.camera, T_camera_goal),
                   {words, "green: tags as seen; light blue: where they stand at the dock", keys_}});
    }
  }

  // For the picture of the docking.
  void remember(const DockingLoop::Inputs& inputs, const DockingLoop::Outputs& outputs) {
    if (options_.picture.empty()) return;
    DockingMoment moment{inputs.now, std::string(name(loop_.docker().phase())), {}, {}};
    if (outputs.docking.estimate) moment.estimated = outputs.docking.estimate->T_station_base * T_base_camera_;
    if (devices_.true_camera_point) moment.truth = devices_.true_camera_point();
    story_.moments.push_back(moment);
    if (const BoardSighting* board = outputs.sighting ? std::get_if<BoardSighting>(&*outputs.sighting) : nullptr) {
      story_.last_image = inputs.frame->gray;
      story_.last_tags = board->tags;
    }
  }

  const DockOptions& options_;
  const Config& config_;
  Devices& devices_;
  DockingLoop loop_;
  Pose2 T_base_camera_;
  Talk talk_;
  std::unique_ptr<SessionRecorder> recorder_;
  std::unique_ptr<View> view_;
  AutoExposure exposure_{AutoExposureConfig{}};
  std::map<int, Corners> last_corners_;  ///< of the tags in the last frame
  nanoseconds last_seen_{0};
  double largest_blur_px_ = 0.0;
  double blurred_exposure_us_ = 0.0;
  DockingStory story_;
  std::string keys_;  ///< what to tell a person about them
  bool person_waits_ = false;
  bool robot_waits_ = false;
};

void write_file(const std::string& file, const std::string& text, const std::string& option) {
  std::ofstream stream(file, std::ios::binary);
  stream << text << std::flush;
  if (!stream) throw Failure(ExitCode::usage, option + " " + file + ": cannot be written");
}

// After a docking a file that cannot be written is said, and does not change what the docking came to.
void try_write_file(const std::string& file, const std::string& text, const std::string& option) {
  if (file.empty()) return;
  try {
    write_file(file, text, option);
  } catch (const Failure& failure) {
    std::cerr << "tagdock: " << failure.what() << "\n";
  }
}

// Frames that come coarser need not be made coarser still to find tags.
void adapt_to_coarse_frames(Config& config, int binning) {
  config.locator.detector.decimate = std::max(1, config.locator.detector.decimate / binning);
}

int dock(const DockOptions& options) {
  if (options.station != "off")
    throw Failure(ExitCode::usage,
                  "--station " + options.station + ": there is no station page yet; only off is known");
  if (options.speedup && !(*options.speedup >= 0.0))
    throw Failure(ExitCode::usage, "--speedup must be 0 (as fast as it can) or more");
  if (!options.phases.empty()) {
    const std::string picture = phase_picture(transitions());
    if (options.phases == "-")
      std::cout << picture;
    else
      write_file(options.phases, picture, "--phases");
    return static_cast<int>(ExitCode::done);
  }
  if (options.write_config != "-") check_new("--write-config", options.write_config);
  Config config = configuration(options);
  if (!options.write_config.empty()) {
    if (options.write_config == "-")
      std::cout << to_yaml(config);
    else
      write_file(options.write_config, to_yaml(config), "--write-config");
    return static_cast<int>(ExitCode::done);
  }
  if (!options.report.empty() && std::filesystem::path(options.report).lexically_normal() ==
                                     std::filesystem::path(options.picture).lexically_normal())
    throw Failure(ExitCode::usage, "--report and --picture are both " + options.report + "; name two files");
  check_writable("--report", options.report);
  check_writable("--picture", options.picture);
  Devices devices = open_devices(config, {options.seed, options.speedup});
  config.rig.camera = devices.camera_model;
  adapt_to_coarse_frames(config, devices.binning);
  const std::string config_text = to_yaml(config);
  config = parse_config(config_text, "(configuration of this docking)");
  Docking docking(options, config, config_text, devices);
  const DockingReport report = docking.run();
  const std::string words = summary(report);
  if (options.json)
    std::cout << to_json(report).dump(2) << "\n";
  else
    std::cout << words;
  try_write_file(options.report, to_json(report).dump(2) + "\n", "--report");
  if (!options.picture.empty()) {
    DockingStory story = docking.story();
    std::string line;
    for (std::istringstream stream(words); std::getline(stream, line);) story.lines.push_back(line);
    try_write_file(options.picture, docking_picture(story), "--picture");
  }
  return static_cast<int>(exit_code(report));
}

}  // namespace

namespace {

// What docking and undocking have in common.
void add_options_of_both(CLI::App* verb, const std::shared_ptr<DockOptions>& options) {
  verb->add_option("--config", options->config, "configuration (YAML); unknown keys are refused");
  verb->add_option("--camera", options->camera, "sim, gige:127.x.y.z, gige:SERIAL or images:DIR");
  verb->add_option("--robot", options->robot, "sim, ros2 or none")->check(CLI::IsMember({"sim", "ros2", "none"}));
  add_ros2_options(*verb, options->domain, options->name_space, options->remaps);
  verb->add_option("--rig", options->rig, "rig file: camera, T_base_cam, odometry; overrides the configuration's");
  verb->add_option("--board", options->board, "board file: family and tags; overrides the configuration's");
  verb->add_option("--docks", options->docks, "docks that are known (tagdock docks import); with --dock");
  verb->add_option("--dock", options->dock_name,
                   "name of the dock in --docks: its board and its docking pose are used");
  verb->add_option("--dock-pose", options->dock_pose,
                   "X,Y,YAW_DEG of the camera point in the station frame, X negative: before the wall");
  verb->add_option("--scenario", options->scenario, "simulation: the world (YAML, see data/scenarios)");
  verb->add_option("--method", options->method, "how corners are made: apriltag tanh filter erf best");
  CLI::Option* record =
      verb->add_option("--record", options->record, "write a session folder there; it must not exist or be empty");
  verb->add_flag("--compress", options->compress,
                 "with --record: frames as PNG, half the disk for a quarter of a processor")
      ->needs(record);
  verb->add_option("--station", options->station, "off; the station page comes with a later version")
      ->capture_default_str();
  verb->add_option("--seed", options->seed, "simulation: seed of start pose, slip and noise")
      ->check(not_negative())
      ->capture_default_str();
  verb->add_option("--speedup", options->speedup,
                   "simulation: frames in-process, this many times faster than real; 0 as fast as it can");
  verb->add_option("--report", options->report, "write what the docking came to, as JSON");
  verb->add_option("--picture", options->picture, "write the docking at a glance, as SVG");
  verb->add_flag("--operator", options->operator_words,
                 "without a terminal: read the words pause, resume, cancel, stop, one a line, from standard input");
  verb->add_flag("--view", options->view, "window with the live image, the tags and the target");
  verb->add_flag("--json", options->json, "the report on stdout instead of words");
}

}  // namespace

void add_undock(CLI::App& program, Action& action) {
  auto options = std::make_shared<DockOptions>();
  options->errand = Errand::undock;
  CLI::App* verb = program.add_subcommand(
      "undock", "Drives a docked robot straight back, out of the station. Refuses where the robot is not docked.");
  add_options_of_both(verb, options);
  verb->footer(
      "How far: docking.undock.camera_distance_m of the configuration (2.2 m before the board). The simulated robot\n"
      "starts at the dock. While it runs at a terminal: p pauses, r resumes, c cancels, space stops.\n"
      "Exit codes: 0 undocked, 1 not undocked (also: was not docked), 2 usage or configuration, 3 camera,\n"
      "4 tag never seen, 5 robot link, 6 stopped, 130 interrupted.");
  verb->callback([options, &action] { action = [options] { return dock(*options); }; });
}

void add_dock(CLI::App& program, Action& action) {
  auto options = std::make_shared<DockOptions>();
  CLI::App* verb = program.add_subcommand(
      "dock", "Docks the robot. Without any option: a simulated robot, seen through a GigE Vision stream on loopback.");
  add_options_of_both(verb, options);
  verb->add_option("--write-config", options->write_config,
                   "write every key of the configuration that would be used, as YAML (- is stdout), and do not dock");
  verb->add_option("--phases", options->phases,
                   "draw the phases of a docking and the ways between them (SVG; - for stdout), and dock nothing");
  verb->footer(
      "While it runs at a terminal: p pauses, r resumes, c cancels, space stops.\n"
      "Examples:\n  tagdock dock --seed 1\n  tagdock dock --speedup 0 --record docking1 --report docking1.json\n"
      "Exit codes: 0 docked, 1 not docked, 2 usage or configuration, 3 camera, 4 tag never seen, 5 robot link,\n"
      "6 stopped, 130 interrupted.");
  verb->callback([options, &action] { action = [options] { return dock(*options); }; });
}

}  // namespace tagdock
