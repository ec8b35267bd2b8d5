#include "app/session_replay.h"

#include <unistd.h>

#include <catch2/catch.hpp>

#include "app/recording.h"
#include "tests/app/session_mutation.h"

using namespace tagdock;
using Catch::Matchers::Contains;

namespace {

struct Scratch {
  std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("tagdock_session_replay_" + std::to_string(::getpid()));
  Scratch() { std::filesystem::remove_all(folder); }
  ~Scratch() { std::filesystem::remove_all(folder); }
};

ReplayResult repeated(const std::filesystem::path& folder) {
  return replay(read_session(folder), read_session_head(folder).config);
}

}  // namespace

TEST_CASE("frames that the docking used and that were not recorded are told as just that") {
  const Scratch scratch;
  make_small_session(scratch.folder, false);
  REQUIRE(repeated(scratch.folder).difference_count == 0);
  std::filesystem::remove(scratch.folder / "cam0/data/I000001.pgm");
  const ReplayResult one = repeated(scratch.folder);
  CHECK(one.frames_not_recorded == 1);
  REQUIRE_FALSE(one.differences.empty());
  CHECK_THAT(one.differences.front(),
             Contains("1 frame that the docking used was not recorded") && Contains("(2)") && Contains("at 0.085 s"));
  std::filesystem::remove(scratch.folder / "cam0/data/I000003.pgm");
  const ReplayResult two = repeated(scratch.folder);
  CHECK(two.frames_not_recorded == 2);
  CHECK_THAT(two.differences.front(), Contains("2 frames that the docking used were not recorded") && Contains("(2)"));
}

TEST_CASE("sentences with whatever in them repeat a docking as it was") {
  // What a camera or a robot's driver says comes from elsewhere, and stands in one field of a line.
  const Scratch scratch;
  const Config config = parse_config(to_yaml(Config{}), "(the default)");
  const std::string wild = "lost, \"quoted\"; a\rb\r\nc: \xc3\xa4 \xff %s\t" + std::string(1, '\0') + "end,\r";
  {
    SessionRecorder recorder(scratch.folder, session_yaml(to_yaml(Config{}), "test", CameraSettings{}, 1), "", true);
    DockingLoop loop(config);
    for (int cycle = 1; cycle <= 400; ++cycle) {
      DockingLoop::Inputs inputs;
      inputs.now = std::chrono::milliseconds(20 * cycle);
      inputs.odometry = {{inputs.now, {}, {}}};
      inputs.camera = CameraState::lost;
      inputs.camera_sentence = wild;
      inputs.robot_linked = cycle < 300;
      inputs.robot_sentence = inputs.robot_linked ? "" : wild;
      const DockingLoop::Outputs outputs = loop.cycle(inputs);
      for (const std::string& text : outputs.odometry_lines) recorder.line(SessionStream::odometry, text);
      recorder.line(SessionStream::commands, outputs.command_line);
      if (outputs.phase_line) recorder.line(SessionStream::phases, *outputs.phase_line);
    }
  }
  const ReplayResult again = repeated(scratch.folder);
  CAPTURE(again.differences);
  CHECK(again.cycles == 400);
  CHECK(again.difference_count == 0);
  // The docking ended for the camera's or the robot's sake, and says so in their words.
  CHECK_THAT(again.reason, Contains("quoted"));
}
