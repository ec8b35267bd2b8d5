#include "detection/tag_locator.h"

#include <algorithm>
#include <cmath>
#include <stdexcept>
#include <utility>

#include "detection/board_fit.h"
#include "detection/tag_following.h"
#include "planning/pose2.h"

namespace tagdock {
namespace {

constexpr double least_region_px = 48.0;  ///< a far board's region still holds a tag and its surroundings
/// Ideal image places farther out than this are not projected: lens models fold over there.
constexpr double widest_ideal = 2.0;

Board checked(const Board& board) {
  if (board.tags.empty()) throw std::invalid_argument("the board has no tags");
  for (const BoardTag& tag : board.tags) {
    if (!(std::isfinite(tag.size) && tag.size > 0.0))
      throw std::invalid_argument("tag " + std::to_string(tag.id) + " of the board has no positive size");
    if (!tag.T_station_tag.matrix().allFinite())
      throw std::invalid_argument("the place of tag " + std::to_string(tag.id) + " on the board is not finite");
    if (std::count_if(board.tags.begin(), board.tags.end(), [&](const BoardTag& t) { return t.id == tag.id; }) > 1)
      throw std::invalid_argument("tag " + std::to_string(tag.id) + " is on the board twice");
  }
  return board;
}

TagDetectorConfig detector_config(const TagLocatorConfig& config, const Board& board) {
  TagDetectorConfig detector = config.detector;
  detector.family = board.family;
  return detector;
}

/// Where the board should be in the image, enlarged; none if part of it would be behind the lens or out of its field.
std::optional<cv::Rect> predicted_region(const Board& board, const Eigen::Isometry3d& T_camera_station,
                                         const CameraModel& camera, double margin) {
  if (!T_camera_station.matrix().allFinite()) return std::nullopt;
  Eigen::AlignedBox2d box;
  for (const BoardTag& tag : board.tags)
    for (const Eigen::Vector3d& corner : corners_station(tag)) {
      const Eigen::Vector3d corner_camera = T_camera_station * corner;
      if (!(corner_camera.z() > 0.0) ||
          !(corner_camera.head<2>().cwiseAbs().maxCoeff() < widest_ideal * corner_camera.z()))
        return std::nullopt;
      box.extend(project(camera, corner_camera));
    }
  const Eigen::Vector2d size = box.sizes();
  // The larger side sets the margin: a prediction errs by the robot's turning, alike in every direction of the image.
  const double reach = margin * size.maxCoeff();
  const Eigen::Vector2d half = (0.5 * size).array().max(0.5 * least_region_px) + reach;
  const Eigen::AlignedBox2d grown(box.center() - half, box.center() + half);
  const Eigen::AlignedBox2d image(Eigen::Vector2d::Zero(), Eigen::Vector2d(camera.width, camera.height));
  const Eigen::AlignedBox2d region = grown.intersection(image);
  if (region.isEmpty() || !region.sizes().allFinite()) return std::nullopt;
  const Eigen::Vector2i first = region.min().array().floor().cast<int>();
  const Eigen::Vector2i last = region.max().array().ceil().cast<int>();
  return cv::Rect(first.x(), first.y(), last.x() - first.x(), last.y() - first.y());
}

bool shows(const std::vector<TagDetection>& detections, const Board& board) {
  return std::any_of(detections.begin(), detections.end(),
                     [&](const TagDetection& d) { return find_tag(board, d.id) != nullptr; });
}

}  // namespace

GroundPrior ground_prior(const Rig& rig, const TagLocatorConfig& config) {
  return {rig.T_base_camera, radians(config.sigma_roll_deg), radians(config.sigma_pitch_deg),
          1e-3 * config.sigma_height_mm};
}

TagLocator::TagLocator(const Rig& rig, const Board& board, const TagLocatorConfig& config)
    : rig_(rig), board_(checked(board)), config_(config), detector_(detector_config(config, board)) {
  check(rig.camera);
  config_.detector.family = board.family;
  for (const double positive :
       {config.region_margin, config.sigma_roll_deg, config.sigma_pitch_deg, config.sigma_height_mm})
    if (!(std::isfinite(positive) && positive > 0.0))
      throw std::invalid_argument("region margin and the sigmas of roll, pitch and height must be positive");
}

Sighting TagLocator::locate(const Frame& frame, const std::optional<Eigen::Isometry3d>& predicted) const {
  if (frame.gray.cols != rig_.camera.width || frame.gray.rows != rig_.camera.height)
    throw std::invalid_argument("the frame has " + std::to_string(frame.gray.cols) + "x" +
                                std::to_string(frame.gray.rows) + " pixels, the rig's camera model " +
                                std::to_string(rig_.camera.width) + "x" + std::to_string(rig_.camera.height));
  // 1. where the tags are: followed, or found in a region or the whole frame
  std::vector<TagDetection> detections;
  bool followed = false;
  if (predicted && config_.follow) {
    FollowedTags there = follow_tags(frame.gray, board_, rig_.camera, *predicted, config_.detector.max_hamming,
                                     config_.detector.border_px);
    followed = there.expected > 0 && static_cast<int>(there.tags.size()) == there.expected;
    if (followed) detections = std::move(there.tags);
  }
  const std::optional<cv::Rect> region =
      predicted && !followed ? predicted_region(board_, *predicted, rig_.camera, config_.region_margin) : std::nullopt;
  if (region) detections = detector_.detect(frame.gray, *region);
  if (!shows(detections, board_)) detections = detector_.detect(frame.gray);
  if (detections.empty()) return Unseen::no_tag;
  if (!shows(detections, board_)) return Unseen::other_tags;

  // 2. refinement
  std::vector<RefinedTag> tags;
  std::vector<FittedTag> fitted;  // for a pose from the pixels
  const bool joint = config_.joint && config_.method == CornerMethod::best;
  bool unrefined = false;
  for (const TagDetection& detection : detections) {
    if (find_tag(board_, detection.id) == nullptr) continue;
    if (std::any_of(tags.begin(), tags.end(), [&](const RefinedTag& tag) { return tag.id == detection.id; }))
      return Unseen::duplicate_tag;
    if (joint) {
      auto whole = fit_photometric(frame.gray, board_.family, detection, PhotometricConfig{}, rig_.camera);
      if (FittedTag* one = std::get_if<FittedTag>(&whole); one != nullptr && fine_enough(one->tag)) {
        tags.push_back(one->tag);
        fitted.push_back(std::move(*one));
        continue;
      }
    }
    Refinement refined = refine(frame.gray, board_.family, detection, config_.method, rig_.camera);
    if (std::holds_alternative<Unrefined>(refined)) {
      unrefined = true;
      refined = refine(frame.gray, board_.family, detection, CornerMethod::apriltag, rig_.camera);
    }
    tags.push_back(std::get<RefinedTag>(refined));
  }

  // 3. board pose
  const std::optional<GroundPrior> prior = ground_prior(rig_, config_);
  Sighting sighting = board_pose(tags, board_, rig_.camera, prior, predicted);
  if (BoardSighting* seen = std::get_if<BoardSighting>(&sighting)) {
    seen->frame_number = frame.number;
    seen->time = frame.time;
    seen->unrefined = unrefined;
    seen->followed = followed;
    // 4. board pose from the pixels
    if (joint)
      seen->source = fitted.size() == tags.size() ? fit_board(fitted, board_, rig_.camera, prior, *seen)
                                                  : PoseSource::corners_tag_unfitted;
  }
  return sighting;
}

}  // namespace tagdock
