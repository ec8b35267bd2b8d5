#include "detection/tag_detector.h"

#include <algorithm>

#include <catch2/catch.hpp>

#include "detection/tag_locator.h"
#include "planning/pose2.h"
#include "tests/detection/scene_rendering.h"

namespace tagdock {
namespace {

using namespace testing;

TagDetectorConfig with(const std::string& family, int decimate) {
  TagDetectorConfig config;
  config.family = family;
  config.decimate = decimate;
  return config;
}

}  // namespace

TEST_CASE("the rendering is symmetric about the tag's centre to a thousandth of a grey level") {
  // An upright, frontal tag of a whole number of pixels, centred: its margin and border must mirror exactly.
  Scene scene;
  scene.T_camera_tag = pose_seen(scene.camera, scene.size, 96.0, {159.5, 159.5}, 0.0, 0.0, 0.0);
  const Rendering seen = render(scene);
  for (int i = 40; i < 160; ++i) {
    CHECK(seen.grey(104, i) == Approx(seen.grey(104, 319 - i)).margin(1e-3));  // along the white margin
    CHECK(seen.grey(115, i) == Approx(seen.grey(204, i)).margin(1e-3));        // the border's first and last row
  }
}

TEST_CASE("corners come in our order and pixel convention, upright and turned") {
  // 0.35 px: the library's own error on clean renderings is up to 0.3 px; a missing half pixel would be 0.5 in the
  // mean, a wrong order tens of pixels.
  std::mt19937_64 random(11);
  for (const int decimate : {1, 2}) {
    const TagDetector detector(with("tag36h11", decimate));
    CornerError error;
    for (int turn = 0; turn < 24; ++turn) {
      Scene scene;
      scene.id = 7 * turn;
      const Eigen::Vector2d centre(159.5 + 0.13 * turn, 158.9 - 0.29 * turn);
      scene.T_camera_tag = pose_seen(scene.camera, scene.size, 110.0, centre, 0.2, turn, radians(15.0 * turn));
      const Rendering seen = render(scene);
      const auto found = detector.detect(digitised(seen.grey, 1.0, random));
      CAPTURE(decimate, turn);
      REQUIRE(found.size() == 1);
      CHECK(found[0].id == scene.id);
      CHECK(found[0].modules == 8);
      error.add(found[0].corners_px, seen.corners_px);
    }
    CAPTURE(decimate, error.mean_px().transpose());
    CHECK(error.worst_px < 0.45);
    CHECK(error.mean_px().cwiseAbs().maxCoeff() < 0.1);
  }
}

TEST_CASE("every family is found, and its corners are those of its own square") {
  std::mt19937_64 random(12);
  for (const std::string family :
       {"tag36h11", "tag25h9", "tag16h5", "tagStandard41h12", "tagStandard52h13", "tagCircle21h7", "tagCircle49h12"}) {
    CAPTURE(family);
    TagDetectorConfig config = with(family, 1);
    config.max_hamming = 0;
    const TagDetector detector(config);
    Scene scene;
    scene.family = family;
    scene.id = 3;
    scene.T_camera_tag = pose_seen(scene.camera, scene.size, 90.0, {160.3, 158.8}, 0.3, 1.0, 0.5);
    const Rendering seen = render(scene);
    const auto found = detector.detect(digitised(seen.grey, 1.0, random));
    REQUIRE(found.size() == 1);
    CHECK(found[0].id == 3);
    CornerError error;
    error.add(found[0].corners_px, seen.corners_px);
    CHECK(error.worst_px < 0.6);  // the wrong square of a family would be off by a cell, 10 px
  }
}

TEST_CASE("a region gives the same tag in pixels of the whole image") {
  std::mt19937_64 random(13);
  Scene scene;
  scene.T_camera_tag = pose_seen(scene.camera, scene.size, 80.0, {180.0, 120.0}, 0.4, 2.0, 0.3);
  const Rendering seen = render(scene);
  const cv::Mat1b gray = digitised(seen.grey, 1.0, random);
  const TagDetector detector(with("tag36h11", 1));
  const auto whole = detector.detect(gray);
  const auto part = detector.detect(gray, {101, 43, 160, 160});
  REQUIRE(whole.size() == 1);
  REQUIRE(part.size() == 1);
  CornerError error;
  error.add(part[0].corners_px, whole[0].corners_px);
  CHECK(error.worst_px < 0.2);  // thresholds of the library are taken over tiles, which a region shifts
  CHECK(detector.detect(gray, {0, 0, 60, 60}).empty());
}

TEST_CASE("a tag cut by the image border is not handed on") {
  std::mt19937_64 random(14);
  const TagDetector detector(with("tag36h11", 1));
  for (const double place : {40.0, 42.0, 44.0, 46.0}) {
    Scene scene;
    scene.T_camera_tag = pose_seen(scene.camera, scene.size, 80.0, {place, 160.0}, 0.0, 0.0, 0.0);
    const Rendering seen = render(scene);
    CAPTURE(place);
    const bool near_border = seen.corners_px[0].x() < 4.5;
    CHECK(detector.detect(digitised(seen.grey, 1.0, random)).empty() == near_border);
  }
}

TEST_CASE("both of two tags with one id are reported, in a fixed order") {
  std::mt19937_64 random(15);
  Scene scene;
  scene.id = 5;
  cv::Mat1d grey(320, 320, scene.wall);
  for (const Eigen::Vector2d& place : {Eigen::Vector2d(230, 230), Eigen::Vector2d(90, 90)}) {
    scene.T_camera_tag = pose_seen(scene.camera, scene.size, 70.0, place, 0.1, 0.0, 0.0);
    render_into(grey, scene);
  }
  const auto found = TagDetector(with("tag36h11", 2)).detect(digitised(grey, 1.0, random));
  REQUIRE(found.size() == 2);
  CHECK(found[0].id == 5);
  CHECK(found[1].id == 5);
  CHECK(found[0].corners_px[0].y() < found[1].corners_px[0].y());
}

TEST_CASE("images of any size, stride and content are borne") {
  // AprilTag 3.3.0 itself crashes on most of the small ones.
  for (const int decimate : {1, 2, 4}) {
    const TagDetector detector(with("tag36h11", decimate));
    for (const cv::Size& size : {cv::Size(0, 0), cv::Size(1, 1), cv::Size(2, 1), cv::Size(3, 3), cv::Size(40, 4),
                                 cv::Size(4, 40), cv::Size(31, 200), cv::Size(32, 32), cv::Size(33, 47)}) {
      CAPTURE(decimate, size.width, size.height);
      for (const int level : {0, 255}) CHECK(detector.detect(cv::Mat1b(size, static_cast<uchar>(level))).empty());
      cv::Mat1b checkered(size);
      for (int y = 0; y < size.height; ++y)
        for (int x = 0; x < size.width; ++x) checkered(y, x) = (x / 3 + y / 2) % 2 != 0 ? 255 : 0;
      CHECK(detector.detect(checkered).empty());
    }
    const cv::Mat1b black(64, 64, uchar{0});
    for (const cv::Rect& region : {cv::Rect(-5, -5, 3, 3), cv::Rect(60, 60, 100, 100), cv::Rect(10, 10, 0, 0),
                                   cv::Rect(63, 63, 1, 1), cv::Rect(2147483000, 0, 600, 5), cv::Rect(0, 0, -4, 9)})
      CHECK(detector.detect(black, region).empty());
  }
  CHECK(TagDetector(with("tag36h11", 4)).detect(cv::Mat1b(8192, 8192, uchar{0})).empty());
}

TEST_CASE("an image of 8192 by 8192 pixels is borne by every family") {
  const std::string family = GENERATE(as<std::string>(), "tag25h9", "tag16h5", "tagStandard41h12", "tagStandard52h13",
                                      "tagCircle21h7", "tagCircle49h12");
  CAPTURE(family);
  TagDetectorConfig config = with(family, 4);
  config.max_hamming = 0;
  std::mt19937_64 random(18);
  Scene scene;
  scene.family = family;
  scene.id = 2;
  scene.T_camera_tag = pose_seen(scene.camera, scene.size, 120.0, {160.0, 160.0}, 0.2, 1.0, 0.4);
  cv::Mat1b wall(8192, 8192, uchar{120});
  digitised(render(scene).grey, 1.0, random).copyTo(wall(cv::Rect(7000, 6500, 320, 320)));
  const auto found = TagDetector(config).detect(wall);
  REQUIRE(found.size() == 1);
  CHECK(found[0].id == 2);
}

TEST_CASE("rows that are farther apart than they are long change nothing") {
  const std::string family = GENERATE(as<std::string>(), "tag36h11", "tag25h9", "tag16h5", "tagStandard41h12",
                                      "tagStandard52h13", "tagCircle21h7", "tagCircle49h12");
  CAPTURE(family);
  std::mt19937_64 random(16);
  Scene scene;
  scene.family = family;
  scene.id = 4;
  scene.T_camera_tag = pose_seen(scene.camera, scene.size, 80.0, {160.0, 160.0}, 0.3, 1.0, 0.4);
  const cv::Mat1b gray = digitised(render(scene).grey, 1.0, random);
  cv::Mat1b wide(320, 500, uchar{77});
  cv::Mat1b inset = wide(cv::Rect(90, 0, 320, 320));
  gray.copyTo(inset);
  TagDetectorConfig config = with(family, 2);
  config.max_hamming = 0;
  const TagDetector detector(config);
  const auto plain = detector.detect(gray);
  const auto strided = detector.detect(inset);
  REQUIRE(plain.size() == 1);
  REQUIRE(strided.size() == 1);
  CHECK(plain[0].corners_px == strided[0].corners_px);
  for (const CornerMethod method : {CornerMethod::tanh, CornerMethod::filter, CornerMethod::erf, CornerMethod::best}) {
    CAPTURE(word(method));
    const auto fine = refine(gray, family, plain[0], method, std::nullopt);
    const auto fine_strided = refine(inset, family, strided[0], method, std::nullopt);
    REQUIRE(std::holds_alternative<RefinedTag>(fine));
    REQUIRE(std::holds_alternative<RefinedTag>(fine_strided));
    CHECK(std::get<RefinedTag>(fine).corners_px == std::get<RefinedTag>(fine_strided).corners_px);
  }
}

TEST_CASE("a wrong set-up is refused by a sentence") {
  CHECK_THROWS_WITH(TagDetector(with("tag36h12", 2)), Catch::Contains("tag36h12") && Catch::Contains("tag36h11"));
  CHECK_THROWS_WITH(TagDetector(with("tag36h11", 0)), Catch::Contains("decimate"));
  TagDetectorConfig greedy = with("tagStandard52h13", 2);
  greedy.max_hamming = 2;  // would take a gigabyte
  CHECK_THROWS_WITH(TagDetector(greedy), Catch::Contains("max_hamming"));
}

}  // namespace tagdock
