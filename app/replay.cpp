// Verb: replay. A recorded session, or images, through the same code.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>
#include <optional>
#include <sstream>
#include <thread>
#include <unistd.h>

#include <nlohmann/json.hpp>

#include "app/camera_file.h"
#include "app/detect.h"
#include "app/failure.h"
#include "app/frame_source.h"
#include "app/png_file.h"
#include "app/replay_difference.h"
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
  double from = 0.0;
  double to = 1e12;
  double rate = 25.0;
  bool step = false;
};

void write_stream(const std::filesystem::path& folder, SessionStream stream, const std::string& file,
                  const std::vector<std::string>& lines) {
  std::ofstream out(folder / file, std::ios::binary);
  out << header(stream) << "\n";
  for (const std::string& text : lines) out << text << "\n";
  if (!out.flush()) throw Failure(ExitCode::usage, "--output " + (folder / file).string() + ": cannot be written");
}

/// Holds replay back for who looks on: its speed from --from on, and one picture at a time with --step.
class Pace {
 public:
  explicit Pace(const ReplayOptions& options) : options_(options) {}

  /// @param seconds  since the beginning of the recording
  /// @return         false when it shall end here
  bool at(double seconds, const std::string& what) {
    if (seconds > options_.to) return false;
    if (seconds < options_.from) return true;  // as fast as it can, to get there with the same state
    if (!begin_) {
      begin_ = std::chrono::steady_clock::now();
      first_ = seconds;
    }
    if (options_.speed > 0.0)
      std::this_thread::sleep_until(
          *begin_ + std::chrono::nanoseconds(static_cast<std::int64_t>(1e9 * (seconds - first_) / options_.speed)));
    if (!options_.step || what.empty()) return true;
    std::fprintf(stderr, "%8.3f s  %s   [Enter: next, q: end]\n", seconds, what.c_str());
    std::string typed;
    return static_cast<bool>(std::getline(std::cin, typed)) && typed != "q";
  }

 private:
  const ReplayOptions& options_;
  std::optional<std::chrono::steady_clock::time_point> begin_;
  double first_ = 0.0;
};

nlohmann::ordered_json to_json(const ReplayDifference& made) {
  return {
      {"seen_by_both", made.seen_by_both},
      {"only_recorded", made.only_recorded},
      {"only_replayed", made.only_replayed},
      {"shift_mm", {{"median", made.shift_median_mm}, {"p95", made.shift_95_mm}, {"largest", made.shift_largest_mm}}},
      {"turn_deg", {{"median", made.turn_median_deg}, {"p95", made.turn_95_deg}, {"largest", made.turn_largest_deg}}},
      {"commands_compared", made.commands_compared},
      {"commands_different", made.commands_different},
      {"linear_largest", made.linear_largest},
      {"angular_largest", made.angular_largest},
      {"first_different_command", made.first_different_command},
      {"phases_recorded", made.phases_recorded},
      {"phases_replayed", made.phases_replayed}};
}

int replay_session(const ReplayOptions& options, const Session& session) {
  for (const std::string& remark : session.remarks) std::cerr << "replay: " << remark << "\n";
  const SessionHead head = read_session_head(options.folder);
  Config config = head.config;
  if (!options.camera.empty()) config.rig.camera = CameraFile::load(options.camera).camera();
  if (!options.rig.empty()) config.rig = read_rig(options.rig);
  if (!options.board.empty()) config.board = read_board(options.board);
  if (!options.method.empty()) config.locator.method = *corner_method(options.method);
  // As a configuration is read: what cannot dock is refused, and what follows from it is made anew.
  if (!options.camera.empty() || !options.rig.empty() || !options.board.empty())
    config = parse_config(to_yaml(config), "(recorded configuration with what was given now)");

  Pace pace(options);
  const ReplayResult result =
      replay(session, config, [&](const DockingLoop::Inputs& inputs, const DockingLoop::Outputs& outputs) {
        std::string what;
        if (options.step && outputs.sighting_line)
          what = outputs.sighting_line->substr(0, 90) + "  command " + outputs.command_line;
        return pace.at(std::chrono::duration<double>(inputs.now).count(), what);
      });
  if (options.compare && result.cycles == 0)
    throw Failure(ExitCode::usage, "--compare: this recording has no control cycle, so nothing that could be compared");
  const ReplayDifference made = difference(session, result);
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
    json["recorded_cycles"] = session.ticks.size();
    json["frames"] = result.frames;
    json["sightings"] = result.sightings;
    json["last_phase"] = result.last_phase;
    json["differences"] = result.difference_count;
    json["frames_not_recorded"] = result.frames_not_recorded;
    json["first_differences"] = result.differences;
    json["difference"] = to_json(made);
    json["recorded_frames"] = session.frames.size();
    json["remarks"] = session.remarks;
    std::cout << json.dump(2) << "\n";
  } else {
    std::printf("%llu cycles, %llu frames, %llu with the board; ended %s\n",
                static_cast<unsigned long long>(result.cycles), static_cast<unsigned long long>(result.frames),
                static_cast<unsigned long long>(result.sightings), result.last_phase.c_str());
    if (result.difference_count > 0)
      std::printf("%llu lines differ from the recording\n%s", static_cast<unsigned long long>(result.difference_count),
                  words(made).c_str());
    else if (result.cycles == 0)
      std::printf("no control cycle, so nothing to compare\n");
    else if (result.ended_early)
      std::printf(
          "bit-equal: every sighting, phase and command of the first %llu of %zu cycles is as it was recorded\n",
          static_cast<unsigned long long>(result.cycles), session.ticks.size());
    else
      std::printf("bit-equal: every sighting, phase and command is as it was recorded\n");
    for (const std::string& difference : result.differences) std::printf("%s\n", difference.c_str());
  }
  return static_cast<int>(options.compare && result.difference_count > 0 ? ExitCode::failed : ExitCode::done);
}

// The board in each picture, as lines of sightings.csv. Pictures that cannot be read are said and left out.
std::vector<std::string> board_sightings(const ReplayOptions& options, const Rig& rig, const Board& board,
                                         const FrameSource& source, bool& spoiled) {
  TagLocatorConfig config;
  config.detector.family = board.family;
  if (!options.method.empty()) config.method = *corner_method(options.method);
  const TagLocator locator(rig, board, config);
  std::vector<std::string> lines;
  Pace pace(options);
  for (const SourceFrame& one : source.frames) {
    Frame frame{{}, one.time, one.number};
    try {
      frame.gray = one.load();
    } catch (const Failure& failure) {
      std::cerr << "replay: " << failure.what() << "\n";
      spoiled = true;
      continue;
    }
    const cv::Size size = frame.gray.size();
    if (size.width != rig.camera.width || size.height != rig.camera.height)
      throw Failure(ExitCode::usage, one.name + ": is " + std::to_string(size.width) + "x" +
                                         std::to_string(size.height) + ", and the rig's camera is " +
                                         std::to_string(rig.camera.width) + "x" + std::to_string(rig.camera.height));
    lines.push_back(sighting_line(frame, locator.locate(frame, std::nullopt)));
    const double seconds = std::chrono::duration<double>(one.time - source.frames.front().time).count() + options.from;
    if (!pace.at(seconds, one.name + "  " + lines.back().substr(0, 90))) break;
  }
  return lines;
}

void show_sightings(const ReplayOptions& options, const std::vector<std::string>& lines) {
  if (!options.output.empty()) {
    std::filesystem::create_directories(options.output);
    write_stream(options.output, SessionStream::sightings, "sightings.csv", lines);
    return;
  }
  std::cout << header(SessionStream::sightings) << "\n";
  for (const std::string& text : lines) std::cout << text << "\n";
}

int replay_images(const ReplayOptions& options);

// Of the first picture that can be read.
cv::Size size_of_first(const FrameSource& source) {
  for (const SourceFrame& frame : source.frames) {
    try {
      return frame.load().size();
    } catch (const Failure&) {
      // Said when its turn comes.
    }
  }
  throw Failure(ExitCode::usage, "none of the pictures can be read");
}

// A recording without a docking: what would be seen in it.
int replay_recording(const ReplayOptions& options) {
  if (options.compare)
    throw Failure(ExitCode::usage, "--compare: nothing was done in this recording that could be compared");
  const SessionHead head = read_session_head(options.folder);
  Rig rig = options.rig.empty() ? head.config.rig : read_rig(options.rig);
  if (!options.camera.empty()) rig.camera = CameraFile::load(options.camera).camera();
  const Board board = options.board.empty() ? head.config.board : read_board(options.board);
  FrameSource source = open_frames(options.folder, options.rate);
  const std::size_t recorded = source.frames.size();
  if (const cv::Size size = size_of_first(source);
      options.rig.empty() && (size.width != rig.camera.width || size.height != rig.camera.height)) {
    std::cerr << "replay: recorded without a calibration of this camera (" << size.width << "x" << size.height
              << "): tags are looked for, not the board; --rig gives one\n";
    return replay_images(options);
  }
  for (const std::string& remark : source.remarks) std::cerr << "replay: " << remark << "\n";
  keep_between(source, options.from, options.to);
  bool spoiled = false;
  const std::vector<std::string> lines = board_sightings(options, rig, board, source, spoiled);
  if (options.json) {
    nlohmann::ordered_json json;
    json["schema"] = "tagdock-replay/1";
    json["recorded_frames"] = recorded;
    json["frames"] = lines.size();
    json["sightings"] = std::count_if(
        lines.begin(), lines.end(), [](const std::string& line) { return line.find(",board,") != std::string::npos; });
    json["remarks"] = source.remarks;
    std::cout << json.dump(2) << "\n";
  } else {
    show_sightings(options, lines);
  }
  return static_cast<int>(spoiled ? ExitCode::usage : ExitCode::done);
}

// Lines of sightings.csv as objects, with the columns' names; numbers where they are numbers.
nlohmann::json json_of(const std::vector<std::string>& lines) {
  const auto fields = [](const std::string& line) {
    std::vector<std::string> parts;
    std::istringstream stream(line + ",");
    for (std::string part; std::getline(stream, part, ',');) parts.push_back(part);
    return parts;
  };
  const std::vector<std::string> names = fields(header(SessionStream::sightings));
  nlohmann::json sightings = nlohmann::json::array();
  for (const std::string& line : lines) {
    const std::vector<std::string> values = fields(line);
    nlohmann::json one = nlohmann::json::object();
    for (std::size_t i = 0; i < std::min(names.size(), values.size()); ++i) {
      if (values[i].empty()) continue;
      const nlohmann::json number =
          names[i] == "tags" ? nlohmann::json() : nlohmann::json::parse(values[i], nullptr, false);
      one[names[i]] = number.is_number() ? number : nlohmann::json(values[i]);
    }
    sightings.push_back(one);
  }
  return sightings;
}

// The pictures of a video as files, beside what is made of them, or in a folder that goes with this object.
class CutFolder {
 public:
  explicit CutFolder(const std::string& output)
      : keep_(!output.empty()),
        folder_((keep_ ? std::filesystem::path(output) : std::filesystem::temp_directory_path()) /
                ("frames_" + std::to_string(::getpid()))) {
    std::filesystem::create_directories(folder_);
  }
  ~CutFolder() {
    std::error_code error;
    if (!keep_) std::filesystem::remove_all(folder_, error);
  }
  CutFolder(const CutFolder&) = delete;
  CutFolder& operator=(const CutFolder&) = delete;

  // Pictures that cannot be read are said and taken out: a video's own count of them is an estimate.
  // @return whether there were such
  bool take(FrameSource& source) {
    const std::size_t before = source.frames.size();
    std::erase_if(source.frames, [&](SourceFrame& frame) {
      std::vector<std::uint8_t> png;
      try {
        png = png_of(frame.load(), "");
      } catch (const Failure& failure) {
        std::cerr << "replay: " << failure.what() << "\n";
        return true;
      }
      char name[32];
      std::snprintf(name, sizeof name, "I%06llu.png", static_cast<unsigned long long>(frame.number));
      frame.file = (folder_ / name).string();
      std::ofstream stream(frame.file, std::ios::binary);
      stream.write(reinterpret_cast<const char*>(png.data()), static_cast<std::streamsize>(png.size()));
      if (!stream.flush()) throw Failure(ExitCode::usage, frame.file + ": cannot be written");
      return false;
    });
    if (source.frames.empty()) throw Failure(ExitCode::usage, "no picture of the video can be read");
    return source.frames.size() < before;
  }

 private:
  bool keep_;
  std::filesystem::path folder_;
};

int replay_images(const ReplayOptions& options) {
  if (options.compare)
    throw Failure(ExitCode::usage, "--compare needs a session folder; images have nothing to compare with");
  if (options.board.empty() != options.rig.empty())
    throw Failure(ExitCode::usage, "for the pose of a board in images, --board and --rig go together");
  FrameSource source = open_frames(options.folder, options.rate);
  for (const std::string& remark : source.remarks) std::cerr << "replay: " << remark << "\n";
  keep_between(source, options.from, options.to);
  if (source.frames.empty()) throw Failure(ExitCode::usage, "there is no picture between --from and --to");
  bool spoiled = false;
  std::optional<CutFolder> cut;
  if (source.kind == "video") {
    cut.emplace(options.output);
    spoiled = cut->take(source);
  }
  DetectOptions detect;
  for (const SourceFrame& frame : source.frames) detect.images.push_back(frame.file);
  detect.camera = options.camera.empty() ? options.rig : options.camera;
  detect.family = options.family;
  detect.tag_size = options.tag_size;
  if (!options.method.empty()) detect.method = options.method;
  detect.json = options.json;
  const std::filesystem::path folder = options.output;
  if (!options.output.empty()) {
    std::filesystem::create_directories(folder);
    detect.output = (folder / (options.json ? "tags.json" : "tags.csv")).string();
    detect.annotate = options.output;
  }
  std::ostringstream tags;
  const int code = detect_images(detect, options.json ? tags : std::cout);
  if (!options.board.empty()) {
    const std::vector<std::string> lines =
        board_sightings(options, read_rig(options.rig), read_board(options.board), source, spoiled);
    if (!options.json || !options.output.empty()) show_sightings(options, lines);
    if (options.json && options.output.empty()) {
      nlohmann::json whole = nlohmann::json::parse(tags.str());
      whole["sightings"] = json_of(lines);
      tags.str(whole.dump(1) + "\n");
    }
  }
  std::cout << tags.str();
  return spoiled ? static_cast<int>(ExitCode::usage) : code;
}

int replay_any(const ReplayOptions& options) {
  if (!(options.rate > 0.0 && options.rate <= 1e4))
    throw Failure(ExitCode::usage, "--rate must be between 0 and 10000 pictures a second");
  if (!(options.speed >= 0.0 && std::isfinite(options.speed)))
    throw Failure(ExitCode::usage, "--speed must be 0 (as fast as it can) or more");
  if (!(options.from <= options.to)) throw Failure(ExitCode::usage, "--from must not be after --to");
  if (!options.method.empty() && !corner_method(options.method))
    throw Failure(ExitCode::usage,
                  "--method is " + options.method + "; it must be one of apriltag tanh filter erf best");
  const bool session = std::filesystem::is_regular_file(std::filesystem::path(options.folder) / "session.yaml");
  if (!session) return replay_images(options);
  const Session read = read_session(options.folder);
  return read.ticks.empty() && read.commands.empty() && !read.frames.empty() ? replay_recording(options)
                                                                             : replay_session(options, read);
}

}  // namespace

void add_replay(CLI::App& program, Action& action) {
  auto options = std::make_shared<ReplayOptions>();
  CLI::App* verb = program.add_subcommand(
      "replay", "Repeats a recorded docking through the same code, or looks for tags in a folder of images.");
  verb->add_option("folder", options->folder,
                   "session folder, folder of images, numbered pattern (I%04d.pgm), EuRoC or TUM folder, or video")
      ->required();
  verb->add_flag("--compare", options->compare,
                 "succeed only if every sighting, phase and command is as it was recorded, to the last bit");
  verb->add_option("--speed", options->speed, "times real time; 0 as fast as it can")->capture_default_str();
  verb->add_option("--from", options->from, "go there as fast as it can, then at --speed: seconds from the beginning");
  verb->add_option("--to", options->to, "end there: seconds from the beginning");
  verb->add_flag("--step", options->step, "one frame at a time: Enter for the next, q to end");
  verb->add_option("--rate", options->rate, "images: pictures a second, where they have no times")
      ->capture_default_str();
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
