#include "tests/detection/scene_rendering.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <numbers>
#include <stdexcept>

#include <apriltag/apriltag.h>
#include <apriltag/common/image_u8.h>
#include <apriltag/tag16h5.h>
#include <apriltag/tag25h9.h>
#include <apriltag/tag36h11.h>
#include <apriltag/tagCircle21h7.h>
#include <apriltag/tagCircle49h12.h>
#include <apriltag/tagStandard41h12.h>
#include <apriltag/tagStandard52h13.h>

#include "planning/pose2.h"

namespace tagdock::testing {
namespace {

constexpr int fine = 8;  // fine cells a pixel

struct Family {
  const char* name;
  apriltag_family_t* (*create)();
  void (*destroy)(apriltag_family_t*);
};
constexpr Family families[] = {{"tag36h11", tag36h11_create, tag36h11_destroy},
                               {"tag25h9", tag25h9_create, tag25h9_destroy},
                               {"tag16h5", tag16h5_create, tag16h5_destroy},
                               {"tagStandard41h12", tagStandard41h12_create, tagStandard41h12_destroy},
                               {"tagStandard52h13", tagStandard52h13_create, tagStandard52h13_destroy},
                               {"tagCircle21h7", tagCircle21h7_create, tagCircle21h7_destroy},
                               {"tagCircle49h12", tagCircle49h12_create, tagCircle49h12_destroy}};

struct Pattern {
  cv::Mat1b cells;  ///< 255 white, 0 black, the margin included
  int border = 0;   ///< cells along the square whose corners count
};

Pattern pattern(const std::string& name, int id) {
  for (const Family& family : families) {
    if (name != family.name) continue;
    const std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)> made(family.create(), family.destroy);
    const std::unique_ptr<image_u8_t, void (*)(image_u8_t*)> image(apriltag_to_image(made.get(), id), image_u8_destroy);
    Pattern result{cv::Mat1b(image->height, image->width), made->width_at_border};
    for (int y = 0; y < image->height; ++y)
      for (int x = 0; x < image->width; ++x) result.cells(y, x) = image->buf[y * image->stride + x];
    return result;
  }
  throw std::invalid_argument("no family " + name);
}

/// Signed coverage of polygons by fine cells, as differences along each row.
class Coverage {
 public:
  Coverage(int width, int height) : sums_(cv::Mat1d::zeros(height, width + 2)) {}

  /// Adds an edge; the area to its right is counted, positive where it runs down.
  void edge(Eigen::Vector2d from, Eigen::Vector2d to, double weight) {
    if (from.y() == to.y()) return;
    if (from.y() > to.y()) {
      std::swap(from, to);
      weight = -weight;
    }
    const double slope = (to.x() - from.x()) / (to.y() - from.y());
    const int first = std::max(0, static_cast<int>(std::floor(from.y())));
    const int last = std::min(sums_.rows - 1, static_cast<int>(std::ceil(to.y())) - 1);
    for (int row = first; row <= last; ++row) {
      const double y0 = std::max(from.y(), static_cast<double>(row));
      const double y1 = std::min(to.y(), row + 1.0);
      if (y1 <= y0) continue;
      span(row, from.x() + (y0 - from.y()) * slope, from.x() + (y1 - from.y()) * slope, weight * (y1 - y0));
    }
  }

  cv::Mat1d covered() const {
    cv::Mat1d result(sums_.rows, sums_.cols - 2);
    for (int y = 0; y < result.rows; ++y) {
      double sum = 0.0;
      for (int x = 0; x < result.cols; ++x) result(y, x) = sum += sums_(y, x);
    }
    return result;
  }

 private:
  /// An edge piece within one row, from x0 to x1, that is `height` high.
  void span(int row, double x0, double x1, double height) {
    if (x0 > x1) std::swap(x0, x1);
    const double limit = sums_.cols - 2;
    x0 = std::clamp(x0, 0.0, limit);
    x1 = std::clamp(x1, 0.0, limit);
    const int first = static_cast<int>(std::floor(x0));
    const int last = static_cast<int>(std::floor(x1));
    // `covered(x)`: the share of cells up to x that lies to the right of the piece; its differences are stored.
    double before = 0.0;
    for (int x = first; x <= last; ++x) {
      const double left = std::max<double>(x, x0);
      const double right = std::min<double>(x + 1.0, x1);
      double area;  // of the cell, right of the piece
      if (x1 > x0) {
        const double share0 = (left - x0) / (x1 - x0);
        const double share1 = (right - x0) / (x1 - x0);
        area = 0.5 * (share0 + share1) * (right - left) + (x + 1.0 - right) * share1;
      } else {
        area = x + 1.0 - x0;
      }
      sums_(row, x) += height * (area - before);
      before = area;
    }
    sums_(row, last + 1) += height * (1.0 - before);
  }

  cv::Mat1d sums_;
};

}  // namespace

Corners render_into(cv::Mat1d& grey, const Scene& scene) {
  const Pattern tag = pattern(scene.family, scene.id);
  const double cell = scene.size / tag.border;
  const double half = 0.5 * tag.cells.cols * cell;
  const auto place = [&](double u, double v) {
    return project(scene.camera, scene.T_camera_tag * Eigen::Vector3d(u * cell - half, v * cell - half, 0.0));
  };

  // The part of the image that the tag and its spread touch.
  const double reach = 5.0 * scene.psf_px + 2.0;
  Eigen::AlignedBox2d box;
  for (int i = 0; i <= tag.cells.cols; ++i)
    for (int j = 0; j <= tag.cells.rows; ++j) box.extend(place(i, j));
  const int x0 = std::max(0, static_cast<int>(std::floor(box.min().x() - reach)));
  const int y0 = std::max(0, static_cast<int>(std::floor(box.min().y() - reach)));
  const int x1 = std::min(grey.cols - 1, static_cast<int>(std::ceil(box.max().x() + reach)));
  const int y1 = std::min(grey.rows - 1, static_cast<int>(std::ceil(box.max().y() + reach)));
  const int rim = static_cast<int>(std::ceil(4.5 * scene.psf_px)) + 1;  // pixels the kernel reaches beyond

  const int left = x0 - rim;
  const int top = y0 - rim;
  Coverage coverage(fine * (x1 - x0 + 1 + 2 * rim), fine * (y1 - y0 + 1 + 2 * rim));
  const auto in_fine = [&](const Eigen::Vector2d& pixel) -> Eigen::Vector2d {
    return fine * (pixel + Eigen::Vector2d(0.5 - left, 0.5 - top));
  };
  const auto add = [&](double u0, double v0, double u1, double v1, double level) {
    constexpr int pieces = 6;  // a curved side deviates by 1/36 of its sagitta
    const Eigen::Vector2d corners[] = {{u0, v0}, {u0, v1}, {u1, v1}, {u1, v0}};
    for (int side = 0; side < 4; ++side)
      for (int i = 0; i < pieces; ++i) {
        const Eigen::Vector2d a = corners[side] + (corners[(side + 1) % 4] - corners[side]) * i / pieces;
        const Eigen::Vector2d b = corners[side] + (corners[(side + 1) % 4] - corners[side]) * (i + 1) / pieces;
        coverage.edge(in_fine(place(a.x(), a.y())), in_fine(place(b.x(), b.y())), level);
      }
  };
  for (int j = 0; j < tag.cells.rows; ++j)
    for (int i = 0; i < tag.cells.cols; ++i)
      add(i, j, i + 1, j + 1, (tag.cells(j, i) > 127 ? scene.white : scene.black) - scene.wall);
  const cv::Mat1d covered = coverage.covered();

  // PSF and pixel box in one separable kernel, sampled at pixel centres.
  const double sigma = std::sqrt(std::max(1e-4, scene.psf_px * scene.psf_px - 1.0 / (12.0 * fine * fine)));
  Eigen::VectorXd kernel(fine * (2 * rim + 1));
  for (Eigen::Index i = 0; i < kernel.size(); ++i) {
    const double offset = (static_cast<double>(i) + 0.5) / fine - (rim + 0.5);
    kernel[i] = 0.5 * (std::erf((offset + 0.5) / (std::numbers::sqrt2 * sigma)) -
                       std::erf((offset - 0.5) / (std::numbers::sqrt2 * sigma)));
  }
  kernel /= kernel.sum();
  const Eigen::Index columns = x1 - x0 + 1;
  Eigen::MatrixXd across(columns, covered.rows);  // column y holds fine row y, already spread along x
  for (int y = 0; y < covered.rows; ++y) {
    const Eigen::Map<const Eigen::VectorXd> row(covered[y], covered.cols);
    for (Eigen::Index x = 0; x < columns; ++x) across(x, y) = kernel.dot(row.segment(fine * x, kernel.size()));
  }
  for (int y = y0; y <= y1; ++y)
    Eigen::Map<Eigen::VectorXd>(grey[y] + x0, columns) += across.middleCols(fine * (y - y0), kernel.size()) * kernel;

  Corners truth;
  const TagPoints points = tag_corners(scene.size);
  for (int i = 0; i < 4; ++i) truth[i] = project(scene.camera, scene.T_camera_tag * points[i]);
  return truth;
}

Rendering render(const Scene& scene) {
  Rendering result{cv::Mat1d(scene.camera.height, scene.camera.width, scene.wall), {}};
  result.corners_px = render_into(result.grey, scene);
  return result;
}

cv::Mat1b digitised(const cv::Mat1d& grey, double noise, std::mt19937_64& random) {
  std::normal_distribution<double> normal(0.0, 1.0);
  cv::Mat1b result(grey.size());
  for (int y = 0; y < grey.rows; ++y)
    for (int x = 0; x < grey.cols; ++x)
      result(y, x) = static_cast<std::uint8_t>(std::clamp(std::round(grey(y, x) + noise * normal(random)), 0.0, 255.0));
  return result;
}

Eigen::Isometry3d pose_seen(const CameraModel& camera, double size, double side_px, const Eigen::Vector2d& centre_px,
                            double tilt, double tilt_way, double roll) {
  using Eigen::AngleAxisd;
  using Eigen::Vector3d;
  const double depth = camera.fx * size / side_px;
  const Vector3d sight((centre_px.x() - camera.cx) / camera.fx, (centre_px.y() - camera.cy) / camera.fy, 1.0);
  const Vector3d axis(-std::sin(tilt_way), std::cos(tilt_way), 0.0);
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = (Eigen::Quaterniond::FromTwoVectors(Vector3d::UnitZ(), sight) * AngleAxisd(tilt, axis) *
                AngleAxisd(roll, Vector3d::UnitZ()))
                   .toRotationMatrix();
  T.translation() = depth * sight;
  return T;
}

Scene base_scene(std::mt19937_64& random, double side_px, double tilt_deg) {
  std::uniform_real_distribution<double> share(0.0, 1.0);
  const double turn = 2.0 * std::numbers::pi;
  Scene scene;
  scene.id = static_cast<int>(587 * share(random));
  const Eigen::Vector2d centre =
      Eigen::Vector2d::Constant(159.5) + Eigen::Vector2d(share(random), share(random)) * 20.0;
  const double way = turn * share(random);
  scene.T_camera_tag =
      pose_seen(scene.camera, scene.size, side_px, centre, radians(tilt_deg), way, turn * share(random));
  return scene;
}

void CornerError::add(const Corners& found, const Corners& truth) {
  for (int i = 0; i < 4; ++i) {
    const Eigen::Vector2d error = found[i] - truth[i];
    squares += error.squaredNorm();
    worst_px = std::max(worst_px, error.norm());
    sum += error;
    ++corners;
  }
}

double CornerError::rms_px() const { return std::sqrt(squares / (2.0 * corners)); }
Eigen::Vector2d CornerError::mean_px() const { return sum / corners; }

}  // namespace tagdock::testing
