#include "calibration/wizard.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <sstream>
#include <stdexcept>

namespace tagdock {
namespace {

/// Median way of the corners that two views share; infinite if they share few.
double way(const CalibrationView& a, const CalibrationView& b) {
  std::map<int, Eigen::Vector2d> places;
  for (const SeenPoint& seen : a.corners) places[seen.id] = seen.pixel;
  std::vector<double> ways;
  for (const SeenPoint& seen : b.corners)
    if (const auto at = places.find(seen.id); at != places.end()) ways.push_back((at->second - seen.pixel).norm());
  if (2 * ways.size() < std::max(a.corners.size(), b.corners.size()) || ways.empty()) return 1e9;
  std::nth_element(ways.begin(), ways.begin() + static_cast<std::ptrdiff_t>(ways.size() / 2), ways.end());
  return ways[ways.size() / 2];
}

std::string figure(double value) {
  std::ostringstream text;
  text.precision(3);
  text << value;
  return text.str();
}

std::size_t used_views(const WizardState& state) {
  if (!state.result) return 0;
  return static_cast<std::size_t>(std::count_if(state.result->views.begin(), state.result->views.end(),
                                                [](const ViewResidual& view) { return view.used; }));
}

}  // namespace

std::string advice(const WizardState& state, const WizardConfig& config) {
  if (state.finished) return "enough views; the result can be used";
  if (state.kept.size() < config.first_solution)
    return "hold the board still in the picture, tilted, each time another way (" + std::to_string(state.kept.size()) +
           " of the first " + std::to_string(config.first_solution) + " views)";
  if (!state.wishes.empty()) return state.wishes.front().sentence;
  return "hold the board tilted and closer";
}

WizardStep step(const WizardState& now, const CalibrationView& view, const WizardConfig& config, bool forced) {
  WizardStep result;
  result.next = now;
  result.next.last = view;
  if (now.finished) return result;
  for (const CalibrationView& before : now.kept)
    if (way(before, view) == 0.0) return result;  // the very same picture: a session that goes on with its folder
  if (!forced) {
    constexpr std::size_t least_corners = 12;
    if (view.corners.size() < least_corners || !now.last || way(*now.last, view) > config.still_px) return result;
    for (const CalibrationView& before : now.kept)
      if (way(before, view) < config.new_view_px) return result;
  }
  result.keep = true;
  result.next.kept.push_back(view);
  // Judged among all that were kept: what blurs is known only beside what does not.
  const ViewResidual judged = judge_views(result.next.kept).back();
  result.sentence = "view " + std::to_string(result.next.kept.size()) +
                    (judged.used ? ": kept, " + std::to_string(view.corners.size()) + " corners"
                                 : ": kept, but not used (" + judged.reason + ")");
  if (result.next.kept.size() >= config.first_solution) {
    try {
      IntrinsicsConfig quick;
      quick.lens = LensModel::brown4;  // the ladder is climbed once, at the end
      result.next.result = calibrate_intrinsics(result.next.kept, now.width, now.height, quick);
      result.next.wishes = next_best_views(*result.next.result, now.board, 3);
      const double sigma = result.next.result->sigma_max_px;
      if (std::isfinite(sigma)) result.sentence += "; projection known to " + figure(sigma) + " px at worst";
      const std::size_t used = used_views(result.next);
      result.next.finished =
          (used >= config.least_views && sigma <= config.enough_sigma_px && result.next.result->complaints.empty()) ||
          result.next.kept.size() >= config.most_views;
    } catch (const std::invalid_argument& error) {
      result.sentence += std::string("; ") + error.what();
    }
  }
  result.sentence += ". Next: " + advice(result.next, config);
  return result;
}

}  // namespace tagdock
