// Verb: record. Camera and odometry into a session folder, without docking.
#include <cstdio>
#include <iostream>
#include <memory>

#include <nlohmann/json.hpp>

#include "app/devices.h"
#include "app/failure.h"
#include "app/option_checks.h"
#include "app/recording.h"
#include "app/rig_file.h"
#include "app/session.h"
#include "app/stop_signal.h"
#include "app/verbs.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;

struct RecordOptions {
  std::string folder;
  std::string config;
  std::string camera;
  std::string robot = "none";
  std::string rig;
  double seconds = 0.0;
  std::uint64_t frames = 0;
  std::uint64_t seed = 1;
  bool compress = false;
  bool json = false;
};

int record(const RecordOptions& options) {
  Config config = options.config.empty() ? Config{} : read_config(options.config);
  if (!options.rig.empty()) config.rig = read_rig(options.rig);
  if (!options.camera.empty()) config.camera.source = options.camera;
  config.robot = options.robot;
  config = parse_config(to_yaml(config), "(configuration of this recording)");
  const StopSignal stop_signal;
  Devices devices = open_devices(config, {options.seed, std::nullopt, options.config.empty() && options.rig.empty()});
  config.rig.camera = devices.camera_model;
  const std::string config_text = to_yaml(config);
  SessionRecorder recorder(options.folder,
                           session_yaml(config_text, devices.camera_name, devices.camera->actual(), options.seed),
                           sensor_yaml(config.rig.camera, config.camera.frame_rate), false, {options.compress, {}});
  if (!options.json) std::cout << "recording " << devices.camera_name << " into " << options.folder << std::endl;
  for (const std::string& note : devices.notes) std::cerr << "camera: " << note << "\n";
  const nanoseconds begin = devices.clock->now();
  std::string state;
  std::uint64_t taken = 0;
  bool over = false;
  bool lost = false;
  while (!over) {
    const nanoseconds now = devices.clock->now();
    if (const std::optional<CameraFrame> frame = devices.camera->newest(now)) {
      recorder.frame(*frame);
      ++taken;
    }
    for (const Odometry& odometry : devices.robot->read()) recorder.line(SessionStream::odometry, line(odometry));
    const CameraHealth health = devices.camera->health();
    if (health.state != state) {
      recorder.line(SessionStream::events, std::to_string(now.count()) + ",camera " + health.state);
      if (!state.empty() || health.state != "streaming")
        std::cerr << "camera: " << health.state << (health.reason.empty() ? "" : ": " + health.reason) << "\n";
      state = health.state;
    }
    lost = health.state == "lost";
    over = stop_signal.requested() || health.state == "ended" || (options.frames > 0 && taken >= options.frames) ||
           (options.seconds > 0.0 && std::chrono::duration<double>(now - begin).count() >= options.seconds) ||
           !recorder.health().warning.empty();
    if (!over) devices.clock->sleep_until(now + std::chrono::milliseconds(2));
  }
  recorder.finish();
  const RecorderHealth recorded = recorder.health();
  const CameraHealth health = devices.camera->health();
  if (options.json) {
    const nlohmann::ordered_json json = {{"schema", "tagdock-record/1"},
                                         {"frames", recorded.frames_written},
                                         {"dropped_by_the_disk", recorded.frames_dropped},
                                         {"lost_by_the_camera", health.lost},
                                         {"incomplete", health.incomplete},
                                         {"not_taken_in_time", health.overwritten},
                                         {"warning", recorded.warning}};
    std::cout << json.dump() << "\n";
  } else {
    std::printf(
        "%llu frames recorded; %llu dropped because the disk was too slow, %llu lost and %llu incomplete on "
        "the way from the camera\n",
        static_cast<unsigned long long>(recorded.frames_written),
        static_cast<unsigned long long>(recorded.frames_dropped), static_cast<unsigned long long>(health.lost),
        static_cast<unsigned long long>(health.incomplete));
  }
  if (!recorded.warning.empty()) {
    std::cerr << "recording: " << recorded.warning << "\n";
    return static_cast<int>(ExitCode::failed);
  }
  return static_cast<int>(lost ? ExitCode::camera : ExitCode::done);
}

}  // namespace

void add_record(CLI::App& program, Action& action) {
  auto options = std::make_shared<RecordOptions>();
  CLI::App* verb =
      program.add_subcommand("record", "Records what the camera sees, and odometry, without docking; Ctrl-C ends it.");
  verb->add_option("folder", options->folder, "session folder to write; it must not exist or be empty")->required();
  verb->add_option("--camera", options->camera, "sim, gige:127.x.y.z, gige:SERIAL or images:DIR");
  verb->add_option("--robot", options->robot, "where odometry comes from: none or sim")
      ->check(CLI::IsMember({"none", "sim"}))
      ->capture_default_str();
  verb->add_option("--config", options->config, "configuration (YAML): camera settings, rig");
  verb->add_option("--rig", options->rig, "rig file; overrides the configuration's");
  verb->add_option("--seconds", options->seconds, "end after this time; 0 at Ctrl-C")
      ->check(not_negative())
      ->capture_default_str();
  verb->add_option("--frames", options->frames, "end after so many frames; 0 never")->capture_default_str();
  verb->add_flag("--compress", options->compress, "PNG instead of PGM: half the disk, a quarter of a processor");
  verb->add_option("--seed", options->seed, "simulation: seed")->check(not_negative())->capture_default_str();
  verb->add_flag("--json", options->json, "the count as JSON");
  verb->footer(
      "A recording does not begin with less than 2 GB free and ends, with a warning, at 500 MB.\n"
      "Examples:\n  tagdock record walk1 --camera gige:127.0.0.1 --seconds 60\n  tagdock replay walk1 --output seen\n"
      "Exit codes: 0 done, 1 ended early because of the disk, 2 usage, 3 camera.");
  verb->callback([options, &action] { action = [options] { return record(*options); }; });
}

}  // namespace tagdock
