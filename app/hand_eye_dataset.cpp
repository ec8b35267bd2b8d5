#include "app/hand_eye_dataset.h"

#include <array>
#include <map>
#include <optional>
#include <set>
#include <stdexcept>

#include "app/csv_table.h"
#include "app/failure.h"
#include "app/fields.h"
#include "app/rig_file.h"
#include "app/yaml_file.h"
#include "planning/pose2.h"

namespace tagdock {
namespace {

CameraModel read_camera(YamlMap map) {
  CameraModel camera;
  camera.width = static_cast<int>(map.integer("width", 1, 65536));
  camera.height = static_cast<int>(map.integer("height", 1, 65536));
  camera.fx = map.number("fx", 1.0, 1e6);
  camera.fy = map.number("fy", 1.0, 1e6);
  camera.cx = map.number("cx", -1e5, 1e5);
  camera.cy = map.number("cy", -1e5, 1e5);
  if (map.has("dist")) set_distortion(camera, map.numbers("dist", 0, 8));
  return camera;
}

std::map<int, Eigen::Vector3d> read_points(const std::filesystem::path& file) {
  const CsvTable table = CsvTable::load(file);
  const std::size_t id = table.column("id");
  const std::size_t place[] = {table.column("x"), table.column("y"), table.column("z")};
  std::map<int, Eigen::Vector3d> points;
  for (std::size_t row = 0; row < table.rows(); ++row) {
    const Eigen::Vector3d point(table.number(row, place[0]), table.number(row, place[1]), table.number(row, place[2]));
    if (!points.emplace(table.integer(row, id), point).second) table.refuse(row, "this id was given before");
  }
  return points;
}

/// The stops that see the board, by id, in a map of all stops.
void read_corners(const std::filesystem::path& file, const std::map<int, Eigen::Vector3d>& points, double sigma_px,
                  std::map<int, HandEyeStop>& stops) {
  const CsvTable table = CsvTable::load(file);
  const std::size_t stop = table.column("stop");
  const std::size_t id = table.column("id");
  const std::size_t u = table.column("u");
  const std::size_t v = table.column("v");
  const bool frames = table.has("frame");
  std::set<std::array<int, 3>> known;
  for (std::size_t row = 0; row < table.rows(); ++row) {
    const auto point = points.find(table.integer(row, id));
    if (point == points.end())
      table.refuse(row, "id " + std::to_string(table.integer(row, id)) + " is not in board_points.csv");
    HandEyeStop& seen = stops[table.integer(row, stop)];
    if (!known.insert({table.integer(row, stop), frames ? table.integer(row, table.column("frame")) : 0, point->first})
             .second)
      table.refuse(row, std::string("this corner of this stop was given before") +
                            (frames ? " in this frame" : "; several frames of a stop need the column frame"));
    const double own = table.number(row, "sigma_px").value_or(sigma_px);
    if (!(own > 0.0)) table.refuse(row, "sigma_px is not positive");
    seen.corners.push_back({point->first, point->second, {table.number(row, u), table.number(row, v)}, own});
  }
}

void read_tracker(const std::filesystem::path& file, std::map<int, HandEyeStop>& stops) {
  const CsvTable table = CsvTable::load(file);
  const std::size_t stop = table.column("stop");
  std::size_t columns[7];
  const char* const names[] = {"x", "y", "z", "qx", "qy", "qz", "qw"};
  for (std::size_t i = 0; i < 7; ++i) columns[i] = table.column(names[i]);
  for (std::size_t row = 0; row < table.rows(); ++row) {
    double value[7];
    for (std::size_t i = 0; i < 7; ++i) value[i] = table.number(row, columns[i]);
    const Eigen::Quaterniond rotation(value[6], value[3], value[4], value[5]);
    if (std::abs(rotation.norm() - 1.0) > 1e-3) table.refuse(row, "qx, qy, qz, qw is not a unit quaternion");
    HandEyeStop& at = stops[table.integer(row, stop)];
    if (at.T_tracker_base) table.refuse(row, "this stop was given before");
    at.T_tracker_base = Eigen::Isometry3d::Identity();
    at.T_tracker_base->linear() = rotation.normalized().toRotationMatrix();
    at.T_tracker_base->translation() << value[0], value[1], value[2];
  }
  for (const auto& [id, at] : stops)
    if (!at.T_tracker_base)
      throw Failure(ExitCode::usage, file.string() + ": stop " + std::to_string(id) + " of corners.csv is missing");
}

void read_wheels(const std::filesystem::path& file, std::map<int, HandEyeStop>& stops) {
  const CsvTable table = CsvTable::load(file);
  const std::size_t from = table.column("from_stop");
  const std::size_t segment = table.column("seg");
  const std::size_t left = table.column("phi_left");
  const std::size_t right = table.column("phi_right");
  std::map<int, std::map<int, std::array<double, 2>>> ways;
  for (std::size_t row = 0; row < table.rows(); ++row)
    if (!ways[table.integer(row, from)]
             .emplace(table.integer(row, segment), std::array{table.number(row, left), table.number(row, right)})
             .second)
      table.refuse(row, "this segment was given before");
  for (const auto& [id, arcs] : ways)
    for (const auto& [number, arc] : arcs) stops[id].wheels_to_next.push_back(arc);
  // A stop behind the last one that is driven from may be missing here; one between others may not.
  for (auto at = stops.begin(); at != stops.end() && std::next(at) != stops.end(); ++at)
    if (at->second.wheels_to_next.empty())
      throw Failure(ExitCode::usage, file.string() + ": no segment leads on from stop " + std::to_string(at->first));
}

}  // namespace

HandEyeProblem read_hand_eye_dataset(const std::filesystem::path& folder) {
  YamlMap map = YamlMap::load(folder / "problem.yaml");
  HandEyeProblem problem;
  const std::string reference = map.text("reference");
  if (reference != "tracker" && reference != "odometry")
    map.refuse("reference", "is " + reference + "; it must be tracker or odometry");
  problem.by_wheels = reference == "odometry";
  const double corner_sigma = map.number("corner_sigma_px", 1e-4, 100.0);
  YamlMap camera = map.map("camera");
  problem.camera = read_camera(camera);
  try {
    check(problem.camera);
  } catch (const std::invalid_argument& error) {
    map.refuse("camera", std::string("cannot be: ") + error.what());
  }
  std::map<int, HandEyeStop> stops;
  read_corners(folder / "corners.csv", read_points(folder / "board_points.csv"), corner_sigma, stops);
  if (problem.by_wheels) {
    YamlMap nominal = map.map("odometry_nominal");
    problem.nominal.r_left = nominal.number("r_left", 0.005, 2.0);
    problem.nominal.r_right = nominal.number("r_right", 0.005, 2.0);
    problem.nominal.track = nominal.number("track", 0.05, 10.0);
    problem.wheel_noise_rad_per_sqrt_rad = map.number("wheel_noise_rad_per_sqrt_rad", 1e-7, 1.0);
    problem.wheel_noise_floor_rad = map.number("wheel_noise_floor_rad", 0.0, 1.0);
    read_wheels(folder / "odometry.csv", stops);
  } else {
    problem.tracker_sigma_m = map.number("tracker_sigma_m", 1e-7, 1.0);
    problem.tracker_sigma_rad = radians(map.number("tracker_sigma_deg", 1e-6, 90.0));
    if (auto surveyed = map.optional_map("T_tracker_board")) {
      (void)surveyed->numbers("t", 3, 3);  // a missing half is an error, not an identity
      (void)surveyed->numbers("q_xyzw", 4, 4);
      SurveyedPose board;
      FieldReader reader(map);
      reader.transform("T_tracker_board", board.T_tracker_board);
      board.sigma_m = map.number("survey_sigma_m", 1e-7, 1.0);
      board.sigma_rad = radians(map.number("survey_sigma_deg", 1e-6, 90.0));
      problem.board = board;
    }
    read_tracker(folder / "tracker.csv", stops);
  }
  if (auto hint = map.optional_map("camera_height_hint"))
    problem.camera_height = Measured{hint->number("value", -100.0, 100.0), hint->number("sigma", 1e-6, 100.0)};
  for (auto& [id, stop] : stops) {
    stop.id = id;
    problem.stops.push_back(std::move(stop));
  }
  return problem;
}

}  // namespace tagdock
