#include "detection/edge_refiner.h"

#include <catch2/catch.hpp>

#include "planning/pose2.h"
#include "tests/detection/scene_rendering.h"

namespace tagdock {
namespace {

using namespace testing;

/// The true corners moved by up to a third of a pixel, as a detector would give them.
TagDetection coarse(const Rendering& seen, std::mt19937_64& random, int modules = 8) {
  std::uniform_real_distribution<double> shift(-0.33, 0.33);
  TagDetection detection;
  detection.modules = modules;
  for (int i = 0; i < 4; ++i)
    detection.corners_px[i] = seen.corners_px[i] + Eigen::Vector2d(shift(random), shift(random));
  return detection;
}

EdgeRefinerConfig profile(EdgeProfile shape, bool pre_blur = false) {
  EdgeRefinerConfig config;
  config.profile = shape;
  config.pre_blur = pre_blur;
  return config;
}

}  // namespace

TEST_CASE("the tanh fit finds corners to 0.010 px rms at 100 px, tilt 30 degrees, noise 2") {
  // The demand. 40 tags: the figure itself scatters by 1 / sqrt(2 * 320) = 4 %.
  std::mt19937_64 random(21);
  for (const EdgeProfile shape : {EdgeProfile::tanh, EdgeProfile::erf}) {
    CornerError error;
    for (int i = 0; i < 40; ++i) {
      const Rendering seen = render(base_scene(random));
      const cv::Mat1b gray = digitised(seen.grey, 2.0, random);
      const Refinement refined = refine_edges(gray, coarse(seen, random), profile(shape));
      REQUIRE(std::holds_alternative<RefinedTag>(refined));
      error.add(std::get<RefinedTag>(refined).corners_px, seen.corners_px);
    }
    CAPTURE(error.rms_px(), error.worst_px);
    CHECK(error.rms_px() < 0.010);
    // No shift is left of the half pixel: the mean of 160 corners scatters by 0.006 / sqrt(160) = 0.0005 px.
    CHECK(error.mean_px().cwiseAbs().maxCoeff() < 0.003);
  }
}

TEST_CASE("the covariance of refined corners is true: normalised squared error about 1 for erf") {
  // Over N tags the mean scatters by 0.5 / sqrt(N) = 0.07, and the erf profile is the rendering's own.
  std::mt19937_64 random(22);
  double sum = 0.0;
  constexpr int tags = 50;
  for (int i = 0; i < tags; ++i) {
    const Rendering seen = render(base_scene(random));
    const Refinement refined =
        refine_edges(digitised(seen.grey, 2.0, random), coarse(seen, random), profile(EdgeProfile::erf));
    REQUIRE(std::holds_alternative<RefinedTag>(refined));
    const RefinedTag& tag = std::get<RefinedTag>(refined);
    Eigen::Matrix<double, 8, 1> e;
    for (int c = 0; c < 4; ++c) e.segment<2>(2 * c) = tag.corners_px[c] - seen.corners_px[c];
    sum += e.dot(tag.covariance_px2.llt().solve(e)) / 8.0;
    CHECK(tag.residual_rms == Approx(2.05).margin(0.3));  // noise 2 and rounding
    CHECK(tag.blur_px == Approx(std::sqrt(0.49 + 1.0 / 12.0)).margin(0.15));
  }
  CAPTURE(sum / tags);
  CHECK(sum / tags > 0.7);
  CHECK(sum / tags < 1.4);
}

TEST_CASE("with the camera model, straight sides are found under a barrel lens") {
  // Without it the same tag is off by tenths of a pixel. 0.02 px leaves room for the blur that varies over the tag.
  std::mt19937_64 random(23);
  CornerError with_lens;
  CornerError without;
  for (int i = 0; i < 12; ++i) {
    Scene scene;
    scene.camera = {640, 480, 500.0, 500.0, 319.5, 239.5, -0.28, 0.09, 0.0004, -0.0003};
    scene.id = i;
    scene.T_camera_tag = pose_seen(scene.camera, scene.size, 110.0, {600.0 + i, 80.0 + 2 * i}, 0.4, 0.5 * i, 0.7 * i);
    const Rendering seen = render(scene);
    const cv::Mat1b gray = digitised(seen.grey, 2.0, random);
    const TagDetection start = coarse(seen, random);
    const Refinement bent = refine_edges(gray, start, EdgeRefinerConfig{}, scene.camera);
    const Refinement straight = refine_edges(gray, start, EdgeRefinerConfig{});
    CAPTURE(i);
    REQUIRE(std::holds_alternative<RefinedTag>(bent));
    with_lens.add(std::get<RefinedTag>(bent).corners_px, seen.corners_px);
    if (std::holds_alternative<RefinedTag>(straight))
      without.add(std::get<RefinedTag>(straight).corners_px, seen.corners_px);
  }
  CAPTURE(with_lens.rms_px(), without.rms_px());
  CHECK(with_lens.rms_px() < 0.02);
  REQUIRE(without.corners > 0);
  CHECK(without.rms_px() > 3.0 * with_lens.rms_px());
}

TEST_CASE("a shift by whole pixels and a quarter turn of the image move corners exactly") {
  std::mt19937_64 random(24);
  const Rendering seen = render(base_scene(random));
  const cv::Mat1b gray = digitised(seen.grey, 2.0, random);
  const TagDetection start = coarse(seen, random);
  const RefinedTag plain = std::get<RefinedTag>(refine_edges(gray, start, EdgeRefinerConfig{}));

  cv::Mat1b shifted(gray.rows + 17, gray.cols + 9, uchar{120});
  cv::Mat1b inset = shifted(cv::Rect(9, 17, gray.cols, gray.rows));
  gray.copyTo(inset);
  TagDetection moved = start;
  for (Eigen::Vector2d& corner : moved.corners_px) corner += Eigen::Vector2d(9, 17);
  const RefinedTag there = std::get<RefinedTag>(refine_edges(shifted, moved, EdgeRefinerConfig{}));

  const cv::Mat1b transposed = gray.t();
  cv::Mat1b quarter(transposed.size());  // turned clockwise: (x, y) -> (height - 1 - y, x)
  for (int y = 0; y < quarter.rows; ++y)
    for (int x = 0; x < quarter.cols; ++x) quarter(y, x) = transposed(y, quarter.cols - 1 - x);
  TagDetection turned = start;
  for (Eigen::Vector2d& corner : turned.corners_px) corner = {gray.rows - 1 - corner.y(), corner.x()};
  const RefinedTag after = std::get<RefinedTag>(refine_edges(quarter, turned, EdgeRefinerConfig{}));

  for (int i = 0; i < 4; ++i) {
    // 1e-5 px: the solver stops at a relative decrease of 1e-10, and sums run in another order.
    CHECK((there.corners_px[i] - plain.corners_px[i] - Eigen::Vector2d(9, 17)).norm() < 1e-5);
    const Eigen::Vector2d expected(gray.rows - 1 - plain.corners_px[i].y(), plain.corners_px[i].x());
    CHECK((after.corners_px[i] - expected).norm() < 1e-5);
  }
}

TEST_CASE("white squares of the standard families are refined as well") {
  std::mt19937_64 random(25);
  Scene scene;
  scene.family = "tagStandard41h12";
  scene.id = 12;
  scene.T_camera_tag = pose_seen(scene.camera, scene.size, 90.0, {160.2, 159.1}, 0.4, 1.0, 0.4);
  const Rendering seen = render(scene);
  const Refinement refined =
      refine_edges(digitised(seen.grey, 2.0, random), coarse(seen, random, 5), EdgeRefinerConfig{});
  REQUIRE(std::holds_alternative<RefinedTag>(refined));
  CornerError error;
  error.add(std::get<RefinedTag>(refined).corners_px, seen.corners_px);
  CHECK(error.worst_px < 0.04);  // three sigma of a corner at noise 2 is about 0.03 px
}

TEST_CASE("the filter method uses a kernel on a sharp tag and stays within a tenth of a pixel") {
  std::mt19937_64 random(26);
  CornerError error;
  bool filtered = false;
  for (int i = 0; i < 12; ++i) {
    Scene scene = base_scene(random);
    scene.psf_px = 0.4;
    const Rendering seen = render(scene);
    const Refinement refined =
        refine_edges(digitised(seen.grey, 1.0, random), coarse(seen, random), profile(EdgeProfile::tanh, true));
    REQUIRE(std::holds_alternative<RefinedTag>(refined));
    error.add(std::get<RefinedTag>(refined).corners_px, seen.corners_px);
    filtered = filtered || std::get<RefinedTag>(refined).terms.find("gauss") != std::string::npos;
  }
  CHECK(filtered);
  CHECK(error.rms_px() < 0.010);
}

TEST_CASE("what cannot be refined says why") {
  TagDetection nowhere;
  nowhere.corners_px = {Eigen::Vector2d(100, 100), {200, 100}, {200, 200}, {100, 200}};
  const cv::Mat1b flat(300, 300, uchar{90});
  CHECK(std::get<Unrefined>(refine_edges(flat, nowhere, {})) == Unrefined::did_not_converge);

  TagDetection tiny = nowhere;
  tiny.corners_px = {Eigen::Vector2d(100, 100), {102, 100}, {102, 102}, {100, 102}};
  CHECK(std::get<Unrefined>(refine_edges(flat, tiny, {})) == Unrefined::too_few_pixels);

  TagDetection outside = nowhere;
  for (Eigen::Vector2d& corner : outside.corners_px) corner.array() += 5000.0;
  CHECK(std::get<Unrefined>(refine_edges(flat, outside, {})) == Unrefined::too_few_pixels);

  TagDetection crossed = nowhere;
  std::swap(crossed.corners_px[1], crossed.corners_px[2]);
  CHECK(std::get<Unrefined>(refine_edges(flat, crossed, {})) == Unrefined::not_a_quadrilateral);

  TagDetection broken = nowhere;
  broken.corners_px[2].x() = std::nan("");
  CHECK(std::get<Unrefined>(refine_edges(flat, broken, {})) == Unrefined::not_a_quadrilateral);

  // An edge that lies five pixels from where the corners say: not this tag's side.
  std::mt19937_64 random(27);
  const Rendering seen = render(base_scene(random));
  TagDetection displaced = coarse(seen, random);
  for (Eigen::Vector2d& corner : displaced.corners_px) corner.x() += 9.0;
  CHECK(std::holds_alternative<Unrefined>(refine_edges(digitised(seen.grey, 2.0, random), displaced, {})));
}

}  // namespace tagdock
