#include "app/session.h"

#include <algorithm>
#include <atomic>
#include <fstream>
#include <future>
#include <string>
#include <thread>
#include <unistd.h>
#include <vector>

#include <catch2/catch.hpp>

#include "app/cameras/shared_frames.h"
#include "app/failure.h"

using namespace tagdock;
using Catch::Matchers::Contains;

namespace {

// A folder of its own for each test, removed at the end.
struct Scratch {
  std::filesystem::path folder;
  explicit Scratch(const std::string& name)
      : folder(std::filesystem::temp_directory_path() / ("tagdock_" + name + "_" + std::to_string(::getpid()))) {
    std::filesystem::remove_all(folder);
  }
  ~Scratch() { std::filesystem::remove_all(folder); }
};

CameraFrame frame(std::uint64_t number) {
  CameraFrame frame;
  frame.frame.gray = cv::Mat1b(48, 64);
  for (int row = 0; row < 48; ++row)
    for (int column = 0; column < 64; ++column)
      frame.frame.gray(row, column) = static_cast<uchar>(7 * row + 3 * column + static_cast<int>(number));
  frame.frame.time = std::chrono::milliseconds(40 * number);
  frame.frame.number = number;
  frame.exposure_us = 5000.0;
  return frame;
}

}  // namespace

TEST_CASE("what was recorded is read back to the last bit") {
  const Scratch scratch("session");
  const Odometry odometry{std::chrono::nanoseconds(123456789), {0.1, -1.0 / 3.0, 2e-17}, {0.05, -0.3}};
  TickRecord tick;
  tick.time = std::chrono::nanoseconds(20000000);
  tick.command = {1.0 / 7.0, -0.0};
  tick.phase = "servo";
  tick.frame = 3;
  tick.odometry_read = 2;
  tick.robot_linked = false;
  tick.robot_sentence = "the robot is silent for 210 ms";
  {
    SessionRecorder recorder(scratch.folder, "format: 1\n", "sensor_type: camera\n", true);
    for (std::uint64_t number : {1U, 2U, 4U}) recorder.frame(frame(number));
    recorder.line(SessionStream::odometry, line(odometry));
    recorder.line(SessionStream::commands, line(tick));
    tick.frame.reset();
    recorder.line(SessionStream::commands, line(tick));
    recorder.line(SessionStream::phases, "0,idle,acquire,started");
  }
  const Session session = read_session(scratch.folder);
  CHECK(session.remarks.empty());
  CHECK(session.session_yaml == "format: 1\n");
  REQUIRE(session.frames.size() == 3);
  for (std::size_t i = 0; i < 3; ++i) {
    const Frame read = read_frame(session.frames[i]);
    const Frame truth = frame(session.frames[i].number).frame;
    CHECK(read.time == truth.time);
    CHECK(cv::norm(read.gray, truth.gray, cv::NORM_INF) == 0.0);
  }
  REQUIRE(session.odometry.size() == 1);
  CHECK(session.odometry[0] == odometry);
  REQUIRE(session.ticks.size() == 2);
  CHECK(session.ticks[0].frame == std::optional<std::uint64_t>(3));
  CHECK(session.ticks[1] == tick);
  CHECK(session.phases == std::vector<std::string>{"0,idle,acquire,started"});
}

TEST_CASE("a recording never overwrites, and an unwritable folder is refused with its name") {
  const Scratch scratch("session_refusal");
  { SessionRecorder recorder(scratch.folder, "", "", true); }
  try {
    SessionRecorder recorder(scratch.folder, "", "", true);
    FAIL("a second recording into the same folder began");
  } catch (const Failure& failure) {
    CHECK(failure.code() == ExitCode::usage);
    CHECK_THAT(failure.what(), Contains(scratch.folder.string()) && Contains("not an empty folder"));
  }
  try {
    SessionRecorder recorder("/proc/nowhere/session", "", "", true);
    FAIL("a recording began where nothing can be written");
  } catch (const Failure& failure) {
    CHECK(failure.code() == ExitCode::usage);
    CHECK_THAT(failure.what(), Contains("/proc/nowhere/session"));
  }
}

TEST_CASE("a session cut by a crash opens with all whole records, and says what is left out") {
  const Scratch scratch("session_crash");
  {
    SessionRecorder recorder(scratch.folder, "format: 1\n", "", true);
    for (std::uint64_t number = 0; number < 5; ++number) recorder.frame(frame(number));
    recorder.line(SessionStream::odometry, "1,0,0,0,0,0");
  }
  std::ofstream(scratch.folder / "odometry.csv", std::ios::app) << "2,0.5,0";  // no end of line: cut short
  std::filesystem::remove(scratch.folder / "cam0" / "data" / "I000004.pgm");
  std::filesystem::resize_file(scratch.folder / "cam0" / "data" / "I000003.pgm", 700);
  const Session session = read_session(scratch.folder);
  CHECK(session.odometry.size() == 1);
  REQUIRE(session.frames.size() == 3);
  CHECK_NOTHROW(read_frame(session.frames[2]));
  CHECK(session.remarks.size() == 3);  // the line cut short, the frame missing, the frame cut short
}

TEST_CASE("a frame whose line was never written is taken from what it says of itself, PGM and PNG") {
  const bool compress = GENERATE(false, true);
  const Scratch scratch("session_adopt");
  {
    SessionRecorder recorder(scratch.folder, "format: 1\n", "", true, {compress, {}});
    for (std::uint64_t number = 1; number <= 4; ++number) recorder.frame(frame(number));
  }
  // Killed between the frame and its line: the last line is gone, or half of it.
  const std::filesystem::path csv = scratch.folder / "cam0" / "data.csv";
  std::filesystem::resize_file(csv, std::filesystem::file_size(csv) - 30);
  const Session session = read_session(scratch.folder);
  REQUIRE(session.frames.size() == 4);
  CHECK(session.frames[3].number == 4);
  CHECK(session.frames[3].time == std::chrono::milliseconds(160));
  CHECK(cv::norm(read_frame(session.frames[3]).gray, frame(4).frame.gray, cv::NORM_INF) == 0.0);
  CHECK(session.remarks.size() == 2);
}

TEST_CASE("frames taken from what they say of themselves stand where their time is, not at the end") {
  const Scratch scratch("session_order");
  {
    SessionRecorder recorder(scratch.folder, "format: 1\n", "", true);
    for (std::uint64_t number = 1; number <= 4; ++number) recorder.frame(frame(number));
  }
  const std::filesystem::path csv = scratch.folder / "cam0" / "data.csv";
  std::vector<std::string> lines;
  {
    std::ifstream stream(csv);
    for (std::string text; std::getline(stream, text);) lines.push_back(text);
  }
  REQUIRE(lines.size() == 5);
  std::ofstream(csv) << lines[0] << "\n" << lines[1] << "\n" << lines[3] << "\n" << lines[4] << "\n";
  const Session session = read_session(scratch.folder);
  REQUIRE(session.frames.size() == 4);
  for (std::size_t i = 0; i < 4; ++i) CHECK(session.frames[i].number == i + 1);
}

TEST_CASE("compressed frames are the same pixels in fewer bytes") {
  const Scratch scratch("session_compressed");
  {
    SessionRecorder recorder(scratch.folder, "format: 1\n", "", true, {true, {}});
    recorder.frame(frame(7));
  }
  const Session session = read_session(scratch.folder);
  REQUIRE(session.frames.size() == 1);
  CHECK(session.frames[0].file.filename() == "I000000.png");
  CHECK(std::filesystem::file_size(session.frames[0].file) < 48 * 64);
  CHECK(cv::norm(read_frame(session.frames[0]).gray, frame(7).frame.gray, cv::NORM_INF) == 0.0);
}

TEST_CASE("a recording does not begin on a full disk, and ends with a warning when the disk fills") {
  const Scratch scratch("session_full");
  std::atomic<std::uintmax_t> left{1'999'000'000};
  const RecorderOptions options{false, [&] { return left.load(); }};
  CHECK_THROWS_AS(SessionRecorder(scratch.folder, "", "", true, options), Failure);
  std::filesystem::remove_all(scratch.folder);
  left = 2'000'000'000;
  SessionRecorder recorder(scratch.folder, "", "", true, options);
  recorder.frame(frame(1));
  left = 499'000'000;
  std::uint64_t number = 2;
  const auto deadline = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  for (; recorder.health().warning.empty() && std::chrono::steady_clock::now() < deadline; ++number) {
    recorder.frame(frame(number));
    std::this_thread::sleep_for(std::chrono::milliseconds(5));
  }
  CHECK_THAT(recorder.health().warning, Contains("less than 500 MB"));
  recorder.frame(frame(number));  // goes nowhere, and nobody waits for it
  recorder.finish();
  CHECK(read_session(scratch.folder).frames.size() == recorder.health().frames_written);
}

TEST_CASE("a disk that refuses to be written ends the recording with a sentence, and nothing else") {
  const Scratch scratch("session_refused");
  SessionRecorder recorder(scratch.folder, "", "", true);
  recorder.frame(frame(1));
  while (recorder.health().frames_written == 0) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  std::filesystem::remove_all(scratch.folder / "cam0" / "data");
  recorder.frame(frame(2));
  recorder.finish();
  CHECK_THAT(recorder.health().warning, Contains("cannot write I000001.pgm") && Contains("the docking goes on"));
}

TEST_CASE("a live recorder drops frames and counts them instead of waiting for the disk") {
  const Scratch scratch("session_queue");
  // A disk that stands still while its free space is asked for, as it is after the first frame.
  std::atomic<int> asked{0};
  std::promise<void> go_on;
  RecorderOptions options;
  options.free_space = [&asked, gone_on = go_on.get_future().share()] {
    if (++asked == 2) gone_on.wait();  // the first is before the recording
    return std::uintmax_t{4'000'000'000};
  };
  constexpr std::uint64_t room = 30, more = 400;
  options.queue_bytes = room * frame(0).frame.gray.total();
  SessionRecorder recorder(scratch.folder, "", "", false, options);
  recorder.frame(frame(0));
  while (asked < 2) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  for (std::uint64_t number = 1; number <= more; ++number) recorder.frame(frame(number));
  CHECK(recorder.health().frames_dropped == more - room);
  go_on.set_value();
  recorder.finish();
  CHECK(recorder.health().frames_written == 1 + room);
  CHECK(read_session(scratch.folder).frames.size() == 1 + room);
}

TEST_CASE("a recorder that waits for the disk keeps at most four of the camera's places, and records the rest") {
  // A camera has twelve: three are in its stream, one in each mailbox, one in the loop.
  const Scratch scratch("session_places");
  std::atomic<bool> stuck{true};
  std::atomic<int> out{0};
  int most = 0;
  {
    RecorderOptions options;
    options.free_space = [&] {  // asked by the writer after the first frame
      while (stuck) std::this_thread::sleep_for(std::chrono::milliseconds(1));
      return std::uintmax_t{1} << 40;
    };
    stuck = false;
    SessionRecorder recorder(scratch.folder, "", "", false, options);
    stuck = true;
    std::vector<cv::Mat1b> memory;
    for (std::uint64_t number = 1; number <= 60; ++number) {
      CameraFrame one = frame(number);
      memory.push_back(one.frame.gray);
      ++out;
      one.frame.gray = lent_picture(memory.back().data, 48, 64, [&out] { --out; });
      recorder.frame(one);
      one.frame.gray.release();
      most = std::max(most, out.load());
    }
    stuck = false;
    recorder.finish();
    CHECK(recorder.health().frames_dropped == 0);
  }
  CHECK(most >= 2);
  CHECK(most <= 4);
  CHECK(out == 0);
  const Session session = read_session(scratch.folder);
  REQUIRE(session.frames.size() == 60);
  for (const RecordedFrame& one : session.frames)
    CHECK(cv::countNonZero(read_frame(one).gray != frame(one.number).frame.gray) == 0);
}

TEST_CASE("a folder without session.yaml is no session") {
  const Scratch scratch("no_session");
  std::filesystem::create_directories(scratch.folder);
  CHECK_THROWS_AS(read_session(scratch.folder), Failure);
}
