#include <filesystem>
#include <fstream>
#include <functional>
#include <string>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "app/calibration_result.h"
#include "app/camera_file.h"
#include "app/camera_writer.h"
#include "app/failure.h"
#include "app/hand_eye_dataset.h"
#include "app/printed_target.h"
#include "app/rig_file.h"
#include "app/target_file.h"

using namespace tagdock;
namespace fs = std::filesystem;

namespace {

/// A folder that is gone when the test is.
struct Folder {
  fs::path path = fs::temp_directory_path() / ("tagdock_calibrate_" + std::to_string(::getpid()));
  Folder() {
    fs::remove_all(path);
    fs::create_directories(path);
  }
  ~Folder() { fs::remove_all(path); }
  void write(const std::string& name, const std::string& text) const { std::ofstream(path / name) << text; }
};

std::string refusal(const std::function<void()>& act) {
  try {
    act();
  } catch (const Failure& failure) {
    return failure.what();
  }
  return "";
}

const char* const problem_text =
    "reference: tracker\ncorner_sigma_px: 0.1\ncamera: {width: 1280, height: 1024, fx: 1100, fy: 1100, cx: 640, cy: "
    "512, "
    "dist: [0, 0, 0, 0, 0]}\ntracker_sigma_m: 0.001\ntracker_sigma_deg: 0.05\n";

}  // namespace

TEST_CASE("every format that is written reads back as the camera that it claims to hold") {
  const CameraModel camera{1280, 1024, 1100.25, 1101.5, 640.125, 511.75, -0.12, 0.08, 0.0004, -0.0003, 0.01};
  for (const char* format : {"ros", "opencv", "kalibr", "mrcal", "visp", "tagdock"}) {
    CAPTURE(format);
    const CameraText text = camera_text(camera, format);
    const CameraModel read = CameraFile::parse(text.text, format).camera();
    CHECK(read == text.held);
    CHECK(loss_between(camera, read).largest_px == text.loss.largest_px);
  }
  CHECK(camera_text(camera, "mrcal").loss.largest_px < 1e-9);  // rounding on the way to a pixel and back
  CHECK(camera_text(camera, "visp").loss.largest_px > 0.1);
  CHECK(refusal([&] { (void)camera_text(camera, "matlab"); }).find("kalibr") != std::string::npos);
}

TEST_CASE("a printed target has a description that reads back, and too large a square is refused with what fits") {
  const Folder folder;
  CalibrationTarget wanted;
  wanted.squares_x = 10;
  wanted.squares_y = 7;
  wanted.dictionary = "DICT_5X5_100";
  const CalibrationTarget drawn = fitted(wanted, paper_of("A4"));
  print_target(drawn, paper_of("A4"), folder.path / "a.pdf");
  CHECK(fs::file_size(folder.path / "a.pdf") > 2000);
  folder.write("a.yaml", target_text(drawn));
  const CalibrationTarget read = read_target(folder.path / "a.yaml");
  CHECK(read.square == Approx(drawn.square).epsilon(1e-11));
  CHECK(read.marker == Approx(drawn.marker).epsilon(1e-11));
  CHECK(read.squares_x == 10);
  wanted.square = 0.05;
  CHECK(refusal([&] { (void)fitted(wanted, paper_of("A4")); }).find("the largest is") != std::string::npos);
  const Board board = v_board(0.16, 0.35);
  print_board(board, 0.2, 0.5236, paper_of("A1"), folder.path / "v.pdf");
  CHECK(fs::file_size(folder.path / "v.pdf") > 2000);
}

TEST_CASE("a hand-eye dataset with a flaw is refused with file, line and what is wrong") {
  const Folder folder;
  folder.write("problem.yaml", problem_text);
  folder.write("board_points.csv", "id,x,y,z\n0,0,0,0\n1,0.1,0,0\n2,0.1,0.1,0\n3,0,0.1,0\n");
  folder.write("corners.csv", "stop,id,u,v\n0,0,100,100\n0,7,200,100\n");
  folder.write("tracker.csv", "stop,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n");
  const auto read = [&] { (void)read_hand_eye_dataset(folder.path); };
  CHECK(refusal(read).find("corners.csv:3: id 7") != std::string::npos);
  folder.write("corners.csv", "stop,id,u,v\n0,0,100,nan\n");
  CHECK(refusal(read).find("v is nan") != std::string::npos);
  folder.write("corners.csv", "stop,id,u\n0,0,100\n");
  CHECK(refusal(read).find("column v is missing") != std::string::npos);
  folder.write("corners.csv", "stop,id,u,v\n0,0,100,100\n1,0,100,100\n");
  CHECK(refusal(read).find("stop 1") != std::string::npos);
  folder.write("corners.csv", "stop,id,u,v\n0,0,100,100\n");
  folder.write("tracker.csv", "stop,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,2\n");
  CHECK(refusal(read).find("unit quaternion") != std::string::npos);
  folder.write("tracker.csv", "stop,x,y,z,qx,qy,qz,qw\n0,0,0,0,0,0,0,1\n");
  CHECK(read_hand_eye_dataset(folder.path).stops.size() == 1);
  folder.write("corners.csv", "stop,id,u,v\n0,0,1,2\n0,0,1,3\n");
  CHECK(refusal(read).find("column frame") != std::string::npos);
  folder.write("corners.csv", "stop,frame,id,u,v,sigma_px\n0,0,0,1,2,0.1\n0,1,0,1,3,0.2\n");
  const HandEyeProblem twice = read_hand_eye_dataset(folder.path);
  REQUIRE(twice.stops.at(0).corners.size() == 2);
  CHECK(twice.stops[0].corners[1].sigma_px == 0.2);
}

TEST_CASE("a calibration that was refused is no rig to dock with") {
  const Folder folder;
  const std::string rig =
      "camera: {width: 1280, height: 1024, fx: 1100, fy: 1100, cx: 640, cy: 512, dist: [0, 0, 0, 0, 0]}\n"
      "T_base_cam: {t: [0.3, 0, 0.3], q_xyzw: [0.5, -0.5, 0.5, -0.5]}\n";
  folder.write("good.yaml",
               rig + "verdict: \"good\"\nquality: {reasons: []}\nunobservable: []\nT_base_cam_covariance: [1, 2]\n");
  folder.write("bad.yaml", rig + "verdict: \"refused\"\n");
  CHECK(read_rig(folder.path / "good.yaml").camera.fx == 1100);
  CHECK(refusal([&] { (void)read_rig(folder.path / "bad.yaml"); }).find("verdict") != std::string::npos);
}

TEST_CASE("a refused calibration does not replace a good one") {
  const Folder folder;
  const auto text = [&](const std::string& name) {
    std::ifstream stream(folder.path / name);
    return std::string(std::istreambuf_iterator<char>(stream), {});
  };
  const fs::path file = folder.path / "rig.yaml";
  write_result(file, {{"verdict", "good"}, {"number", 1}});
  const std::string good = text("rig.yaml");
  write_result(file, {{"verdict", "refused"}, {"number", 2}});
  CHECK(text("rig.yaml").find("refused") != std::string::npos);
  CHECK(text("rig.yaml.good") == good);
  write_result(file, {{"verdict", "refused"}, {"number", 3}});
  CHECK(text("rig.yaml.good") == good);
  CHECK(refusal([&] { write_whole(folder.path / "nowhere" / "x.html", "", "--report"); }).find("--report") == 0);
}
