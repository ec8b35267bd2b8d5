// Which pictures are not fit to calibrate with, before anything is solved.
#include <algorithm>
#include <cmath>
#include <map>

#include "calibration/intrinsics.h"

namespace tagdock {
namespace {

constexpr std::size_t least_corners = 8;       // two more than a view's pose takes away
constexpr double least_share = 0.25;           // of the corners inside the picture
constexpr double blurred = 1.5;                // over the sharpest quarter of the views ...
constexpr double blurred_px = 0.25;            // ... and by at least this
constexpr double smeared = 1.6;                // worst over best direction
constexpr double clipped_share = 0.08;         // of the pixels beside the corners, beyond the usual share
constexpr double same_view_px = 3.0;           // median way of the corners between two views that are one
constexpr double least_contrast_share = 0.25;  // of the usual contrast

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(share * static_cast<double>(values.size() - 1))];
}

/// Median distance of the corners that two views share; infinite if they share few.
double way_between(const CalibrationView& a, const CalibrationView& b) {
  std::map<int, Eigen::Vector2d> places;
  for (const SeenPoint& seen : a.corners) places[seen.id] = seen.pixel;
  std::vector<double> ways;
  for (const SeenPoint& seen : b.corners)
    if (const auto at = places.find(seen.id); at != places.end()) ways.push_back((at->second - seen.pixel).norm());
  const std::size_t most = std::max(a.corners.size(), b.corners.size());
  return 2 * ways.size() < most ? 1e9 : quantile(ways, 0.5);
}

std::string figure(double value) {
  const double rounded = std::round(value * 10.0) / 10.0;
  std::string text = std::to_string(rounded);
  return text.substr(0, text.find('.') + 2);
}

}  // namespace

std::vector<ViewResidual> judge_views(const std::vector<CalibrationView>& views) {
  std::vector<double> blur;
  std::vector<double> clipped;
  std::vector<double> contrast;
  for (const CalibrationView& view : views) {
    if (view.corners.size() < least_corners) continue;
    if (view.blur_px > 0.0) blur.push_back(view.blur_px);
    clipped.push_back(view.clipped);
    contrast.push_back(view.contrast);
  }
  const double sharp = quantile(blur, 0.25);
  const double usual_clipped = quantile(clipped, 0.25);
  const double usual_contrast = quantile(contrast, 0.5);

  std::vector<ViewResidual> judged;
  for (std::size_t i = 0; i < views.size(); ++i) {
    const CalibrationView& view = views[i];
    ViewResidual result;
    result.name = view.name;
    result.corners = static_cast<int>(view.corners.size());
    result.blur_px = view.blur_px;
    if (view.marks_found == 0 && view.marks_elsewhere > 0)
      result.reason = "another board: its marks do not stand as the target says";
    else if (view.marks_found == 0)
      result.reason = "no board found";
    else if (view.marks_elsewhere > view.marks_found)
      result.reason = "another board: most marks do not stand as the target says";
    else if (view.corners.size() < least_corners)
      result.reason = "too few corners: " + std::to_string(view.corners.size());
    else if (static_cast<double>(view.corners.size()) < least_share * view.corners_expected)
      result.reason = "too few corners: " + std::to_string(view.corners.size()) + " of " +
                      std::to_string(view.corners_expected) + " inside the picture";
    else if (view.blur_px > blurred * sharp && view.blur_px > sharp + blurred_px)
      result.reason =
          (view.sharpest_px > 0.0 && view.blur_px > smeared * view.sharpest_px ? "motion blur: " : "blurred: ") +
          figure(view.blur_px) + " px, the sharp ones " + figure(sharp);
    else if (view.clipped > usual_clipped + clipped_share)
      result.reason = "saturated: " + figure(100.0 * view.clipped) + " % of the pixels beside the corners";
    else if (view.contrast < least_contrast_share * usual_contrast)
      result.reason = "too little contrast";
    else
      result.used = true;
    for (std::size_t k = 0; k < i && result.used; ++k)
      if (judged[k].used && way_between(views[k], view) < same_view_px) {
        result.used = false;
        result.reason = "the same view as " + views[k].name;
      }
    judged.push_back(result);
  }
  return judged;
}

}  // namespace tagdock
