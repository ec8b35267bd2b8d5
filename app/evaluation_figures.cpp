#include "app/evaluation_figures.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstring>
#include <limits>

#include "app/docking_report.h"
#include "app/simulation/robot_physics.h"
#include "app/svg.h"
#include "planning/docking_plan.h"
#include "servo/odometry_controller.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;

std::string with_width(const std::string& colour, double width, double opacity = 1.0) {
  char text[96];
  std::snprintf(text, sizeof text, "stroke:%s;stroke-width:%.1f;stroke-opacity:%.2f", colour.c_str(), width, opacity);
  return text;
}

// Bars of values in their unit, between -reach and reach about a centre.
void histogram(Svg& svg, const Eigen::Vector2d& corner, const std::vector<double>& values, const std::string& title,
               const std::string& unit, const std::string& colour) {
  constexpr int bins = 31;
  constexpr double width = 400.0;
  constexpr double left = 36.0;
  constexpr double top = 30.0;
  constexpr double bottom = 180.0;
  double mean = 0.0;
  for (const double value : values) mean += value / static_cast<double>(values.size());
  double square = 0.0;
  std::vector<double> sizes;
  for (const double value : values) {
    square += (value - mean) * (value - mean);
    sizes.push_back(std::abs(value - mean));
  }
  const double sigma = values.size() > 1 ? std::sqrt(square / static_cast<double>(values.size() - 1)) : 0.0;
  const double reach = std::max(1e-9, 1.05 * quantile(sizes, 0.995));
  std::array<int, bins> counts{};
  int outside = 0;
  for (const double value : values) {
    const int bin = static_cast<int>(std::floor((value - mean + reach) / (2.0 * reach) * bins));
    if (bin >= 0 && bin < bins)
      ++counts[static_cast<std::size_t>(bin)];
    else
      ++outside;
  }
  const int most = std::max(1, *std::max_element(counts.begin(), counts.end()));
  const auto at = [&](double x, double y) { return Eigen::Vector2d(corner.x() + x, corner.y() + y); };
  svg.text(at(left, 18.0), title, 14.0, "start", "font-weight:bold");
  const double step = (width - left - 14.0) / bins;
  for (int i = 0; i < bins; ++i) {
    const double tall = (bottom - top) * counts[static_cast<std::size_t>(i)] / most;
    svg.rectangle(at(left + i * step, bottom - tall), step - 1.0, tall, "fill:" + colour);
  }
  svg.line(at(left, bottom), at(width - 14.0, bottom), "stroke:#333;stroke-width:1");
  for (const double tick : axis_ticks(mean - reach, mean + reach, 6)) {
    const double x = left + (tick - mean + reach) / (2.0 * reach) * bins * step;
    svg.line(at(x, bottom), at(x, bottom + 4.0), "stroke:#333;stroke-width:1");
    svg.text(at(x, bottom + 17.0), plain(tick, 3), 11.0, "middle");
  }
  char text[160];
  std::snprintf(text, sizeof text - 32, "%s; mean %.3g, sigma %.3g", unit.c_str(), mean, sigma);
  if (outside > 0) std::snprintf(text + std::strlen(text), 32, "; %d beyond", outside);
  svg.text(at(0.5 * (left + width), bottom + 34.0), text, 12.0, "middle");
  svg.text(at(left - 6.0, top + 8.0), std::to_string(most), 11.0, "end");
}

// The trace at a distance left to the wall, on the way in; none if it was not there.
std::optional<double> y_at(const RunTrace& trace, double x) {
  for (std::size_t i = 1; i < trace.size(); ++i) {
    const Pose2& a = trace[i - 1].camera_point;
    const Pose2& b = trace[i].camera_point;
    if (a.x <= x && b.x > x) return a.y + (x - a.x) / (b.x - a.x) * (b.y - a.y);
  }
  return std::nullopt;
}

// One drive of the controller along the paper's path: lateral deviation over the way, mm over m.
std::vector<Eigen::Vector2d> driven(double damping, bool dynamic_rate, double dead_time) {
  StartScenario start;
  start.range = 3.45;
  start.bearing = radians(26.0);
  start.range_sigma = start.bearing_sigma = start.bearing_spread = start.heading_sigma = start.heading_spread =
      start.castor_sigma = 0.0;
  DriveScenario drive;
  drive.friction = drive.over_turn = drive.over_turn_field_sigma = drive.floor_coupling = drive.turn_scale_sigma =
      drive.speed_scale_sigma = drive.wheel_difference_sigma = drive.yaw_walk = 0.0;
  drive.dead_time = dead_time;
  RobotPhysics robot(start, drive, 0.35, 1);
  DockingPlanConfig wish;
  wish.limits = {1.0 / 0.97, 1.0 / 0.97 / 0.40};
  wish.straights = {};
  wish.softness = 0.0;
  wish.view.reset();
  const DockingPlanResult planned = plan_docking(robot.truth().T_station_base, {-1.35, 0.0, 0.0}, wish);
  const DockingPlan* plan = std::get_if<DockingPlan>(&planned);
  if (plan == nullptr) return {};
  OdometryControllerConfig controller;
  controller.damping = damping;
  controller.max_command = 0.4;
  const nanoseconds period = dynamic_rate
                                 ? control_period(travel_time(plan->length, controller), controller.nominal_period)
                                 : controller.nominal_period;
  FollowState state;
  nanoseconds now{0};
  std::vector<Eigen::Vector2d> points;
  while (now < std::chrono::seconds(60)) {
    const FollowStep step = follow(plan->path, state, robot.truth().T_station_base, period, controller);
    state = step.next;
    points.emplace_back(plan->length - step.remaining, 1e3 * step.deviation.y);
    if (step.arrived) break;
    robot.command(step.command, now);
    now += period;
    robot.advance(now);
  }
  return points;
}

}  // namespace

std::string figure_5() {
  constexpr double dead_time = 0.15;  // s; notes on docking, 4.8: here 0.2 swings and 0.075 does not
  Svg svg(1280, 340);
  draw_diagram(svg, {0, 0}, 1280, 340, "Fig. 5: deviation from the path, dead time 0.15 s", "way along the path [m]",
               "mm",
               {{driven(0.2, true, dead_time), with_width("#c53030", 1.5), "a = 0.2, dynamic rate"},
                {driven(0.075, false, dead_time), with_width("#dd6b20", 4.5), "a = 0.075, 50 Hz"},
                {driven(0.075, true, dead_time), with_width("#2b6cb0", 2.0), "a = 0.075, dynamic rate"}});
  return svg.text();
}

std::string figure_8(const std::vector<FigureData>& data) {
  constexpr double bin = 0.2;  // m
  Svg svg(1280, 340);
  std::vector<Curve> errors;
  std::vector<Curve> bounds;
  for (const FigureData& one : data) {
    std::vector<std::vector<double>> by_distance;
    for (const RunTrace& trace : one.traces)
      for (const TracePoint& point : trace) {
        if (!point.reprojection_px) continue;
        const double distance = std::hypot(point.camera_point.x, point.camera_point.y);
        const auto place = static_cast<std::size_t>(distance / bin);
        if (place >= by_distance.size()) by_distance.resize(place + 1);
        by_distance[place].push_back(*point.reprojection_px);
      }
    Curve error{{}, with_width(one.style, 2.0), one.name};
    Curve bound{{}, with_width(one.style, 2.0), one.name};
    for (std::size_t i = 0; i < by_distance.size(); ++i) {
      if (by_distance[i].size() < 3) continue;
      const double distance = bin * (static_cast<double>(i) + 0.5);
      const double reprojection = quantile(by_distance[i], 0.5);
      const double width = one.focal_length_px * one.tag_edge / distance;
      error.points.emplace_back(distance, reprojection);
      bound.points.emplace_back(distance,
                                1e3 * (distance - one.focal_length_px * one.tag_edge / (width + 2.0 * reprojection)));
    }
    // Who looked from one distance only gets a dash there.
    for (Curve* curve : {&error, &bound})
      if (curve->points.size() == 1) {
        const Eigen::Vector2d only = curve->points.front();
        curve->points = {only - Eigen::Vector2d(0.5 * bin, 0.0), only + Eigen::Vector2d(0.5 * bin, 0.0)};
      }
    errors.push_back(error);
    bounds.push_back(bound);
  }
  draw_diagram(svg, {0, 0}, 630, 340, "Fig. 8: reprojection error", "distance [m]", "px", errors);
  draw_diagram(svg, {650, 0}, 630, 340, "Distance error by eq. (7)", "distance [m]", "mm", bounds);
  return svg.text();
}

std::string figure_9(const std::vector<FigureData>& data) {
  Svg svg(1280, 420);
  std::vector<Curve> curves;
  for (const FigureData& one : data) {
    for (const RunTrace& trace : one.traces) {
      Curve curve{{}, with_width(one.style, 0.8, 0.35), ""};
      for (const TracePoint& point : trace) curve.points.emplace_back(point.camera_point.x, point.camera_point.y);
      curves.push_back(curve);
    }
    Curve mean{{}, with_width(one.style, 3.0), one.name};
    for (double x = -5.0; x < 0.0; x += 0.05) {
      double sum = 0.0;
      int count = 0;
      for (const RunTrace& trace : one.traces)
        if (const std::optional<double> y = y_at(trace, x)) {
          sum += *y;
          ++count;
        }
      if (count > 0 && 2 * count >= static_cast<int>(one.traces.size())) mean.points.emplace_back(x, sum / count);
    }
    curves.push_back(mean);
  }
  draw_diagram(svg, {0, 0}, 1280, 420, "Fig. 9: the way of the camera point, from above", "x [m], the wall is at 0",
               "y [m]", curves);
  return svg.text();
}

std::string figure_10(const FigureData& data) {
  std::array<std::vector<double>, 3> errors;
  for (const RunRecord& record : data.records) {
    errors[0].push_back(1e3 * record.true_error.x);
    errors[1].push_back(1e3 * record.true_error.y);
    errors[2].push_back(degrees(record.true_error.yaw));
  }
  if (data.records.empty()) return "";
  Svg svg(1260, 230);
  histogram(svg, {0, 0}, errors[0], data.name + ": x when docked", "mm", data.style);
  histogram(svg, {420, 0}, errors[1], "y when docked", "mm", data.style);
  histogram(svg, {840, 0}, errors[2], "heading when docked", "degrees", data.style);
  return svg.text();
}

std::string figure_10_start(const FigureData& data) {
  constexpr double first = 2.0;  // s, in which the robot has not moved yet
  std::array<std::vector<double>, 3> errors;
  for (const RunTrace& trace : data.traces)
    for (const TracePoint& point : trace) {
      if (!point.seen || point.time_s > first) continue;
      errors[0].push_back(1e3 * (point.seen->x - point.camera_point.x));
      errors[1].push_back(1e3 * (point.seen->y - point.camera_point.y));
      errors[2].push_back(degrees(wrap_angle(point.seen->yaw - point.camera_point.yaw)));
    }
  if (errors[0].size() < 2) return "";
  Svg svg(1260, 230);
  histogram(svg, {0, 0}, errors[0], data.name + ": x seen at the start, less the truth", "mm", data.style);
  histogram(svg, {420, 0}, errors[1], "y seen at the start, less the truth", "mm", data.style);
  histogram(svg, {840, 0}, errors[2], "heading seen at the start, less the truth", "degrees", data.style);
  return svg.text();
}

}  // namespace tagdock
