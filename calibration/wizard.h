#pragma once

#include <optional>
#include <string>
#include <vector>

#include "calibration/intrinsics.h"

namespace tagdock {

/// Where a person stands who calibrates a camera. A pure state machine: pictures' views go in, what to do comes out.
struct WizardState {
  int width = 0;
  int height = 0;
  std::vector<Eigen::Vector3d> board;      ///< the board's points, to plan views with
  std::vector<CalibrationView> kept;       ///< every view that was taken, good or not
  std::optional<CalibrationView> last;     ///< the picture before, kept or not
  std::optional<IntrinsicsResult> result;  ///< of the kept views, once there are enough
  std::vector<ViewWish> wishes;            ///< the views that would help most now
  bool finished = false;
};

struct WizardConfig {
  double still_px = 1.0;           ///< between two pictures in which the board counts as standing still
  double new_view_px = 40.0;       ///< from all kept views, before another is taken by itself
  std::size_t first_solution = 6;  ///< views
  double enough_sigma_px = 0.3;    ///< worst uncertainty over the image at which the wizard says "enough"
  std::size_t least_views = 12;
  std::size_t most_views = 60;
};

/// What came of one picture.
struct WizardStep {
  WizardState next;
  bool keep = false;     ///< write this picture to the session
  std::string sentence;  ///< for the person; empty if nothing changed
};

/// One picture more.
/// @param forced  take it whatever it shows (a picture of a folder, or the person pressed a key)
WizardStep step(const WizardState& now, const CalibrationView& view, const WizardConfig& config, bool forced);

/// What to do next, in one sentence.
std::string advice(const WizardState& state, const WizardConfig& config);

}  // namespace tagdock
