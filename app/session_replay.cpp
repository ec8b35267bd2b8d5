#include "app/session_replay.h"

#include <algorithm>
#include <charconv>
#include <cstdio>
#include <map>

#include "app/failure.h"

namespace tagdock {
namespace {

void compare(const std::string& stream, const std::vector<std::string>& recorded, const std::vector<std::string>& made,
             ReplayResult& result) {
  const std::size_t common = std::min(recorded.size(), made.size());
  bool named = false;
  for (std::size_t i = 0; i < common; ++i) {
    if (recorded[i] == made[i]) continue;
    ++result.difference_count;
    if (!named)
      result.differences.push_back(stream + ", line " + std::to_string(i + 2) + ":\n  recorded " + recorded[i] +
                                   "\n  replayed " + made[i]);
    named = true;
  }
  if (recorded.size() == made.size() || (result.ended_early && made.size() < recorded.size())) return;
  result.difference_count += std::max(recorded.size(), made.size()) - common;
  result.differences.push_back(stream + ": " + std::to_string(recorded.size()) + " lines recorded, " +
                               std::to_string(made.size()) + " replayed");
}

}  // namespace

SessionHead read_session_head(const std::filesystem::path& folder) {
  YamlMap map = YamlMap::load(folder / "session.yaml");
  if (const auto format = map.integer("format", 0, 1000000); format != 1)
    map.refuse("format", "is " + std::to_string(format) + "; this program reads format 1");
  SessionHead head;
  head.program = map.text("program");
  // Not through a double, which has 53 bits.
  const std::string seed = map.text("seed");
  if (const auto [end, error] = std::from_chars(seed.data(), seed.data() + seed.size(), head.seed);
      error != std::errc() || end != seed.data() + seed.size())
    map.refuse("seed", "is " + seed + "; it must be a whole number from 0 to 18446744073709551615");
  head.camera_name = map.text("camera_name");
  if (std::optional<YamlMap> camera = map.optional_map("camera")) {
    CameraSettings& actual = head.camera;
    camera->read("identity", actual.identity);
    camera->read("address", actual.address);
    constexpr int most = 1 << 16;
    camera->read("sensor_width", actual.sensor_width, 0, most);
    camera->read("sensor_height", actual.sensor_height, 0, most);
    camera->read("binning", actual.binning, 1, 16);
    camera->read("offset_x", actual.offset_x, 0, most);
    camera->read("offset_y", actual.offset_y, 0, most);
    camera->read("width", actual.width, 0, most);
    camera->read("height", actual.height, 0, most);
    camera->read("frame_rate", actual.frame_rate, 0.0, 1e6);
    camera->read("exposure_us", actual.exposure_us, 0.0, 1e9);
    camera->read("gain", actual.gain, -1e3, 1e3);
  }
  head.config = read_config(map.map("config"));
  map.finish();
  return head;
}

ReplayResult replay(const Session& session, const Config& config, const ReplayWatcher& watcher) {
  std::map<std::uint64_t, const RecordedFrame*> frames;
  for (const RecordedFrame& frame : session.frames) frames.emplace(frame.number, &frame);

  ReplayResult result;
  DockingLoop loop(config);
  std::size_t odometry = 0;
  const TickRecord* first_not_recorded = nullptr;
  for (const TickRecord& tick : session.ticks) {
    const std::size_t end = odometry + std::min(tick.odometry_read, session.odometry.size() - odometry);
    std::vector<Odometry> readings(session.odometry.begin() + static_cast<std::ptrdiff_t>(odometry),
                                   session.odometry.begin() + static_cast<std::ptrdiff_t>(end));
    odometry = end;
    std::optional<Frame> frame;
    if (tick.frame) {
      const auto found = frames.find(*tick.frame);
      if (found == frames.end()) {
        ++result.difference_count;
        if (result.frames_not_recorded++ == 0) first_not_recorded = &tick;
      } else {
        frame = read_frame(*found->second);
        if (frame->gray.cols != config.rig.camera.width || frame->gray.rows != config.rig.camera.height)
          throw Failure(ExitCode::usage,
                        found->second->file.string() + ": has " + std::to_string(frame->gray.cols) + "x" +
                            std::to_string(frame->gray.rows) + " pixels, and the camera it is replayed with " +
                            std::to_string(config.rig.camera.width) + "x" + std::to_string(config.rig.camera.height));
        ++result.frames;
      }
    }
    const DockingLoop::Inputs inputs = inputs_of(tick, std::move(readings), std::move(frame));
    const DockingLoop::Outputs outputs = loop.cycle(inputs);
    ++result.cycles;
    if (outputs.sighting && std::holds_alternative<BoardSighting>(*outputs.sighting)) ++result.sightings;
    if (outputs.sighting_line) result.sighting_lines.push_back(*outputs.sighting_line);
    result.command_lines.push_back(outputs.command_line);
    if (outputs.phase_line) result.phase_lines.push_back(*outputs.phase_line);
    if (watcher && !watcher(inputs, outputs)) {
      result.ended_early = true;
      break;
    }
  }
  const Phase& last = loop.docker().phase();
  result.last_phase = std::string(name(last));
  result.attempts = job_of(last).attempts;
  if (const std::optional<Reason> reason = reason_of(last)) result.reason = reason->sentence;
  if (const Docked* docked = std::get_if<Docked>(&last)) result.fix = docked->fix;
  if (const Failed* failed = std::get_if<Failed>(&last)) result.fix = failed->fix;
  if (first_not_recorded != nullptr) {
    char first[80];
    std::snprintf(first, sizeof first, ", the first of them (%llu) at %.3f s",
                  static_cast<unsigned long long>(*first_not_recorded->frame),
                  std::chrono::duration<double>(first_not_recorded->time).count());
    const std::string count = std::to_string(result.frames_not_recorded);
    result.differences.push_back(count + (result.frames_not_recorded == 1 ? " frame" : " frames") +
                                 " that the docking used " + (result.frames_not_recorded == 1 ? "was" : "were") +
                                 " not recorded" + first + ": what follows cannot be repeated");
  }
  compare("sightings.csv", session.sightings, result.sighting_lines, result);
  compare("commands.csv", session.commands, result.command_lines, result);
  compare("phases.csv", session.phases, result.phase_lines, result);
  return result;
}

}  // namespace tagdock
