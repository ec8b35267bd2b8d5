#include "app/auto_exposure.h"

#include <cmath>

#include <catch2/catch.hpp>
#include <opencv2/imgproc.hpp>

using namespace tagdock;

namespace {

const Corners square{Eigen::Vector2d(100, 100), Eigen::Vector2d(180, 100), Eigen::Vector2d(180, 180),
                     Eigen::Vector2d(100, 180)};

/// A tag of 80 px with a white frame of one module, in surroundings of any level.
cv::Mat1b picture(double white, int around) {
  cv::Mat1b gray(300, 300, static_cast<unsigned char>(around));
  cv::rectangle(gray, cv::Rect(90, 90, 101, 101), cv::Scalar(std::min(255.0, white)), cv::FILLED);
  cv::rectangle(gray, cv::Rect(100, 100, 81, 81), cv::Scalar(10), cv::FILLED);
  return gray;
}

}  // namespace

TEST_CASE("the tag's white is metered, whatever is around it") {
  for (const int around : {0, 128, 255}) {
    CAPTURE(around);
    const auto light = meter(picture(153.0, around), {square});
    REQUIRE(light);
    CHECK(light->white == Approx(0.6).margin(0.01));
    CHECK(light->saturated == 0.0);
  }
  CHECK(meter(picture(255.0, 0), {square})->saturated == 1.0);
  CHECK_FALSE(meter(picture(100.0, 0), {}));
}

TEST_CASE("from darkness and from glare the tag's white comes between its limits, and stays") {
  const AutoExposureConfig config;
  // Levels a microsecond of exposure: from a lamp in the face to dusk.
  for (const double light_per_us : {2.0, 0.2, 0.05, 0.012}) {
    for (const double speed_px : {0.0, 100.0}) {
      CAPTURE(light_per_us, speed_px);
      AutoExposure control(config);
      ExposureSetting set{5000.0, 0.0};
      int changes_late = 0;
      double white = 0.0;
      for (int frame = 0; frame < 200; ++frame) {
        const double level = light_per_us * set.exposure_us * std::pow(10.0, set.gain_db / 20.0);
        const auto light = meter(picture(level, 255), {square});
        REQUIRE(light);
        white = light->white;
        if (const auto next = control.next(*light, set, speed_px, false)) {
          CHECK(next->exposure_us * std::pow(10.0, next->gain_db / 20.0) <
                1.51 * set.exposure_us * std::pow(10.0, set.gain_db / 20.0));
          set = *next;
          if (frame > 100) ++changes_late;
        }
      }
      CHECK(changes_late == 0);
      CHECK(white >= config.white_low - 0.01);
      CHECK(white <= config.white_high + 0.01);
      // No more than a pixel of blur.
      CHECK(set.exposure_us * 1e-6 * speed_px <= 1.06);
    }
  }
}

TEST_CASE("in the final approach nothing is changed") {
  AutoExposure control{AutoExposureConfig{}};
  for (int i = 0; i < 20; ++i) CHECK_FALSE(control.next({0.1, 0.0}, {5000.0, 0.0}, 0.0, true));
}

TEST_CASE("a picture that moves by 200 px a second stays sharp to a pixel for 5 ms") {
  CHECK(longest_exposure_us(200.0, 1.0) == Approx(5000.0));
  CHECK(std::isinf(longest_exposure_us(0.0, 1.0)));
}
