#include "app/view.h"

#include <cstdlib>
#include <cstring>

#include <visp3/core/vpDisplay.h>
#include <visp3/core/vpImage.h>
#include <visp3/gui/vpDisplayX.h>

#include "app/failure.h"

namespace tagdock {
namespace {

vpImagePoint point(const Eigen::Vector2d& pixel) { return {pixel.y(), pixel.x()}; }

void draw_outline(const vpImage<unsigned char>& image, const Corners& corners, const vpColor& color, unsigned width) {
  for (std::size_t i = 0; i < corners.size(); ++i)
    vpDisplay::displayLine(image, point(corners[i]), point(corners[(i + 1) % corners.size()]), color, width);
}

}  // namespace

struct View::Window {
  vpImage<unsigned char> image;
  vpDisplayX display;
};

View::View(const std::string& title, int width, int height) : window_(std::make_unique<Window>()) {
  if (std::getenv("DISPLAY") == nullptr)
    throw Failure(ExitCode::usage,
                  "--view needs a screen, and DISPLAY is not set; run without --view, or under xvfb-run");
  window_->image.resize(static_cast<unsigned>(height), static_cast<unsigned>(width), 0);
  try {
    window_->display.init(window_->image, 40, 40, title);
  } catch (const vpException& error) {
    throw Failure(ExitCode::usage, std::string("--view cannot open a window: ") + error.what());
  }
}

View::~View() = default;

void View::show(const ViewContent& content) {
  vpImage<unsigned char>& image = window_->image;
  if (content.gray.rows != static_cast<int>(image.getHeight()) ||
      content.gray.cols != static_cast<int>(image.getWidth()))
    return;  // the window keeps the size that it was opened with
  for (int row = 0; row < content.gray.rows; ++row)
    std::memcpy(image[static_cast<unsigned>(row)], content.gray.ptr(row), static_cast<std::size_t>(content.gray.cols));
  vpDisplay::display(image);
  for (const Corners& corners : content.target) draw_outline(image, corners, vpColor::lightBlue, 1);
  for (const RefinedTag& tag : content.tags) {
    draw_outline(image, tag.corners_px, vpColor::green, 2);
    for (const Eigen::Vector2d& corner : tag.corners_px)
      vpDisplay::displayCross(image, point(corner), 12, vpColor::red, 1);
    vpDisplay::displayText(image, point(tag.corners_px[0]), std::to_string(tag.id), vpColor::yellow);
  }
  for (const Eigen::Vector2d& at : content.points) vpDisplay::displayCross(image, point(at), 10, vpColor::green, 1);
  const vpImagePoint centre(0.5 * (content.gray.rows - 1), 0.5 * (content.gray.cols - 1));
  vpDisplay::displayCross(image, centre, 30, vpColor::yellow, 1);
  double row = 24.0;
  for (const std::string& text : content.lines) {
    vpDisplay::displayText(image, vpImagePoint(row, 16.0), text, vpColor::yellow);
    row += 24.0;
  }
  vpDisplay::flush(image);
}

std::vector<Corners> projected_board(const Board& board, const CameraModel& camera,
                                     const Eigen::Isometry3d& T_camera_station) {
  std::vector<Corners> outlines;
  for (const BoardTag& tag : board.tags) {
    const TagPoints points = corners_station(tag);
    Corners corners;
    bool before = true;
    for (std::size_t i = 0; i < points.size(); ++i) {
      const Eigen::Vector3d point_camera = T_camera_station * points[i];
      before = before && point_camera.z() > 0.05;
      if (before) corners[i] = project(camera, point_camera);
    }
    if (before) outlines.push_back(corners);
  }
  return outlines;
}

}  // namespace tagdock
