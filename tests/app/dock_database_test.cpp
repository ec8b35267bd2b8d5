#include "app/dock_database.h"

#include <filesystem>
#include <fstream>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "app/failure.h"

using namespace tagdock;
using Catch::Matchers::Contains;

namespace {

struct Written {
  std::filesystem::path file =
      std::filesystem::temp_directory_path() / ("tagdock_docks_" + std::to_string(::getpid()) + ".yaml");
  explicit Written(const std::string& text) { std::ofstream(file) << text; }
  ~Written() { std::filesystem::remove(file); }
};

std::vector<DockEntry> nav2(const std::string& text) { return read_nav2_docks(Written(text).file); }

// As Nav2's documentation of the docking server writes it.
const std::string example = R"(docks:
  home_dock:
    type: "charging_dock"
    frame: "map"
    pose: [0.3, 0.3, 0.0]
  flex_dock2:
    type: "dock_flex"
    frame: "map"
    pose: [20.0, 20.0, -1.570796]
    id: "42"
  bare:
    pose: [1, 2, 3]
)";

}  // namespace

TEST_CASE("Nav2's dock database goes to ours and back with nothing lost") {
  const std::vector<DockEntry> docks = nav2(example);
  REQUIRE(docks.size() == 3);
  CHECK(docks[1] ==
        DockEntry{"flex_dock2", "dock_flex", "map", {20.0, 20.0, -1.570796}, "42", "", std::nullopt, std::nullopt});
  CHECK(docks[2].frame == "map");
  const std::vector<DockEntry> ours = read_docks(Written(docks_yaml(docks)).file);
  const std::vector<DockEntry> again = nav2(nav2_docks(ours));
  REQUIRE(again.size() == docks.size());
  for (std::size_t i = 0; i < docks.size(); ++i) {
    CHECK(again[i].name == docks[i].name);
    CHECK(again[i].type == docks[i].type);
    CHECK(again[i].frame == docks[i].frame);
    CHECK(again[i].id == docks[i].id);
    CHECK(again[i].pose.x == docks[i].pose.x);
    CHECK(again[i].pose.y == docks[i].pose.y);
    CHECK(again[i].pose.yaw == Approx(docks[i].pose.yaw).margin(1e-14));  // through degrees
  }
  CHECK_THAT(nav2_docks(ours), Contains("pose: [1.0, 2.0, "));  // doubles for Nav2, never integers
}

TEST_CASE("what only we know of a dock is kept, and a dock is found by name") {
  std::vector<DockEntry> docks = nav2(example);
  docks[0].board = "boards/home.yaml";
  docks[0].dock_pose = Pose2{-1.0, 0.01, 0.0};
  const std::vector<DockEntry> again = read_docks(Written(docks_yaml(docks)).file);
  CHECK(again[0].board == "boards/home.yaml");
  CHECK(*again[0].dock_pose == Pose2{-1.0, 0.01, 0.0});
  CHECK(find_dock(again, "bare").pose.x == 1.0);
  CHECK_THROWS_WITH(find_dock(again, "nowhere"), Contains("home_dock flex_dock2 bare"));
}

TEST_CASE("what was taught at a dock is kept with it: how well its pose was measured and how the board hung") {
  std::vector<DockEntry> docks = nav2(example);
  docks[0].dock_pose = Pose2{-1.0, 0.01, 0.0};
  TaughtDock taught;
  taught.covariance << 4e-8, 1e-9, 0.0, 1e-9, 9e-8, 2e-9, 0.0, 2e-9, 1e-8;
  taught.hang = BoardHang{0.352, 0.001, -0.002};
  docks[0].taught = taught;
  const std::vector<DockEntry> again = read_docks(Written(docks_yaml(docks)).file);
  REQUIRE(again[0].taught);
  CHECK(again[0].taught->covariance.isApprox(taught.covariance, 1e-12));  // through sigmas and degrees
  REQUIRE(again[0].taught->hang);
  CHECK(again[0].taught->hang->camera_height == 0.352);
  CHECK(again[0].taught->hang->roll == Approx(0.001).epsilon(1e-12));
  CHECK(again[0].taught->hang->pitch == Approx(-0.002).epsilon(1e-12));
  CHECK_FALSE(again[1].taught);
  // Without the board's hang, and without a pose that it could belong to.
  docks[0].taught->hang.reset();
  CHECK_FALSE(read_docks(Written(docks_yaml(docks)).file)[0].taught->hang);
  docks[0].dock_pose.reset();
  CHECK_THROWS_WITH(read_docks(Written(docks_yaml(docks)).file), Contains("taught") && Contains("dock_pose"));
}

TEST_CASE("dock databases that mean something else are refused with file, line and key") {
  const auto refused = [](const std::string& pose) { return nav2("docks:\n  home:\n    pose: " + pose + "\n"); };
  CHECK_THROWS_WITH(refused("[1, 2]"), Contains(".yaml:3") && Contains("pose"));
  CHECK_THROWS_WITH(refused("[1, 2, 0, 90]"), Contains("pose"));
  CHECK_THROWS_WITH(refused("[1, 2, 90]"), Contains("yaw") && Contains("rad"));
  CHECK_THROWS_WITH(refused("[1, .nan, 0]"), Contains("pose"));
  CHECK_THROWS_WITH(refused("{x: 1, y: 2}"), Contains("pose"));
  CHECK_THROWS_AS(nav2("docks: [home]\nhome: {pose: [1, 2, 0]}\n"), Failure);
  CHECK_THROWS_AS(nav2("docks: {}\n"), Failure);
  CHECK_THROWS_WITH(nav2("docks:\n  home: {pose: [1, 2, 0], kind: x}\n"), Contains("kind"));
  CHECK_THROWS_WITH(nav2("docks:\n  home: {pose: [1, 2, 0], frame: \"a b\"}\n"), Contains("frame"));
}
