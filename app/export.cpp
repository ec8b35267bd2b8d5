// Verb: export. A session, or any other recorded pictures, in the formats of others.
#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <memory>
#include <optional>
#include <sstream>

#include <nlohmann/json.hpp>
#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>

#include "app/failure.h"
#include "app/frame_source.h"
#include "app/mcap_file.h"
#include "app/png_file.h"
#include "app/session.h"
#include "app/verbs.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;
namespace fs = std::filesystem;

struct ExportOptions {
  std::string source;
  std::string euroc;
  std::string tum;
  std::string mp4;
  std::string mcap;
  double rate = 25.0;
  double from = 0.0;
  double to = 1e12;
  bool json = false;
};

void write_whole(const fs::path& file, const void* bytes, std::size_t size) {
  std::ofstream stream(file, std::ios::binary);
  stream.write(static_cast<const char*>(bytes), static_cast<std::streamsize>(size));
  if (!stream.flush()) throw Failure(ExitCode::usage, file.string() + ": cannot be written");
}

/// A folder that is not there yet, or empty.
void make_folder(const fs::path& folder) {
  std::error_code error;
  if (fs::exists(folder, error) && !(fs::is_directory(folder, error) && fs::is_empty(folder, error)))
    throw Failure(ExitCode::usage, folder.string() + ": exists and is not an empty folder; name a new one");
  fs::create_directories(folder, error);
  if (error) throw Failure(ExitCode::usage, folder.string() + ": cannot be created: " + error.message());
}

std::string seconds_text(nanoseconds time) {
  char text[40];
  std::snprintf(text, sizeof text, "%lld.%09lld", static_cast<long long>(time.count() / 1'000'000'000),
                static_cast<long long>(time.count() % 1'000'000'000));
  return text;
}

/// One format: told each frame in turn.
class Sink {
 public:
  virtual ~Sink() = default;
  virtual void frame(const SourceFrame& frame, const cv::Mat1b& gray) = 0;
  virtual void finish() = 0;
};

class Euroc final : public Sink {
 public:
  Euroc(const fs::path& folder, const std::string& source) : data_(folder / "mav0" / "cam0" / "data") {
    make_folder(folder);
    fs::create_directories(data_);
    if (const fs::path sensor = fs::path(source) / "cam0" / "sensor.yaml"; fs::is_regular_file(sensor))
      fs::copy_file(sensor, data_.parent_path() / "sensor.yaml");
    list_ = "#timestamp [ns],filename\n";
  }
  void frame(const SourceFrame& frame, const cv::Mat1b& gray) override {
    const std::string name = std::to_string(frame.time.count()) + ".png";
    const auto png = png_of(gray, "");
    write_whole(data_ / name, png.data(), png.size());
    list_ += std::to_string(frame.time.count()) + "," + name + "\n";
  }
  void finish() override { write_whole(data_.parent_path() / "data.csv", list_.data(), list_.size()); }

 private:
  fs::path data_;
  std::string list_;
};

class Tum final : public Sink {
 public:
  Tum(const fs::path& folder, const std::optional<Session>& session) : folder_(folder) {
    make_folder(folder);
    fs::create_directories(folder_ / "rgb");
    list_ = "# timestamp filename\n";
    if (!session || session->odometry.empty()) return;
    std::string poses = "# odometry of the base: timestamp tx ty tz qx qy qz qw\n";
    for (const Odometry& odometry : session->odometry) {
      char text[200];
      const Pose2& pose = odometry.T_odom_base;
      std::snprintf(text, sizeof text, " %.9f %.9f 0 0 0 %.12f %.12f\n", pose.x, pose.y, std::sin(0.5 * pose.yaw),
                    std::cos(0.5 * pose.yaw));
      poses += seconds_text(odometry.time) + text;
    }
    write_whole(folder_ / "odometry.txt", poses.data(), poses.size());
  }
  void frame(const SourceFrame& frame, const cv::Mat1b& gray) override {
    const std::string name = "rgb/" + seconds_text(frame.time) + ".png";
    const auto png = png_of(gray, "");
    write_whole(folder_ / name, png.data(), png.size());
    list_ += seconds_text(frame.time) + " " + name + "\n";
  }
  void finish() override { write_whole(folder_ / "rgb.txt", list_.data(), list_.size()); }

 private:
  fs::path folder_;
  std::string list_;
};

/// For looking only: lossy, and of an even rate.
class Mp4 final : public Sink {
 public:
  Mp4(std::string file, double rate) : file_(std::move(file)), rate_(rate) {}
  void frame(const SourceFrame& frame, const cv::Mat1b& gray) override {
    if (!video_.isOpened() &&
        !video_.open(file_, cv::CAP_FFMPEG, cv::VideoWriter::fourcc('m', 'p', '4', 'v'), rate_, gray.size(), true))
      throw Failure(ExitCode::usage, file_ + ": a video cannot be written there");
    if (size_.area() == 0) size_ = gray.size();
    if (gray.size() != size_)
      throw Failure(ExitCode::usage, frame.name + ": is of another size than the first picture");
    cv::Mat colour;
    cv::cvtColor(gray, colour, cv::COLOR_GRAY2BGR);
    char text[80];
    std::snprintf(text, sizeof text, "%.2f s  frame %llu", std::chrono::duration<double>(frame.time).count(),
                  static_cast<unsigned long long>(frame.number));
    cv::putText(colour, text, {8, gray.rows - 10}, cv::FONT_HERSHEY_SIMPLEX, 0.6, {0, 0, 0}, 3);
    cv::putText(colour, text, {8, gray.rows - 10}, cv::FONT_HERSHEY_SIMPLEX, 0.6, {255, 255, 255}, 1);
    video_.write(colour);
  }
  void finish() override { video_.release(); }

 private:
  std::string file_;
  double rate_;
  cv::Size size_;
  cv::VideoWriter video_;
};

std::string base64(const std::vector<std::uint8_t>& bytes) {
  constexpr char letters[] = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (std::size_t i = 0; i < bytes.size(); i += 3) {
    const std::size_t left = std::min<std::size_t>(3, bytes.size() - i);
    std::uint32_t three = 0;
    for (std::size_t k = 0; k < 3; ++k) three = three << 8 | (k < left ? bytes[i + k] : 0U);
    for (std::size_t k = 0; k < 4; ++k) text.push_back(k <= left ? letters[three >> (18 - 6 * k) & 63] : '=');
  }
  return text;
}

// The parts of Foxglove's schemas that are used, as JSON schemas. Foxglove knows them by their names.
nlohmann::json object_schema(const std::string& title, const nlohmann::json& properties) {
  return {{"title", title}, {"type", "object"}, {"properties", properties}};
}
nlohmann::json time_schema() {
  return object_schema("time", {{"sec", {{"type", "integer"}, {"minimum", 0}}},
                                {"nsec", {{"type", "integer"}, {"minimum", 0}, {"maximum", 999999999}}}});
}
nlohmann::json pose_schema() {
  const nlohmann::json number = {{"type", "number"}};
  return object_schema("foxglove.Pose",
                       {{"position", object_schema("foxglove.Vector3", {{"x", number}, {"y", number}, {"z", number}})},
                        {"orientation", object_schema("foxglove.Quaternion",
                                                      {{"x", number}, {"y", number}, {"z", number}, {"w", number}})}});
}
const nlohmann::json text_schema = {{"type", "string"}};

nlohmann::json time_json(nanoseconds time) {
  return {{"sec", time.count() / 1'000'000'000}, {"nsec", time.count() % 1'000'000'000}};
}
nlohmann::json pose_json(const std::array<double, 7>& pose) {
  return {{"position", {{"x", pose[0]}, {"y", pose[1]}, {"z", pose[2]}}},
          {"orientation", {{"x", pose[3]}, {"y", pose[4]}, {"z", pose[5]}, {"w", pose[6]}}}};
}
nlohmann::json pose_json(const Pose2& pose) {
  return pose_json({pose.x, pose.y, 0.0, 0.0, 0.0, std::sin(0.5 * pose.yaw), std::cos(0.5 * pose.yaw)});
}

/// Time and pose of a line of sightings.csv that saw the board.
std::optional<std::pair<nanoseconds, std::array<double, 7>>> sighting_of(const std::string& line) {
  std::vector<std::string> fields;
  std::istringstream stream(line);
  for (std::string field; std::getline(stream, field, ',');) fields.push_back(field);
  std::int64_t time = 0;
  std::array<double, 7> pose{};
  if (fields.size() < 10 || fields[2] != "board") return std::nullopt;
  const auto good = [](const std::string& text, auto& value) {
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    return error == std::errc() && end == text.data() + text.size();
  };
  if (!good(fields[0], time) || time < 0) return std::nullopt;
  for (std::size_t i = 0; i < pose.size(); ++i)
    if (!good(fields[3 + i], pose[i]) || !std::isfinite(pose[i])) return std::nullopt;
  return std::pair(nanoseconds(time), pose);
}

class Mcap final : public Sink {
 public:
  Mcap(const std::string& file, const std::optional<Session>& session, nanoseconds begin, nanoseconds end)
      : file_(file) {
    images_ = file_.add_channel(
        "/camera/image", "foxglove.CompressedImage",
        object_schema("foxglove.CompressedImage", {{"timestamp", time_schema()},
                                                   {"frame_id", text_schema},
                                                   {"data", {{"type", "string"}, {"contentEncoding", "base64"}}},
                                                   {"format", text_schema}})
            .dump());
    if (!session) return;
    const std::string in_frame =
        object_schema("foxglove.PoseInFrame",
                      {{"timestamp", time_schema()}, {"frame_id", text_schema}, {"pose", pose_schema()}})
            .dump();
    const std::uint16_t odometry = file_.add_channel("/odometry", "foxglove.PoseInFrame", in_frame);
    const std::uint16_t station = file_.add_channel("/camera/station", "foxglove.PoseInFrame", in_frame);
    const std::uint16_t path = file_.add_channel(
        "/path", "foxglove.PosesInFrame",
        object_schema("foxglove.PosesInFrame", {{"timestamp", time_schema()},
                                                {"frame_id", text_schema},
                                                {"poses", {{"type", "array"}, {"items", pose_schema()}}}})
            .dump());
    const auto inside = [&](nanoseconds time) { return time >= begin && time <= end && time.count() >= 0; };
    nlohmann::json poses = nlohmann::json::array();
    nanoseconds next_pose{0}, next_path{0};
    for (const Odometry& one : session->odometry) {
      if (!inside(one.time) || !is_finite(one.T_odom_base)) continue;
      const nlohmann::json pose = pose_json(one.T_odom_base);
      add(odometry, one.time, {{"timestamp", time_json(one.time)}, {"frame_id", "odom"}, {"pose", pose}});
      if (one.time < next_pose) continue;
      next_pose = one.time + std::chrono::milliseconds(200);  // a point each 6 cm at the highest speed
      poses.push_back(pose);
      if (one.time < next_path) continue;
      next_path = one.time + std::chrono::seconds(1);
      add(path, one.time, {{"timestamp", time_json(one.time)}, {"frame_id", "odom"}, {"poses", poses}});
    }
    for (const std::string& line : session->sightings)
      if (const auto seen = sighting_of(line); seen && inside(seen->first))
        add(station, seen->first,
            {{"timestamp", time_json(seen->first)}, {"frame_id", "camera"}, {"pose", pose_json(seen->second)}});
  }
  void frame(const SourceFrame& frame, const cv::Mat1b& gray) override {
    if (frame.time.count() < 0) return;
    add(images_, frame.time,
        {{"timestamp", time_json(frame.time)},
         {"frame_id", "camera"},
         {"data", base64(png_of(gray, ""))},
         {"format", "png"}});
  }
  void finish() override { file_.finish(); }

 private:
  void add(std::uint16_t channel, nanoseconds time, const nlohmann::json& message) {
    file_.write(channel, static_cast<std::uint64_t>(time.count()), message.dump());
  }
  McapFile file_;
  std::uint16_t images_ = 0;
};

int export_frames(const ExportOptions& options) {
  if (options.euroc.empty() && options.tum.empty() && options.mp4.empty() && options.mcap.empty())
    throw Failure(ExitCode::usage, "nothing to do: name at least one of --euroc, --tum, --mp4, --mcap");
  if (!(options.rate > 0.0 && options.rate <= 1e4))
    throw Failure(ExitCode::usage, "--rate must be between 0 and 10000 pictures a second");
  FrameSource source = open_frames(options.source, options.rate);
  for (const std::string& remark : source.remarks) std::cerr << "export: " << remark << "\n";
  std::optional<Session> session;
  if (source.kind == "session") session = read_session(options.source);
  keep_between(source, options.from, options.to);
  if (source.frames.empty()) throw Failure(ExitCode::usage, "there is no frame between --from and --to");
  const nanoseconds begin = source.frames.front().time, end = source.frames.back().time;
  double rate = options.rate;
  if (source.frames.size() > 1 && end > begin)
    rate =
        std::clamp(static_cast<double>(source.frames.size() - 1) / std::chrono::duration<double>(end - begin).count(),
                   0.1, 1000.0);
  std::vector<std::unique_ptr<Sink>> sinks;
  if (!options.euroc.empty()) sinks.push_back(std::make_unique<Euroc>(options.euroc, options.source));
  if (!options.tum.empty()) sinks.push_back(std::make_unique<Tum>(options.tum, session));
  if (!options.mp4.empty()) sinks.push_back(std::make_unique<Mp4>(options.mp4, rate));
  if (!options.mcap.empty()) sinks.push_back(std::make_unique<Mcap>(options.mcap, session, begin, end));
  std::uint64_t written = 0;
  bool spoiled = false;
  for (const SourceFrame& frame : source.frames) {
    cv::Mat1b gray;
    try {
      gray = frame.load();
    } catch (const Failure& failure) {
      std::cerr << "export: " << failure.what() << "\n";
      spoiled = true;
      continue;
    }
    for (const auto& sink : sinks) sink->frame(frame, gray);
    ++written;
  }
  for (const auto& sink : sinks) sink->finish();
  if (options.json) {
    nlohmann::ordered_json json{{"schema", "tagdock-export/1"},
                                {"source", options.source},
                                {"kind", source.kind},
                                {"frames", written},
                                {"unreadable", source.frames.size() - written},
                                {"written", nlohmann::ordered_json::object()},
                                {"remarks", source.remarks}};
    for (const auto& [name, where] :
         {std::pair{"euroc", &options.euroc}, {"tum", &options.tum}, {"mp4", &options.mp4}, {"mcap", &options.mcap}})
      if (!where->empty()) json["written"][name] = *where;
    std::cout << json.dump(2, ' ', false, nlohmann::json::error_handler_t::replace) << "\n";
  } else {
    std::printf("%llu frames of %s (%s) written\n", static_cast<unsigned long long>(written), options.source.c_str(),
                source.kind.c_str());
  }
  return static_cast<int>(spoiled ? ExitCode::usage : ExitCode::done);
}

}  // namespace

void add_export(CLI::App& program, Action& action) {
  auto options = std::make_shared<ExportOptions>();
  CLI::App* verb =
      program.add_subcommand("export", "Writes a session, or other recorded pictures, as EuRoC, TUM, MP4 or MCAP.");
  verb->add_option("source", options->source, "session folder, images, numbered pattern, EuRoC or TUM folder, video")
      ->required();
  verb->add_option("--euroc", options->euroc, "new folder in EuRoC's form: mav0/cam0/data.csv and PNG");
  verb->add_option("--tum", options->tum, "new folder in the form of TUM RGB-D: rgb.txt, PNG, odometry.txt");
  verb->add_option("--mp4", options->mp4, "video, for looking only");
  verb->add_option("--mcap", options->mcap,
                   "MCAP with images, odometry, path and where the station was seen, as Foxglove reads it");
  verb->add_option("--rate", options->rate, "pictures a second, where they have no times")->capture_default_str();
  verb->add_option("--from", options->from, "leave out what is before, in seconds after the first frame");
  verb->add_option("--to", options->to, "leave out what is after, in seconds after the first frame");
  verb->add_flag("--json", options->json, "what was written, as one JSON object on stdout");
  verb->footer(
      "Examples:\n  tagdock export docking1 --mcap docking1.mcap\n  tagdock export docking1 --from 10 --to 20 --euroc "
      "part --mp4 part.mp4\n"
      "Times are the session's own, from its beginning. Exit codes: 0 done, 2 usage, or a frame could not be read.");
  verb->callback([options, &action] { action = [options] { return export_frames(*options); }; });
}

}  // namespace tagdock
