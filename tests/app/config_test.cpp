#include "app/config.h"

#include <filesystem>
#include <fstream>

#include <catch2/catch.hpp>

#include "app/failure.h"
#include "app/rig_file.h"
#include "app/sensor_error_file.h"

using namespace tagdock;
using Catch::Matchers::Contains;

TEST_CASE("the rig and the board that are shipped as examples are those of the simulated robot") {
  const Rig rig = read_rig("data/rigs/default.yaml");
  CHECK(rig.camera == default_rig().camera);
  CHECK(rig.odometry == default_rig().odometry);
  CHECK(rig.T_base_camera.isApprox(default_rig().T_base_camera, 1e-14));
  const Board board = read_board("data/boards/default.yaml");
  const Board expected = default_board(0.35);
  REQUIRE(board.tags.size() == expected.tags.size());
  CHECK(board.family == expected.family);
  for (std::size_t i = 0; i < expected.tags.size(); ++i) {
    CHECK(board.tags[i].id == expected.tags[i].id);
    CHECK(board.tags[i].size == expected.tags[i].size);
    CHECK(board.tags[i].T_station_tag.isApprox(expected.tags[i].T_station_tag, 1e-14));
  }
}

TEST_CASE("a configuration that was written reads back with the same numbers, short and fit for any YAML reader") {
  Config config;
  config.docking.fix.tolerance_x = 0.1 + 0.2;  // needs all its digits
  config.docking.centering.gain = 0.3;
  config.rig.camera.p1 = 3e-4;
  const std::string text = to_yaml(config);
  CHECK_THAT(text, Contains("gain: 0.3\n"));
  CHECK_THAT(text, Contains("3.0e-04"));
  const Config read = parse_config(text, "(test)");
  CHECK(read.docking.fix.tolerance_x == config.docking.fix.tolerance_x);
  CHECK(read.docking.centering.gain == config.docking.centering.gain);
  CHECK(read.rig.camera == config.rig.camera);
}

TEST_CASE("a default robot knows how well one frame tells its pose, another one does not take that for its own") {
  const Config config = parse_config("version: 1\n", "(test)");
  REQUIRE(config.docking.filter.sensor);
  const auto near = config.docking.filter.sensor->at(1.0, 0.0, 0.0);
  const auto far = config.docking.filter.sensor->at(4.0, 0.0, 0.0);
  REQUIRE((near && far));
  CHECK(near->across < far->across);
  CHECK_FALSE(parse_config("detection: {sensor_errors: none}\n", "(test)").docking.filter.sensor);
  Config other;
  other.board.tags.pop_back();
  CHECK_FALSE(parse_config(to_yaml(other), "(test)").docking.filter.sensor);
}

TEST_CASE("files of sensor errors read back as written, and are refused with file and key") {
  const std::string shipped = "data/sensor_errors/v_convex_centre.yaml";
  const SensorErrorFile file = read_sensor_errors(YamlMap::load(shipped));
  const SensorErrorFile again = read_sensor_errors(YamlMap::parse(to_yaml(file), "(again)"));
  CHECK(again.errors.cells.size() == file.errors.cells.size());
  CHECK(again.errors.at(2.2, 0.0, 0.0)->across == Approx(file.errors.at(2.2, 0.0, 0.0)->across).epsilon(1e-3));

  const auto refusal = [](const std::string& from, const std::string& to) {
    std::string text = to_yaml(read_sensor_errors(YamlMap::load("data/sensor_errors/v_convex_centre.yaml")));
    const std::size_t place = text.find(from);
    REQUIRE(place != std::string::npos);
    text.replace(place, from.size(), to);
    const std::filesystem::path changed = std::filesystem::temp_directory_path() / "tagdock_sensor_errors_test.yaml";
    std::ofstream(changed) << text;
    std::string sentence;
    try {
      (void)parse_config("detection: {sensor_errors: " + changed.string() + "}\n", "robot.yaml");
    } catch (const Failure& failure) {
      CHECK(failure.code() == ExitCode::usage);
      sentence = failure.what();
    }
    std::filesystem::remove(changed);
    return sentence;
  };
  CHECK_THAT(refusal("tags: 3", "tags: 2"), Contains("tagdock_sensor_errors_test.yaml") && Contains("tags is 2"));
  CHECK_THAT(refusal("image_width: 1280", "image_width: 640"), Contains("image_width"));
  CHECK_THAT(refusal("tag_size_m: 0.16", "tag_size_m: 0.2"), Contains("tag_size_m is 0.2"));
  CHECK_THAT(refusal("distance_m: [1, 1.5", "distance_m: [1.5, 1"), Contains("distance_m") && Contains("rise"));
  CHECK_THAT(refusal("place: 0\n    bearing_deg: 5", "place: 0\n    bearing_deg: 6"), Contains("bearing_deg"));
  CHECK_THAT(refusal("along_mm: [", "along_mm: [-0.5, "), Contains("along_mm"));
  CHECK_THROWS_WITH(parse_config("detection: {sensor_errors: nowhere.yaml}\n", "robot.yaml"),
                    Contains("robot.yaml: detection.sensor_errors is nowhere.yaml") && Contains("no such file"));
}

TEST_CASE("keys of a taught docking pose know each other") {
  const std::string taught =
      "docking:\n  taught: {measured: true, sigma_x_m: 1.0e-05, sigma_y_m: 2.0e-05, sigma_yaw_deg: 0.001, "
      "correlation: [0.1, 0.2, -0.9], board_checked: true, camera_height_m: 0.35}\n";
  const DockingConfig docking = parse_config(taught, "(test)").docking;
  CHECK(docking.dock_pose_taught);
  CHECK(docking.dock_pose_covariance(1, 2) == Approx(-0.9 * 2e-5 * radians(0.001)));
  REQUIRE(docking.taught_hang);
  CHECK(docking.taught_hang->camera_height == 0.35);
  const DockingConfig again = parse_config(to_yaml(parse_config(taught, "(test)")), "(test)").docking;
  CHECK(again.dock_pose_covariance.isApprox(docking.dock_pose_covariance, 1e-12));

  const auto refused = [](const std::string& keys, const std::string& why) {
    CHECK_THROWS_WITH(parse_config("docking:\n  taught: {" + keys + "}\n", "robot.yaml"),
                      Contains("robot.yaml:2") && Contains(why));
  };
  refused("measured: true", "sigma_x_m");
  refused("sigma_x_m: 0.001, sigma_y_m: 0.001, sigma_yaw_deg: 0.1", "measured: true");
  refused("board_checked: true, camera_height_m: 0.35", "measured");
  refused("measured: true, sigma_x_m: 0.001, sigma_y_m: 0.001, sigma_yaw_deg: 0.1, board_checked: true",
          "camera_height_m");
  refused("measured: true, sigma_x_m: 0.001, sigma_y_m: 0.001, sigma_yaw_deg: 0.1, correlation: [0.9, 0.9, -0.9]",
          "correlation");
}
