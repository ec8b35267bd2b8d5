#include "tests/calibration/board_rendering.h"

#include <algorithm>
#include <cmath>
#include <map>
#include <stdexcept>

#include <opencv2/aruco.hpp>
#include <opencv2/imgproc.hpp>

#include "detection/tag_pattern.h"
#include "planning/pose2.h"

namespace tagdock::testing {
namespace {

using Eigen::Vector2d;
using Eigen::Vector3d;
enum Colour { black, white, wall };

/// The drawing as a function of the place.
class Drawing {
 public:
  Drawing(const CalibrationTarget& target, const BoardScene& scene) : target_(target), scene_(scene) {
    if (target.type == CalibrationTarget::Type::charuco) {
      width = target.squares_x * target.square;
      height = target.squares_y * target.square;
      margin = 0.5 * target.square;
      if (target.dictionary != "DICT_5X5_100") throw std::invalid_argument("the tests print DICT_5X5_100 only");
      const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_5X5_100);
      cells_ = dictionary->markerSize + 2;
      int next = 0;
      for (int row = 0; row < target.squares_y; ++row)
        for (int column = 0; column < target.squares_x; ++column) {
          if (((row + column) % 2 == 0) == scene.black_top_left) continue;
          cv::Mat bits;
          dictionary->drawMarker(next++, cells_, bits, 1);
          marks_[{column, row}] = bits;
        }
    } else {
      pitch_ = target.tag_size * (1.0 + target.tag_spacing);
      gap_ = target.tag_size * target.tag_spacing;
      width = target.tag_cols * pitch_ - gap_;
      height = target.tag_rows * pitch_ - gap_;
      margin = 1.2 * gap_;
      for (int row = 0; row < target.tag_rows; ++row)
        for (int column = 0; column < target.tag_cols; ++column) {
          const int line = scene.rows_from_above ? row : target.tag_rows - 1 - row;
          tags_.push_back(tag_pattern(target.family, target.first_id + line * target.tag_cols + column));
        }
    }
  }

  [[nodiscard]] Colour at(const Vector2d& p) const {
    if (p.x() < -margin || p.y() < -margin || p.x() > width + margin || p.y() > height + margin) return wall;
    return target_.type == CalibrationTarget::Type::charuco ? charuco(p) : grid(p);
  }

  double width = 0.0;
  double height = 0.0;
  double margin = 0.0;

 private:
  [[nodiscard]] Colour charuco(const Vector2d& p) const {
    if (p.x() < 0 || p.y() < 0 || p.x() >= width || p.y() >= height) return white;
    const int column = static_cast<int>(p.x() / target_.square);
    const int row = static_cast<int>(p.y() / target_.square);
    const auto mark = marks_.find({column, row});
    if (mark == marks_.end()) return black;
    const double inset = 0.5 * (target_.square - target_.marker);
    const double x = (p.x() - column * target_.square - inset) / target_.marker * cells_;
    const double y = (p.y() - row * target_.square - inset) / target_.marker * cells_;
    if (x < 0 || y < 0 || x >= cells_ || y >= cells_) return white;
    return mark->second.at<unsigned char>(static_cast<int>(y), static_cast<int>(x)) > 127 ? white : black;
  }

  [[nodiscard]] Colour grid(const Vector2d& p) const {
    // Shifted so that each pitch begins with the gap before a tag.
    const double x = p.x() + gap_;
    const double y = p.y() + gap_;
    if (x < 0 || y < 0) return white;
    const int column = static_cast<int>(x / pitch_);
    const int row = static_cast<int>(y / pitch_);
    const double in_x = x - column * pitch_ - gap_;
    const double in_y = y - row * pitch_ - gap_;
    if (in_x < 0 && in_y < 0 && column <= target_.tag_cols && row <= target_.tag_rows)
      return target_.type == CalibrationTarget::Type::aprilgrid ? black : white;
    if (in_x < 0 || in_y < 0 || column >= target_.tag_cols || row >= target_.tag_rows) return white;
    const TagPattern& tag = tags_[static_cast<std::size_t>(row * target_.tag_cols + column)];
    const int rim = (tag.cells - tag.border_cells) / 2;
    const int i = std::min(tag.border_cells - 1, static_cast<int>(in_x / target_.tag_size * tag.border_cells));
    const int k = std::min(tag.border_cells - 1, static_cast<int>(in_y / target_.tag_size * tag.border_cells));
    return tag.at(i + rim, k + rim) == TagPattern::white ? white : black;
  }

  const CalibrationTarget& target_;
  const BoardScene& scene_;
  std::map<std::pair<int, int>, cv::Mat> marks_;
  int cells_ = 0;
  std::vector<TagPattern> tags_;
  double pitch_ = 0.0;
  double gap_ = 0.0;
};

}  // namespace

cv::Mat1b render_board(const CalibrationTarget& target, const BoardScene& scene, std::mt19937_64& random) {
  const Drawing drawing(target, scene);
  const CameraModel& camera = scene.camera;
  const Eigen::Isometry3d T_board_camera = scene.T_camera_board.inverse();
  const auto bulge = [&](const Vector2d& p) {
    const double u = 2.0 * p.x() / drawing.width - 1.0;
    const double v = 2.0 * p.y() / drawing.height - 1.0;
    return scene.bow * ((1.0 - scene.bow_skew) * (1.0 - 0.7 * u * u - 0.3 * v * v) + scene.bow_skew * u * v);
  };
  const auto drawn = [&](const Vector2d& ideal) -> Vector2d {
    const Vector3d sight = T_board_camera.linear() * Vector3d(ideal.homogeneous());
    const Vector3d from = T_board_camera.translation();
    double z = 0.0;
    Vector2d p;
    for (int i = 0; i < (scene.bow != 0.0 ? 4 : 1); ++i) {
      p = (from + sight * ((z - from.z()) / sight.z())).head<2>();
      z = -bulge(p);
    }
    return p;
  };
  // The part of the picture that the board can touch.
  Eigen::AlignedBox2d box;
  for (int i = 0; i <= 10; ++i)
    for (int k = 0; k <= 10; ++k) {
      const Vector3d at =
          scene.T_camera_board * Vector3d(-drawing.margin + 0.1 * i * (drawing.width + 2 * drawing.margin),
                                          -drawing.margin + 0.1 * k * (drawing.height + 2 * drawing.margin), 0.0);
      if (at.z() > 0.02) box.extend(project(camera, at));
    }
  const int x0 = std::clamp(static_cast<int>(box.min().x()) - 8, 0, camera.width - 1);
  const int x1 = std::clamp(static_cast<int>(box.max().x()) + 8, 0, camera.width - 1);
  const int y0 = std::clamp(static_cast<int>(box.min().y()) - 8, 0, camera.height - 1);
  const int y1 = std::clamp(static_cast<int>(box.max().y()) + 8, 0, camera.height - 1);
  cv::Mat1f light(camera.height, camera.width, static_cast<float>(scene.wall));
  const double level[] = {scene.black, scene.white, scene.wall};

  // Lines of sight at the corners of all pixels of that part; between them they are straight enough.
  const int columns = x1 - x0 + 2;
  std::vector<Vector2d> ideal(static_cast<std::size_t>(columns) * static_cast<std::size_t>(y1 - y0 + 2));
  std::vector<Colour> colour(ideal.size());
  for (int y = y0; y <= y1 + 1; ++y)
    for (int x = x0; x <= x1 + 1; ++x) {
      const std::size_t i = static_cast<std::size_t>((y - y0) * columns + x - x0);
      ideal[i] = unproject(camera, {x - 0.5, y - 0.5}).value_or(Vector2d(1e3, 1e3));
      colour[i] = drawing.at(drawn(ideal[i]));
    }
  for (int y = y0; y <= y1; ++y)
    for (int x = x0; x <= x1; ++x) {
      const std::size_t a = static_cast<std::size_t>((y - y0) * columns + x - x0);
      const std::size_t b = a + static_cast<std::size_t>(columns);
      // A corner of a field may poke into a pixel and leave all four of its corners alike, so their neighbours count,
      // too: without them tags came out 0.003 px small.
      const auto all_alike = [&](std::size_t first, std::size_t step, int count) {
        for (int k = 0; k < count; ++k)
          if (colour[first + static_cast<std::size_t>(k) * step] != colour[a]) return false;
        return true;
      };
      const bool inside = x > x0 && y > y0 && x < x1 && y < y1;
      const auto row = static_cast<std::size_t>(columns);
      if (inside
              ? all_alike(a - row, 1, 2) && all_alike(a - 1, 1, 4) && all_alike(b - 1, 1, 4) && all_alike(b + row, 1, 2)
              : all_alike(a, 1, 2) && all_alike(b, 1, 2)) {
        light(y, x) = static_cast<float>(level[colour[a]]);
        continue;
      }
      constexpr int fine = 8;
      double sum = 0.0;
      for (int k = 0; k < fine; ++k)
        for (int i = 0; i < fine; ++i) {
          const double s = (i + 0.5) / fine;
          const double t = (k + 0.5) / fine;
          const Vector2d sight =
              (1 - t) * ((1 - s) * ideal[a] + s * ideal[a + 1]) + t * ((1 - s) * ideal[b] + s * ideal[b + 1]);
          sum += level[drawing.at(drawn(sight))];
        }
      light(y, x) = static_cast<float>(sum / (fine * fine));
    }
  if (scene.blur_px > 0.0) cv::GaussianBlur(light, light, cv::Size(0, 0), scene.blur_px);
  if (scene.motion.norm() > 0.0) {
    const int reach = static_cast<int>(std::ceil(scene.motion.cwiseAbs().maxCoeff())) + 2;
    cv::Mat1f kernel = cv::Mat1f::zeros(2 * reach + 1, 2 * reach + 1);
    constexpr int steps = 200;
    for (int i = 0; i < steps; ++i) {  // bilinear splats along the way
      const Vector2d at = scene.motion * ((i + 0.5) / steps - 0.5) + Vector2d::Constant(reach);
      const int x = static_cast<int>(at.x());
      const int y = static_cast<int>(at.y());
      const double s = at.x() - x;
      const double t = at.y() - y;
      kernel(y, x) += static_cast<float>((1 - s) * (1 - t) / steps);
      kernel(y, x + 1) += static_cast<float>(s * (1 - t) / steps);
      kernel(y + 1, x) += static_cast<float>((1 - s) * t / steps);
      kernel(y + 1, x + 1) += static_cast<float>(s * t / steps);
    }
    cv::filter2D(light, light, -1, kernel);
  }
  std::normal_distribution<float> normal(0.0F, static_cast<float>(scene.noise));
  cv::Mat1b picture(light.size());
  for (int y = 0; y < light.rows; ++y)
    for (int x = 0; x < light.cols; ++x)
      picture(y, x) = static_cast<std::uint8_t>(
          std::clamp(std::round(static_cast<float>(scene.gain) * light(y, x) + normal(random)), 0.0F, 255.0F));
  return picture;
}

CameraModel random_camera(std::mt19937_64& random) {
  const auto between = [&](double least, double most) {
    return std::uniform_real_distribution<double>(least, most)(random);
  };
  const double focal = between(1050.0, 1250.0);
  return {1280,
          1024,
          focal,
          focal * between(0.998, 1.002),
          640.0 + between(-15, 15),
          512.0 + between(-15, 15),
          between(-0.16, -0.06),
          between(0.02, 0.12),
          between(-5e-4, 5e-4),
          between(-5e-4, 5e-4),
          0.0};
}

std::vector<Eigen::Isometry3d> views_of(const CalibrationTarget& target, const CameraModel& camera, int count,
                                        std::mt19937_64& random, bool poor) {
  const auto between = [&](double least, double most) {
    return std::uniform_real_distribution<double>(least, most)(random);
  };
  const TargetLayout layout = layouts_of(target).front();
  const Vector3d centre(0.5 * layout.width, 0.5 * layout.height, 0.0);
  const double diagonal = std::hypot(layout.width, layout.height);
  std::vector<Eigen::Isometry3d> views;
  for (int i = 0; i < count; ++i) {
    const double share = poor ? between(0.45, 0.5) : between(0.45, 0.95);
    const double depth = camera.fx * diagonal / (share * camera.width);
    const double tilt = radians(poor ? between(0.0, 4.0) : between(5.0, 45.0));
    const double way = between(0.0, 2.0 * std::acos(-1.0));
    const double roll = radians(poor ? between(-3.0, 3.0) : between(-20.0, 20.0));
    const double room = poor ? 0.03 : 0.5 - 0.36 * share;
    const Vector2d pixel(camera.width * (0.5 + between(-room, room)), camera.height * (0.5 + between(-room, room)));
    const Vector2d ideal = unproject(camera, pixel).value();
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.linear() = (Eigen::AngleAxisd(tilt, Vector3d(std::cos(way), std::sin(way), 0.0)) *
                  Eigen::AngleAxisd(roll, Vector3d::UnitZ()))
                     .toRotationMatrix();
    T.translation() = depth * Vector3d(ideal.homogeneous()) - T.linear() * centre;
    views.push_back(T);
  }
  return views;
}

CalibrationTarget charuco_board() {
  CalibrationTarget target;
  target.type = CalibrationTarget::Type::charuco;
  target.squares_x = 10;
  target.squares_y = 7;
  target.square = 0.04;
  target.marker = 0.03;
  target.dictionary = "DICT_5X5_100";
  return target;
}

CalibrationTarget tag_board(CalibrationTarget::Type type) {
  CalibrationTarget target;
  target.type = type;
  target.tag_cols = 6;
  target.tag_rows = 6;
  target.tag_size = 0.06;
  target.tag_spacing = 0.3;
  return target;
}

}  // namespace tagdock::testing
