// The goals of the camera layer, each measured over real UDP on the loopback device and printed; run by
// tests/in_namespace. The ten-minute ones are in tests/bench/camera_soak.cpp.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <string>
#include <thread>
#include <vector>

#include <catch2/catch.hpp>

#include "app/cameras/gvcp_probe.h"
#include "app/failure.h"
#include "tests/fakes/process.h"
#include "tests/fakes/served_patterns.h"

namespace tagdock {
namespace {

void measured(const std::string& goal, double value, const std::string& unit) {
  std::printf("measured: %s %.2f %s\n", goal.c_str(), value, unit.c_str());
  std::fflush(stdout);
}

double quantile(std::vector<double> values, double part) {
  std::sort(values.begin(), values.end());
  return values.at(static_cast<std::size_t>(part * static_cast<double>(values.size() - 1)));
}

std::vector<std::string> serve(const std::string& serial, const std::string& size = "320x256") {
  return {GIGE_PEER, "serve", serial, size};
}

// Times are bounds that a robot needs, and three to ten times what was measured, for a machine that others load too.

TEST_CASE("goals 2 and 4: opened, first frame, and from published to taken at 1280x1024", "[full-size]") {
  GigeServerSettings served;
  served.frame_rate = 100.0;
  const auto start = steady_clock::now();
  GigeServer server(served);
  const Producer producer(server, served, start, 30.0);
  const auto opening = steady_clock::now();
  const auto camera = open_gige(at_home(), start);
  measured("goal 4, opened after", ms_since(opening), "ms (goal 200)");
  REQUIRE(wait_for_frame(*camera, 2000ms));
  measured("goal 4, first frame after", ms_since(opening), "ms (goal 350)");
  CHECK(ms_since(opening) < 2000.0);
  std::vector<double> delays_ms;
  while (delays_ms.size() < 150) {
    const auto frame = wait_for_frame(*camera, 1000ms);
    REQUIRE(frame);
    delays_ms.push_back(static_cast<double>((steady_clock::now() - start - frame->camera_time).count()) / 1e6);
  }
  measured("goal 2, published to taken, median", quantile(delays_ms, 0.5), "ms (goal 2)");
  measured("goal 2, published to taken, 99 %", quantile(delays_ms, 0.99), "ms (goal 15)");
  CHECK(quantile(delays_ms, 0.5) < 20.0);
  measured("goal 1 (5 s of it), incomplete frames after the first", static_cast<double>(camera->health().incomplete),
           "");
  measured("goal 1 (5 s of it), frames lost by their numbers", static_cast<double>(camera->health().lost), "");
  CHECK(camera->health().incomplete <= 1);
}

TEST_CASE("goal 5: a camera that dies is lost, comes back, and never holds up who asks for frames") {
  auto server = std::make_unique<Process>(serve("TD000001"));
  REQUIRE(server->line() == "serving");
  const auto camera = open_gige(at_home(), steady_clock::now());
  REQUIRE(wait_for_frame(*camera, 2000ms));
  double longest_ms = 0.0;
  const auto ask = [&] {
    const auto before = steady_clock::now();
    const bool got = camera->newest(0ns).has_value();
    (void)camera->health();
    longest_ms = std::max(longest_ms, ms_since(before));
    return got;
  };
  server->kill();
  const auto killed = steady_clock::now();
  REQUIRE(wait_until(500ms, [&] {
    ask();
    return camera->health().state == "lost";
  }));
  measured("goal 5, lost after", ms_since(killed), "ms (goal 500)");
  while (ask()) {
  }
  for (int i = 0; i < 200; ++i, std::this_thread::sleep_for(5ms)) ask();
  server = std::make_unique<Process>(serve("TD000001"));
  REQUIRE(server->line() == "serving");
  const auto back = steady_clock::now();
  REQUIRE(wait_until(3000ms, ask));
  measured("goal 5, frames after its return", ms_since(back), "ms (goal 500)");
  measured("goal 5, longest time that a question took", longest_ms, "ms (goal 5)");
  CHECK(ms_since(back) < 1500.0);
}

void next_client_streams(int quarters_apart) {
  const GigeServerSettings served = small_sensor();
  const auto start = steady_clock::now();
  GigeServer server(served);
  const Producer producer(server, served, start, 25.0);
  double worst_ms = 0.0;
  int delays = 0;
  for (int quarter = 0; quarter <= 16; quarter += quarters_apart, ++delays) {
    CAPTURE(quarter);
    {
      Process client({GIGE_PEER, "watch", "127.0.0.1"});
      REQUIRE(client.line() == "streaming");
      client.kill();
    }
    std::this_thread::sleep_for(quarter * 250ms);
    const auto began = steady_clock::now();
    const auto camera = open_gige(at_home(), start);
    REQUIRE(wait_for_frame(*camera, 4000ms));
    worst_ms = std::max(worst_ms, ms_since(began));
  }
  measured("goal 6, next client streams after, worst of " + std::to_string(delays) + " delays from 0 to 4 s", worst_ms,
           "ms (goal 4000)");
  CHECK(worst_ms < 4000.0);
}

TEST_CASE("goal 6: the next client streams within 4 s, whenever the one before was killed") { next_client_streams(4); }

// Takes a minute and a half of waiting: camera_goals_test [.delays]
TEST_CASE("goal 6: at every delay from 0 to 4 s in steps of 0.25 s", "[.delays]") { next_client_streams(1); }

TEST_CASE("goal 7: a second client is refused at once, and the first loses no frame") {
  const GigeServerSettings served = small_sensor();
  const auto start = steady_clock::now();
  GigeServer server(served);
  const Producer producer(server, served, start, 25.0);
  const auto first = open_gige(at_home(), start);
  REQUIRE(wait_for_frame(*first, 2000ms));
  const CameraHealth before = first->health();
  GigeSettings impatient = at_home();
  impatient.take_over_wait = 0ms;
  const auto asked = steady_clock::now();
  CHECK_THROWS_AS(open_gige(impatient, start), Failure);
  measured("goal 7, refused after", ms_since(asked), "ms (goal 200)");
  CHECK(ms_since(asked) < 1500.0);
  REQUIRE(wait_for_frame(*first, 1000ms));
  const CameraHealth after = first->health();
  measured("goal 7, frames that the first lost",
           static_cast<double>(after.lost + after.incomplete - before.lost - before.incomplete), "");
  CHECK(after.lost + after.incomplete == before.lost + before.incomplete);
  CHECK(after.reconnects == before.reconnects);
}

TEST_CASE("goal 9: one packet in a thousand lost leaves most frames whole, and all of them when it is over",
          "[full-size]") {
  GigeServerSettings served;
  const bool resend = GENERATE(false, true);
  served.resend = resend;
  served.frame_rate = 100.0;
  const auto start = steady_clock::now();
  GigeServer server(served);
  const Producer producer(server, served, start, 30.0);
  const auto camera = open_gige(at_home(), start);
  REQUIRE(wait_for_frame(*camera, 2000ms));
  const std::uint64_t sent_before = server.sent();
  const std::uint64_t got_before = camera->health().received;
  server.lose_packets(0.001);
  std::this_thread::sleep_for(4s);
  server.lose_packets(0.0);
  const auto sent = static_cast<double>(server.sent() - sent_before);
  std::this_thread::sleep_for(300ms);
  const CameraHealth lossy = camera->health();
  const double share = static_cast<double>(lossy.received - got_before) / (sent + 9.0);
  measured(std::string("goal 9, frames whole, packets ") + (resend ? "sent again" : "not sent again"), 100.0 * share,
           "% (goal 85)");
  measured("goal 9, packets that came again", static_cast<double>(lossy.resent), "");
  // A frame has 83 packets: 0.999^83 = 92 % are whole. Of 120 frames 84 % and less are seen once in 500 runs.
  CHECK(share > (resend ? 0.9 : 0.84));
  std::this_thread::sleep_for(700ms);  // clean within 1 s
  const CameraHealth clean = camera->health();
  std::this_thread::sleep_for(1s);
  CHECK(camera->health().incomplete == clean.incomplete);
  CHECK(camera->health().received > clean.received + 20);
}

TEST_CASE("goal 10: who takes 60 ms for a frame gets one that is new") {
  const GigeServerSettings served = small_sensor();
  const auto start = steady_clock::now();
  GigeServer server(served);
  const Producer producer(server, served, start, 25.0);
  const auto camera = open_gige(at_home(), start);
  REQUIRE(wait_for_frame(*camera, 2000ms));
  std::vector<double> ages_ms;
  while (ages_ms.size() < 50) {
    std::this_thread::sleep_for(60ms);
    if (const auto frame = camera->newest(0ns))
      ages_ms.push_back(static_cast<double>((steady_clock::now() - start - frame->camera_time).count()) / 1e6);
  }
  measured("goal 10, age when taken, median", quantile(ages_ms, 0.5), "ms");
  measured("goal 10, age when taken, 95 %", quantile(ages_ms, 0.95), "ms (goal 65: 1.5 periods and 5 ms)");
  CHECK(quantile(ages_ms, 0.5) < 65.0);
}

}  // namespace
}  // namespace tagdock
