#include "tests/app/session_mutation.h"

#include <algorithm>
#include <iterator>

#include "app/config.h"
#include "app/failure.h"
#include "app/frame_source.h"
#include "app/recording.h"
#include "app/replay_difference.h"
#include "app/session.h"
#include "app/session_replay.h"

namespace tagdock {

std::string SessionMutation::damaged(std::string content) {
  constexpr const char* odd[] = {"nan",
                                 "-nan",
                                 "inf",
                                 "-1",
                                 "0",
                                 "1e999",
                                 "99999999999999999999",
                                 "-9223372036854775808",
                                 "9223372036854775807",
                                 "18446744073709551615",
                                 "",
                                 ",",
                                 "\n",
                                 "../../../x",
                                 "\"",
                                 "{",
                                 "[",
                                 "&a [*a]",
                                 "%s%n"};
  const std::size_t times = 1 + below(4);
  for (std::size_t i = 0; i < times; ++i) {
    const std::size_t at = below(content.size() + 1);
    switch (below(7)) {
      case 0:
        content.resize(at);
        break;
      case 1:
        if (at < content.size()) content[at] = static_cast<char>(random_());
        break;
      case 2:
        if (at < content.size()) content[at] = static_cast<char>(content[at] ^ (1 << below(8)));
        break;
      case 3: {  // a field becomes something odd
        const std::size_t begin = content.find_last_of(",\n: ", at == 0 ? 0 : at - 1);
        const std::size_t first = begin == std::string::npos ? 0 : begin + 1;
        const std::size_t last = std::min(content.find_first_of(",\n", first), content.size());
        content.replace(first, last - first, odd[below(std::size(odd))]);
        break;
      }
      case 4: {  // a line twice, or not at all
        const std::size_t begin = content.rfind('\n', at);
        const std::size_t first = begin == std::string::npos ? 0 : begin + 1;
        const std::size_t last = std::min(content.find('\n', first), content.size());
        const std::string line = content.substr(first, last - first);
        if (below(2) == 0)
          content.insert(first, line + "\n");
        else
          content.erase(first, last - first);
        break;
      }
      case 5:
        content.insert(at, std::string(below(300), static_cast<char>(random_())));
        break;
      default:
        content.insert(at, odd[below(std::size(odd))]);
    }
  }
  return content;
}

void make_small_session(const std::filesystem::path& folder, bool compress) {
  Config config;
  CameraModel& camera = config.rig.camera;
  // The same view with a twentieth of the pixels.
  constexpr double scale = 0.05;
  camera.width = 64;
  camera.height = 51;
  camera.fx *= scale;
  camera.fy *= scale;
  camera.cx = scale * (camera.cx + 0.5) - 0.5;
  camera.cy = scale * (camera.cy + 0.5) - 0.5;
  const std::string config_text = to_yaml(config);
  config = parse_config(config_text, "(a small session)");
  SessionRecorder recorder(folder, session_yaml(config_text, "test", CameraSettings{}, 1),
                           sensor_yaml(config.rig.camera, 25.0), true, {compress, {}});
  DockingLoop loop(config);
  for (std::uint64_t number = 1; number <= 4; ++number) {
    CameraFrame frame;
    frame.frame.gray = cv::Mat1b(51, 64, static_cast<unsigned char>(40 * number));
    frame.frame.time = std::chrono::milliseconds(40 * number);
    frame.frame.number = number;
    recorder.frame(frame);
    DockingLoop::Inputs inputs;
    inputs.now = frame.frame.time + std::chrono::milliseconds(5);
    inputs.odometry = {{inputs.now, {}, {}}};
    inputs.frame = frame.frame;
    const DockingLoop::Outputs outputs = loop.cycle(inputs);
    for (const std::string& text : outputs.odometry_lines) recorder.line(SessionStream::odometry, text);
    recorder.line(SessionStream::sightings, *outputs.sighting_line);
    recorder.line(SessionStream::commands, outputs.command_line);
    if (outputs.phase_line) recorder.line(SessionStream::phases, *outputs.phase_line);
  }
}

bool try_session(const std::filesystem::path& folder) {
  bool good = true;
  try {
    FrameSource source = open_frames(folder.string(), 25.0);
    for (const SourceFrame& frame : source.frames) {
      try {
        (void)frame.load();
      } catch (const Failure&) {
        good = false;
      }
    }
  } catch (const Failure&) {
    good = false;
  }
  try {
    const Session session = read_session(folder);
    const SessionHead head = read_session_head(folder);
    int cycles = 0;
    const ReplayResult result = replay(session, head.config, [&](const auto&, const auto&) { return ++cycles < 8; });
    (void)words(difference(session, result));
    return good && result.difference_count == 0;
  } catch (const Failure&) {
    return false;
  }
}

}  // namespace tagdock
