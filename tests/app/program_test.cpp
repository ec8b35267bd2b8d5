// The program as a person or a script meets it: arguments in, exit code, words and files out.
#include <algorithm>
#include <atomic>
#include <chrono>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <sys/wait.h>
#include <thread>
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

/// The processes below this test that talk to a camera; the first of them was started first.
std::vector<pid_t> camera_clients() {
  std::vector<pid_t> found;
  const auto parent_of = [](pid_t process) {
    const std::string stat = contents("/proc/" + std::to_string(process) + "/stat");
    const auto end = stat.rfind(')');
    return end == std::string::npos ? 0 : std::atoi(stat.c_str() + end + 4);
  };
  for (const auto& entry : std::filesystem::directory_iterator("/proc")) {
    const pid_t process = std::atoi(entry.path().filename().c_str());
    if (process <= 0 || contents(entry.path() / "cmdline").find("camera-client") == std::string::npos) continue;
    pid_t ancestor = process;
    while (ancestor > 1 && ancestor != ::getpid()) ancestor = parent_of(ancestor);
    if (ancestor == ::getpid()) found.push_back(process);
  }
  std::sort(found.begin(), found.end());
  return found;
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
  std::istringstream events(contents(scratch.path("session") + "/events.csv"));
  int lines = 0;
  for (std::string line; std::getline(events, line); ++lines) {
    CAPTURE(line);
    CHECK(std::count(line.begin(), line.end(), ',') == 1);  // time_ns,text
  }
  CHECK(lines > 3);

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

  // A dock that was knocked aside by 20 mm: the robot docks at it where it is now, and the truth is against that.
  const Run moved =
      run(scratch, "dock --speedup 0 --seed 4 --json --scenario data/scenarios/dock_moved.yaml --config " + taught);
  INFO(moved.err);
  REQUIRE(moved.code == 0);
  const nlohmann::json at_moved = nlohmann::json::parse(moved.out)["final"];
  CHECK(std::abs(at_moved["pose_error_true"]["y"].get<double>()) < 0.003);
  CHECK(std::abs(at_moved["pose_error_true"]["y"].get<double>() - at_moved["pose_error_estimated"]["y"].get<double>()) <
        0.0001);
}

TEST_CASE("one dock of several is taught into the dock database, and docked at from there", "[docking]") {
  const Scratch scratch;
  const std::string docks = scratch.write(
      "docks.yaml",
      "version: 1\ndocks:\n  - name: home\n    pose: {x_m: 1, y_m: 2, yaw_deg: 0}\n    dock_pose: {x_m: -1.05, y_m: "
      "0.02, yaw_deg: 0.5}\n  - name: other\n    pose: {x_m: 5, y_m: 2, yaw_deg: 90}\n");
  const std::string taught = scratch.path("taught_docks.yaml");
  const Run teaching =
      run(scratch, "teach --speedup 0 --seed 4 --seconds 2 --docks " + docks + " --dock home --output " + taught);
  INFO(teaching.err);
  REQUIRE(teaching.code == 0);
  const Run listed = run(scratch, "docks export --json " + taught);
  const nlohmann::json known = nlohmann::json::parse(listed.out)["docks"];
  REQUIRE(known.size() == 2);
  CHECK(known[0]["taught"]["sigma"]["y"].get<double>() < 1e-4);
  CHECK(known[0]["taught"]["hang"]["camera_height"].get<double>() > 0.1);
  CHECK(known[1]["taught"].is_null());
  const Run docking = run(scratch, "dock --speedup 0 --seed 4 --json --docks " + taught + " --dock home");
  INFO(docking.err);
  CHECK(docking.code == 0);
  CHECK(nlohmann::json::parse(docking.out)["final"]["pose_error_estimated"]["taught"] == true);
  const Run sunk = run(scratch, "dock --speedup 0 --seed 4 --scenario data/scenarios/board_sunk.yaml --docks " +
                                    taught + " --dock home");
  CHECK(sunk.code == 1);
  CHECK_THAT(sunk.out + sunk.err, Contains("the board hangs"));
  CHECK(run(scratch, "teach --speedup 0 --docks " + docks + " --output " + taught).code == 2);
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

TEST_CASE("a docking goes on when the process that talks to the camera is aborted, and replays bit-equal",
          "[docking]") {
  const Scratch scratch;
  const std::string config = scratch.write("dock.yaml", "camera: {receive_buffer_bytes: 212992}\n");
  // Once on the way and once in the servo phase; there the spare one dies with it, and another must be started.
  std::atomic<bool> over{false};
  int aborted = 0;
  std::thread killer([&] {
    for (const char* phase : {",following,", ",servoing,"}) {
      while (!over && contents(scratch.path("aborted") + "/phases.csv").find(phase) == std::string::npos)
        std::this_thread::sleep_for(std::chrono::milliseconds(20));
      std::this_thread::sleep_for(std::chrono::milliseconds(1500));
      const std::vector<pid_t> clients = camera_clients();
      const bool both = std::string(phase) == ",servoing,";
      for (std::size_t i = 0; !over && i < (both ? clients.size() : std::min<std::size_t>(1, clients.size())); ++i)
        aborted += ::kill(clients[i], SIGABRT) == 0 ? 1 : 0;
    }
  });
  const Run run_through =
      run(scratch, "dock --config " + config + " --seed 2 --json --record " + scratch.path("aborted"));
  over = true;
  killer.join();
  INFO(run_through.out << run_through.err);
  CHECK(aborted == 3);
  REQUIRE(run_through.code == 0);
  const auto report = nlohmann::json::parse(run_through.out);
  CHECK(report["result"] == "docked");
  CHECK(report["camera"]["reconnects"].get<int>() == 2);
  const auto truth = report["final"]["pose_error_true"];
  CHECK(std::abs(truth["x"].get<double>()) < 0.010);
  CHECK(std::abs(truth["y"].get<double>()) < 0.010);
  CHECK(std::abs(truth["yaw"].get<double>()) < 0.01745);
  // What the docking saw of it is a camera that was lost.
  CHECK_THAT(contents(scratch.path("aborted") + "/commands.csv"), Contains(",lost,"));
  const Run same = run(scratch, "replay " + scratch.path("aborted") + " --compare");
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

TEST_CASE("a calibration given a wrong number names the option, and what it should be", "[quick]") {
  const Scratch scratch;
  const auto refused = [&](const std::string& arguments, const std::string& option) {
    const Run made = run(scratch, "calibrate " + arguments);
    INFO(arguments << ": " << made.err);
    CHECK(made.code == 2);
    CHECK_THAT(made.err, Contains(option));
  };
  const std::string hand_eye = "hand-eye --dataset " + scratch.path("none") + " --output " + scratch.path("rig.yaml");
  refused(hand_eye + " --camera-height -0.3", "--camera-height");
  refused(hand_eye + " --camera-height 360", "--camera-height");
  refused(hand_eye + " --camera-height 0.3 --camera-height-sigma -1", "--camera-height-sigma");
  const std::string target = "target --output " + scratch.path("board.pdf");
  refused(target + " --cols 0", "--cols");
  refused(target + " --square -0.02", "--square");
  refused(target + " --kind taggrid --spacing -1", "--spacing");
  refused(target + " --description " + scratch.path("nowhere/board.yaml"), "--description");
  refused("wizard --target x.yaml --measured-x -5", "--measured-x");
  CHECK(run(scratch, "calibrate target --kind vboard --output " + scratch.path("v.pdf")).code == 0);
}

TEST_CASE("a report or a picture that cannot be written is known before anything moves, and undoes no docking",
          "[quick]") {
  const Scratch scratch;
  const std::string config =
      scratch.write("dock.yaml", "camera: {frame_rate: 4}\nsimulation: {faults: {odometry_nan_at_s: 3.0}}\n");
  for (const std::string option : {"--report", "--picture"}) {
    const Run bad = run(scratch, "dock --speedup 0 --config " + config + " " + option + " /proc/nowhere/file");
    CHECK(bad.code == 2);
    CHECK_THAT(bad.err, Contains(option + " /proc/nowhere/file") && !Contains("docking: camera"));
    // The disk is full when it is over: what the docking came to is what the program says.
    const Run full = run(scratch, "dock --speedup 0 --config " + config + " " + option + " /dev/full");
    CHECK(full.code == 5);
    CHECK_THAT(full.err, Contains(option + " /dev/full"));
  }
  CHECK(run(scratch, "dock --camera gige:127.0.0.77 --robot none --report " + scratch.path("report.json")).code == 3);
  CHECK_FALSE(std::filesystem::exists(scratch.path("report.json")));
}

TEST_CASE("what was taught at one docking pose is not said of another pose or board", "[quick]") {
  const Scratch scratch;
  const std::string config = scratch.write(
      "dock.yaml",
      "docking:\n  taught: {measured: true, sigma_x_m: 0.0002, sigma_y_m: 0.0002, sigma_yaw_deg: 0.01, board_checked: "
      "true, camera_height_m: 0.35}\n");
  const std::string board = std::filesystem::absolute("data/boards/pair.yaml").string();
  const std::string docks =
      scratch.write("docks.yaml",
                    "docks:\n  - {name: pose, pose: {x_m: 0, y_m: 0, yaw_deg: 0}, dock_pose: {x_m: -1.2, y_m: 0, "
                    "yaw_deg: 0}}\n  - {name: board, pose: {x_m: 0, y_m: 0, yaw_deg: 0}, board: " +
                        board + "}\n  - {name: same, pose: {x_m: 0, y_m: 0, yaw_deg: 0}}\n");
  const auto taught = [&](const std::string& more) {
    const Run used = run(scratch, "dock --config " + config + more + " --write-config -");
    INFO(used.err);
    REQUIRE(used.code == 0);
    const bool measured = used.out.find("measured: true") != std::string::npos;
    CHECK((used.out.find("board_checked: true") != std::string::npos) == measured);
    CHECK((used.out.find("sigma_x_m: 0\n") == std::string::npos) == measured);
    return measured;
  };
  CHECK(taught(""));
  CHECK_FALSE(taught(" --dock-pose -1.2,0,0"));
  CHECK_FALSE(taught(" --board " + board));
  CHECK_FALSE(taught(" --docks " + docks + " --dock pose"));
  CHECK_FALSE(taught(" --docks " + docks + " --dock board"));
  CHECK(taught(" --docks " + docks + " --dock same"));
}

TEST_CASE("nothing that is read, and no earlier result, is written over", "[quick]") {
  const Scratch scratch;
  const auto refused = [&](const std::string& arguments, const std::string& file) {
    const std::string before = contents(scratch.folder / file);
    const Run one = run(scratch, arguments);
    CAPTURE(arguments, one.err);
    CHECK(one.code == 2);
    CHECK_THAT(one.err, Contains(file));
    CHECK(contents(scratch.folder / file) == before);
  };
  const std::string queries =
      scratch.write("queries.csv", "id,sx,sy,sth,gx,gy,gth,kappa_max,sigma_max\n1,0,0,0,4,1,0,1,1\n");
  std::filesystem::create_symlink(queries, scratch.folder / "same.csv");
  refused("plan --batch " + queries + " --output " + queries, "queries.csv");
  refused("plan --batch " + queries + " --output " + scratch.path("same.csv"), "same.csv");
  const std::string list = scratch.write("list.csv", "image\na.pgm\n");
  scratch.write("a.pgm", "P5\n1 1\n255\nx");
  refused("detect --list " + list + " --output " + list, "list.csv");
  refused("detect " + scratch.path("a.pgm") + " --output " + scratch.path("a.pgm"), "a.pgm");
  const std::string nav2 = scratch.write("nav2.yaml", "docks:\n  home: {pose: [1.5, -2.0, 0.5]}\n");
  refused("docks import " + nav2 + " --output " + nav2, "nav2.yaml");
  const std::string docks = scratch.path("docks.yaml");
  REQUIRE(run(scratch, "docks import " + nav2 + " --output " + docks).code == 0);
  refused("docks import " + nav2 + " --output " + docks, "docks.yaml");
  refused("docks export " + docks + " --output " + docks, "docks.yaml");
  refused("dock --write-config " + scratch.write("dock.yaml", few_frames), "dock.yaml");
  refused("dock --report " + scratch.path("x") + " --picture " + scratch.folder.string() + "/./x", "x");
  refused("export " + scratch.folder.string() + " --mcap " + scratch.write("old.mcap", "old"), "old.mcap");
  std::filesystem::create_directories(scratch.folder / "seen");
  scratch.write("seen/tags.csv", "old");
  refused("replay " + scratch.folder.string() + " --output " + scratch.path("seen"), "tags.csv");
  CHECK(run(scratch, "replay " + scratch.folder.string() + " --output /proc/nowhere").code == 2);
}

TEST_CASE("a slip of the pen on the command line is named, with what would be right", "[quick]") {
  const Scratch scratch;
  const auto refused = [&](const std::string& arguments, const std::string& sentence) {
    const Run one = run(scratch, arguments);
    CAPTURE(arguments);
    CHECK(one.code == 2);
    CHECK_THAT(one.err, Contains("tagdock: ") && Contains(sentence));
  };
  refused("dok", "no verb dok; did you mean dock?");
  refused("camera-client", "camera-client is started by tagdock itself, not by hand");
  refused("convert --help", "no verb convert");
  refused("", "subcommand");
  refused("dock --robot foo", "--robot");
  refused("dock --robot ros2 --domain 200", "--domain");
  refused("dock --seed -1", "--seed: -1 is no number of 0 or more");
  refused("dock --compress", "--record");
  refused("record x --seconds -3", "--seconds");
  refused("camera-sim world --seconds -1", "--seconds");
  refused("replay x --from -5", "--from");
  refused("plan --from 0,0,0 --to 4,1,0 --as arcs --arc-steps 0", "--arc-steps");
  refused("detect x.png --tag-size 160", "--tag-size");
  refused("export x --mp4 x.avi", ".mp4");
}

TEST_CASE("no calibration writes onto what it reads, nor one result onto another", "[quick]") {
  const Scratch scratch;
  const auto refused = [&](const std::string& arguments, const std::string& option, const std::string& file) {
    const std::string before = contents(scratch.folder / file);
    const Run one = run(scratch, "calibrate " + arguments);
    CAPTURE(arguments, one.err);
    CHECK(one.code == 2);
    CHECK_THAT(one.err, Contains(option) && Contains(file));
    CHECK(contents(scratch.folder / file) == before);
  };
  const std::string board = scratch.path("board.yaml");
  REQUIRE(run(scratch, "calibrate target --output " + scratch.path("board.pdf") + " --description " + board).code == 0);
  std::filesystem::create_directories(scratch.folder / "pictures");
  scratch.write("pictures/a.png", "no picture");
  const std::string pictures = scratch.path("pictures");
  std::filesystem::create_symlink(scratch.folder / "pictures" / "a.png", scratch.folder / "link.png");
  const std::string camera = scratch.write("camera.yaml",
                                           "camera: {width: 1280, height: 1024, fx: 1100, fy: 1100, cx: 640, cy: 512, "
                                           "dist: [0, 0, 0, 0, 0]}\n");
  const std::string intrinsics = "intrinsics --images " + pictures + " --target " + board;
  refused(intrinsics + " --output " + board, "--output", "board.yaml");
  refused(intrinsics + " --output " + scratch.path("link.png"), "--output", "link.png");
  refused(intrinsics + " --output " + scratch.path("c.yaml") + " --report " + board, "--report", "board.yaml");
  refused(intrinsics + " --output " + scratch.path("c.yaml") + " --report " + scratch.folder.string() + "/./c.yaml",
          "--report", "c.yaml");
  refused("convert --camera " + camera + " --format visp --output " + camera, "--output", "camera.yaml");
  const std::string station = "station --images " + pictures + " --camera " + camera + " --board " + board;
  refused(station + " --output " + camera, "--output", "camera.yaml");
  refused(station + " --output " + board, "--output", "board.yaml");
  refused(station + " --output " + pictures + "/a.png", "--output", "pictures/a.png");
  refused("wizard --target " + board + " --camera images:" + pictures + " --session " + scratch.path("session") +
              " --output " + board,
          "--output", "board.yaml");
  refused("wizard --target " + board + " --camera images:" + pictures + " --session " + pictures, "--session",
          "pictures");
  refused("target --output " + scratch.path("x") + " --description " + scratch.path("x"), "--description", "x");
  // The same results again are results, not inputs.
  CHECK(run(scratch, "calibrate target --output " + scratch.path("board.pdf") + " --description " + board).code == 0);
}

TEST_CASE("the wizard keeps both rulers' lengths, asked for or given, and may write into its session", "[quick]") {
  const Scratch scratch;
  const std::string board = scratch.path("board.yaml");
  REQUIRE(run(scratch, "calibrate target --output " + scratch.path("board.pdf") + " --description " + board).code == 0);
  std::filesystem::create_directories(scratch.folder / "pictures");
  scratch.write("pictures/a.png", "no picture");
  const std::string lengths = scratch.write("lengths", "99.5\n100.25\n");
  const auto walk = [&](const std::string& session, const std::string& options) {
    // No picture can be read, so it ends without a camera; what was measured is kept all the same.
    const std::string arguments =
        "calibrate wizard --target " + board + " --camera images:" + scratch.path("pictures") + " --session " +
        scratch.path(session) + " --output " + scratch.path(session + "/camera.yaml") + options;
    const std::string command = std::string(TAGDOCK_PROGRAM) + " " + arguments + " <" + lengths + " >" +
                                scratch.path("out") + " 2>" + scratch.path("err");
    CHECK(std::system(command.c_str()) != 0);
    CHECK(contents(scratch.folder / "out").empty());
    return contents(scratch.folder / session / "target.yaml");
  };
  CHECK_THAT(walk("asked", ""), Contains("over_drawn_x: 0.995\n") && Contains("over_drawn_y: 1.0025\n"));
  CHECK_THAT(walk("given", " --measured-x 100.5"),
             Contains("over_drawn_x: 1.005\n") && Contains("over_drawn_y: 0.995\n"));
}

TEST_CASE("targets and converted cameras are also told as JSON, and nothing else is on stdout", "[quick]") {
  const Scratch scratch;
  const Run drawn = run(scratch, "calibrate target --kind tag --paper A5 --id 3 --json --output " +
                                     scratch.path("t.pdf") + " --description " + scratch.path("t.yaml"));
  REQUIRE(drawn.code == 0);
  const auto tag = nlohmann::json::parse(drawn.out);
  CHECK(tag["target"]["id"] == 3);
  CHECK_THAT(contents(scratch.folder / "t.yaml"),
             Contains("tag_size: " + nlohmann::json(tag["target"]["tag_size"]).dump()));
  // With its white rim and marks of 6 mm it stays clear of margins and foot.
  CHECK(1250.0 * tag["target"]["tag_size"].get<double>() + 12.0 <= tag["paper"]["height_mm"].get<double>() - 44.0);
  const Run plates = run(scratch, "calibrate target --kind vboard --json --output " + scratch.path("v.pdf"));
  REQUIRE(plates.code == 0);
  CHECK(nlohmann::json::parse(plates.out)["board"]["tags"].size() == 3);
  const std::string camera = scratch.write("camera.yaml",
                                           "camera: {width: 1280, height: 1024, fx: 1100, fy: 1100, cx: 640, cy: 512, "
                                           "dist: [0.1, 0, 0.001, 0, 0]}\n");
  const Run made =
      run(scratch, "calibrate convert --json --camera " + camera + " --format visp --output " + scratch.path("c.xml"));
  REQUIRE(made.code == 0);
  const auto converted = nlohmann::json::parse(made.out);
  CHECK(converted["camera"]["fx"].get<double>() == Approx(1100.0).epsilon(0.01));
  CHECK(converted["loss_px"]["max"].get<double>() > 0.01);  // ViSP's model has no p1
  CHECK_THAT(contents(scratch.folder / "c.xml"), Contains("<camera>"));
}

TEST_CASE("docks are also told as JSON", "[quick]") {
  const Scratch scratch;
  const std::string nav2 = scratch.write("nav2.yaml", "docks:\n  home: {frame: map, pose: [1.5, -2.0, 0.5]}\n");
  const Run shown = run(scratch, "docks import " + nav2 + " --json");
  REQUIRE(shown.code == 0);
  const auto docks = nlohmann::json::parse(shown.out)["docks"];
  REQUIRE(docks.size() == 1);
  CHECK(docks[0]["name"] == "home");
  CHECK(docks[0]["pose"]["yaw"] == 0.5);
  CHECK(docks[0]["dock_pose"].is_null());
  const Run both = run(scratch, "docks import " + nav2 + " --json --output " + scratch.path("docks.yaml"));
  CHECK(both.out == shown.out);
  const Run back = run(scratch, "docks export " + scratch.path("docks.yaml") + " --json");
  REQUIRE(back.code == 0);
  CHECK(nlohmann::json::parse(back.out)["docks"][0]["pose"]["x"] == 1.5);
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
  const auto findings = nlohmann::json::parse(fit.out)["findings"];
  CHECK(findings.size() >= 6);
  for (const auto& finding : findings) CHECK(finding["verdict"] != "fault");  // advice depends on the machine
  CHECK(fit.code == 0);
  const Run sick = run(scratch, "doctor --config " + scratch.write("dock.yaml", "camera: {exposure_us: -3}\n"));
  CHECK(sick.code == 1);
  CHECK_THAT(sick.out, Contains("FAULT") && Contains("dock.yaml:1:") && Contains("exposure_us"));
  const Run alone = run(scratch, "doctor --camera gige:127.0.0.77 --rig " + scratch.path("nowhere.yaml"));
  CHECK_THAT(alone.out, Contains("nowhere.yaml") && !Contains("mend that line"));
  const Run dark = run(scratch, "doctor --camera gige:127.0.0.77");
  CHECK_THAT(dark.out, Contains("no camera answers") && !Contains("nobody else controls"));
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
                                        scratch.path("walk.mcap") + " --json");
  INFO(exported.err);
  REQUIRE(exported.code == 0);
  CHECK(nlohmann::json::parse(exported.out)["frames"] == frames);
  CHECK(nlohmann::json::parse(exported.out)["written"]["mp4"] == scratch.path("walk.mp4"));
  const std::string count = std::to_string(frames) + " frames of ";
  for (const char* kind : {"euroc", "tum", "walk.mp4"}) {
    const Run again =
        run(scratch, std::string("export ") + scratch.path(kind) + " --mcap " + scratch.path(kind) + ".mcap");
    INFO(again.err);
    CHECK(again.code == 0);
    CHECK_THAT(again.out, Contains(count));
  }
  const std::string rig = " --rig data/rigs/default.yaml --board data/boards/default.yaml";
  const Run euroc = run(scratch, "replay " + scratch.path("euroc") + rig + " --output " + scratch.path("found"));
  CHECK(euroc.code == 0);
  const std::string found = contents(scratch.folder / "found" / "sightings.csv");
  CHECK(std::count(found.begin(), found.end(), '\n') == frames + 1);
  const Run object = run(scratch, "replay " + scratch.path("euroc") + rig + " --to 0.1 --json");
  CHECK(object.code == 0);
  const auto whole = nlohmann::json::parse(object.out);  // one object, with both
  REQUIRE(whole["sightings"].size() > 0);
  CHECK(whole["sightings"].size() == whole["images"].size());
  CHECK(whole["sightings"][0]["result"] == "board");
  CHECK(whole["sightings"][0]["tz"].is_number());

  // A picture that cannot be read costs itself, also where it is the first.
  const std::filesystem::path first = scratch.folder / "walk" / "cam0" / "data" / "I000000.png";
  std::string picture = contents(first);
  picture[picture.size() / 2] = static_cast<char>(picture[picture.size() / 2] ^ 1);
  std::ofstream(first, std::ios::binary) << picture;
  const Run rest = run(scratch, "replay " + scratch.path("walk") + " --json");
  CHECK(rest.code == 2);
  CHECK_THAT(rest.err, Contains("I000000.png"));
  CHECK(nlohmann::json::parse(rest.out)["sightings"] == frames - 1);
  std::string video = contents(scratch.folder / "walk.mp4");
  const std::size_t pictures = video.find("mdat"), index = video.find("moov");
  REQUIRE(pictures < index);
  std::fill(video.begin() + static_cast<std::ptrdiff_t>((pictures + index) / 2),
            video.begin() + static_cast<std::ptrdiff_t>(index - 4), '\0');
  std::ofstream(scratch.folder / "spoiled.mp4", std::ios::binary) << video;
  std::filesystem::create_directories(scratch.folder / "temporary");
  const Run spoiled =
      run(scratch, "replay " + scratch.path("spoiled.mp4") + " --json", "TMPDIR=" + scratch.path("temporary"));
  CHECK(spoiled.code == 2);
  CHECK_THAT(spoiled.err, Contains("cannot be read"));
  const auto images = nlohmann::json::parse(spoiled.out)["images"];
  REQUIRE(images.size() >= 2);
  CHECK(images[1]["image"] == scratch.path("spoiled.mp4") + "#1");
  CHECK(std::filesystem::is_empty(scratch.folder / "temporary"));

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
  const Run part = run(scratch, "replay " + scratch.path("session") + " --compare --to 3");
  CHECK(part.code == 0);
  CHECK_THAT(part.out, Contains("of the first"));
  CHECK(run(scratch, "replay " + scratch.path("session") + " --speed -3").code == 2);
  const std::string far_sighted = scratch.write(
      "rig.yaml",
      "camera: {width: 1280, height: 1024, fx: 20000, fy: 20000, cx: 639.5, cy: 511.5, dist: [0, 0, 0, 0, 0]}\n"
      "T_base_cam: {t: [0.35, 0, 0.35], q_xyzw: [0.5, -0.5, 0.5, -0.5]}\n"
      "odometry: {r_left: 0.1, r_right: 0.1, track: 0.6}\n");
  const Run unfit = run(scratch, "replay " + scratch.path("session") + " --rig " + far_sighted);
  CHECK(unfit.code == 2);
  CHECK_THAT(unfit.err, Contains("view") && !Contains("internal"));
  const std::filesystem::path idle = scratch.folder / "idle";
  std::filesystem::create_directories(idle / "cam0");
  std::filesystem::copy_file(scratch.folder / "session" / "session.yaml", idle / "session.yaml");
  for (const char* name : {"odometry.csv", "sightings.csv", "commands.csv", "phases.csv", "cam0/data.csv"}) {
    std::istringstream stream(contents(scratch.folder / "session" / name));
    std::string header;
    std::getline(stream, header);
    std::ofstream(idle / name) << header << "\n";
  }
  const Run nothing = run(scratch, "replay " + idle.string() + " --compare");
  CHECK(nothing.code == 2);
  CHECK_THAT(nothing.err, Contains("no control cycle"));
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
  const Run objects = run(scratch, "camera-sim world --address 127.0.0.9 --seconds 0.3 --json");
  CHECK(objects.code == 0);
  CHECK((objects.out.empty() || objects.out.front() == '{'));
  CHECK_THAT(objects.err, Contains("127.0.0.9"));
  const Run short_one = run(scratch, "camera-sim world --address 127.0.0.9 --seconds 0.3");
  CHECK(short_one.code == 0);
  CHECK_THAT(short_one.out, Contains("127.0.0.9"));
}

TEST_CASE("an evaluation that cannot be meant is refused, and says what would be right", "[quick][evaluate]") {
  const Scratch scratch;
  const auto refused = [&](const std::string& arguments, const std::string& sentence) {
    const Run one = run(scratch, "evaluate " + arguments + " --output " + scratch.path("results"));
    CAPTURE(arguments);
    CHECK(one.code == 2);
    CHECK_THAT(one.err, Contains("tagdock: ") && Contains(sentence));
    CHECK_FALSE(std::filesystem::exists(scratch.folder / "results"));
  };
  refused("--runs 0", "--runs");
  refused("--shard 4/4", "0 to n - 1");
  refused("--strategy best", "--strategy");
  refused("--seed -1", "--seed: -1 is no number of 0 or more");
  refused("--seed 18446744073709551615 --runs 2", "take a smaller one");
  refused("--rig foo", "--rig foo: is no file, nor one of default and five_megapixel");
  refused("--board foo", "nor one of one_tag");
  refused("--corners foo", "--corners foo: is no file, nor one of apriltag");
  refused("--images on --corners best", "drawn without images");
  refused("--partial", "--partial goes with --join");
  refused("--ablation --law line", "--law does not go with --ablation");
  refused("--ablation --images on", "--images does not go with --ablation");
  refused("--ablation --scenario data/scenarios", "takes one --scenario file");
  // A file that is not there is named, also together with --ablation.
  refused("--ablation --scenario nowhere.yaml", "nowhere.yaml");
}

TEST_CASE("a campaign that is killed goes on to the same results, and is not joined before", "[evaluate]") {
  const Scratch scratch;
  const auto evaluate = [&](const std::string& more, const std::string& folder) {
    return run(scratch, "evaluate --runs 60 --jobs 2 " + more + " --output " + scratch.path(folder));
  };
  CHECK(evaluate("", "whole").code == 0);
  // Killed as soon as a few runs are written.
  const std::string killed = scratch.path("killed");
  const std::string script = std::string(TAGDOCK_PROGRAM) + " evaluate --runs 60 --jobs 1 --output " + killed +
                             " >/dev/null 2>&1 & while [ \"$(cat " + killed +
                             "/runs.csv 2>/dev/null | wc -l)\" -lt 4 ]; do sleep 0.01; done; kill -9 $!; wait $!";
  REQUIRE(WEXITSTATUS(std::system(script.c_str())) == 128 + SIGKILL);
  const Run early = run(scratch, "evaluate --join " + scratch.path("killed") + " --output " + scratch.path("early"));
  CHECK(early.code == 2);
  CHECK_FALSE(std::filesystem::exists(scratch.folder / "early"));
  CHECK(evaluate("", "killed").code == 0);
  for (const char* file : {"runs.csv", "summary.json", "report.html"}) {
    CAPTURE(file);
    CHECK(contents(scratch.folder / "killed" / file) == contents(scratch.folder / "whole" / file));
  }
  CHECK(evaluate("--shard 0/2", "first").code == 0);
  CHECK(contents(scratch.folder / "first" / "report.html").find("Partial: 30 of 60 runs.") != std::string::npos);
  const Run one = run(scratch, "evaluate --join " + scratch.path("first") + " --output " + scratch.path("joined"));
  CHECK(one.code == 2);
  CHECK_THAT(one.err, Contains("shard 1/2 is in none of the folders: 30 runs"));
  const Run part =
      run(scratch, "evaluate --partial --json --join " + scratch.path("first") + " --output " + scratch.path("joined"));
  CHECK(part.code == 0);
  CHECK(nlohmann::json::parse(part.out).at("partial").at("of") == 60);
}

TEST_CASE("a measurement's help is its own, not the campaign's", "[quick][evaluate]") {
  const Scratch scratch;
  for (const char* verb :
       {"step-response", "paper-table1", "paper-table2", "corner-errors", "accuracy-map", "tracked"}) {
    CAPTURE(verb);
    const Run one = run(scratch, std::string("evaluate ") + verb + " --help");
    CHECK(one.code == 0);
    CHECK_THAT(one.out, !Contains("A campaign that was stopped"));
  }
  CHECK_THAT(run(scratch, "evaluate --help").out, Contains("A campaign that was stopped"));
}

TEST_CASE("an ablation compares in the world it is given, from both starts", "[evaluate]") {
  const Scratch scratch;
  const std::string folder = scratch.path("ablation");
  const Run one =
      run(scratch,
          "evaluate --ablation --runs 1 --json --scenario data/scenarios/castor_scrub_1.5.yaml --output " + folder);
  CHECK(one.code == 0);
  const auto json = nlohmann::json::parse(one.out);
  CHECK(json.at("campaigns").size() == 150);  // 2 paths, 3 laws, 5 boards, 5 corners
  for (const char* path : {"paper", "straight"}) {
    const auto& campaign = json.at("campaigns").at(std::string(path) + "_start-line-v_convex_centre-best");
    CHECK(campaign.at("scenario") == "castor_scrub_1.5");
    CHECK(campaign.at("start") == path);
  }
}
