// The wizard and the station's survey as a technician runs them: the program itself, on rendered pictures.
#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "app/calibration_result.h"
#include "app/camera_file.h"
#include "app/failure.h"
#include "app/rig_file.h"
#include "app/target_file.h"
#include "calibration/projection_difference.h"
#include "calibration/rig.h"
#include "tests/calibration/board_rendering.h"
#include "tests/detection/scene_rendering.h"

using namespace tagdock;
using namespace tagdock::testing;
using Catch::Matchers::Contains;

namespace {

namespace fs = std::filesystem;

struct Scratch {
  fs::path folder = fs::temp_directory_path() / ("tagdock_wizard_" + std::to_string(::getpid()));
  Scratch() {
    fs::remove_all(folder);
    fs::create_directories(folder);
  }
  ~Scratch() { fs::remove_all(folder); }
  [[nodiscard]] std::string path(const std::string& name) const { return (folder / name).string(); }
};

std::string contents(const fs::path& file) {
  std::stringstream text;
  text << std::ifstream(file).rdbuf();
  return text.str();
}

/// The program in a process of its own; stderr goes to a file.
class Child {
 public:
  Child(const std::vector<std::string>& arguments, const std::string& err) {
    pid_ = ::fork();
    if (pid_ != 0) return;
    if (std::freopen(err.c_str(), "w", stderr) == nullptr || std::freopen("/dev/null", "r", stdin) == nullptr)
      ::_exit(126);
    std::vector<char*> words;
    for (const std::string& word : arguments) words.push_back(const_cast<char*>(word.c_str()));
    words.push_back(nullptr);
    ::execvp(words[0], words.data());
    ::_exit(127);
  }
  ~Child() {
    if (pid_ > 0) end(SIGKILL);
  }
  Child(const Child&) = delete;
  Child& operator=(const Child&) = delete;

  int wait() {
    int status = 0;
    ::waitpid(pid_, &status, 0);
    pid_ = 0;
    return WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
  }
  int end(int signal) {
    ::kill(pid_, signal);
    return wait();
  }

 private:
  pid_t pid_ = 0;
};

int views_in(const fs::path& folder) {
  int count = 0;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error)) count += entry.path().extension() == ".png" ? 1 : 0;
  return count;
}

/// Pictures of the ChArUco board, each `times` as a camera on a tripod would give it.
CameraModel write_pictures(const fs::path& folder, int count, int times) {
  fs::create_directories(folder);
  std::mt19937_64 random(42);
  const CameraModel camera = random_camera(random);
  BoardScene scene;
  scene.camera = camera;
  int number = 0;
  for (const Eigen::Isometry3d& pose : views_of(charuco_board(), camera, count, random)) {
    scene.T_camera_board = pose;
    for (int i = 0; i < times; ++i) {
      char name[32];
      std::snprintf(name, sizeof name, "%04d.png", number++);
      cv::imwrite((folder / name).string(), render_board(charuco_board(), scene, random));
    }
  }
  std::ofstream(folder.parent_path() / "target.yaml") << target_text(charuco_board());
  return camera;
}

}  // namespace

TEST_CASE("a wizard that was killed goes on with every view it kept, and shows them in its window") {
  const Scratch scratch;
  constexpr int pictures = 14;
  const CameraModel truth = write_pictures(scratch.folder / "pictures", pictures, 1);
  std::vector<std::string> command{TAGDOCK_PROGRAM,
                                   "calibrate",
                                   "wizard",
                                   "--target",
                                   scratch.path("target.yaml"),
                                   "--camera",
                                   "images:" + scratch.path("pictures"),
                                   "--session",
                                   scratch.path("session"),
                                   "--output",
                                   scratch.path("camera.yaml"),
                                   "--measured-x",
                                   "100",
                                   "--measured-y",
                                   "100"};
  {
    Child first(command, scratch.path("err1"));
    while (views_in(scratch.folder / "session") < 5) std::this_thread::sleep_for(std::chrono::milliseconds(5));
    CHECK(first.end(SIGKILL) == 128 + SIGKILL);
  }
  const int kept = views_in(scratch.folder / "session");
  CHECK(kept >= 5);
  CHECK(kept < pictures);
  CHECK_FALSE(fs::exists(scratch.folder / "camera.yaml"));

  command.insert(command.begin(), {"xvfb-run", "-a", "-s", "-screen 0 1600x1200x24"});
  command.push_back("--view");
  Child again(command, scratch.path("err2"));
  const int code = again.wait();
  INFO(contents(scratch.folder / "err2"));
  CHECK(code == 0);
  CHECK_THAT(contents(scratch.folder / "err2"), Contains("goes on with its views") && Contains("Next: "));
  const int all = views_in(scratch.folder / "session");
  CHECK(all > kept);
  CHECK(all <= pictures);  // none twice
  const CameraModel found = CameraFile::load(scratch.path("camera.yaml")).camera();
  CHECK(projection_difference(truth, found).largest() < 0.4);  // px, the bound for thirty views
  CHECK_THAT(contents(scratch.folder / "session" / "report.html"), Contains("<svg"));
}

TEST_CASE("a wizard takes still views from a GigE camera by itself until it has enough") {
  const Scratch scratch;
  const CameraModel truth = write_pictures(scratch.folder / "pictures", 14, 3);
  Child camera({TAGDOCK_PROGRAM, "camera-sim", scratch.path("pictures"), "--rate", "4"}, scratch.path("camera_err"));
  std::this_thread::sleep_for(std::chrono::seconds(1));
  Child wizard({TAGDOCK_PROGRAM, "calibrate", "wizard", "--target", scratch.path("target.yaml"), "--camera",
                "gige:127.0.0.1", "--session", scratch.path("session"), "--output", scratch.path("camera.yaml"),
                "--measured-x", "100", "--measured-y", "100", "--seconds", "300"},
               scratch.path("err"));
  const int code = wizard.wait();
  INFO(contents(scratch.folder / "err"));
  CHECK(code == 0);
  CHECK(views_in(scratch.folder / "session") >= 12);
  const CameraModel found = CameraFile::load(scratch.path("camera.yaml")).camera();
  CHECK(projection_difference(truth, found).largest() < 0.4);
  camera.end(SIGTERM);
}

TEST_CASE("a station is surveyed from pictures with a verdict, and one in which a plate moved is told") {
  const Scratch scratch;
  Board real = default_board(0.35);
  real.tags[0].T_station_tag = upright_tag(0.004, 0.202, 0.351, -0.55);
  const Rig rig = default_rig();
  fs::create_directories(scratch.folder / "pictures");
  std::mt19937_64 random(5);
  const auto take = [&](int number, const Board& board) {
    const double bearing = -0.5 + 0.2 * number;
    const double distance = 1.0 + 0.05 * (number % 3);
    Eigen::Isometry3d T_station_base = Eigen::Isometry3d::Identity();
    T_station_base.linear() = Eigen::AngleAxisd(-bearing, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    T_station_base.translation() << -distance * std::cos(bearing), distance * std::sin(bearing), 0.0;
    cv::Mat1d grey(rig.camera.height, rig.camera.width, 120.0);
    for (const BoardTag& tag : board.tags) {
      Scene scene;
      scene.camera = rig.camera;
      scene.id = tag.id;
      scene.size = tag.size;
      scene.T_camera_tag = (T_station_base * level_camera(0.0, 0.35)).inverse() * tag.T_station_tag;
      render_into(grey, scene);
    }
    cv::imwrite(scratch.path("pictures/" + std::to_string(number) + ".png"), digitised(grey, 1.5, random));
  };
  for (int number = 0; number < 6; ++number) take(number, real);
  std::ofstream(scratch.folder / "camera.yaml") << to_yaml({{"camera", camera_block(rig.camera)}});
  std::ofstream(scratch.folder / "board.yaml") << drawn_board_text(default_board(0.35));
  const std::vector<std::string> command{"/bin/sh", "-c",
                                         std::string(TAGDOCK_PROGRAM) + " calibrate station --images " +
                                             scratch.path("pictures") + " --camera " + scratch.path("camera.yaml") +
                                             " --board " + scratch.path("board.yaml") + " --output " +
                                             scratch.path("measured.yaml") + " --json > " + scratch.path("json")};
  Child good(command, scratch.path("err"));
  const int code = good.wait();
  INFO(contents(scratch.folder / "err"));
  REQUIRE(code == 0);
  const auto told = nlohmann::json::parse(contents(scratch.folder / "json"));
  CHECK(told["verdict"] == "good");
  CHECK(told["quality"]["pictures"].size() == 6);
  CHECK(told["quality"]["rms_px"].get<double>() < 0.2);
  const Board measured = read_board(scratch.path("measured.yaml"));
  CHECK(1000.0 * (measured.tags[0].T_station_tag.translation() - real.tags[0].T_station_tag.translation()).norm() <
        1.0);  // mm, the sigma that is asked for

  Board moved = real;
  moved.tags[2].T_station_tag.translation().y() -= 0.02;
  take(3, moved);
  Child bad(command, scratch.path("err"));
  CHECK(bad.wait() == 7);
  CHECK_THAT(contents(scratch.folder / "err"), Contains("REFUSED: corners leave") && Contains("most in 3.png"));
  CHECK(nlohmann::json::parse(contents(scratch.folder / "json"))["verdict"] == "refused");
  CHECK_THROWS_AS(read_board(scratch.path("measured.yaml")), Failure);
  CHECK(read_board(scratch.path("measured.yaml.good")).tags.size() == 3);
}
