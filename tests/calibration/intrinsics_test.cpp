#include "calibration/intrinsics.h"

#include <cmath>
#include <random>
#include <stdexcept>

#include <catch2/catch.hpp>

#include "calibration/calibration_target.h"
#include "calibration/poorer_lens.h"
#include "tests/calibration/board_rendering.h"

using namespace tagdock;
using namespace tagdock::testing;

namespace {

constexpr double noise_px = 0.05;

/// Views of a ChArUco board as points with noise, no pictures.
struct Points {
  CameraModel camera;
  std::vector<CalibrationView> views;
};

Points points(int count, std::uint64_t seed, bool poor = false, double bow = 0.0) {
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal(0.0, noise_px);
  const CalibrationTarget target = charuco_board();
  const TargetLayout layout = layouts_of(target).front();
  Points result;
  result.camera = random_camera(random);
  for (const Eigen::Isometry3d& pose : views_of(target, result.camera, count, random, poor)) {
    CalibrationView view;
    view.name = std::to_string(result.views.size());
    view.marks_found = 30;
    view.contrast = 150.0;
    view.blur_px = view.sharpest_px = 0.7;
    for (const TargetLayout::Corner& corner : layout.corners) {
      Eigen::Vector3d point = corner.point;
      const double u = 2.0 * point.x() / layout.width - 1.0;
      const double v = 2.0 * point.y() / layout.height - 1.0;
      point.z() -= bow * (1.0 - 0.6 * u * u - 0.4 * v * v);
      const Eigen::Vector2d pixel =
          project(result.camera, pose * point) + Eigen::Vector2d(normal(random), normal(random));
      if (pixel.x() < 0 || pixel.y() < 0 || pixel.x() > 1279 || pixel.y() > 1023) continue;
      view.corners.push_back({corner.id, corner.point, pixel, noise_px});
    }
    view.corners_expected = static_cast<int>(view.corners.size());
    result.views.push_back(view);
  }
  return result;
}

}  // namespace

TEST_CASE("twenty views give the lens within what is claimed, whether the board is flat or bowed by 1.5 mm") {
  for (const double bow : {0.0, 0.0015}) {
    CAPTURE(bow);
    const Points seen = points(20, 5, false, bow);
    const IntrinsicsResult result = calibrate_intrinsics(seen.views, 1280, 1024);
    CHECK(result.complaints.empty());
    const ImageMap error = projection_difference(seen.camera, result.camera);
    CHECK(error.largest() < 3.0 * result.sigma_max_px);
    CHECK(error.rms() < 0.25);
    CHECK(result.noise_scale == Approx(1.0).margin(0.1));
    // Seen is the part between the inner corners: 0.8 of the width and 5/7 of the height, squared.
    CHECK(result.board.bow() == Approx(bow * (0.6 * 0.64 + 0.4 * 25.0 / 49.0)).margin(0.0001));
  }
}

TEST_CASE("a bowed board that is taken for flat is caught, and claims a sixth of its error or more") {
  IntrinsicsConfig config;
  config.flat_board = true;
  config.lens = LensModel::brown5;
  for (const std::uint64_t seed : {6U, 7U, 8U, 9U}) {
    CAPTURE(seed);
    const Points seen = points(20, seed, false, 0.0015);
    const IntrinsicsResult result = calibrate_intrinsics(seen.views, 1280, 1024, config);
    const ImageMap error = projection_difference(seen.camera, result.camera);
    CHECK(error.largest() > 1.0);
    CHECK_FALSE(result.complaints.empty());
    INFO(error.rms() << " px, claimed " << result.sigma.rms());
    CHECK(error.rms() < 6.0 * result.sigma.rms());  // what all views share, no spread between them tells in full
  }
}

TEST_CASE("a lens model that is too poor for the lens is refused, and the better one named") {
  const Points seen = points(20, 5);
  IntrinsicsConfig config;
  config.lens = LensModel::k1;
  const IntrinsicsResult result = calibrate_intrinsics(seen.views, 1280, 1024, config);
  CHECK(projection_difference(seen.camera, result.camera).largest() > 1.0);
  REQUIRE_FALSE(result.complaints.empty());
  CHECK(result.complaints.front().find("too poor") != std::string::npos);
  config.lens = LensModel::brown4;
  CHECK(calibrate_intrinsics(seen.views, 1280, 1024, config).complaints.empty());
}

TEST_CASE("a dozen nearly frontal views are refused, and the missing ones named") {
  const Points seen = points(12, 7, true);
  const IntrinsicsResult result = calibrate_intrinsics(seen.views, 1280, 1024);
  CHECK_FALSE(result.complaints.empty());
  CHECK(result.sigma_max_px > 1.0);
  REQUIRE_FALSE(result.missing.empty());
  CHECK(result.missing.front().find("tilted") != std::string::npos);
  std::vector<Eigen::Vector3d> board;
  const TargetLayout layout = layouts_of(charuco_board()).front();
  for (const TargetLayout::Corner& corner : layout.corners) board.push_back(corner.point);
  const std::vector<ViewWish> wishes = next_best_views(result, board, 3);
  REQUIRE(wishes.size() == 3);
  CHECK(wishes[0].sentence.find("nearer") != std::string::npos);  // a tilted view helps most
  CHECK(wishes[0].sigma_after_px < result.sigma.rms());
}

TEST_CASE("blurred, smeared, saturated, repeated and foreign views are set aside with their reason") {
  Points seen = points(14, 8);
  seen.views[1].blur_px = 1.6;
  seen.views[1].sharpest_px = 1.5;
  seen.views[3].blur_px = 2.0;
  seen.views[5].clipped = 0.4;
  seen.views[7].corners = seen.views[6].corners;
  seen.views[9].marks_found = 0;
  seen.views[9].marks_elsewhere = 12;
  seen.views[11].corners.resize(5);
  const std::vector<ViewResidual> judged = judge_views(seen.views);
  const std::pair<std::size_t, const char*> reasons[] = {{1, "blurred"},   {3, "motion"},        {5, "saturated"},
                                                         {7, "same view"}, {9, "another board"}, {11, "too few"}};
  for (const auto& [view, reason] : reasons) {
    CHECK_FALSE(judged[view].used);
    CHECK(judged[view].reason.find(reason) != std::string::npos);
  }
  for (const std::size_t view : {0U, 2U, 4U, 6U, 8U, 10U, 12U, 13U}) CHECK(judged[view].used);
  CHECK_THROWS_AS(calibrate_intrinsics({}, 1280, 1024), std::invalid_argument);
}

TEST_CASE("a poorer lens comes as near as it can, and its loss is told") {
  CameraModel camera{1280, 1024, 1100.0, 1101.0, 640.0, 511.0, -0.12, 0.08, 0.0004, -0.0003, 0.01};
  CHECK(loss_between(camera, poorer_lens(camera, LensTerms::brown5)).largest_px <
        1e-9);  // rounding to a pixel and back
  const Loss four = loss_between(camera, poorer_lens(camera, LensTerms::brown4));
  const Loss one = loss_between(camera, poorer_lens(camera, LensTerms::radial1));
  CHECK(four.largest_px < one.largest_px);
  CHECK(one.largest_px > 0.1);
  CameraModel cut = camera;  // dropping terms without fitting again is worse
  cut.k2 = cut.p1 = cut.p2 = cut.k3 = 0.0;
  CHECK(one.rms_px < loss_between(camera, cut).rms_px);
}
