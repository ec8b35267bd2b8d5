#include "app/rig_file.h"

#include <filesystem>
#include <fstream>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "app/failure.h"

using namespace tagdock;
using Catch::Matchers::Contains;

namespace {

std::filesystem::path written(const std::string& name, const std::string& text) {
  const auto file = std::filesystem::temp_directory_path() / (std::to_string(::getpid()) + "_" + name);
  std::ofstream(file) << text;
  return file;
}

template <class Value>
std::string text_of(Value value) {
  FieldWriter writer;
  visit(writer, value);
  return writer.text();
}

std::string refusal_of_board(const std::string& text) {
  const auto file = written("board.yaml", text);
  try {
    (void)read_board(file);
  } catch (const Failure& failure) {
    return failure.what();
  }
  return "";
}

}  // namespace

TEST_CASE("a rig that was written is read back, and judged keys of calibrate are passed over") {
  Rig rig = default_rig();
  rig.T_base_camera.rotate(Eigen::AngleAxisd(0.02, Eigen::Vector3d(1, 2, 3).normalized()));
  const auto file =
      written("rig.yaml", text_of(rig) + "unobservable: [height]\nprojection_sigma_px: {max: 0.4, center: 0.1}\n");
  const Rig read = read_rig(file);
  CHECK(read.camera == rig.camera);
  CHECK(read.odometry == rig.odometry);
  CHECK(read.T_base_camera.isApprox(rig.T_base_camera, 1e-15));
}

TEST_CASE("a rig whose height no drive determined is not taken, and says how to measure it") {
  const std::string text = text_of(default_rig());
  const auto refused = written("rig.yaml", text + "height_known: false\n");
  try {
    (void)read_rig(refused);
    FAIL("an arbitrary height was taken");
  } catch (const Failure& failure) {
    CHECK_THAT(failure.what(), Contains("height_known") && Contains("--camera-height"));
  }
  CHECK(read_rig(written("rig.yaml", text + "height_known: true\n")).camera == default_rig().camera);
}

TEST_CASE("what was read and written again reads the same to the last bit") {
  // The run uses the configuration as parsed from the text that is recorded, and so does replay.
  const Board once = read_board(written("board.yaml", text_of(default_board(0.35))));
  const Board twice = read_board(written("board.yaml", text_of(default_board(0.35))));
  REQUIRE(once.tags.size() == 3);
  for (std::size_t i = 0; i < 3; ++i)
    CHECK(once.tags[i].T_station_tag.matrix() == twice.tags[i].T_station_tag.matrix());
}

TEST_CASE("a board that was printed larger than drawn is the board that was printed") {
  const Board drawn = default_board(0.35);
  const std::string text = drawn_board_text(drawn);
  CHECK(read_board(written("board.yaml", text)).tags[0].size == drawn.tags[0].size);
  const auto measured = [&](const std::string& x, const std::string& y) {
    std::string changed = text;
    changed.replace(changed.find("_x: 1\n") + 4, 1, x);
    changed.replace(changed.find("_y: 1\n") + 4, 1, y);
    return changed;
  };
  const Board larger = read_board(written("board.yaml", measured("1.02", "1.02")));
  for (std::size_t i = 0; i < drawn.tags.size(); ++i) {
    CHECK(larger.tags[i].size == Approx(1.02 * drawn.tags[i].size));
    const Eigen::Vector3d was = drawn.tags[i].T_station_tag.translation();
    const Eigen::Vector3d is = larger.tags[i].T_station_tag.translation();
    CHECK((is - Eigen::Vector3d(1.02 * was.x(), 1.02 * was.y(), was.z())).norm() < 1e-12);  // its height is not printed
  }
  CHECK_THAT(refusal_of_board(measured("1.01", "1.00")), Contains("measured_over_drawn_x") && Contains("no squares"));
  CHECK_THAT(refusal_of_board(measured("102", "102")), Contains("measured_over_drawn_x"));
}

TEST_CASE("a survey that was refused is no board to dock at") {
  const std::string text = text_of(default_board(0.35));
  CHECK_THAT(refusal_of_board(text + "verdict: \"refused\"\nquality: {reasons: [x]}\n"), Contains("verdict"));
  CHECK(refusal_of_board(text + "verdict: \"good\"\nquality: {reasons: []}\n").empty());
}

TEST_CASE("a bad rig or board is refused with file, line and key") {
  std::string text = text_of(default_rig());
  text.replace(text.find("fx: "), 4, "fx: -");
  try {
    (void)read_rig(written("rig.yaml", text));
    FAIL("a negative focal length was taken");
  } catch (const Failure& failure) {
    CHECK_THAT(failure.what(), Contains("rig.yaml:4:") && Contains("camera.fx"));
  }
  CHECK_THROWS_WITH(read_rig(written("rig.yaml", "camera: {width: 10}\nT_base_cam: {}\n")), Contains("camera.height"));
  const std::string tag = "{id: 3, size: 0.16, T_station_tag: {t: [0, 0, 0.3], q_xyzw: [0.5, -0.5, 0.5, -0.5]}}";
  CHECK(refusal_of_board("family: tag36h11\ntags: [" + tag + "]\n").empty());
  CHECK_THAT(refusal_of_board("tags: [" + tag + ", " + tag + "]\n"), Contains("id 3 twice"));
  CHECK_THAT(refusal_of_board("tags: []\n"), Contains("empty"));
  CHECK_THAT(refusal_of_board("tags: [{id: 1, size: 160}]\n"), Contains("tags[0].size is 160"));
  CHECK_THAT(refusal_of_board("tags: [{id: 1, size: 0.16, T_station_tag: {t: [0, 0, 0], q_xyzw: [0, 0, 0, 0]}}]\n"),
             Contains("unit quaternion"));
  CHECK_THAT(refusal_of_board("family: tag36h12\ntags: [" + tag + "]\n"), Contains("must be one of"));
  CHECK_THROWS_WITH(read_board("/nowhere/board.yaml"), Contains("no such file"));
}

TEST_CASE("a rig or a board that lacks a place is refused, not taken for one at the origin") {
  const auto rig = [](const std::string& transform, const std::string& rest) {
    return read_rig(written("rig.yaml",
                            "camera: {width: 1280, height: 1024, fx: 1100, fy: 1100, cx: 640, cy: 512, dist: [0, 0, 0, "
                            "0, 0]}\nT_base_cam: {" +
                                transform + "}\n" + rest));
  };
  const std::string place = "t: [0.3, 0, 0.3]";
  const std::string whole = place + ", q_xyzw: [0.5, -0.5, 0.5, -0.5]";
  const std::string wheels = "odometry: {r_left: 0.1, r_right: 0.1, track: 0.5}\n";
  CHECK(rig(whole, wheels).odometry.track == 0.5);
  CHECK_THROWS_WITH(rig(place, wheels), Contains("rig.yaml:2:") && Contains("T_base_cam.q_xyzw is missing"));
  CHECK_THROWS_WITH(rig("q_xyzw: [0, 0, 0, 1]", wheels), Contains("T_base_cam.t is missing"));
  CHECK_THROWS_WITH(rig(whole, ""), Contains("odometry is missing"));
  CHECK_THROWS_WITH(rig(whole, "odometry: {r_left: 0.1, r_right: 0.1}\n"), Contains("odometry.track is missing"));
  // A tracker measured where the camera is; it says nothing of wheels.
  CHECK(rig(whole, "T_base_cam_sigma: {xy_mm: 0.4, z_mm: 0.4, rot_deg: 0.05}\n").T_base_camera.translation().x() ==
        0.3);
  CHECK_THAT(refusal_of_board("tags: [{id: 1, size: 0.16}]\n"), Contains("tags[0].T_station_tag is missing"));
  CHECK_THAT(refusal_of_board("tags: [{id: 1, size: 0.16, T_station_tag: {t: [0, 0, 0.3]}}]\n"),
             Contains("tags[0].T_station_tag.q_xyzw is missing"));
  CHECK_THAT(refusal_of_board("tags: [{size: 0.16, T_station_tag: {t: [0, 0, 0.3], q_xyzw: [0, 0, 0, 1]}}]\n"),
             Contains("tags[0].id is missing"));
}
