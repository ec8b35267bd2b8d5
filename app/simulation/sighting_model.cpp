#include "app/simulation/sighting_model.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "app/simulation/draws.h"

namespace tagdock {
namespace {

// Purposes of random numbers; World has 11 to 16.
constexpr std::uint64_t corner_bias_purpose = 21;
constexpr std::uint64_t corner_noise_purpose = 22;

// Where the true corners of a tag are seen by the true camera; none if one is behind it or off the image.
std::optional<Corners> corners_seen(const BoardTag& tag, const Eigen::Isometry3d& T_camera_station,
                                    const CameraModel& camera, double border_px) {
  Corners corners;
  const TagPoints points = corners_station(tag);
  const Eigen::Isometry3d T_camera_tag = T_camera_station * tag.T_station_tag;
  if (T_camera_tag.linear().col(2).dot(T_camera_tag.translation()) <= 0.0) return std::nullopt;  // its back
  for (std::size_t i = 0; i < 4; ++i) {
    const Eigen::Vector3d point = T_camera_station * points[i];
    if (point.z() < 0.15) return std::nullopt;
    corners[i] = project(camera, point);
    if (!(corners[i].minCoeff() >= border_px && corners[i].x() <= camera.width - 1 - border_px &&
          corners[i].y() <= camera.height - 1 - border_px))
      return std::nullopt;
  }
  return corners;
}

double shortest_side(const Corners& corners) {
  double shortest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < 4; ++i) shortest = std::min(shortest, (corners[i] - corners[(i + 1) % 4]).norm());
  return shortest;
}

}  // namespace

SightingModel::SightingModel(const Rig& calibrated, const Board& surveyed, const TagLocatorConfig& locator,
                             const CornerErrors& errors, std::uint64_t seed)
    : calibrated_(calibrated),
      surveyed_(surveyed),
      prior_(ground_prior(calibrated, locator)),
      border_px_(locator.detector.border_px),
      errors_(errors),
      seed_(seed) {
  for (const BoardTag& tag : surveyed.tags) {
    Draws draws(mixed(seed) + static_cast<std::uint64_t>(tag.id), corner_bias_purpose);
    Biases& bias = biases_.emplace_back();
    bias.tag = tag.id;
    for (double& normal : bias.normal) normal = draws.normal();
    for (double& phase : bias.phase) phase = std::numbers::pi * draws.even();
  }
}

const SightingModel::Biases& SightingModel::bias_of(int tag) const {
  return *std::find_if(biases_.begin(), biases_.end(), [tag](const Biases& bias) { return bias.tag == tag; });
}

double SightingModel::on_pixels(const Biases& bias, Eigen::Index place, const Eigen::Vector2d& corner) {
  const auto wave = [&](double px, Eigen::Index number) {
    return std::cos(2.0 * std::numbers::pi * px + bias.phase[static_cast<std::size_t>(2 * place + number)]);
  };
  return wave(corner.x(), 0) + wave(corner.y(), 1);  // mean square 1
}

Sighting SightingModel::look(const World& world, std::uint64_t frame, std::chrono::nanoseconds mid_exposure,
                             const std::optional<Eigen::Isometry3d>& predicted) const {
  const TimedExposure exposure = world.exposure_at(mid_exposure);
  const auto& poses = exposure.exposure.T_station_camera;
  const Eigen::Isometry3d T_camera_station = poses[poses.size() / 2].inverse();
  const Eigen::Isometry3d T_camera_station_open = poses.front().inverse();
  const Eigen::Isometry3d T_camera_station_close = poses.back().inverse();
  Draws noise(mixed(seed_) + frame, corner_noise_purpose);
  std::vector<RefinedTag> tags;
  tags.reserve(world.board().tags.size());
  for (const BoardTag& tag : world.board().tags) {
    std::optional<Corners> corners = corners_seen(tag, T_camera_station, world.rig().camera, border_px_);
    if (!corners) continue;
    const double side = shortest_side(*corners);
    const double noise_px = errors_.noise_at(side);
    const double bias_px = errors_.bias_at(side);
    const TagPoints points = corners_station(tag);
    RefinedTag& seen = tags.emplace_back();
    seen.id = tag.id;
    const Biases& bias = bias_of(tag.id);
    for (std::size_t i = 0; i < 4; ++i) {
      double sigma = noise_px;
      if (errors_.noise_per_blur_px > 0.0) {
        const double blur = (project(world.rig().camera, T_camera_station_close * points[i]) -
                             project(world.rig().camera, T_camera_station_open * points[i]))
                                .norm();
        sigma = std::hypot(noise_px, errors_.noise_per_blur_px * blur);
      }
      for (Eigen::Index axis = 0; axis < 2; ++axis) {
        const auto place = static_cast<Eigen::Index>(2 * i) + axis;
        const double lasting = errors_.bias_follows_pixels ? on_pixels(bias, place, (*corners)[i]) : bias.normal[place];
        seen.corners_px[i][axis] = (*corners)[i][axis] + sigma * noise.normal() + bias_px * lasting;
        seen.covariance_px2(place, place) = std::pow(errors_.claimed_share * sigma, 2);
      }
    }
    seen.terms = "drawn";
  }
  if (tags.empty()) return Unseen::no_tag;
  Sighting sighting = Unseen::no_pose;
  if (predicted && tags.size() > 1)
    sighting = board_pose(tags, surveyed_, calibrated_.camera, prior_, predicted, PoseStarts::only_guess);
  if (std::holds_alternative<Unseen>(sighting))
    sighting = board_pose(tags, surveyed_, calibrated_.camera, prior_, predicted, PoseStarts::all);
  if (BoardSighting* board = std::get_if<BoardSighting>(&sighting)) {
    board->frame_number = frame;
    board->time = mid_exposure;
  }
  return sighting;
}

}  // namespace tagdock
