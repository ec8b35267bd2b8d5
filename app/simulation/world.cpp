#include "app/simulation/world.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>

#include "app/simulation/draws.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;

constexpr nanoseconds kept = std::chrono::seconds(2);                 // of history
constexpr nanoseconds ahead = std::chrono::milliseconds(20);          // of the world, at most
constexpr nanoseconds longest_guess = std::chrono::milliseconds(50);  // beyond the last place that was told

// Purposes of random numbers; RobotPhysics has 1, 2 and 4.
constexpr std::uint64_t rig_purpose = 11;
constexpr std::uint64_t board_purpose = 12;
constexpr std::uint64_t chassis_purpose = 13;
constexpr std::uint64_t noise_purpose = 14;
constexpr std::uint64_t latency_purpose = 15;
constexpr std::uint64_t loss_purpose = 16;

nanoseconds from_seconds(double seconds) { return nanoseconds(std::llround(1e9 * seconds)); }

std::uint64_t key_of(std::uint64_t seed, std::uint64_t purpose, std::uint64_t number) {
  return mixed(mixed(mixed(seed) + purpose) + number);
}

/// A small random rotation and shift.
Eigen::Isometry3d small_motion(Draws& draws, double place_sigma, double angle_sigma) {
  Eigen::Vector3d place;
  Eigen::Vector3d turn;
  for (double& value : place) value = place_sigma * draws.normal();
  for (double& value : turn) value = angle_sigma * draws.normal();
  Eigen::Isometry3d motion = Eigen::Isometry3d::Identity();
  if (turn.norm() > 0.0) motion.linear() = Eigen::AngleAxisd(turn.norm(), turn.normalized()).toRotationMatrix();
  motion.translation() = place;
  return motion;
}

Eigen::Isometry3d in_space(const Pose2& pose) {
  Eigen::Isometry3d result = Eigen::Isometry3d::Identity();
  result.linear() = Eigen::AngleAxisd(pose.yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  result.translation() << pose.x, pose.y, 0.0;
  return result;
}

Scene scene_of(const Scenario& scenario, const Board& board) {
  Scene scene;
  scene.board = board;
  scene.lamp.strength = scenario.station.lamp_strength;
  scene.lamp.ambient = scenario.station.ambient;
  for (const Dirt& dirt : scenario.station.dirt) {
    const BoardTag* tag = find_tag(board, dirt.tag);
    if (tag == nullptr)
      throw std::invalid_argument("scenario " + scenario.name + " has dirt on tag " + std::to_string(dirt.tag) +
                                  ", which is not on the board");
    constexpr double thickness = 0.0003;  // m; a label
    Eigen::Isometry3d T_tag_stain = Eigen::Isometry3d::Identity();
    T_tag_stain.translation() << dirt.x, dirt.y, -thickness;
    T_tag_stain.linear() = Eigen::AngleAxisd(dirt.angle, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    scene.stains.push_back({tag->T_station_tag * T_tag_stain, dirt.width, dirt.height, dirt.reflectance});
  }
  return scene;
}

}  // namespace

Rig true_rig(const Rig& calibrated, const ResidualScenario& residuals, std::uint64_t seed) {
  Draws draws(seed, rig_purpose);
  Rig rig = calibrated;
  const Eigen::Isometry3d motion = small_motion(draws, residuals.camera_place_sigma, residuals.camera_angle_sigma);
  rig.T_base_camera.linear() = Eigen::AngleAxisd(residuals.camera_bump, Eigen::Vector3d::UnitZ()).toRotationMatrix() *
                               motion.linear() * calibrated.T_base_camera.linear();
  rig.T_base_camera.translation() += motion.translation();
  const double scale = 1.0 + residuals.focal_length_sigma * draws.normal();
  rig.camera.fx *= scale;
  rig.camera.fy *= scale;
  rig.camera.cx += residuals.principal_point_sigma_px * draws.normal();
  rig.camera.cy += residuals.principal_point_sigma_px * draws.normal();
  return rig;
}

Board true_board(const Board& surveyed, const ResidualScenario& residuals, const StationScenario& station,
                 std::uint64_t seed) {
  Draws draws(seed, board_purpose);
  Eigen::Isometry3d moved = in_space(station.moved);
  moved.translation().z() -= station.sunk;
  moved.rotate(Eigen::AngleAxisd(-station.lean, Eigen::Vector3d::UnitY()));
  Board board = surveyed;
  for (BoardTag& tag : board.tags)
    tag.T_station_tag =
        moved * tag.T_station_tag * small_motion(draws, residuals.tag_place_sigma, residuals.tag_angle_sigma);
  return board;
}

World::World(const Scenario& scenario, const Rig& calibrated, const Board& surveyed, std::uint64_t seed)
    : scenario_(scenario),
      seed_(seed),
      rig_(true_rig(calibrated, scenario.residuals, seed)),
      board_(true_board(surveyed, scenario.residuals, scenario.station, seed)),
      physics_(scenario.start, scenario.drive, calibrated.T_base_camera.translation().x(), seed),
      scene_(scene_of(scenario, board_)) {
  history_.push_back({physics_.truth().time, physics_.truth().T_station_base});
}

void World::advance(nanoseconds now) {
  if (placed_) return;
  while (physics_.truth().time + RobotPhysics::step <= now) {
    physics_.advance(physics_.truth().time + RobotPhysics::step);
    remember(physics_.truth().time, physics_.truth().T_station_base);
  }
}

void World::place(nanoseconds time, const Pose2& T_station_base) {
  if (!placed_) history_.clear();
  placed_ = true;
  if (history_.empty() || time > history_.back().time) remember(time, T_station_base);
}

void World::remember(nanoseconds time, const Pose2& T_station_base) {
  history_.push_back({time, T_station_base});
  while (history_.front().time + kept < time) history_.pop_front();
  if (scenario_.station.light_change != 1.0 && !light_changed_ &&
      -T_station_camera_point().x < scenario_.station.light_change_range)
    light_changed_ = time;
}

Pose2 World::T_station_base_at(nanoseconds time) const {
  if (!placed_ && (time < history_.front().time - RobotPhysics::step || time > history_.back().time + ahead))
    throw std::invalid_argument("the world was asked for an image of a time it does not know");
  if (history_.size() == 1 || time <= history_.front().time) return history_.front().T_station_base;
  // Who tells the robot's place may be late, and when silent the robot stands.
  if (placed_) time = std::min(time, history_.back().time + longest_guess);
  // The step that holds the time; the last one goes on when the time is ahead.
  const auto after = std::upper_bound(history_.begin(), history_.end(), time,
                                      [](nanoseconds value, const Moment& moment) { return value < moment.time; });
  const std::size_t index = std::min(static_cast<std::size_t>(after - history_.begin()) - 1, history_.size() - 2);
  const Moment& from = history_[index];
  const Moment& to = history_[index + 1];
  const double share =
      static_cast<double>((time - from.time).count()) / static_cast<double>((to.time - from.time).count());
  const auto between = [share](double a, double b) { return a + share * (b - a); };
  return {between(from.T_station_base.x, to.T_station_base.x), between(from.T_station_base.y, to.T_station_base.y),
          between(from.T_station_base.yaw, to.T_station_base.yaw)};
}

Rendering World::render(nanoseconds mid_exposure, RenderedRows rows) const {
  const TimedExposure timed = exposure_at(mid_exposure);
  return renderer().render(timed.exposure, timed.noise_seed, rows);
}

const Renderer& World::renderer() const {
  if (renderer_ == nullptr) renderer_ = std::make_unique<const Renderer>(scene_, rig_.camera, scenario_.camera.sensor);
  return *renderer_;
}

TimedExposure World::exposure_at(nanoseconds mid_exposure) const {
  const std::uint64_t frame_key = static_cast<std::uint64_t>(mid_exposure.count());
  Draws draws(key_of(seed_, chassis_purpose, frame_key), 0);
  const ChassisScenario& chassis = scenario_.chassis;
  const double pitch = chassis.pitch_sigma * draws.normal();
  const double roll = chassis.roll_sigma * draws.normal();
  const double height = chassis.height_sigma * draws.normal();
  // The chassis shakes about the lens: what the lens' place would change is part of its height.
  Eigen::Isometry3d T_base_camera = rig_.T_base_camera;
  T_base_camera.linear() = Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitY()).toRotationMatrix() *
                           Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitX()).toRotationMatrix() *
                           rig_.T_base_camera.linear();
  T_base_camera.translation().z() += height;

  Exposure exposure;
  exposure.duration = from_seconds(scenario_.camera.exposure);
  exposure.T_station_camera.clear();
  for (const int half : {-1, 0, 1})
    exposure.T_station_camera.push_back(in_space(T_station_base_at(mid_exposure + half * exposure.duration / 2)) *
                                        T_base_camera);
  if (light_changed_ && mid_exposure >= *light_changed_) exposure.light = scenario_.station.light_change;
  return {exposure, key_of(seed_, noise_purpose, frame_key)};
}

nanoseconds World::frame_period() const { return from_seconds(1.0 / scenario_.camera.frame_rate); }

nanoseconds World::latency_of(std::uint64_t frame) const {
  const double share = 2.0 * even_number(key_of(seed_, latency_purpose, frame)) - 1.0;
  return from_seconds(std::max(0.0, scenario_.camera.latency + share * scenario_.camera.latency_jitter));
}

bool World::is_lost(std::uint64_t frame) const {
  return even_number(key_of(seed_, loss_purpose, frame)) < scenario_.camera.loss;
}

Pose2 World::T_station_camera_point() const {
  const Eigen::Vector3d lens = rig_.T_base_camera.translation();
  return history_.back().T_station_base * Pose2{lens.x(), lens.y(), 0.0};
}

Pose2 World::docking_error(const Pose2& docking_pose) const {
  const Pose2 reached = T_station_camera_point();
  const Pose2 wanted = scenario_.station.moved * docking_pose;
  return {reached.x - wanted.x, reached.y - wanted.y, wrap_angle(reached.yaw - wanted.yaw)};
}

}  // namespace tagdock
