#pragma once

#include <optional>
#include <span>
#include <string_view>

#include "calibration/camera_model.h"
#include "calibration/target.h"
#include "detection/fitted_tag.h"
#include "detection/tag_pose.h"

namespace tagdock {

/// Fits one pose of a known board to the grey values of all its tags: every border is where the pose and the lens put
/// it; each tag keeps light, ink and tone of its own, and all share one blur unless their own blurs contradict that.
/// Gauss-Newton from a pose that the corners gave. Where the tags' free corners contradict the board (a tag that hangs
/// elsewhere than it was surveyed) a common pose would be wrong in a way that no pixel shows, so it is refused.
/// Source: notes on detection, section 8, "with known intrinsics".
/// @param tags      as fitted one by one; left as the common pose has them
/// @param sighting  `board_pose` of the same tags; gets the pose and its covariance, unchanged where the fit is refused
/// @return          whose the pose is now
PoseSource fit_board(std::span<FittedTag> tags, const Board& board, const CameraModel& camera,
                     const std::optional<GroundPrior>& prior, BoardSighting& sighting);

}  // namespace tagdock
