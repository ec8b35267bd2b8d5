// The program as a person or a script meets it: arguments in, exit code, words and files out.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <sys/wait.h>
#include <unistd.h>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>

using Catch::Matchers::Contains;

namespace {

struct Run {
  int code = -1;
  std::string out;
  std::string err;
};

std::string contents(const std::filesystem::path& file) {
  std::ifstream stream(file);
  std::stringstream text;
  text << stream.rdbuf();
  return text.str();
}

struct Scratch {
  std::filesystem::path folder =
      std::filesystem::temp_directory_path() / ("tagdock_program_" + std::to_string(::getpid()));
  Scratch() {
    std::filesystem::remove_all(folder);
    std::filesystem::create_directories(folder);
  }
  ~Scratch() { std::filesystem::remove_all(folder); }
  [[nodiscard]] std::string path(const std::string& name) const { return (folder / name).string(); }
  std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(folder / name) << text;
    return path(name);
  }
};

Run run(const Scratch& scratch, const std::string& arguments, const std::string& before = "") {
  const std::string command = before + " " + TAGDOCK_PROGRAM + " " + arguments + " >" + scratch.path("out") + " 2>" +
                              scratch.path("err") + " </dev/null";
  const int status = std::system(command.c_str());
  return {WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status), contents(scratch.path("out")),
          contents(scratch.path("err"))};
}

// Few frames, so that a whole docking takes seconds; the same code as with many.
const std::string few_frames = "camera: {frame_rate: 10}\n";

}  // namespace

TEST_CASE("a simulated docking ends docked, repeats itself, and its recording replays bit-equal", "[docking]") {
  const Scratch scratch;
  const std::string config = scratch.write("dock.yaml", few_frames);
  const Run first =
      run(scratch, "dock --config " + config + " --speedup 0 --seed 3 --record " + scratch.path("session") +
                       " --report " + scratch.path("report.json") + " --picture " + scratch.path("docking.svg"));
  INFO(first.err);
  REQUIRE(first.code == 0);
  CHECK_THAT(first.out, Contains("docked after") && Contains("final error, true"));
  const auto report = nlohmann::json::parse(contents(scratch.path("report.json")));
  CHECK(report["result"] == "docked");
  const auto truth = report["final"]["pose_error_true"];
  CHECK(std::abs(truth["x"].get<double>()) < 0.010);  // the demand: 10 mm, 1 degree
  CHECK(std::abs(truth["y"].get<double>()) < 0.010);
  CHECK(std::abs(truth["yaw"].get<double>()) < 0.01745);
  CHECK(report["phases"].size() > 3);
  CHECK(report["camera"]["frames"].get<int>() > 50);
  CHECK_THAT(contents(scratch.path("docking.svg")), Contains("<svg") && Contains("data:image/jpeg"));

  const Run second = run(scratch, "dock --config " + config + " --speedup 0 --seed 3 --json");
  REQUIRE(second.code == 0);
  const auto again = nlohmann::json::parse(second.out)["final"]["pose_error_true"];
  for (const char* axis : {"x", "y", "yaw"})
    CHECK(std::abs(again[axis].get<double>() - truth[axis].get<double>()) < 1e-12);

  const Run same = run(scratch, "replay " + scratch.path("session") + " --compare");
  INFO(same.out);
  CHECK(same.code == 0);
  CHECK_THAT(same.out, Contains("bit-equal"));
  const Run other = run(scratch, "replay " + scratch.path("session") + " --compare --method apriltag --json");
  CHECK(other.code == 1);
  CHECK(nlohmann::json::parse(other.out)["differences"].get<int>() > 0);
}

TEST_CASE("a dock that was taught is docked at, in the very place; a board that sank since is noticed", "[docking]") {
  const Scratch scratch;
  const std::string taught = scratch.path("taught.yaml");
  const Run teaching =
      run(scratch, "teach --speedup 0 --seed 4 --seconds 2 --dock-pose -1.05,0.02,0.5 --json --output " + taught);
  INFO(teaching.err);
  REQUIRE(teaching.code == 0);
  const nlohmann::json seen = nlohmann::json::parse(teaching.out);
  // What the robot saw is not where it was: calibration and survey are part of it.
  CHECK(std::abs(seen["dock_pose"]["y"].get<double>() - seen["true_camera_point"]["y"].get<double>()) > 1e-5);
  CHECK(seen["sigma"]["y"].get<double>() < 1e-4);

  const Run docking = run(scratch, "dock --speedup 0 --seed 4 --json --config " + taught);
  INFO(docking.err);
  REQUIRE(docking.code == 0);
  const nlohmann::json final = nlohmann::json::parse(docking.out)["final"];
  // Against where it truly stood when it was taught: inside the tolerance, and as the robot says itself. Without
  // teaching, what calibration and survey leave would stand between the two (1 mm of the lens' place alone).
  const auto& truth = final["pose_error_true"];
  const auto& claim = final["pose_error_estimated"];
  for (const char* part : {"x", "y"}) {
    CHECK(std::abs(truth[part].get<double>()) < 0.003);
    CHECK(std::abs(truth[part].get<double>() - claim[part].get<double>()) < 0.0001);
  }
  CHECK(std::abs(truth["yaw"].get<double>()) < 0.0087);

  const Run sunk =
      run(scratch, "dock --speedup 0 --seed 4 --scenario data/scenarios/board_sunk.yaml --config " + taught);
  CHECK(sunk.code == 1);
  CHECK_THAT(sunk.out + sunk.err, Contains("the board hangs") && Contains("teach again"));
}

TEST_CASE("what cannot be taught is refused, and nothing is written", "[quick]") {
  const Scratch scratch;
  const Run nowhere = run(scratch, "teach --speedup 0");
  CHECK(nowhere.code == 2);
  CHECK_THAT(nowhere.err, Contains("--output"));
  const std::string blind = scratch.write("blind.yaml", "simulation: {faults: {no_board: true}}\n");
  const Run unseen =
      run(scratch, "teach --speedup 0 --seconds 1 --config " + blind + " --output " + scratch.path("t.yaml"));
  CHECK(unseen.code == 4);
  const Run beside = run(scratch, "teach --speedup 0 --dock-pose 1,0,0 --output " + scratch.path("t.yaml"));
  CHECK(beside.code == 2);
  CHECK_THAT(beside.err, Contains("--dock-pose is 1,0,0"));
  CHECK_FALSE(std::filesystem::exists(scratch.path("t.yaml")));
}

TEST_CASE("over a small receive buffer the docking goes on with coarser pictures of the same view", "[docking]") {
  const Scratch scratch;
  const std::string config = scratch.write("dock.yaml", "camera: {receive_buffer_bytes: 212992}\n");
  const Run coarse = run(scratch, "dock --config " + config + " --seed 2 --json --record " + scratch.path("coarse"));
  INFO(coarse.err);
  REQUIRE(coarse.code == 0);
  const auto truth = nlohmann::json::parse(coarse.out)["final"]["pose_error_true"];
  CHECK(std::abs(truth["x"].get<double>()) < 0.010);
  CHECK(std::abs(truth["y"].get<double>()) < 0.010);
  CHECK(std::abs(truth["yaw"].get<double>()) < 0.01745);
  CHECK_THAT(contents(scratch.path("coarse") + "/session.yaml"), Contains("width: 640") && Contains("height: 480"));
  const Run same = run(scratch, "replay " + scratch.path("coarse") + " --compare");
  INFO(same.out << same.err);
  CHECK(same.code == 0);
}

TEST_CASE("a wrong configuration is refused with file, line and key", "[quick]") {
  const Scratch scratch;
  const std::string config = scratch.write("dock.yaml", "docking:\n  servo: {max_sped: 0.1}\n");
  const Run bad = run(scratch, "dock --config " + config);
  CHECK(bad.code == 2);
  CHECK_THAT(bad.err, Contains("dock.yaml:2:") && Contains("max_sped") && Contains("did you mean max_speed"));
  CHECK(run(scratch, "dock --config " + scratch.path("nowhere.yaml")).code == 2);
  CHECK(run(scratch, "dock --dock-pose 1,0,0 --speedup 0").code == 2);
  CHECK(run(scratch, "dock --station 127.0.0.1:8080").code == 2);
  CHECK(run(scratch, "dock --sped 3").code == 2);
  CHECK(run(scratch, "").code == 2);
  CHECK(run(scratch, "--help").code == 0);
}

TEST_CASE("a folder that cannot be recorded into is refused before anything moves", "[quick]") {
  const Scratch scratch;
  const Run bad = run(scratch, "dock --speedup 0 --record /proc/nowhere/session");
  CHECK(bad.code == 2);
  CHECK_THAT(bad.err, Contains("/proc/nowhere/session"));
}

TEST_CASE("a camera address with nobody there is said as such", "[quick]") {
  const Scratch scratch;
  const Run nobody = run(scratch, "dock --camera gige:127.0.0.77 --robot none");
  CHECK(nobody.code == 3);
  CHECK_THAT(nobody.err, Contains("127.0.0.77"));
  const Run outside = run(scratch, "dock --camera gige:192.0.2.7 --robot none");
  CHECK(outside.code == 2);
  CHECK_THAT(outside.err, Contains("127"));
}

TEST_CASE("a board that is not there ends with exit code 4 and the robot at rest") {
  const Scratch scratch;
  const std::string config =
      scratch.write("dock.yaml", "camera: {frame_rate: 4}\nsimulation: {faults: {no_board: true}}\n");
  const Run unseen = run(scratch, "dock --speedup 0 --config " + config + " --json");
  CHECK(unseen.code == 4);
  const auto report = nlohmann::json::parse(unseen.out);
  CHECK(report["result"] == "failed");
  CHECK(report["final"]["pose_error_estimated"].is_null());
}

TEST_CASE("NaN from odometry stops the robot and ends with exit code 5", "[quick]") {
  const Scratch scratch;
  const std::string config =
      scratch.write("dock.yaml", few_frames + "simulation: {faults: {odometry_nan_at_s: 6.0}}\n");
  const Run stopped = run(scratch, "dock --speedup 0 --seed 2 --config " + config + " --json");
  INFO(stopped.err);
  CHECK(stopped.code == 5);
  const auto report = nlohmann::json::parse(stopped.out);
  CHECK(report["result"] == "stopped");
  CHECK(report["cause"] == "odometry_invalid");
  CHECK(report["duration_s"].get<double>() < 6.5);
}

TEST_CASE("a camera that dies in the middle of a docking stops the robot and ends with exit code 3") {
  const Scratch scratch;
  const std::string config = scratch.write("dock.yaml", few_frames + "simulation: {faults: {camera_dies_at_s: 6.0}}\n");
  const Run stopped = run(scratch, "dock --speedup 0 --seed 2 --config " + config + " --json");
  INFO(stopped.err);
  CHECK(stopped.code == 3);
  CHECK(nlohmann::json::parse(stopped.out)["cause"] == "camera_lost");
}

TEST_CASE("a folder of images gives tags, annotated pictures and, with rig and board, sightings", "[quick]") {
  const Scratch scratch;
  const std::filesystem::path photograph = "/usr/share/visp-images-data/ViSP-images/AprilTag/AprilTag.pgm";
  REQUIRE(std::filesystem::exists(photograph));  // package visp-images-data
  std::filesystem::create_directories(scratch.folder / "photos");
  std::filesystem::copy_file(photograph, scratch.folder / "photos" / "a.pgm");
  const Run seen = run(scratch, "replay " + scratch.path("photos") + " --output " + scratch.path("seen"));
  INFO(seen.err);
  CHECK(seen.code == 0);
  const std::string tags = contents(scratch.folder / "seen" / "tags.csv");
  CHECK(std::count(tags.begin(), tags.end(), '\n') == 13);  // a header and twelve tags
  CHECK(std::filesystem::file_size(scratch.folder / "seen" / "a.png") > 10000);

  std::ofstream(scratch.folder / "photos" / "b.png") << "not a picture";
  const Run spoiled = run(scratch, "replay " + scratch.path("photos") + " --output " + scratch.path("seen2"));
  CHECK(spoiled.code == 2);
  CHECK_THAT(spoiled.err, Contains("b.png"));
  const std::string rest = contents(scratch.folder / "seen2" / "tags.csv");
  CHECK(std::count(rest.begin(), rest.end(), '\n') == 13);  // the good image is still done
  CHECK(run(scratch, "replay " + scratch.path("photos") + " --compare").code == 2);
  CHECK(run(scratch, "replay " + scratch.path("nowhere")).code == 2);
}

TEST_CASE("the window shows a docking on a screen, and without a screen says what to do", "[quick]") {
  const Scratch scratch;
  const std::string config =
      scratch.write("dock.yaml", "camera: {frame_rate: 4}\nsimulation: {faults: {odometry_nan_at_s: 3.0}}\n");
  const std::string arguments = "dock --view --speedup 0 --config " + config;
  const Run blind = run(scratch, arguments, "env -u DISPLAY");
  CHECK(blind.code == 2);
  CHECK_THAT(blind.err, Contains("DISPLAY"));
  const Run seen = run(scratch, arguments, "xvfb-run -a -s '-screen 0 1600x1200x24'");
  INFO(seen.err);
  CHECK(seen.code == 5);  // it ran until the odometry broke, with the window
}

TEST_CASE("the doctor finds nothing at fault with the defaults, and names what is wrong with a file", "[quick]") {
  const Scratch scratch;
  const Run fit = run(scratch, "doctor --json");
  INFO(fit.out);
  CHECK(nlohmann::json::parse(fit.out)["findings"].size() >= 6);
  const Run sick = run(scratch, "doctor --config " + scratch.write("dock.yaml", "camera: {exposure_us: -3}\n"));
  CHECK(sick.code == 1);
  CHECK_THAT(sick.out, Contains("FAULT") && Contains("dock.yaml:1:") && Contains("exposure_us"));
}

TEST_CASE("a recording without a docking is replayed, exported, and read again from each format") {
  const Scratch scratch;
  const Run made =
      run(scratch, "record " + scratch.path("walk") + " --camera sim --robot sim --frames 12 --compress --json");
  INFO(made.err);
  REQUIRE(made.code == 0);
  const int frames = nlohmann::json::parse(made.out)["frames"];
  CHECK(frames >= 11);  // the recorder may have dropped one on a busy machine
  CHECK_THAT(contents(scratch.folder / "walk" / "session.yaml"), Contains("identity: \"tagdock Simulated"));
  const Run seen = run(scratch, "replay " + scratch.path("walk") + " --json");
  REQUIRE(seen.code == 0);
  CHECK(nlohmann::json::parse(seen.out)["sightings"] == frames);
  CHECK(run(scratch, "replay " + scratch.path("walk") + " --compare").code == 2);
  const Run exported = run(scratch, "export " + scratch.path("walk") + " --euroc " + scratch.path("euroc") + " --tum " +
                                        scratch.path("tum") + " --mp4 " + scratch.path("walk.mp4") + " --mcap " +
                                        scratch.path("walk.mcap"));
  INFO(exported.err);
  REQUIRE(exported.code == 0);
  const std::string count = std::to_string(frames) + " frames of ";
  CHECK_THAT(exported.out, Contains(count));
  for (const char* kind : {"euroc", "tum", "walk.mp4"}) {
    const Run again =
        run(scratch, std::string("export ") + scratch.path(kind) + " --mcap " + scratch.path("again.mcap"));
    INFO(again.err);
    CHECK(again.code == 0);
    CHECK_THAT(again.out, Contains(count));
  }
  const std::string rig = " --rig data/rigs/default.yaml --board data/boards/default.yaml";
  const Run euroc = run(scratch, "replay " + scratch.path("euroc") + rig + " --output " + scratch.path("found"));
  CHECK(euroc.code == 0);
  const std::string found = contents(scratch.folder / "found" / "sightings.csv");
  CHECK(std::count(found.begin(), found.end(), '\n') == frames + 1);

  CHECK(run(scratch, "export " + scratch.path("walk")).code == 2);  // to what?
  CHECK(run(scratch, "export " + scratch.path("nowhere") + " --mcap " + scratch.path("x.mcap")).code == 2);
  CHECK(run(scratch, "export " + scratch.path("walk") + " --euroc " + scratch.path("euroc")).code == 2);  // not empty
  CHECK(run(scratch, "export " + scratch.path("walk") + " --from 100 --tum " + scratch.path("t")).code == 2);
}

TEST_CASE("replay goes to a place, one frame at a time, and tells what a changed calibration would have made") {
  const Scratch scratch;
  const std::string config =
      scratch.write("dock.yaml", few_frames + "simulation: {faults: {odometry_nan_at_s: 6.0}}\n");
  REQUIRE(run(scratch, "dock --config " + config + " --speedup 0 --seed 3 --record " + scratch.path("session")).code ==
          5);
  CHECK(run(scratch, "replay " + scratch.path("session") + " --compare --to 3").code == 0);
  const Run stepped = run(scratch, "replay " + scratch.path("session") + " --from 2 --step --json");
  CHECK(std::count(stepped.err.begin(), stepped.err.end(), '[') == 1);  // without a person, the first step is the last
  // A camera with a focal length 2 % longer sees the station 2 % farther: 60 to 80 mm at 3 to 4 m.
  const std::string camera = scratch.write(
      "camera.yaml",
      "image_width: 1280\nimage_height: 1024\ncamera_name: longer\ncamera_matrix: {rows: 3, cols: 3, data: [1253.8, 0, "
      "639.5, 0, "
      "1253.8, 511.5, 0, 0, 1]}\ndistortion_model: plumb_bob\ndistortion_coefficients: {rows: 1, cols: 5, "
      "data: [0, 0, 0, 0, 0]}\n");
  const Run changed = run(scratch, "replay " + scratch.path("session") + " --json --camera " + camera);
  INFO(changed.err);
  REQUIRE(changed.code == 0);
  const auto difference = nlohmann::json::parse(changed.out)["difference"];
  CHECK(difference["seen_by_both"].get<int>() > 20);
  CHECK(difference["shift_mm"]["median"].get<double>() > 40.0);
  CHECK(difference["shift_mm"]["median"].get<double>() < 150.0);
  CHECK(difference["commands_different"].get<int>() > 0);
}

TEST_CASE("the simulated camera refuses what it cannot do", "[quick]") {
  const Scratch scratch;
  CHECK(run(scratch, "camera-sim nowhere").code == 2);
  CHECK(run(scratch, "camera-sim world --address 192.0.2.1").code == 2);
  const Run wrong = run(scratch, "camera-sim world --fault \"5 loose 0.1\"");
  CHECK(wrong.code == 2);
  CHECK_THAT(wrong.err, Contains("loose") && Contains("lose SHARE"));
  CHECK(run(scratch, "camera-sim world --rate 0").code == 2);
  const Run short_one = run(scratch, "camera-sim world --address 127.0.0.9 --seconds 0.3");
  CHECK(short_one.code == 0);
  CHECK_THAT(short_one.out, Contains("127.0.0.9"));
}
