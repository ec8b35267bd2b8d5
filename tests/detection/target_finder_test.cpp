#include "detection/target_finder.h"

#include <cmath>
#include <map>
#include <random>
#include <stdexcept>

#include <catch2/catch.hpp>

#include "planning/pose2.h"
#include "tests/calibration/board_rendering.h"

using namespace tagdock;
using namespace tagdock::testing;

namespace {

/// Shares and errors of the corners of some rendered views; ids must belong to the places that they name.
struct Score {
  double share = 0.0;
  double rms_px = 0.0;
  double normalised = 0.0;  ///< rms of error over claimed sigma
};

Score score(const CalibrationTarget& target, int count, const BoardScene& base, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  BoardScene scene = base;
  scene.camera = random_camera(random);
  const TargetFinder finder(target);
  double shown = 0.0;
  double found = 0.0;
  double squares = 0.0;
  double normalised = 0.0;
  for (const Eigen::Isometry3d& pose : views_of(target, scene.camera, count, random)) {
    scene.T_camera_board = pose;
    const TargetView view = finder.find(render_board(target, scene, random));
    const TargetLayout layout = layouts_of(target)[view.layout];
    for (const TargetLayout::Corner& corner : layout.corners) {
      const Eigen::Vector2d p = project(scene.camera, pose * Eigen::Vector3d(corner.drawn.x(), corner.drawn.y(), 0.0));
      if (p.x() > 5 && p.y() > 5 && p.x() < 1274 && p.y() < 1018) shown += 1.0;
      for (const SeenPoint& seen : view.corners) {
        if (seen.id != corner.id) continue;
        found += 1.0;
        squares += (seen.pixel - p).squaredNorm();
        normalised += (seen.pixel - p).squaredNorm() / (seen.sigma_px * seen.sigma_px);
      }
    }
  }
  return {found / shown, std::sqrt(squares / (2.0 * found)), std::sqrt(normalised / (2.0 * found))};
}

}  // namespace

TEST_CASE("ChArUco corners are found in both prints, to hundredths of a pixel and without half a pixel of bias") {
  CalibrationTarget target = charuco_board();
  for (const bool black : {true, false}) {
    if (!black) target.squares_y = 6;  // the print of OpenCV before 4.7: the bottom left square is black
    BoardScene scene;
    scene.black_top_left = black;
    const Score seen = score(target, 2, scene, 11);
    CAPTURE(black, seen.share, seen.rms_px, seen.normalised);
    CHECK(seen.share > 0.97);
    CHECK(seen.rms_px < 0.03);  // OpenCV's own refinement leaves 0.047 (notes)
    CHECK(seen.normalised < 2.0);
  }
}

TEST_CASE("through the lens corners lose the shift towards the middle that its bend gives all of them alike") {
  std::mt19937_64 random(15);
  BoardScene scene;
  scene.camera = {1280, 1024, 1150.0, 1150.0, 640.0, 510.0, -0.3, 0.1, 0.0, 0.0, 0.0};  // a strong one
  const CalibrationTarget target = tag_board(CalibrationTarget::Type::aprilgrid);
  const TargetFinder finder(target);
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();  // of the error away from the middle: without and with the lens [px]
  Eigen::Vector2d count = Eigen::Vector2d::Zero();
  for (const Eigen::Isometry3d& pose : views_of(target, scene.camera, 3, random)) {
    scene.T_camera_board = pose;
    const cv::Mat1b picture = render_board(target, scene, random);
    const TargetView bare = finder.find(picture);
    const TargetView views[] = {bare, finder.refine(picture, bare, scene.camera)};
    std::map<int, Eigen::Vector2d> drawn;
    const TargetLayout layout = layouts_of(target)[bare.layout];
    for (const TargetLayout::Corner& corner : layout.corners) drawn[corner.id] = corner.drawn;
    for (int i = 0; i < 2; ++i)
      for (const SeenPoint& seen : views[i].corners) {
        const Eigen::Vector2d out = seen.pixel - Eigen::Vector2d(scene.camera.cx, scene.camera.cy);
        if (out.norm() < 250.0) continue;
        const Eigen::Vector2d& place = drawn[seen.id];
        const Eigen::Vector2d error =
            seen.pixel - project(scene.camera, pose * Eigen::Vector3d(place.x(), place.y(), 0.0));
        if (error.norm() > 0.05) continue;  // the rare corner that is off for reasons of its own
        sum[i] += error.dot(out.normalized());
        count[i] += 1.0;
      }
  }
  const Eigen::Vector2d mean = sum.cwiseQuotient(count);
  CAPTURE(mean.transpose(), count.transpose());
  CHECK(count[1] > 100);
  CHECK(mean[0] < -0.002);
  CHECK(std::abs(mean[1]) < 0.0015);  // three sigmas of the mean of a hundred corners of 0.005 px
}

TEST_CASE("grids whose squares touch are found whole, numbered from below or from above") {
  for (const bool above : {false, true}) {
    BoardScene scene;
    scene.rows_from_above = above;
    const Score seen = score(tag_board(CalibrationTarget::Type::aprilgrid), 2, scene, 12);
    CAPTURE(above, seen.share, seen.rms_px, seen.normalised);
    CHECK(seen.share > 0.90);  // AprilTag alone finds 8 %
    CHECK(seen.rms_px < 0.05);
  }
}

TEST_CASE("a sharp view whose edges run along the picture's axes is as sharp as any; a smeared one is told apart") {
  std::mt19937_64 random(5);
  BoardScene scene;
  scene.camera = random_camera(random);
  scene.T_camera_board.translation() << -0.2, -0.14, 0.7;  // facing the camera, not turned
  const TargetFinder finder(charuco_board());
  const TargetView sharp = finder.find(render_board(charuco_board(), scene, random));
  CHECK(sharp.blur_px < 0.8);  // 0.6 of the lens and the pixel's own 0.29
  scene.motion << 4.0, 4.0;
  const TargetView smeared = finder.find(render_board(charuco_board(), scene, random));
  CHECK(smeared.blur_px > 1.2);  // 4 px along each axis are 1.15 of themselves
}

TEST_CASE("a view without the board, and a board of another layout, give no corners") {
  std::mt19937_64 random(3);
  const TargetFinder finder(charuco_board());
  CHECK(finder.find(cv::Mat1b(480, 640, static_cast<unsigned char>(90))).marks_found == 0);
  CHECK(finder.find(cv::Mat1b(10, 10, static_cast<unsigned char>(90))).corners.empty());
  CHECK_THROWS_AS(TargetFinder([] {
                    CalibrationTarget target = charuco_board();
                    target.dictionary = "DICT_9X9";
                    return target;
                  }()),
                  std::invalid_argument);
}
