#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <variant>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "calibration/camera_model.h"
#include "calibration/target.h"
#include "detection/refined_tag.h"

namespace tagdock {

using Matrix6 = Eigen::Matrix<double, 6, 6>;

/// One of the poses that explain a flat tag.
struct TagPose {
  Eigen::Isometry3d T_camera_tag = Eigen::Isometry3d::Identity();
  /// [x y z rx ry rz], m and rad: a small motion applied on the left, seen in the camera frame.
  Matrix6 covariance = Matrix6::Zero();
  double reprojection_rms_px = 0.0;
  double chi2 = 0.0;  ///< of the eight coordinates under the corners' covariance
};

/// The poses that explain one flat tag, the likelier first; a flat tag seen small or head-on has two.
/// Start values from ViSP's vpPose and from the mirrored solution; each is refined against the corners under their
/// covariance.
/// @param size  side of the black square [m], > 0
/// @return      one or two; none if the corners are not a convex quadrilateral or no pose lies in front of the camera
std::vector<TagPose> tag_poses(const RefinedTag& tag, double size, const CameraModel& camera);

/// How the camera stands over the floor, and how sure that is. With it the pose of a board on the wall keeps only three
/// free values, which steadies the rest.
struct GroundPrior {
  Eigen::Isometry3d T_base_camera = Eigen::Isometry3d::Identity();
  double sigma_roll = 0.002;    ///< of the base on the floor [rad]
  double sigma_pitch = 0.0035;  ///< [rad]
  double sigma_height = 0.002;  ///< [m]
};

/// Roll, pitch and height of the base over the station's floor, as three measurements of zero: their part of the normal
/// equations of T_camera_station, by a small motion on its left.
struct PriorEquations {
  Matrix6 information = Matrix6::Zero();
  Eigen::Matrix<double, 6, 1> gradient = Eigen::Matrix<double, 6, 1>::Zero();
  double cost = 0.0;
};
PriorEquations ground_equations(const GroundPrior& prior, const Eigen::Isometry3d& T_camera_station);

/// A pose after a small motion [x y z rx ry rz] on its left.
Eigen::Isometry3d moved(const Eigen::Matrix<double, 6, 1>& motion, const Eigen::Isometry3d& T_camera_frame);

/// What a board's pose was fitted to, and if not to the pixels of all tags together, why not.
enum class PoseSource {
  corners,                   ///< the tags' corners under their covariances; no more was asked for
  pixels,                    ///< the pixels of all tags
  corners_contradict_board,  ///< the corners: they do not stand to each other as on the board, beyond chance
  corners_tag_unfitted,      ///< the corners: some tag could not be fitted as a whole
  corners_pixels_unsettled   ///< the corners: the fit to the pixels reached no minimum
};
std::string_view word(PoseSource source);

/// Where a board is, from one frame.
struct BoardSighting {
  std::uint64_t frame_number = 0;
  std::chrono::nanoseconds time{0};  ///< mid-exposure, since the session began
  Eigen::Isometry3d T_camera_station = Eigen::Isometry3d::Identity();
  /// [x y z rx ry rz], m and rad: a small motion applied on the left of T_camera_station, seen in the camera frame.
  Matrix6 covariance = Matrix6::Zero();
  double reprojection_rms_px = 0.0;
  double chi2_per_coordinate = 0.0;
  /// Log of the odds of this pose against the mirrored one of a flat tag; infinite where there is no second one.
  double log_odds = 0.0;
  std::optional<Eigen::Isometry3d> T_camera_station_mirrored;  ///< the second pose, where the odds do not settle it
  std::vector<RefinedTag> tags;                                ///< what it was made from, by id
  bool unrefined = false;  ///< some tag had to be used with the detector's own corners
  bool followed = false;   ///< the tags were found from the predicted pose, without searching the image
  PoseSource source = PoseSource::corners;
};

/// Why a frame gave no pose.
enum class Unseen {
  no_tag,          ///< no tag at all
  other_tags,      ///< tags, but none of the board's
  duplicate_tag,   ///< one of the board's ids is seen twice
  no_pose,         ///< corners that no pose in front of the camera explains
  layout_mismatch  ///< the tags do not stand to each other as on the board
};

std::string_view word(Unseen reason);

/// What one frame says of the board.
using Sighting = std::variant<BoardSighting, Unseen>;

/// Where the minimum is looked for.
enum class PoseStarts {
  all,        ///< the tags' own solutions and the guess: sees the mirrored pose of a flat tag
  only_guess  ///< a hundredth of the time, for simulations that know where to look
};

/// One pose from all corners of all the board's tags that were seen.
/// @param tags   refined tags of that board, any subset, ids unique
/// @param prior  if given, enters as three more measurements (roll, pitch, height)
/// @param guess  T_camera_station to start from besides the tags' own solutions, if one is known
/// @return       pose fields filled (frame_number and time are the caller's), or why not
Sighting board_pose(std::span<const RefinedTag> tags, const Board& board, const CameraModel& camera,
                    const std::optional<GroundPrior>& prior,
                    const std::optional<Eigen::Isometry3d>& guess = std::nullopt, PoseStarts starts = PoseStarts::all);

}  // namespace tagdock
