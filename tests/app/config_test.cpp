#include "app/config.h"

#include <catch2/catch.hpp>

#include "app/rig_file.h"

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
