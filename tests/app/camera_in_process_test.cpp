#include <catch2/catch.hpp>
#include <opencv2/core.hpp>

#include "app/cameras/in_process.h"

using namespace tagdock;
using std::chrono::milliseconds;
using std::chrono::nanoseconds;

namespace {

Rig small_rig() {
  Rig rig = default_rig();
  rig.camera.width = 320;
  rig.camera.height = 256;
  rig.camera.fx = rig.camera.fy = 307.0;
  rig.camera.cx = 159.5;
  rig.camera.cy = 127.5;
  return rig;
}

struct Seen {
  CameraFrame frame;
  double grey = 0.0;  ///< mean
};

/// The frame after a time of standing still.
Seen next(Camera& camera, nanoseconds& now) {
  for (;;) {
    now += milliseconds(5);
    if (auto frame = camera.newest(now)) return {*frame, cv::mean(frame->frame.gray)[0]};
  }
}

}  // namespace

TEST_CASE("a simulated camera in-process takes another exposure and gain, from the frames exposed after it on") {
  Scenario scenario;
  scenario.camera.loss = 0.0;
  const auto camera =
      in_process_camera(std::make_shared<SharedWorld>(scenario, small_rig(), default_board(0.35), 3), {});
  nanoseconds now{0};
  const Seen first = next(*camera, now);
  const double exposure_us = 1e6 * scenario.camera.exposure;
  CHECK(first.frame.exposure_us == exposure_us);
  const nanoseconds asked = now;
  camera->adjust(0.5 * exposure_us, 0.0);
  Seen seen = next(*camera, now);
  // What was exposed already is as it was.
  int on_their_way = 0;
  for (; seen.frame.frame.time < asked; seen = next(*camera, now), ++on_their_way) {
    CHECK(seen.frame.exposure_us == exposure_us);
    CHECK(seen.grey == Approx(first.grey).epsilon(0.01));
  }
  CHECK(on_their_way > 0);  // 80 ms of latency, 40 ms between frames
  // The sensor is linear, so half the light makes half the grey value over its black level (a few grey levels at most).
  CHECK(seen.frame.exposure_us == 0.5 * exposure_us);
  CHECK(seen.grey < 0.6 * first.grey);
  CHECK(seen.grey > 0.4 * first.grey);
  CHECK(camera->actual().exposure_us == 0.5 * exposure_us);
  // 6.02 dB of gain make up for it.
  camera->adjust(0.5 * exposure_us, 20.0 * std::log10(2.0));
  for (int i = 0; i < 5; ++i) seen = next(*camera, now);
  CHECK(seen.frame.gain == Approx(6.0206));
  CHECK(seen.grey == Approx(first.grey).epsilon(0.02));
}
