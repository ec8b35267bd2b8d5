// Verb: replay. A recorded session, or images, through the same code.
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>
#include <thread>

#include <nlohmann/json.hpp>

#include "app/camera_file.h"
#include "app/cameras/image_sequence.h"
#include "app/detect.h"
#include "app/failure.h"
#include "app/rig_file.h"
#include "app/session_replay.h"
#include "app/verbs.h"

namespace tagdock {
namespace {

struct ReplayOptions {
  std::string folder;
  bool compare = false;
  double speed = 0.0;
  std::string camera;
  std::string rig;
  std::string board;
  std::string family = "tag36h11";
  double tag_size = 0.0;
  std::string method;
  std::string output;
  bool json = false;
};

void write_stream(const std::filesystem::path& folder, SessionStream stream, const std::string& file,
                  const std::vector<std::string>& lines) {
  std::ofstream out(folder / file, std::ios::binary);
  out << header(stream) << "\n";
  for (const std::string& text : lines) out << text << "\n";
  if (!out.flush()) throw Failure(ExitCode::usage, "--output " + (folder / file).string() + ": cannot be written");
}

int replay_session(const ReplayOptions& options) {
  const Session session = read_session(options.folder);
  for (const std::string& remark : session.remarks) std::cerr << "replay: " << remark << "\n";
  const SessionHead head = read_session_head(options.folder);
  Config config = head.config;
  if (!options.camera.empty()) config.rig.camera = CameraFile::load(options.camera).camera();
  if (!options.rig.empty()) config.rig = read_rig(options.rig);
  if (!options.board.empty()) config.board = read_board(options.board);
  if (!options.method.empty()) config.locator.method = *corner_method(options.method);
  config.docking.rig = config.rig;

  const auto begin = std::chrono::steady_clock::now();
  const ReplayResult result =
      replay(session, config, [&](const DockingLoop::Inputs& inputs, const DockingLoop::Outputs&) {
        if (options.speed > 0.0)
          std::this_thread::sleep_until(
              begin + std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::duration<double, std::nano>(
                          static_cast<double>(inputs.now.count()) / options.speed)));
        return true;
      });
  if (!options.output.empty()) {
    std::filesystem::create_directories(options.output);
    write_stream(options.output, SessionStream::sightings, "sightings.csv", result.sighting_lines);
    write_stream(options.output, SessionStream::commands, "commands.csv", result.command_lines);
    write_stream(options.output, SessionStream::phases, "phases.csv", result.phase_lines);
  }
  if (options.json) {
    nlohmann::ordered_json json;
    json["schema"] = "tagdock-replay/1";
    json["cycles"] = result.cycles;
    json["frames"] = result.frames;
    json["sightings"] = result.sightings;
    json["last_phase"] = result.last_phase;
    json["differences"] = result.difference_count;
    json["first_differences"] = result.differences;
    json["remarks"] = session.remarks;
    std::cout << json.dump(2) << "\n";
  } else {
    std::printf("%llu cycles, %llu frames, %llu with the board; ended %s\n",
                static_cast<unsigned long long>(result.cycles), static_cast<unsigned long long>(result.frames),
                static_cast<unsigned long long>(result.sightings), result.last_phase.c_str());
    if (result.difference_count == 0)
      std::printf("bit-equal: every sighting, phase and command is as it was recorded\n");
    else
      std::printf("%llu lines differ from the recording\n", static_cast<unsigned long long>(result.difference_count));
    for (const std::string& difference : result.differences) std::printf("%s\n", difference.c_str());
  }
  return static_cast<int>(options.compare && result.difference_count > 0 ? ExitCode::failed : ExitCode::done);
}

// The board in each image, as lines of sightings.csv; images are taken one a second.
std::vector<std::string> board_sightings(const ReplayOptions& options) {
  const Rig rig = read_rig(options.rig);
  const Board board = read_board(options.board);
  TagLocatorConfig config;
  config.detector.family = board.family;
  if (!options.method.empty()) config.method = *corner_method(options.method);
  const TagLocator locator(rig, board, config);
  std::vector<std::string> lines;
  ImageSequence images({options.folder, 1.0});
  while (const std::optional<CameraFrame> image = images.next()) {
    const cv::Size size = image->frame.gray.size();
    if (size.width != rig.camera.width || size.height != rig.camera.height)
      throw Failure(ExitCode::usage, images.files()[image->frame.number].string() + ": is " +
                                         std::to_string(size.width) + "x" + std::to_string(size.height) +
                                         ", and the rig's camera is " + std::to_string(rig.camera.width) + "x" +
                                         std::to_string(rig.camera.height));
    lines.push_back(sighting_line(image->frame, locator.locate(image->frame, std::nullopt)));
  }
  return lines;
}

int replay_images(const ReplayOptions& options) {
  if (options.compare)
    throw Failure(ExitCode::usage, "--compare needs a session folder; images have nothing to compare with");
  if (options.board.empty() != options.rig.empty())
    throw Failure(ExitCode::usage, "for the pose of a board in images, --board and --rig go together");
  DetectOptions detect;
  for (const std::filesystem::path& file : list_images(options.folder)) detect.images.push_back(file.string());
  detect.camera = options.camera.empty() ? options.rig : options.camera;
  detect.family = options.family;
  detect.tag_size = options.tag_size;
  if (!options.method.empty()) detect.method = options.method;
  detect.json = options.json;
  if (!options.output.empty()) {
    std::filesystem::create_directories(options.output);
    detect.output = (std::filesystem::path(options.output) / (options.json ? "tags.json" : "tags.csv")).string();
    detect.annotate = options.output;
  }
  const int code = detect_images(detect);
  if (options.board.empty()) return code;
  const std::vector<std::string> lines = board_sightings(options);
  if (options.output.empty()) {
    std::cout << header(SessionStream::sightings) << "\n";
    for (const std::string& text : lines) std::cout << text << "\n";
  } else {
    write_stream(options.output, SessionStream::sightings, "sightings.csv", lines);
  }
  return code;
}

int replay_any(const ReplayOptions& options) {
  if (!options.method.empty() && !corner_method(options.method))
    throw Failure(ExitCode::usage,
                  "--method is " + options.method + "; it must be one of apriltag tanh filter erf best");
  const bool session = std::filesystem::is_regular_file(std::filesystem::path(options.folder) / "session.yaml");
  return session ? replay_session(options) : replay_images(options);
}

}  // namespace

void add_replay(CLI::App& program, Action& action) {
  auto options = std::make_shared<ReplayOptions>();
  CLI::App* verb = program.add_subcommand(
      "replay", "Repeats a recorded docking through the same code, or looks for tags in a folder of images.");
  verb->add_option("folder", options->folder, "session folder, folder of images, or numbered pattern (I%04d.pgm)")
      ->required();
  verb->add_flag("--compare", options->compare,
                 "succeed only if every sighting, phase and command is as it was recorded, to the last bit");
  verb->add_option("--speed", options->speed, "times real time; 0 as fast as it can")->capture_default_str();
  verb->add_option("--camera", options->camera, "use this camera file instead of the recorded one");
  verb->add_option("--rig", options->rig, "use this rig file instead of the recorded one; images: with --board");
  verb->add_option("--board", options->board, "use this board file instead of the recorded one; images: with --rig");
  verb->add_option("--family", options->family, "images: tag family")->capture_default_str();
  verb->add_option("--tag-size", options->tag_size, "images: side of the black square [m]");
  verb->add_option("--method", options->method, "how corners are made: apriltag tanh filter erf best");
  verb->add_option("--output", options->output, "folder for what is made now: CSV files and, for images, pictures");
  verb->add_flag("--json", options->json, "the result as JSON");
  verb->footer(
      "Examples:\n  tagdock replay docking1 --compare\n  tagdock replay photos --camera camera.yaml --output seen");
  verb->callback([options, &action] { action = [options] { return replay_any(*options); }; });
}

}  // namespace tagdock
