#include "app/docking_picture.h"

#include <algorithm>
#include <cmath>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "app/svg.h"

namespace tagdock {
namespace {

constexpr double width = 1100;
constexpr double image_width = 560;

void draw_image(Svg& svg, const DockingStory& story, const Eigen::Vector2d& corner, double& height) {
  const double scale = image_width / story.last_image.cols;
  height = scale * story.last_image.rows;
  cv::Mat1b small;
  cv::resize(story.last_image, small, {}, 0.5, 0.5, cv::INTER_AREA);
  std::vector<unsigned char> bytes;
  cv::imencode(".jpg", small, bytes, {cv::IMWRITE_JPEG_QUALITY, 85});
  svg.image(corner, image_width, height, "image/jpeg", bytes);
  const auto place = [&](const Eigen::Vector2d& pixel) -> Eigen::Vector2d {
    return corner + scale * (pixel + Eigen::Vector2d::Constant(0.5));
  };
  for (const RefinedTag& tag : story.last_tags) {
    std::vector<Eigen::Vector2d> outline;
    for (const Eigen::Vector2d& pixel : tag.corners_px) outline.push_back(place(pixel));
    svg.polygon(outline, "fill:none;stroke:#20c020;stroke-width:1.5");
    for (const Eigen::Vector2d& at : outline) {
      svg.line(at - Eigen::Vector2d(5, 0), at + Eigen::Vector2d(5, 0), "stroke:#e02020");
      svg.line(at - Eigen::Vector2d(0, 5), at + Eigen::Vector2d(0, 5), "stroke:#e02020");
    }
    svg.text(outline[0] + Eigen::Vector2d(0, -6), "tag " + std::to_string(tag.id), 12, "start", "fill:#ffe040");
  }
}

// From above: the station at the right, x to the right, y up.
void draw_way(Svg& svg, const DockingStory& story, const Eigen::Vector2d& corner, double w, double h) {
  double least_x = story.dock_pose.x - 0.6;
  double half_y = 0.7;
  for (const DockingMoment& moment : story.moments)
    for (const auto& pose : {moment.estimated, moment.truth})
      if (pose) {
        least_x = std::min(least_x, pose->x - 0.3);
        half_y = std::max(half_y, std::abs(pose->y) + 0.2);
      }
  const double most_x = 0.35;
  const double scale = std::min(w / (most_x - least_x), h / (2.0 * half_y));
  const auto place = [&](double x, double y) -> Eigen::Vector2d {
    return corner + Eigen::Vector2d(scale * (x - least_x), 0.5 * h - scale * y);
  };
  svg.rectangle(corner, w, h, "fill:#fafafa;stroke:#888");
  for (const double x : axis_ticks(least_x, most_x, 7)) {
    svg.line(place(x, -0.5 * h / scale), place(x, 0.5 * h / scale), "stroke:#e4e4e4");
    svg.text(place(x, -0.5 * h / scale) + Eigen::Vector2d(0, 14), plain(x, 2) + " m", 11, "middle");
  }
  for (const double y : axis_ticks(-0.45 * h / scale, 0.45 * h / scale, 5)) {
    svg.line(place(least_x, y), place(most_x, y), "stroke:#e4e4e4");
    svg.text(place(most_x, y) + Eigen::Vector2d(-4, -2), plain(y, 2) + " m", 11, "end", "fill:#888");
  }
  svg.line(place(least_x, 0), place(most_x, 0), "stroke:#bbb;stroke-dasharray:6 4");
  for (const BoardTag& tag : story.board.tags) {
    const TagPoints points = corners_station(tag);
    svg.line(place(points[0].x(), points[0].y()), place(points[1].x(), points[1].y()), "stroke:#000;stroke-width:4");
  }
  std::vector<Eigen::Vector2d> estimated;
  std::vector<Eigen::Vector2d> truth;
  std::string phase;
  double label_row = 16;
  for (const DockingMoment& moment : story.moments) {
    if (moment.truth) truth.push_back(place(moment.truth->x, moment.truth->y));
    if (!moment.estimated) continue;
    estimated.push_back(place(moment.estimated->x, moment.estimated->y));
    if (moment.phase == phase) continue;
    phase = moment.phase;
    svg.circle(estimated.back(), 3, "fill:#c05010");
    svg.line(estimated.back(), {estimated.back().x(), corner.y() + label_row + 2}, "stroke:#c05010;stroke-width:0.5");
    svg.text({estimated.back().x(), corner.y() + label_row}, phase, 11, "start", "fill:#c05010");
    label_row = label_row > 120 ? 16 : label_row + 13;
  }
  svg.polyline(truth, "stroke:#2060c0;stroke-width:3;stroke-opacity:0.45");
  svg.polyline(estimated, "stroke:#c05010;stroke-width:1.2");
  const Eigen::Vector2d dock = place(story.dock_pose.x, story.dock_pose.y);
  svg.circle(dock, 6, "fill:none;stroke:#108030;stroke-width:2");
  svg.text(corner + Eigen::Vector2d(8, h - 10),
           "way of the camera point from above: estimated (orange), true (blue), dock (green)", 12);
}

}  // namespace

std::string docking_picture(const DockingStory& story) {
  double image_height = 0.0;
  Svg svg(width, 860);
  if (!story.last_image.empty()) draw_image(svg, story, {20, 20}, image_height);
  double row = 40;
  constexpr std::size_t letters = 66;  // that fit beside the image
  for (std::string line : story.lines) {
    while (!line.empty()) {
      const std::size_t space = line.size() > letters ? line.rfind(' ', letters) : std::string::npos;
      svg.text({image_width + 40, row}, line.substr(0, space), 13);
      row += 18;
      line = space == std::string::npos ? "" : "    " + line.substr(space + 1);
    }
  }
  Curve x{{}, "stroke:#c05010;stroke-width:1.5", "x"};
  Curve y{{}, "stroke:#2060c0;stroke-width:1.5", "y"};
  Curve yaw{{}, "stroke:#108030;stroke-width:1.5", "yaw"};
  // The last seconds, where millimetres count.
  const std::chrono::nanoseconds end = story.moments.empty() ? std::chrono::nanoseconds(0) : story.moments.back().time;
  for (const DockingMoment& moment : story.moments) {
    if (!moment.estimated || moment.time + std::chrono::seconds(8) < end) continue;
    const double t = std::chrono::duration<double>(moment.time).count();
    x.points.emplace_back(t, 1e3 * (story.dock_pose.x - moment.estimated->x));
    y.points.emplace_back(t, 1e3 * (moment.estimated->y - story.dock_pose.y));
    yaw.points.emplace_back(t, degrees(wrap_angle(moment.estimated->yaw - story.dock_pose.yaw)));
  }
  const double left = image_width + 40;
  draw_diagram(svg, {left, 190}, width - left - 10, 150, "before the dock (estimated, the last 8 s)", "time [s]",
               "[mm]", {x});
  draw_diagram(svg, {left, 335}, width - left - 10, 150, "to the left (estimated, the last 8 s)", "time [s]", "[mm]",
               {y});
  draw_way(svg, story, {20, 500}, image_width + 20, 330);
  draw_diagram(svg, {left + 20, 500}, width - left - 30, 330, "heading (estimated, the last 8 s)", "time [s]", "[deg]",
               {yaw});
  return svg.text();
}

}  // namespace tagdock
