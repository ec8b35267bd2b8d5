#include "app/calibration_report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

#include <Eigen/Geometry>

#include "planning/pose2.h"

namespace tagdock {
namespace {

using Eigen::Vector2d;

constexpr Ink grey_line{-1, 0xb0b0b0, 0.8, 1.0};
constexpr Ink blue_dot{0x1f5fa8, -1, 1.0, 0.45};
constexpr Ink red_line{-1, 0xb3261e, 1.0, 0.9};
constexpr Ink blue_line{-1, 0x1f5fa8, 1.4, 1.0};
constexpr Ink bar{0x1f5fa8, -1, 1.0, 0.9};
constexpr Ink pale_bar{0xb9cbe0, -1, 1.0, 1.0};

std::string text_of(const char* format, auto... values) {
  char text[512];
  std::snprintf(text, sizeof text, format, values...);
  return text;
}

/// With as many decimals as leave two digits that say something: 0.0004 mm is not 0.00 mm, nor 35 px 35.683 px.
std::string rounded(double value) {
  if (!std::isfinite(value)) return "an unknown number of";
  const double size = std::abs(value);
  const int decimals = size > 0.0 ? static_cast<int>(std::ceil(1.0 - std::log10(size) - 1e-9)) : 0;
  return text_of("%.*f", std::clamp(decimals, 0, 5), value);
}

/// White over yellow and red to dark, for a share from 0 to 1.
int heat(double share) {
  constexpr std::array<std::array<double, 3>, 5> stops{
      {{255, 255, 245}, {254, 224, 144}, {252, 141, 89}, {215, 48, 39}, {103, 0, 31}}};
  const double at = std::clamp(share, 0.0, 1.0) * (stops.size() - 1);
  const std::size_t i = std::min(stops.size() - 2, static_cast<std::size_t>(at));
  int value = 0;
  for (std::size_t k = 0; k < 3; ++k)
    value =
        (value << 8) |
        static_cast<int>(std::lround(stops[i][k] + (at - static_cast<double>(i)) * (stops[i + 1][k] - stops[i][k])));
  return value;
}

Axes picture_axes(const CameraModel& camera) {
  Axes axes;
  axes.most = Vector2d(camera.width, camera.height);
  axes.width = 390.0;
  axes.height = 390.0 * camera.height / camera.width;
  axes.y_down = true;
  return axes;
}

Figure heat_map(const std::string& title, const CameraModel& camera, const ImageMap& map) {
  const Axes axes = picture_axes(camera);
  Figure figure(title, 540.0, axes.height + 75.0);
  const double most = std::max(1e-9, map.largest());
  for (int row = 0; row < map.rows; ++row)
    for (int column = 0; column < map.columns; ++column) {
      const double value = map.values[static_cast<std::size_t>(row * map.columns + column)].norm();
      figure.rectangle(axes.corner + Vector2d(axes.width * column / map.columns, axes.height * row / map.rows),
                       axes.width / map.columns + 0.3, axes.height / map.rows + 0.3,
                       {heat(value / most), -1, 1.0, 1.0});
    }
  axes.draw(figure, "u [px]", "v [px]");
  for (int i = 0; i < 20; ++i)
    figure.rectangle(axes.corner + Vector2d(axes.width + 14.0, axes.height * (19 - i) / 20.0), 12.0,
                     axes.height / 20.0 + 0.3, {heat((i + 0.5) / 20.0), -1, 1.0, 1.0});
  figure.text(axes.corner + Vector2d(axes.width + 10.0, -4.0), rounded(most) + " px", 10.0);
  figure.text(axes.corner + Vector2d(axes.width + 10.0, axes.height + 12.0), "0", 10.0);
  return figure;
}

/// The largest of 1, 2 and 5 times a power of ten that is not above the value.
double round_below(double value) {
  if (!(value > 0.0) || !std::isfinite(value)) return 1.0;
  const double power = std::pow(10.0, std::floor(std::log10(value)));
  return power * (value >= 5.0 * power ? 5.0 : value >= 2.0 * power ? 2.0 : 1.0);
}

/// How much of the way from a point within the axes' frame to another one lies within it.
double share_within(const Axes& axes, const Vector2d& from, const Vector2d& to) {
  double share = 1.0;
  const Vector2d far = axes.corner + Vector2d(axes.width, axes.height);
  for (int k = 0; k < 2; ++k) {
    if (to[k] > far[k]) share = std::min(share, (far[k] - from[k]) / (to[k] - from[k]));
    if (to[k] < axes.corner[k]) share = std::min(share, (axes.corner[k] - from[k]) / (to[k] - from[k]));
  }
  return std::clamp(share, 0.0, 1.0);
}

Figure residual_map(const IntrinsicsResult& result) {
  const Axes axes = picture_axes(result.camera);
  const double pixels_drawn = result.camera.width / axes.width;  // one unit of the drawing, in px of the picture
  const double larger = round_below(result.rms_px > 0.0 ? 15.0 * pixels_drawn / result.rms_px : 1.0);
  Figure figure(text_of("residuals of the corners, drawn %.0f times larger", larger), 480.0, axes.height + 75.0);
  const std::size_t stride = std::max<std::size_t>(1, result.corners.size() / 2500);
  for (std::size_t i = 0; i < result.corners.size(); i += stride) {
    const CornerLeft& corner = result.corners[i];
    const Vector2d at = axes(corner.pixel);
    const Vector2d end = at + larger / pixels_drawn * corner.residual;
    figure.line(at, at + share_within(axes, at, end) * (end - at), red_line);
  }
  axes.draw(figure, "u [px]", "v [px]");
  return figure;
}

Figure coverage(const IntrinsicsResult& result) {
  const Axes axes = picture_axes(result.camera);
  Figure figure("coverage: every corner that was used", 480.0, axes.height + 75.0);
  for (const CornerLeft& corner : result.corners) figure.circle(axes(corner.pixel), 1.6, blue_dot);
  axes.draw(figure, "u [px]", "v [px]");
  return figure;
}

/// Points with the rms over bins of x drawn through them.
Figure against(const std::string& title, const std::string& x_label, const std::string& y_label,
               const std::vector<Vector2d>& points, double least_x, double most_x) {
  Axes axes;
  double most = 1e-6;
  for (const Vector2d& point : points) most = std::max(most, point.y());
  axes.least = Vector2d(least_x, 0.0);
  axes.most = Vector2d(std::max(most_x, least_x + 1e-3), 1.05 * most);
  const double beside = 0.03 * (axes.most.x() - axes.least.x());
  axes.most.x() += beside;
  if (least_x > beside) axes.least.x() -= beside;
  axes.height = 260.0;
  Figure figure(title, 480.0, 340.0);
  const std::size_t stride = std::max<std::size_t>(1, points.size() / 2500);
  for (std::size_t i = 0; i < points.size(); i += stride) figure.circle(axes(points[i]), 1.6, blue_dot);
  constexpr int bins = 10;
  std::vector<Vector2d> means;
  for (int bin = 0; bin < bins; ++bin) {
    const double from = axes.least.x() + (axes.most.x() - axes.least.x()) * bin / bins;
    const double to = axes.least.x() + (axes.most.x() - axes.least.x()) * (bin + 1) / bins;
    double squares = 0.0;
    int count = 0;
    for (const Vector2d& point : points)
      if (point.x() >= from && point.x() < to + 1e-9) {
        squares += point.y() * point.y();
        ++count;
      }
    if (count > 0) means.push_back(axes({0.5 * (from + to), std::sqrt(squares / count)}));
  }
  figure.shape(means, false, {-1, 0xb3261e, 2.0, 1.0});
  axes.draw(figure, x_label, y_label);
  return figure;
}

struct Bar {
  std::string name;
  double value;
  bool pale;
};

/// @param x_label    what the names below the bars are
/// @param top_value  of the axis; 0: as tall as the bars are
Figure bars(const std::string& title, const std::string& x_label, const std::string& y_label,
            const std::vector<Bar>& all, double top_value = 0.0) {
  // Pale bars say what was not taken: they do not make the others too small to be read.
  double most = 0.0;
  for (const Bar& one : all)
    if (!one.pale) most = std::max(most, one.value);
  double most_pale = 0.0;
  for (const Bar& one : all)
    if (one.pale && std::isfinite(one.value)) most_pale = std::max(most_pale, one.value);
  most = most > 0.0 ? std::max(most, std::min(2.0 * most, most_pale)) : std::max(1e-6, most_pale);
  if (top_value > 0.0) most = top_value;
  Axes axes;
  axes.most = Vector2d(static_cast<double>(std::max<std::size_t>(1, all.size())), 1.05 * most);
  axes.height = 260.0;
  Figure figure(title, 480.0, 340.0);
  const double step = axes.width / axes.most.x();
  std::size_t too_tall = 0;
  for (std::size_t i = 0; i < all.size(); ++i) {
    const double at = static_cast<double>(i);
    const bool cut = !(all[i].value <= axes.most.y());
    too_tall += cut ? 1 : 0;
    const Vector2d top = axes({at, cut ? axes.most.y() : all[i].value});
    figure.rectangle(top + Vector2d(0.1 * step, 0.0), 0.8 * step, axes.corner.y() + axes.height - top.y(),
                     all[i].pale ? pale_bar : bar);
    axes.names.emplace_back(at + 0.5, all[i].name);
  }
  if (too_tall > 0)
    figure.text(axes.corner + Vector2d(axes.width, -8.0), text_of("%zu pale reach beyond the top", too_tall), 10.0,
                1.0);
  axes.draw(figure, x_label, y_label);
  return figure;
}

/// Residuals over their rms against the bell that they should follow.
Figure histogram(const IntrinsicsResult& result) {
  constexpr int bins = 41;
  constexpr double reach = 5.0;
  std::array<double, bins> count{};
  double total = 0.0;
  for (const CornerLeft& corner : result.corners)
    for (const double value : {corner.residual.x(), corner.residual.y()}) {
      const double z = value / std::max(1e-9, result.rms_px);
      const int bin = static_cast<int>(std::floor((z + reach) / (2.0 * reach) * bins));
      if (bin >= 0 && bin < bins) count[static_cast<std::size_t>(bin)] += 1.0;
      total += 1.0;
    }
  Axes axes;
  axes.least = Vector2d(-reach, 0.0);
  axes.most = Vector2d(reach, 1.1 * std::max(1.0, *std::max_element(count.begin(), count.end())));
  axes.height = 260.0;
  Figure figure("residuals over their rms (line: what chance alone would give)", 480.0, 340.0);
  const double width = 2.0 * reach / bins;
  for (int bin = 0; bin < bins; ++bin) {
    const double from = -reach + bin * width;
    const Vector2d top = axes({from, count[static_cast<std::size_t>(bin)]});
    figure.rectangle(top, axes.width / bins, axes.corner.y() + axes.height - top.y(), pale_bar);
  }
  std::vector<Vector2d> bell;
  for (int i = 0; i <= 100; ++i) {
    const double z = -reach + 2.0 * reach * i / 100.0;
    bell.push_back(axes({z, total * width * std::exp(-0.5 * z * z) / std::sqrt(2.0 * std::acos(-1.0))}));
  }
  figure.shape(bell, false, red_line);
  axes.draw(figure, "residual over rms, u and v", "number");
  return figure;
}

Figure top_view(const HandEyeProblem& problem, const HandEyeResult& result) {
  // In the board's own plane of the floor: x along the wall to the right, y away from it.
  Figure figure("stops from above, the board on top; shaded: the cone of 25 degrees; orange: frontal, grey: not used",
                480.0, 420.0);
  std::vector<Vector2d> places;
  std::vector<Vector2d> sights;
  for (std::size_t i = 0; i < result.stops.size(); ++i) {
    if (problem.stops[i].corners.empty() || result.stops[i].T_board_camera.translation().norm() == 0.0) {
      places.emplace_back(0, 0);
      sights.emplace_back(0, 0);
      continue;
    }
    const Eigen::Isometry3d& T = result.stops[i].T_board_camera;
    places.emplace_back(T.translation().x(), -T.translation().z());
    sights.emplace_back(T.linear()(0, 2), -T.linear()(2, 2));
  }
  double reach = 0.5;
  for (const Vector2d& place : places) reach = std::max({reach, std::abs(place.x()), std::abs(place.y())});
  reach *= 1.15;
  Axes axes;
  axes.least = Vector2d(-reach, -0.15 * reach);
  axes.most = Vector2d(reach, 1.55 * reach);
  axes.width = 390.0;
  axes.height = 330.0;
  axes.y_down = true;  // the wall on top: right is right for a person who faces it
  const double cone = std::tan(radians(25.0)) * 1.5 * reach;
  figure.shape({axes({0, 0}), axes({-cone, 1.5 * reach}), axes({cone, 1.5 * reach})}, true, {0xf3e3c3, -1, 1.0, 0.7});
  figure.line(axes({-0.12 * reach, 0}), axes({0.12 * reach, 0}), {-1, 0x1a1a1a, 4.0, 1.0});
  std::vector<Eigen::AlignedBox2d> named;
  for (std::size_t i = 0; i < places.size(); ++i) {
    if (places[i].norm() == 0.0) continue;
    const Ink ink{result.stops[i].used ? (result.stops[i].frontal ? 0xc08000 : 0x1f5fa8) : 0xc0c0c0, -1, 1.0, 1.0};
    figure.circle(axes(places[i]), 4.0, ink);
    figure.line(axes(places[i]), axes(places[i] + 0.12 * reach * sights[i]), blue_line);
    // Below it, where no line of sight runs, and only where it can be read; the table has all of them.
    const std::string name = std::to_string(result.stops[i].id);
    const Vector2d at = axes(places[i]) + Vector2d(0, 13);
    const Vector2d half(3.0 * static_cast<double>(name.size()), 0.0);
    const Eigen::AlignedBox2d room(at - half - Vector2d(0.0, 8.0), at + half);
    const bool free = std::none_of(named.begin(), named.end(), [&](const Eigen::AlignedBox2d& other) {
      return !room.intersection(other).isEmpty();
    });
    const bool clear = std::none_of(places.begin(), places.end(),
                                    [&](const Vector2d& place) { return room.exteriorDistance(axes(place)) < 4.0; });
    if (!free || !clear) continue;
    named.push_back(room);
    figure.text(at, name, 9.0, 0.5);
  }
  axes.draw(figure, "along the board [m]", "before it [m]");
  return figure;
}

Figure determined(const HandEyeResult& result) {
  std::vector<Bar> all;
  for (std::size_t i = 0; i < result.direction_ratios.size(); ++i)
    all.push_back({i < result.direction_words.size() ? result.direction_words[i] : std::to_string(i + 1),
                   100.0 * result.direction_ratios[i], result.direction_ratios[i] > 0.2});
  return bars("what the drive leaves open of what was not known before (pale: not determined)",
              "direction, named by its largest part", "%", all, 100.0);
}

}  // namespace

Report intrinsics_report(const IntrinsicsResult& result, double working_distance) {
  Report report;
  report.title = "Calibration of the camera";
  report.good = result.complaints.empty();
  const double mm = 1000.0 * working_distance / result.camera.fx;
  if (report.good)
    report.verdict.push_back(text_of(
        "Good. At %.1f m from the dock this calibration is wrong by %s mm in the middle of the picture and "
        "by %s mm in its worst corner (one sigma).",
        working_distance, rounded(mm * result.sigma_center_px).c_str(), rounded(mm * result.sigma_max_px).c_str()));
  for (const std::string& complaint : result.complaints) report.verdict.push_back("Refused: " + complaint + ".");
  for (const std::string& sentence : result.missing) report.verdict.push_back("To add: " + sentence + ".");
  std::size_t used = 0;
  for (const ViewResidual& view : result.views) used += view.used ? 1 : 0;
  report.sentences.push_back(text_of(
      "%zu of %zu views and %zu corners were used; they leave %s px rms. The projection is known to %s px in the "
      "middle and %s px at worst (root of the mean square length, far away, after the best turn).",
      used, result.views.size(), result.corners.size(), rounded(result.rms_px).c_str(),
      rounded(result.sigma_center_px).c_str(), rounded(result.sigma_max_px).c_str()));
  report.sentences.push_back(
      result.halves_expected_px > 0.0
          ? text_of("Two halves of the views, solved apart, differ by %s px over the image; their noise explains %s "
                    "px. A model of lens or board that is wrong shows here, not in the residuals.",
                    rounded(result.halves_px).c_str(), rounded(result.halves_expected_px).c_str())
          : "Two halves of the views were not compared: that needs eight views or more that can be used. Without it a "
            "wrong model of lens or board may stay unseen.");
  report.sentences.push_back(text_of("The board is bowed by %.2f mm, and its print is %.3f permille wider than high.",
                                     1000.0 * result.board.bow(), 1000.0 * result.board.value[BoardShape::stretch]));
  report.sentences.push_back(text_of(
      "fx %.3f, fy %.3f, cx %.3f, cy %.3f; k1 %.6f, k2 %.6f, p1 %.6f, p2 %.6f, k3 %.6f, k4 %.6f, k5 %.6f, k6 %.6f.",
      result.camera.fx, result.camera.fy, result.camera.cx, result.camera.cy, result.camera.k1, result.camera.k2,
      result.camera.p1, result.camera.p2, result.camera.k3, result.camera.k4, result.camera.k5, result.camera.k6));
  Report::Table ladder{
      "Lens models on views that they had not seen; a richer one is chosen if it is clearly better there",
      {{"lens", "error in sigmas of the corners", "chosen"}}};
  for (const IntrinsicsResult::Step& step : result.ladder)
    ladder.rows.push_back(
        {std::string(word(step.lens)), text_of("%.4f", step.held_out), step.lens == result.lens ? "yes" : ""});
  if (!result.ladder.empty()) report.tables.push_back(ladder);
  if (!result.corners.empty()) {
    report.figures.push_back(residual_map(result));
    report.figures.push_back(coverage(result));
    if (!result.sigma.values.empty())
      report.figures.push_back(heat_map("uncertainty of the projection, one sigma", result.camera, result.sigma));
    if (!result.halves.values.empty())
      report.figures.push_back(heat_map("difference of two halves of the views", result.camera, result.halves));
    std::vector<Vector2d> by_distance;
    std::vector<Vector2d> by_radius;
    double nearest = 1e9;
    double farthest = 0.0;
    double widest = 0.0;
    for (const CornerLeft& corner : result.corners) {
      const double distance = result.views[corner.view].distance;
      nearest = std::min(nearest, distance);
      farthest = std::max(farthest, distance);
      const double radius = (corner.pixel - Vector2d(result.camera.cx, result.camera.cy)).norm();
      widest = std::max(widest, radius);
      by_distance.emplace_back(distance, corner.residual.norm());
      by_radius.emplace_back(radius, corner.residual.norm());
    }
    report.figures.push_back(against("reprojection error against distance (line: rms)", "distance of the board [m]",
                                     "px", by_distance, nearest, farthest));
    report.figures.push_back(against("reprojection error against the distance from the image's middle",
                                     "px from the middle", "px", by_radius, 0.0, widest));
    report.figures.push_back(histogram(result));
    std::vector<Bar> by_view;
    for (std::size_t i = 0; i < result.views.size(); ++i)
      if (result.views[i].used) by_view.push_back({std::to_string(i), result.views[i].rms_px, false});
    report.figures.push_back(bars("residuals by view", "view, as numbered in the table below", "px rms", by_view));
  }
  Report::Table views{"Views",
                      {{"no", "picture", "used", "corners", "rms px", "blur px", "tilt deg", "distance m", "why not"}}};
  for (std::size_t i = 0; i < result.views.size(); ++i) {
    const ViewResidual& view = result.views[i];
    views.rows.push_back({std::to_string(i), view.name, view.used ? "yes" : "no", std::to_string(view.corners),
                          view.used ? text_of("%.3f", view.rms_px) : "", text_of("%.2f", view.blur_px),
                          view.used ? text_of("%.0f", view.tilt_deg) : "",
                          view.used ? text_of("%.3f", view.distance) : "", view.reason});
  }
  report.tables.push_back(views);
  return report;
}

Report hand_eye_report(const HandEyeProblem& problem, const HandEyeResult& result) {
  Report report;
  report.title = "The camera on the base" + std::string(problem.by_wheels ? ", and the wheels" : "");
  report.good = result.complaints.empty();
  const double place = 1000.0 * std::sqrt(2.0) * result.xy_sigma;
  if (report.good)
    report.verdict.push_back(
        text_of("Good. At the dock this is %.2f mm if the dock's place comes from a drawing, and %.2f mm if it was "
                "taught and is reached "
                "10 degrees beside the heading taught (one sigma). A metre driven blind adds %.2f mm.",
                place, 2.0 * std::sin(0.5 * radians(10.0)) * place, 1000.0 * result.rotation_sigma));
  for (const std::string& complaint : result.complaints) report.verdict.push_back("Refused: " + complaint + ".");
  for (const Unobservable& open : result.unobservable) {
    const bool refused = std::any_of(result.complaints.begin(), result.complaints.end(), [&](const std::string& told) {
      return told.starts_with(open.word + " is not determined");
    });
    if (!refused) report.verdict.push_back("Not determined: " + open.word + ": " + open.cure + ".");
  }
  const Eigen::Vector3d t = result.T_base_camera.translation();
  report.sentences.push_back(text_of(
      "Camera on the base: x %.4f m, y %.4f m (each +- %.2f mm), z %.3f m (+- %.0f mm), direction +- %.3f degrees.",
      t.x(), t.y(), 1000.0 * result.xy_sigma, t.z(), 1000.0 * result.z_sigma, degrees(result.rotation_sigma)));
  if (problem.by_wheels)
    report.sentences.push_back(
        text_of("Wheels: left %.5f m, right %.5f m, track %.5f m; relative sigmas %.2f, %.2f, %.2f permille.",
                result.odometry.r_left, result.odometry.r_right, result.odometry.track,
                1000.0 * std::sqrt(result.covariance(6, 6)) / result.odometry.r_left,
                1000.0 * std::sqrt(result.covariance(7, 7)) / result.odometry.r_right,
                1000.0 * std::sqrt(result.covariance(8, 8)) / result.odometry.track));
  report.sentences.push_back(text_of(
      "Headings spread over %.0f degrees, places over %.2f m. Noise over what was stated: corners %.2f, %s %.2f.",
      degrees(result.heading_spread), result.travel, result.corner_scale, problem.by_wheels ? "wheels" : "tracker",
      result.motion_scale));
  report.sentences.push_back(result.visp.solved
                                 ? text_of("ViSP's vpHandEyeCalibration on the same stops differs by %.2f mm in the "
                                           "floor plane; it gives no uncertainty, "
                                           "and its height is arbitrary on a planar base.",
                                           1000.0 * (result.visp.T_base_camera.translation() - t).head<2>().norm())
                                 : "ViSP's vpHandEyeCalibration does not converge on these stops.");
  report.sentences.emplace_back("The paper's hand-eye calibration reached 3 mm and 0.15 degrees.");
  report.figures.push_back(top_view(problem, result));
  std::vector<Vector2d> by_distance;
  std::vector<Bar> corners;
  std::vector<Bar> base;
  double nearest = 1e9;
  double farthest = 0.0;
  Report::Table stops{
      "Stops", {{"stop", "used", "bearing deg", "distance m", "corners px rms", "base mm", "base deg", "remark"}}};
  for (const StopResidual& stop : result.stops) {
    if (stop.used) {
      by_distance.emplace_back(stop.distance, stop.corner_rms_px);
      nearest = std::min(nearest, stop.distance);
      farthest = std::max(farthest, stop.distance);
    }
    corners.push_back({std::to_string(stop.id), stop.corner_rms_px, !stop.used});
    base.push_back({std::to_string(stop.id), stop.base_mm, !stop.used});
    stops.rows.push_back({std::to_string(stop.id), stop.used ? "yes" : "no", text_of("%.0f", stop.bearing_deg),
                          text_of("%.2f", stop.distance), text_of("%.3f", stop.corner_rms_px),
                          text_of("%.2f", stop.base_mm), text_of("%.3f", stop.base_deg),
                          !stop.used     ? stop.reason
                          : stop.frontal ? "frontal: not used for start values"
                                         : ""});
  }
  report.figures.push_back(against("reprojection error against distance (line: rms)", "distance of the board [m]",
                                   "px rms", by_distance, nearest, farthest));
  report.figures.push_back(bars("corner residuals by stop (pale: not used)", "stop", "px rms", corners));
  report.figures.push_back(
      problem.by_wheels
          ? bars("wheels against the solution, by way (pale: stop not used)", "stop that the way begins at", "mm", base)
          : bars("tracker against the solution, by stop (pale: not used)", "stop", "mm", base));
  report.figures.push_back(determined(result));
  report.tables.push_back(stops);
  return report;
}

}  // namespace tagdock
