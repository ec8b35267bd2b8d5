#include "app/distance_looks.h"

#include <cmath>
#include <cstdio>
#include <fstream>
#include <string>

#include "app/failure.h"
#include "app/simulation/sighting_model.h"
#include "app/simulation/world.h"
#include "detection/tag_locator.h"
#include "servo/pose_filter.h"

namespace tagdock {
namespace {

using std::chrono::milliseconds;

constexpr double nearest = 1.0;   // m
constexpr double farthest = 6.5;  // m
constexpr double apart = 0.5;     // m

}  // namespace

std::vector<DistanceLook> looks_over_distance(const RunSettings& settings, std::uint64_t seed) {
  const bool paper = settings.strategy == Strategy::paper;
  const int robots = settings.images ? 1 : 4;
  const int frames = settings.images ? 3 : 4;
  const Rig& rig = settings.config.rig;
  TagLocator locator(rig, settings.config.board, settings.config.locator);
  std::vector<DistanceLook> looks;
  for (double distance = nearest; distance < farthest + 0.5 * apart; distance += apart)
    for (int robot = 0; robot < robots; ++robot) {
      Scenario scenario = settings.scenario;
      scenario.station.moved = {};
      scenario.station.sunk = scenario.station.lean = 0.0;
      scenario.start = {};
      scenario.start.range = distance;
      scenario.start.bearing = paper ? radians(26.0) : 0.0;
      scenario.start.range_sigma = scenario.start.bearing_sigma = scenario.start.bearing_spread =
          scenario.start.heading_sigma = scenario.start.heading_spread = scenario.start.castor_sigma = 0.0;
      scenario.camera.frame_rate = settings.config.camera.frame_rate;
      scenario.camera.exposure = 1e-6 * settings.config.camera.exposure_us;
      const std::uint64_t own_seed = seed + static_cast<std::uint64_t>(robot);
      World world(scenario, rig, settings.config.board, own_seed);
      const SightingModel model(rig, settings.config.board, settings.config.locator, settings.corner_errors, own_seed);
      const Pose2 truth = world.T_station_camera_point();
      for (int frame = 1; frame <= frames; ++frame) {
        const std::chrono::nanoseconds exposed = milliseconds(50 * frame);
        world.advance(exposed + milliseconds(40));
        const auto number = static_cast<std::uint64_t>(frame);
        // From the corners alone, as at a first look.
        const Sighting sighting =
            settings.images ? locator.locate({world.render(exposed, RenderedRows::with_tags).gray, exposed, number}, {})
                            : model.look(world, number, exposed, std::nullopt);
        const BoardSighting* board = std::get_if<BoardSighting>(&sighting);
        if (board == nullptr) continue;
        const PlanarSighting planar =
            planar_sighting(rig, board->time, board->T_camera_station, board->covariance, 0.0);
        const Pose2 seen = planar.T_station_base * camera_point(rig);
        const double true_distance = std::hypot(truth.x, truth.y);
        looks.push_back({true_distance, board->reprojection_rms_px, std::hypot(seen.x, seen.y) - true_distance});
      }
    }
  return looks;
}

void write_looks(const std::filesystem::path& file, const std::vector<DistanceLook>& looks) {
  std::ofstream stream(file, std::ios::binary);
  stream << "distance,reprojection_px,distance_error\n";
  char text[120];
  for (const DistanceLook& look : looks) {
    std::snprintf(text, sizeof text, "%.4f,%.5f,%.6f\n", look.distance, look.reprojection_px, look.distance_error);
    stream << text;
  }
  stream.flush();
  if (!stream) throw Failure(ExitCode::usage, file.string() + ": cannot be written (is the disk full?)");
}

std::vector<DistanceLook> read_looks(const std::filesystem::path& file) {
  std::ifstream stream(file);
  std::vector<DistanceLook> looks;
  std::string one;
  std::getline(stream, one);
  for (int number = 2; std::getline(stream, one); ++number) {
    DistanceLook look;
    if (std::sscanf(one.c_str(), "%lf,%lf,%lf", &look.distance, &look.reprojection_px, &look.distance_error) != 3)
      throw Failure(ExitCode::usage, file.string() + ":" + std::to_string(number) +
                                         ": must have distance,reprojection_px,distance_error");
    looks.push_back(look);
  }
  return looks;
}

}  // namespace tagdock
