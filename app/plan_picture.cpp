#include "app/plan_picture.h"

#include <algorithm>
#include <cstdarg>
#include <cstdio>
#include <limits>
#include <vector>

#include "app/html.h"

namespace tagdock {
namespace {

std::string format(const char* pattern, ...) __attribute__((format(printf, 1, 2)));
std::string format(const char* pattern, ...) {
  char text[512];
  va_list arguments;
  va_start(arguments, pattern);
  std::vsnprintf(text, sizeof text, pattern, arguments);
  va_end(arguments);
  return text;
}

struct Box {
  double left, top, width, height;
};

/// A rectangle of the page with axes.
class Diagram {
 public:
  Diagram(Box box, double x_low, double x_high, double y_low, double y_high)
      : box_(box), x_low_(x_low), x_high_(x_high), y_low_(y_low), y_high_(y_high) {}

  [[nodiscard]] double px(double x) const { return box_.left + (x - x_low_) / (x_high_ - x_low_) * box_.width; }
  [[nodiscard]] double py(double y) const {
    return box_.top + box_.height - (y - y_low_) / (y_high_ - y_low_) * box_.height;
  }

  void axes(std::string& svg, const char* x_name, const char* y_name) const {
    const double x_step = tick(x_high_ - x_low_, box_.width / 70.0);
    const double y_step = tick(y_high_ - y_low_, box_.height / 28.0);
    for (double x = std::ceil(x_low_ / x_step) * x_step; x <= x_high_ + 1e-9 * x_step; x += x_step) {
      svg += format("<line x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f' stroke='#e4e4e4' stroke-width='1'/>", px(x),
                    box_.top, px(x), box_.top + box_.height);
      svg += format("<text x='%.1f' y='%.1f' font-size='11' text-anchor='middle'>%g</text>\n", px(x),
                    box_.top + box_.height + 15.0, std::abs(x) < 1e-9 * x_step ? 0.0 : x);
    }
    for (double y = std::ceil(y_low_ / y_step) * y_step; y <= y_high_ + 1e-9 * y_step; y += y_step) {
      svg += format("<line x1='%.1f' y1='%.1f' x2='%.1f' y2='%.1f' stroke='#e4e4e4' stroke-width='1'/>", box_.left,
                    py(y), box_.left + box_.width, py(y));
      svg += format("<text x='%.1f' y='%.1f' font-size='11' text-anchor='end'>%g</text>\n", box_.left - 6.0,
                    py(y) + 4.0, std::abs(y) < 1e-9 * y_step ? 0.0 : y);
    }
    svg += format("<rect x='%.1f' y='%.1f' width='%.1f' height='%.1f' fill='none' stroke='#888888' stroke-width='1'/>",
                  box_.left, box_.top, box_.width, box_.height);
    svg += format("<text x='%.1f' y='%.1f' font-size='13' text-anchor='middle'>%s</text>", box_.left + 0.5 * box_.width,
                  box_.top + box_.height + 34.0, x_name);
    svg += format("<text x='%.1f' y='%.1f' font-size='13'>%s</text>\n", box_.left, box_.top - 8.0, y_name);
  }

  /// A line, cut at the frame.
  void line(std::string& svg, const std::vector<std::pair<double, double>>& points, const char* style) const {
    bool open = false;
    double last_x = 0.0;
    double last_y = 0.0;
    for (std::size_t i = 1; i < points.size(); ++i) {
      double begin = 0.0;
      double end = 1.0;
      const auto [x, y] = points[i - 1];
      const double dx = points[i].first - x;
      const double dy = points[i].second - y;
      // Liang-Barsky: the part of the segment that lies inside of each border.
      const auto inside = [&](double rate, double room) {
        if (rate == 0.0) return room >= 0.0;
        (rate > 0.0 ? end : begin) = rate > 0.0 ? std::min(end, room / rate) : std::max(begin, room / rate);
        return begin <= end;
      };
      const bool visible =
          inside(dx, x_high_ - x) && inside(-dx, x - x_low_) && inside(dy, y_high_ - y) && inside(-dy, y - y_low_);
      if (!visible) continue;
      const double from_x = x + begin * dx;
      const double from_y = y + begin * dy;
      if (!open || from_x != last_x || from_y != last_y) {
        if (open) svg += "'/>\n";
        svg +=
            std::string("<polyline fill='none' ") + style + " points='" + format("%.2f,%.2f ", px(from_x), py(from_y));
        open = true;
      }
      last_x = end == 1.0 ? points[i].first : x + end * dx;
      last_y = end == 1.0 ? points[i].second : y + end * dy;
      svg += format("%.2f,%.2f ", px(last_x), py(last_y));
    }
    if (open) svg += "'/>\n";
  }

 private:
  // A round step that gives about `wanted` ticks.
  static double tick(double span, double wanted) {
    const double raw = span / std::max(1.0, wanted);
    const double power = std::pow(10.0, std::floor(std::log10(raw)));
    for (const double factor : {1.0, 2.0, 5.0})
      if (factor * power >= raw) return factor * power;
    return 10.0 * power;
  }

  Box box_;
  double x_low_, x_high_, y_low_, y_high_;
};

std::vector<std::pair<double, double>> line_of(const Path& path) {
  constexpr int points = 240;
  std::vector<std::pair<double, double>> line;
  const double whole = length(path);
  for (int i = 0; i <= points; ++i) {
    const Pose2 pose = point_at(path, whole * i / points).pose;
    line.emplace_back(pose.x, pose.y);
  }
  return line;
}

// Bearing of a board's edge from the camera [rad], positive to the left.
double edge_bearing(const Pose2& T_board_base, const ViewWish& view, double edge) {
  const Pose2 camera = T_board_base * Pose2{view.camera_ahead, 0.0, view.camera_yaw};
  const double c = std::cos(camera.yaw);
  const double s = std::sin(camera.yaw);
  return std::atan2(camera.x * s + (edge - camera.y) * c, -camera.x * c + (edge - camera.y) * s);
}

std::vector<std::pair<double, double>> outline(const Pose2& pose, const Footprint& robot) {
  std::vector<std::pair<double, double>> corners;
  const double half = 0.5 * robot.width;
  for (const auto& [x, y] :
       {std::pair{robot.ahead, half}, std::pair{-robot.behind, half}, std::pair{-robot.behind, -half},
        std::pair{robot.ahead, -half}, std::pair{robot.ahead, half}}) {
    const Pose2 corner = pose * Pose2{x, y, 0.0};
    corners.emplace_back(corner.x, corner.y);
  }
  return corners;
}

/// Everything that the robot's outline covers on its way: outlines close together in one colour.
void draw_sweep(std::string& svg, const Diagram& map, const DockingPlan& plan, const PlanScene& scene, const Box& box) {
  constexpr int outlines = 160;
  svg += format("<clipPath id='map'><rect x='%.1f' y='%.1f' width='%.1f' height='%.1f'/></clipPath>\n", box.left,
                box.top, box.width, box.height);
  svg += "<g clip-path='url(#map)'><path fill='#f6e7d2' d='";
  for (int i = 0; i <= outlines; ++i) {
    const Pose2 pose = point_at(plan.path, plan.length * i / outlines).pose;
    const char* command = "M";
    for (const auto& [x, y] : outline(pose, scene.keep_out.footprint)) {
      svg += format("%s%.1f %.1f", command, map.px(x), map.py(y));
      command = "L";
    }
    svg += "Z";
  }
  svg += "'/></g>\n";
}

void draw_map(std::string& svg, const DockingPlan* plan, const std::vector<Candidate>& candidates,
              const PlanScene& scene, const Box& box) {
  // What must be seen: start, goal, board, the way; Reeds-Shepp words only as far as they stay near.
  double x_low = std::min({scene.start.x, scene.goal.x, scene.board.x});
  double x_high = std::max({scene.start.x, scene.goal.x, scene.board.x});
  double y_low = std::min({scene.start.y, scene.goal.y, scene.board.y});
  double y_high = std::max({scene.start.y, scene.goal.y, scene.board.y});
  if (plan != nullptr) {
    for (const auto& [x, y] : line_of(plan->path)) {
      x_low = std::min(x_low, x);
      x_high = std::max(x_high, x);
      y_low = std::min(y_low, y);
      y_high = std::max(y_high, y);
    }
  }
  const double room = 0.7 + 0.15 * std::max(x_high - x_low, y_high - y_low);
  const double metre = std::min(box.width / (x_high - x_low + 2.0 * room), box.height / (y_high - y_low + 2.0 * room));
  const double x_middle = 0.5 * (x_low + x_high);
  const double y_middle = 0.5 * (y_low + y_high);
  const Diagram map(box, x_middle - 0.5 * box.width / metre, x_middle + 0.5 * box.width / metre,
                    y_middle - 0.5 * box.height / metre, y_middle + 0.5 * box.height / metre);
  if (plan != nullptr) draw_sweep(svg, map, *plan, scene, box);
  map.axes(svg, "x [m], towards the wall", "y [m], left");
  const Pose2 left_edge = scene.board * Pose2{0.0, scene.view.board_half_width, 0.0};
  const Pose2 right_edge = scene.board * Pose2{0.0, -scene.view.board_half_width, 0.0};
  const Pose2 wall_left = scene.board * Pose2{0.05, 20.0, 0.0};
  const Pose2 wall_right = scene.board * Pose2{0.05, -20.0, 0.0};
  map.line(svg, {{wall_left.x, wall_left.y}, {wall_right.x, wall_right.y}}, "stroke='#9a9a9a' stroke-width='5'");
  for (const Polygon& polygon : scene.keep_out.polygons) {
    std::vector<std::pair<double, double>> line;
    for (const Corner& corner : polygon) line.emplace_back(corner.x, corner.y);
    if (!line.empty()) line.push_back(line.front());
    map.line(svg, line, "stroke='#8a1a1a' stroke-width='2' stroke-dasharray='6 3'");
  }
  for (auto candidate = candidates.rbegin(); candidate != candidates.rend(); ++candidate) {
    if (!candidate->solved) continue;
    const bool forward = candidate->verdict.find(", but its ") != std::string::npos;
    map.line(svg, line_of(candidate->word.path(scene.start, scene.limits.max_curvature)),
             forward ? "stroke='#7ba5d3' stroke-width='1.2'" : "stroke='#cccccc' stroke-width='0.8'");
  }
  if (plan != nullptr) {
    constexpr int outlines = 9;
    for (int i = 1; i < outlines; ++i)
      map.line(svg, outline(point_at(plan->path, plan->length * i / outlines).pose, scene.keep_out.footprint),
               "stroke='#dfb98a' stroke-width='0.8'");
    // The way in alternating shades, so that segments can be told apart; reverse in red.
    Pose2 at = plan->path.start;
    int index = 0;
    for (const Segment& segment : plan->path.segments) {
      const Path piece{at, {segment}};
      const char* style = segment.length < 0.0                                   ? "stroke='#c0202a' stroke-width='3.5'"
                          : segment.curvature == 0.0 && segment.sharpness == 0.0 ? "stroke='#222222' stroke-width='3.5'"
                          : index % 2 == 0                                       ? "stroke='#d06a00' stroke-width='3.5'"
                                           : "stroke='#f0a030' stroke-width='3.5'";
      map.line(svg, line_of(piece), style);
      at = end_pose(piece);
      ++index;
    }
  }
  map.line(svg, outline(scene.start, scene.keep_out.footprint), "stroke='#2a7a3a' stroke-width='1.6'");
  map.line(svg, outline(scene.goal, scene.keep_out.footprint), "stroke='#7a2a7a' stroke-width='1.6'");
  for (const auto& [pose, colour] : {std::pair{scene.start, "#2a7a3a"}, std::pair{scene.goal, "#7a2a7a"}}) {
    const Pose2 nose = pose * Pose2{scene.keep_out.footprint.ahead, 0.0, 0.0};
    map.line(svg, {{pose.x, pose.y}, {nose.x, nose.y}}, format("stroke='%s' stroke-width='2'", colour).c_str());
    svg += format("<circle cx='%.1f' cy='%.1f' r='4' fill='%s'/>", map.px(pose.x), map.py(pose.y), colour);
  }
  map.line(svg, {{left_edge.x, left_edge.y}, {right_edge.x, right_edge.y}}, "stroke='#000000' stroke-width='6'");
}

void draw_curvature(std::string& svg, const DockingPlan& plan, const PlanScene& scene, const Box& box) {
  const double top = 1.15 * std::max(plan.peak_curvature, scene.limits.max_curvature);
  const Diagram diagram(box, 0.0, plan.length, -top, top);
  diagram.axes(svg, "driven length [m]", "curvature [1/m], positive to the left; dashed: limit");
  for (const double limit : {-scene.limits.max_curvature, scene.limits.max_curvature})
    diagram.line(svg, {{0.0, limit}, {plan.length, limit}}, "stroke='#c0202a' stroke-dasharray='5 4'");
  std::vector<std::pair<double, double>> line;
  double driven = 0.0;
  for (const Segment& segment : plan.path.segments) {
    line.emplace_back(driven, segment.curvature);
    driven += std::abs(segment.length);
    line.emplace_back(driven, segment.end_curvature());
  }
  diagram.line(svg, line, "stroke='#d06a00' stroke-width='2'");
}

void draw_bearing(std::string& svg, const DockingPlan& plan, const PlanScene& scene, const Box& box) {
  constexpr int points = 300;
  std::vector<std::pair<double, double>> left;
  std::vector<std::pair<double, double>> right;
  double largest = 0.5 * degrees(scene.view.horizontal_view);
  for (int i = 0; i <= points; ++i) {
    const double driven = plan.length * i / points;
    const Pose2 seen = between(scene.board, point_at(plan.path, driven).pose);
    left.emplace_back(driven, degrees(edge_bearing(seen, scene.view, scene.view.board_half_width)));
    right.emplace_back(driven, degrees(edge_bearing(seen, scene.view, -scene.view.board_half_width)));
    largest = std::max({largest, std::abs(left.back().second), std::abs(right.back().second)});
  }
  const double top = std::min(180.0, 1.15 * largest);
  const Diagram diagram(box, 0.0, plan.length, -top, top);
  diagram.axes(svg, "driven length [m]", "bearing of the board's edges [deg]; dashed: edge of the image");
  for (const double side : {-0.5, 0.5}) {
    const double limit = side * degrees(scene.view.horizontal_view);
    diagram.line(svg, {{0.0, limit}, {plan.length, limit}}, "stroke='#c0202a' stroke-dasharray='5 4'");
  }
  diagram.line(svg, left, "stroke='#2a5fa0' stroke-width='1.8'");
  diagram.line(svg, right, "stroke='#2a8f8f' stroke-width='1.8'");
}

void draw_speed(std::string& svg, const DockingPlan& plan, const TimeLaw& law, const Box& box) {
  std::vector<std::pair<double, double>> line;
  double driven = 0.0;
  double fastest = 0.0;
  const double step = 0.25 * law.period;
  for (double time = 0.0; time <= law.duration(); time += step) {
    const double speed = std::abs(twist_at(plan.path, law, time).linear);
    line.emplace_back(driven, speed);
    fastest = std::max(fastest, speed);
    driven += step * std::abs(twist_at(plan.path, law, time + 0.5 * step).linear);
  }
  const Diagram diagram(box, 0.0, plan.length, 0.0, 1.15 * fastest);
  diagram.axes(svg, "driven length [m]", format("speed [m/s]; %.2f s in all", law.duration()).c_str());
  diagram.line(svg, line, "stroke='#5a3a9a' stroke-width='1.8'");
}

}  // namespace

std::string plan_picture(const DockingPlanResult& result, const PlanScene& scene) {
  const auto* plan = std::get_if<DockingPlan>(&result);
  std::string svg =
      "<svg xmlns='http://www.w3.org/2000/svg' width='1280' height='720' viewBox='0 0 1280 720'>\n"
      "<rect width='1280' height='720' fill='#ffffff'/>\n<g font-family='DejaVu Sans, sans-serif' fill='#222222'>\n";
  svg += "<text x='60' y='30' font-size='17'>" + html_text(scene.title) + "</text>\n";
  const auto* refused = std::get_if<PlanRefusal>(&result);
  const std::vector<Candidate> none;
  draw_map(svg, plan,
           plan != nullptr      ? plan->candidates
           : refused != nullptr ? refused->candidates
                                : none,
           scene, {60.0, 70.0, 640.0, 590.0});
  if (plan != nullptr && plan->length > 0.0) {
    const double height = scene.law ? 135.0 : 240.0;
    const double pitch = height + 90.0;
    draw_curvature(svg, *plan, scene, {780.0, 70.0, 460.0, height});
    draw_bearing(svg, *plan, scene, {780.0, 70.0 + pitch, 460.0, height});
    if (scene.law) draw_speed(svg, *plan, *scene.law, {780.0, 70.0 + 2.0 * pitch, 460.0, height});
    svg +=
        "<text x='60' y='712' font-size='11'>black: straight, orange: turn, red: reverse, blue: Reeds-Shepp words that "
        "would do but for their jumps of curvature, grey: the others; green: start, violet: goal; shaded: "
        "swept</text>\n";
  } else if (const auto* refusal = std::get_if<PlanRefusal>(&result)) {
    double y = 90.0;
    std::string text = refusal->sentence + (refusal->cure.empty() ? "" : ". To cure it: " + refusal->cure);
    while (!text.empty()) {
      std::size_t cut = text.size() <= 62 ? text.size() : text.rfind(' ', 62);
      if (cut == std::string::npos || cut == 0) cut = std::min<std::size_t>(62, text.size());
      svg += format("<text x='780' y='%.0f' font-size='13'>", y) + html_text(text.substr(0, cut)) + "</text>\n";
      text.erase(0, std::min(text.size(), cut + 1));
      y += 20.0;
    }
  }
  return svg + "</g></svg>\n";
}

}  // namespace tagdock
