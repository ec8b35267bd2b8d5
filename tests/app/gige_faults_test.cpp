// What the simulated camera can do wrong, and what the client makes of it; over real UDP, run by tests/in_namespace.
#include <chrono>
#include <set>
#include <thread>

#include <catch2/catch.hpp>

#include "app/failure.h"
#include "app/simulation/fault_script.h"
#include "tests/fakes/served_patterns.h"

using Catch::Matchers::Contains;

namespace tagdock {
namespace {

/// A camera that serves patterns, and its client.
struct Pair {
  explicit Pair(GigeServerSettings settings = small_sensor(), GigeSettings wanted = at_home())
      : served(settings), server(served), producer(server, served, start, 25.0), camera(open_gige(wanted, start)) {}

  void fault(const std::string& text) { apply(parse_fault(text), server, 1); }
  std::optional<CameraFrame> fresh() {
    while (camera->newest(0ns)) {
    }
    return wait_for_frame(*camera, 1500ms);
  }

  steady_clock::time_point start = steady_clock::now();
  GigeServerSettings served;
  GigeServer server;
  Producer producer;
  std::unique_ptr<Camera> camera;
};

}  // namespace

TEST_CASE("frozen pictures come with new numbers and times") {
  Pair pair;
  REQUIRE(pair.fresh());
  pair.fault("freeze on");
  REQUIRE(pair.fresh());
  const auto first = pair.fresh();
  const auto second = pair.fresh();
  REQUIRE((first && second));
  CHECK(equal(first->frame.gray, second->frame.gray));
  CHECK(second->frame.number > first->frame.number);
  CHECK(second->camera_time > first->camera_time);
  pair.fault("freeze off");
  std::set<int> seen;
  for (int i = 0; i < 8; ++i) {
    const auto frame = pair.fresh();
    REQUIRE(frame);
    seen.insert(frame->frame.gray(0, 0));
  }
  CHECK(seen.size() > 1);
}

TEST_CASE("frames whose time stamps stand still are not used, and the camera is called silent") {
  Pair pair;
  REQUIRE(pair.fresh());
  pair.fault("stale on");
  CHECK(wait_until(1500ms, [&] { return pair.camera->health().state == "silent"; }));
  CHECK_THAT(pair.camera->health().reason, Contains("stand still"));
  CHECK(pair.camera->health().stale > 0);
  pair.fault("stale off");
  CHECK(wait_until(3000ms, [&] { return pair.camera->health().state == "streaming" && pair.camera->newest(0ns); }));
}

TEST_CASE("a jump of the camera's clock leaves the times of frames where they were, after three frames at most") {
  Pair pair;
  REQUIRE(pair.fresh());
  const std::string jump = GENERATE("jump 3600000", "jump -3600000");
  CAPTURE(jump);
  pair.fault(jump);
  for (int i = 0; i < 4; ++i) REQUIRE(pair.fresh());
  for (int i = 0; i < 5; ++i) {
    const auto frame = pair.fresh();
    REQUIRE(frame);
    const double late_ms = static_cast<double>((frame->arrived - frame->frame.time).count()) / 1e6;
    CHECK(late_ms > -1.0);
    CHECK(late_ms < 60.0);  // the clock map's own limit of a late packet is 50 ms
  }
}

TEST_CASE("frames of the wrong size are counted and never shown") {
  Pair pair;
  REQUIRE(pair.fresh());
  pair.fault("size on");
  std::this_thread::sleep_for(100ms);
  while (pair.camera->newest(0ns)) {
  }
  CHECK_FALSE(wait_for_frame(*pair.camera, 400ms));
  CHECK(pair.camera->health().incomplete > 3);
  pair.fault("size off");
  const auto frame = wait_for_frame(*pair.camera, 4000ms);
  REQUIRE(frame);
  CHECK(frame->frame.gray.size() == cv::Size(pair.served.width, pair.served.height));
}

TEST_CASE("every frame is counted once: as received, incomplete, or lost") {
  const GigeServerSettings served = small_sensor();
  const auto start = steady_clock::now();
  GigeServer server(served);
  const auto camera = open_gige(at_home(), start);
  const cv::Mat1b gray = pattern(served.width, served.height, 3);
  std::uint64_t number = 0;
  // @return the newest frame's number when all have come through
  const auto serve = [&](int frames) {
    for (int i = 0; i < frames; ++i, std::this_thread::sleep_for(45ms))
      server.publish({gray, ++number, steady_clock::now() - start});
    std::this_thread::sleep_for(300ms);
    std::uint64_t newest = 0;
    while (const auto frame = camera->newest(0ns)) newest = frame->frame.number;
    return newest;
  };
  const std::uint64_t first = serve(8);
  const CameraHealth before = camera->health();
  REQUIRE(first > 0);
  // With 8 packets a frame: 0.2 breaks most, 0.75 loses one in ten whole.
  for (const double ratio : {0.05, 0.2, 0.75}) {
    server.lose_packets(ratio);
    serve(ratio > 0.5 ? 6 : 30);
    server.lose_packets(0.0);
    serve(2);
  }
  const std::uint64_t last = serve(2);
  const CameraHealth after = camera->health();
  const std::uint64_t received = after.received - before.received;
  const std::uint64_t incomplete = after.incomplete - before.incomplete;
  const std::uint64_t lost = after.lost - before.lost;
  CAPTURE(received, incomplete, lost, after.reconnects, after.restarts);
  CHECK(incomplete > 10);
  CHECK(received + incomplete + lost == last - first);
}

TEST_CASE("lost packets come again from a camera that offers it") {
  GigeServerSettings served = small_sensor();
  served.resend = true;
  Pair pair(served);
  REQUIRE(pair.fresh());
  pair.fault("lose 0.05");
  std::this_thread::sleep_for(3s);
  pair.fault("lose 0");
  std::this_thread::sleep_for(300ms);
  const CameraHealth health = pair.camera->health();
  // Of 8 packets a frame, one in 20 lost leaves 66 % of the frames whole without asking again.
  CHECK(health.resent > 5);
  CHECK(static_cast<double>(health.received) / static_cast<double>(pair.server.sent()) > 0.8);
}

TEST_CASE("a triggered camera sends one frame for each question, and none without") {
  GigeSettings wanted = at_home();
  wanted.triggered = true;
  Pair pair(small_sensor(), wanted);
  CHECK_FALSE(wait_for_frame(*pair.camera, 300ms));
  CHECK(pair.camera->health().state == "streaming");
  int got = 0;
  for (int i = 0; i < 6; ++i) {
    pair.camera->trigger();
    got += wait_for_frame(*pair.camera, 1000ms) ? 1 : 0;
    CHECK_FALSE(wait_for_frame(*pair.camera, 120ms));
  }
  CHECK(got >= 5);  // the very first frame of a stream may be broken: the receive buffer grows with it
}

TEST_CASE("exposure and gain are changed while it streams, within the camera's bounds, and told with the frames") {
  Pair pair;
  REQUIRE(pair.fresh());
  pair.camera->adjust(1500.0, 6.0);
  CHECK(wait_until(1000ms, [&] {
    const auto frame = pair.camera->newest(0ns);
    return frame && frame->exposure_us == 1500.0 && frame->gain == 6.0;
  }));
  CHECK(pair.server.client().exposure_us == 1500.0);
  pair.camera->adjust(1.0, 100.0);
  CHECK(wait_until(1000ms, [&] { return pair.server.client().exposure_us == 10.0; }));
  CHECK(wait_until(1000ms, [&] { return pair.server.client().gain == 24.0; }));
}

TEST_CASE("pixels of 10, 12 and 16 bits, packed or not, come as their upper 8") {
  GigeSettings wanted = at_home();
  const std::string format = GENERATE("Mono10", "Mono10Packed", "Mono12", "Mono12Packed", "Mono16");
  CAPTURE(format);
  wanted.pixel_format = format;
  Pair pair(small_sensor(), wanted);
  for (int i = 0; i < 15; ++i) {  // more than the pool holds
    const auto frame = pair.fresh();
    REQUIRE(frame);
    CHECK(equal(frame->frame.gray,
                pattern(pair.served.width, pair.served.height, (frame->frame.number - 1) % Producer::variety)));
  }
  wanted.pixel_format = "Mono7";
  CHECK_THROWS_AS(open_gige(wanted, steady_clock::now()), Failure);
}

TEST_CASE("with chunk data each frame tells the exposure and gain that it was taken with") {
  GigeSettings wanted = at_home();
  wanted.chunks = true;
  wanted.exposure_us = 4000.0;
  const std::string format = GENERATE("Mono8", "Mono12Packed");
  wanted.pixel_format = format;
  const GigeServerSettings served = small_sensor();
  const auto start = steady_clock::now();
  GigeServer server(served);
  auto camera = open_gige(wanted, start);
  CHECK(camera->actual().notes.empty());
  const cv::Mat1b gray = pattern(served.width, served.height, 3);
  int told = 0;
  for (std::uint64_t number = 1; number <= 20; ++number) {
    // Of each frame another one, as with automatic exposure; none is what the client has set.
    server.publish({gray, number, steady_clock::now() - start, 1000.0 + static_cast<double>(number), 0.5});
    const auto frame = wait_for_frame(*camera, 300ms);
    if (!frame) continue;  // the first one of a stream
    ++told;
    CHECK(frame->exposure_us == 999.0 + static_cast<double>(frame->frame.number));  // numbers begin at 2
    CHECK(frame->gain == 0.5);
    CHECK(equal(frame->frame.gray, gray));
  }
  CHECK(told >= 15);
  // The next client wants none, and finds the camera as this one left it.
  camera.reset();
  wanted.chunks = false;
  camera = open_gige(wanted, start);
  std::optional<CameraFrame> plain;
  for (std::uint64_t number = 21; number <= 30 && !plain; ++number) {
    server.publish({gray, number, steady_clock::now() - start, 1.0, 0.5});
    plain = wait_for_frame(*camera, 300ms);
  }
  REQUIRE(plain);
  CHECK(plain->exposure_us == 4000.0);
  CHECK(equal(plain->frame.gray, gray));
}

TEST_CASE("PTP is switched on where the camera has it, and its status is told") {
  GigeSettings wanted = at_home();
  wanted.ptp = true;
  Pair pair(small_sensor(), wanted);
  const CameraSettings actual = pair.camera->actual();
  REQUIRE(actual.notes.size() == 1);
  CHECK_THAT(actual.notes.front(), Contains("PTP is on, its status is Listening"));
}

TEST_CASE("fault commands are read, and refused with what would be right") {
  CHECK(parse_fault("5 lose 0.01").at == 5s);
  CHECK(parse_fault("lose 0.01").value == 0.01);
  CHECK(parse_fault("malformed 10 50").rate == 50.0);
  CHECK(parse_fault("jump -20").value == -20.0);
  for (const char* wrong : {"", "5", "loose 0.1", "lose", "lose 2", "lose x", "freeze", "freeze maybe", "die now",
                            "-1 die", "malformed 0", "malformed 5 0", "lose 0.1 0.2", "jump nan"}) {
    CAPTURE(wrong);
    CHECK_THROWS_AS(parse_fault(wrong), Failure);
  }
}

}  // namespace tagdock
