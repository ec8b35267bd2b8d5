#include "calibration/hand_eye.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include <catch2/catch.hpp>

#include "planning/pose2.h"
#include "tests/calibration/synthetic_drive.h"

using namespace tagdock;
using namespace tagdock::testing;

namespace {

std::vector<std::string> words(const HandEyeResult& result) {
  std::vector<std::string> all;
  for (const Unobservable& open : result.unobservable) all.push_back(open.word);
  std::sort(all.begin(), all.end());
  return all;
}

Drive of(Drive::Way way, bool by_wheels = false) {
  Drive how;
  how.way = way;
  how.by_wheels = by_wheels;
  return how;
}

using Words = std::vector<std::string>;

}  // namespace

TEST_CASE("a tracker and a surveyed board give all six values, within what is claimed") {
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    Drive how = of(Drive::Way::arc);
    how.surveyed = true;
    how.seed = seed;
    const DriveData data = drive(how);
    const HandEyeResult result = calibrate_hand_eye(data.problem);
    CHECK(result.unobservable.empty());
    CHECK(result.complaints.empty());
    const HandEyeError error = error_of(result, data.truth);
    CHECK(error.xy < 3.7 * result.xy_sigma);  // one in a thousand of a plane's normal errors is larger
    CHECK(error.rotation < 2.4 * result.rotation_sigma);
    CHECK(std::abs(result.T_base_camera.translation().z() - data.truth.T_base_camera.translation().z()) <
          3.5 * result.z_sigma);
  }
}

TEST_CASE("thirteen stops on an arc with a tracker beat the paper, and only the height stays open") {
  for (std::uint64_t seed = 1; seed <= 3; ++seed) {
    Drive how = of(Drive::Way::arc);
    how.seed = seed;
    const DriveData data = drive(how);
    const HandEyeResult result = calibrate_hand_eye(data.problem);
    CHECK(words(result) == Words{"height"});
    CHECK(result.complaints.empty());
    const HandEyeError error = error_of(result, data.truth);
    CHECK(error.xy < 0.003);  // the paper: 3 mm and 0.15 degrees
    CHECK(degrees(error.rotation) < 0.15);
    CHECK(error.xy < 3.7 * result.xy_sigma);
  }
}

TEST_CASE("wheels alone give camera, radii and track, corners with blunders among them") {
  Drive how = of(Drive::Way::wide, true);
  how.stops = 24;
  how.outliers = 0.03;
  how.seed = 2;
  how.height_by_tape = true;
  const DriveData data = drive(how);
  const HandEyeResult result = calibrate_hand_eye(data.problem);
  CHECK(result.unobservable.empty());
  const HandEyeError error = error_of(result, data.truth);
  CHECK(error.xy < 3.7 * result.xy_sigma);
  CHECK(error.rotation < 2.4 * result.rotation_sigma);
  CHECK(error.radius < 4.0 * std::sqrt(result.covariance(6, 6)) / data.truth.odometry.r_left);
  CHECK(error.track < 4.0 * std::sqrt(result.covariance(8, 8)) / data.truth.odometry.track);
}

TEST_CASE("what a straight drive and a turn on the spot leave open is named, nothing else, and the result is refused") {
  for (std::uint64_t seed = 1; seed <= 2; ++seed) {
    const auto solved = [&](Drive::Way way, bool by_wheels) {
      Drive how = of(way, by_wheels);
      how.seed = seed;
      const HandEyeResult result = calibrate_hand_eye(drive(how).problem);
      CHECK_FALSE(result.complaints.empty());
      for (const Unobservable& open : result.unobservable) CHECK_FALSE(open.cure.empty());
      return words(result);
    };
    CHECK(solved(Drive::Way::straight, false) == Words{"height", "roll", "tx", "ty"});
    CHECK(solved(Drive::Way::spin, false) == Words{"height", "yaw"});
    CHECK(solved(Drive::Way::straight, true) == Words{"height", "roll", "track", "tx", "ty"});
    CHECK(solved(Drive::Way::spin, true) == Words{"height", "odometry_scale", "yaw"});
  }
}

TEST_CASE("ten frames of each stop count, and what the camera is unsure of is in the claim") {
  Drive how = of(Drive::Way::arc);
  how.corner_noise_px = 0.3;  // so that corners matter beside the tracker
  const HandEyeResult once = calibrate_hand_eye(drive(how).problem);
  how.frames = 10;
  const HandEyeResult often = calibrate_hand_eye(drive(how).problem);
  CHECK(often.xy_sigma < 0.75 * once.xy_sigma);  // corners by the root of ten; the tracker's part stays
  CHECK(once.camera_xy_sigma == 0.0);
  how.camera_error = 2.0;
  how.sees = Drive::Sees::grid;
  const DriveData data = drive(how);
  const HandEyeResult unsure = calibrate_hand_eye(data.problem);
  CHECK(unsure.camera_xy_sigma > 0.0);
  CHECK(unsure.xy_sigma > unsure.camera_xy_sigma);
  const HandEyeError error = error_of(unsure, data.truth);
  CHECK(error.xy < 3.7 * unsure.xy_sigma);
  CHECK(error.rotation < 2.4 * unsure.rotation_sigma);
}

TEST_CASE("fewer than three stops that see the board are refused with a sentence") {
  Drive how = of(Drive::Way::arc);
  how.stops = 2;
  CHECK_THROWS_AS(calibrate_hand_eye(drive(how).problem), std::invalid_argument);
}
