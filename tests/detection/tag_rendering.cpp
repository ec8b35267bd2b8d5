#include "tests/detection/tag_rendering.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <random>

#include <Eigen/Geometry>
#include <Eigen/LU>

namespace tagdock::rendering {
namespace {

using Eigen::Vector2d;

/// Signed area of polygons in the cells of a grid: each edge adds what lies to its right.
class Coverage {
 public:
  Coverage(int width, int height)
      : width_(width), height_(height), sum_(static_cast<std::size_t>(width + 2) * static_cast<std::size_t>(height)) {}

  void add(const std::vector<Vector2d>& polygon, double value) {
    double area = 0.0;
    for (std::size_t i = 0; i < polygon.size(); ++i) {
      const Vector2d& a = polygon[i];
      const Vector2d& b = polygon[(i + 1) % polygon.size()];
      area += a.x() * b.y() - a.y() * b.x();
    }
    const double signed_value = area > 0.0 ? -value : value;
    for (std::size_t i = 0; i < polygon.size(); ++i) edge(polygon[i], polygon[(i + 1) % polygon.size()], signed_value);
  }

  [[nodiscard]] cv::Mat1d image() const {
    cv::Mat1d result(height_, width_);
    for (int row = 0; row < height_; ++row) {
      double level = 0.0;
      for (int column = 0; column < width_; ++column) {
        level += sum_[index(column, row)];
        result(row, column) = level;
      }
    }
    return result;
  }

 private:
  [[nodiscard]] std::size_t index(int column, int row) const {
    return static_cast<std::size_t>(row) * static_cast<std::size_t>(width_ + 2) + static_cast<std::size_t>(column);
  }

  void edge(Vector2d a, Vector2d b, double value) {
    if (a.y() == b.y()) return;
    if (a.y() > b.y()) {
      std::swap(a, b);
      value = -value;
    }
    const double slope = (b.x() - a.x()) / (b.y() - a.y());
    const int first = std::max(0, static_cast<int>(std::floor(a.y())));
    const int last = std::min(height_ - 1, static_cast<int>(std::floor(b.y())));
    for (int row = first; row <= last; ++row) {
      const double top = std::max<double>(row, a.y());
      const double bottom = std::min<double>(row + 1, b.y());
      if (bottom <= top) continue;
      piece(a.x() + (top - a.y()) * slope, a.x() + (bottom - a.y()) * slope, row, value * (bottom - top));
    }
  }

  /// An edge inside one row: `value` is what a full cell to its right receives.
  void piece(double from, double to, int row, double value) {
    const double left = std::clamp(std::min(from, to), 0.0, static_cast<double>(width_));
    const double right = std::clamp(std::max(from, to), 0.0, static_cast<double>(width_));
    const int first = static_cast<int>(std::floor(left));
    const int last = std::min(static_cast<int>(std::floor(right)), width_);
    if (right - left < 1e-12) {
      cell(first, row, value * (first + 1 - left), value);
      return;
    }
    for (int column = first; column <= last; ++column) {
      const double low = std::max<double>(left, column);
      const double high = std::min<double>(right, column + 1);
      if (high <= low) continue;
      const double share = value * (high - low) / (right - left);
      cell(column, row, share * (column + 1 - 0.5 * (low + high)), share);
    }
  }

  void cell(int column, int row, double here, double total) {
    sum_[index(column, row)] += here;
    sum_[index(column + 1, row)] += total - here;
  }

  int width_;
  int height_;
  std::vector<double> sum_;
};

Vector2d bent(const Scene& scene, const Vector2d& undistorted) {
  if (!scene.camera) return undistorted;
  const CameraModel& camera = *scene.camera;
  return project(camera, {(undistorted.x() - camera.cx) / camera.fx, (undistorted.y() - camera.cy) / camera.fy, 1.0});
}

Vector2d pixel_of(const Scene& scene, const Vector2d& tag) {
  return bent(scene, (scene.image_by_tag * tag.homogeneous()).hnormalized());
}

/// Outline in pixels, cut finely where the lens bends it.
std::vector<Vector2d> outline_px(const Scene& scene, const std::vector<Vector2d>& outline) {
  std::vector<Vector2d> result;
  for (std::size_t i = 0; i < outline.size(); ++i) {
    const Vector2d& a = outline[i];
    const Vector2d& b = outline[(i + 1) % outline.size()];
    const int pieces = scene.camera ? std::max(1, static_cast<int>(std::ceil((b - a).norm() * 8.0))) : 1;
    for (int k = 0; k < pieces; ++k) result.push_back(pixel_of(scene, a + (b - a) * k / pieces));
  }
  return result;
}

/// The print as rectangles of one level, the ink's spread applied; level is the difference to the surroundings.
std::vector<Patch> print(const Scene& scene) {
  const TagPattern& pattern = scene.pattern;
  const int n = pattern.cells;
  const double middle = 0.5 * n;
  std::vector<double> line = {-middle};
  for (int i = 1; i < n; ++i)
    for (const double shift : {-std::abs(scene.bleed), std::abs(scene.bleed)})
      if (line.back() < i - middle + shift) line.push_back(i - middle + shift);
  line.push_back(middle);
  const auto colour = [&](double u, double v) {
    const int column = std::clamp(static_cast<int>(std::floor(u + middle)), 0, n - 1);
    const int row = std::clamp(static_cast<int>(std::floor(v + middle)), 0, n - 1);
    return pattern.at(column, row);
  };
  const auto level = [&](double u, double v) {
    const double reach = std::abs(scene.bleed);
    bool any_black = false;
    bool all_black = true;
    for (const double du : {-reach, reach})
      for (const double dv : {-reach, reach}) {
        any_black = any_black || colour(u + du, v + dv) == TagPattern::black;
        all_black = all_black && colour(u + du, v + dv) == TagPattern::black;
      }
    if (scene.bleed >= 0.0 ? any_black : all_black) return scene.black;
    return colour(u, v) == TagPattern::unknown ? scene.surroundings : scene.white;
  };
  std::vector<Patch> patches;
  for (std::size_t j = 0; j + 1 < line.size(); ++j)
    for (std::size_t i = 0; i + 1 < line.size(); ++i) {
      const double here = level(0.5 * (line[i] + line[i + 1]), 0.5 * (line[j] + line[j + 1]));
      patches.push_back(
          {{{line[i], line[j]}, {line[i + 1], line[j]}, {line[i + 1], line[j + 1]}, {line[i], line[j + 1]}},
           here - scene.surroundings});
    }
  return patches;
}

/// Grey value without noise, not rounded.
double toned(double light, const Sensor& sensor, ToneCurve curve) {
  const double share = std::max(light, 0.0) / 255.0;
  if (curve != nullptr) return 255.0 * curve(share);
  return sensor.tone == 1.0 ? light : 255.0 * std::pow(share, sensor.tone);
}

/// Weight of fine cells by their distance from a pixel's centre: Gaussian times the box, by quadrature of the Gaussian
/// (its variance less the fine cell's own).
std::vector<double> kernel(double sigma, int fine) {
  const double step = 1.0 / fine;
  const double own = std::sqrt(std::max(sigma * sigma - step * step / 12.0, 1e-4));
  const int reach = static_cast<int>(std::ceil((5.0 * sigma + 0.5) * fine)) + 1;
  std::vector<double> weights;
  double sum = 0.0;
  for (int i = -reach; i < reach; ++i) {
    const double distance = (i + 0.5) * step;
    const double weight = 0.5 * (std::erf((distance + 0.5) / (own * std::numbers::sqrt2)) -
                                 std::erf((distance - 0.5) / (own * std::numbers::sqrt2)));
    weights.push_back(weight);
    sum += weight;
  }
  for (double& weight : weights) weight /= sum;
  return weights;
}

}  // namespace

Corners true_corners(const Scene& scene) {
  const double half = 0.5 * scene.pattern.border_cells;
  return {pixel_of(scene, {-half, -half}), pixel_of(scene, {half, -half}), pixel_of(scene, {half, half}),
          pixel_of(scene, {-half, half})};
}

cv::Mat1d light(const Scene& scene) {
  const int fine = scene.blur_px < 0.5 ? 16 : 8;
  const std::vector<double> weights = kernel(scene.blur_px, fine);
  const int reach = static_cast<int>(weights.size()) / 2;
  const int width = scene.width * fine + 2 * reach;
  const int height = scene.height * fine + 2 * reach;
  // Fine cell (0, 0) begins `reach` cells before the first pixel's edge, which lies at -0.5 px.
  const auto to_fine = [&](const Vector2d& pixel) -> Vector2d {
    return (pixel.array() + 0.5) * fine + static_cast<double>(reach);
  };
  const int steps = scene.motion.norm() > 0.0 ? static_cast<int>(std::ceil(8.0 * scene.motion.norm())) : 1;
  Coverage coverage(width, height);
  const auto draw = [&](const std::vector<Vector2d>& outline, double difference) {
    const std::vector<Vector2d> pixels = outline_px(scene, outline);
    for (int k = 0; k < steps; ++k) {
      const Vector2d shift = scene.motion * ((k + 0.5) / steps - 0.5);
      std::vector<Vector2d> polygon;
      for (const Vector2d& p : pixels) polygon.push_back(to_fine(p + shift));
      coverage.add(polygon, difference / steps);
    }
  };
  for (const Patch& patch : print(scene)) draw(patch.outline, patch.level);
  cv::Mat1d reflected = coverage.image();
  reflected += scene.surroundings;
  for (const Patch& patch : scene.patches) {
    // A patch hides what is under it: mix by its own coverage (patches do not overlap borders at fine-cell level
    // often enough for the product of coverages to matter).
    Coverage own(width, height);
    for (int k = 0; k < steps; ++k) {
      const Vector2d shift = scene.motion * ((k + 0.5) / steps - 0.5);
      std::vector<Vector2d> polygon;
      for (const Vector2d& p : outline_px(scene, patch.outline)) polygon.push_back(to_fine(p + shift));
      own.add(polygon, 1.0 / steps);
    }
    const cv::Mat1d share = own.image();
    for (int row = 0; row < height; ++row)
      for (int column = 0; column < width; ++column)
        reflected(row, column) += share(row, column) * (patch.level - reflected(row, column));
  }
  if (scene.slope.norm() > 0.0) {
    const Vector2d centre = pixel_of(scene, Vector2d::Zero());
    for (int row = 0; row < height; ++row)
      for (int column = 0; column < width; ++column) {
        const Vector2d pixel((column + 0.5 - reach) / fine - 0.5, (row + 0.5 - reach) / fine - 0.5);
        reflected(row, column) *= std::max(0.0, 1.0 + scene.slope.dot(pixel - centre));
      }
  }
  cv::Mat1d narrow(height, scene.width, 0.0);
  for (int row = 0; row < height; ++row) {
    const double* source = reflected[row];
    for (int column = 0; column < scene.width; ++column) {
      // The pixel's centre lies on the boundary of fine cells column * fine + reach + fine/2.
      const double* from = source + column * fine + fine / 2;
      double sum = 0.0;
      for (std::size_t k = 0; k < weights.size(); ++k) sum += weights[k] * from[k];
      narrow(row, column) = sum;
    }
  }
  cv::Mat1d image(scene.height, scene.width, 0.0);
  for (int row = 0; row < scene.height; ++row) {
    double* target = image[row];
    for (std::size_t k = 0; k < weights.size(); ++k) {
      const double* source = narrow[row * fine + fine / 2 + static_cast<int>(k)];
      for (int column = 0; column < scene.width; ++column) target[column] += weights[k] * source[column];
    }
  }
  return image;
}

double srgb(double share) { return share <= 0.0031308 ? 12.92 * share : 1.055 * std::pow(share, 1.0 / 2.4) - 0.055; }

double rec709(double share) { return share < 0.018 ? 4.5 * share : 1.099 * std::pow(share, 0.45) - 0.099; }

cv::Mat1d traced_light(const Scene& scene, int rays, double disc_px, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  const Eigen::Matrix3d tag_by_image = scene.image_by_tag.inverse();
  const double middle = 0.5 * scene.pattern.cells;
  // Even places of the lens: Shirley and Chiu's concentric map of a grid, dealt out anew to every pixel's rays.
  std::vector<Vector2d> lens;
  for (int i = 0; i < rays; ++i)
    for (int j = 0; j < rays; ++j) {
      const double a = 2.0 * (i + 0.5) / rays - 1.0;
      const double b = 2.0 * (j + 0.5) / rays - 1.0;
      const bool wide = std::abs(a) > std::abs(b);
      const double radius = disc_px * (wide ? a : b);
      const double turn = 0.25 * std::numbers::pi * (wide ? b / a : 2.0 - (b == 0.0 ? 0.0 : a / b));
      lens.emplace_back(radius * std::cos(turn), radius * std::sin(turn));
    }
  cv::Mat1d image(scene.height, scene.width);
  for (int row = 0; row < image.rows; ++row)
    for (int column = 0; column < image.cols; ++column) {
      if (disc_px > 0.0) std::shuffle(lens.begin(), lens.end(), random);
      double sum = 0.0;
      for (int i = 0; i < rays; ++i)
        for (int j = 0; j < rays; ++j) {
          const Vector2d pixel = Vector2d(column - 0.5 + (i + 0.5) / rays, row - 0.5 + (j + 0.5) / rays) +
                                 lens[static_cast<std::size_t>(i * rays + j)];
          const Vector2d place = (tag_by_image * pixel.homogeneous()).hnormalized().array() + middle;
          const int u = static_cast<int>(std::floor(place.x()));
          const int v = static_cast<int>(std::floor(place.y()));
          const bool outside = u < 0 || v < 0 || u >= scene.pattern.cells || v >= scene.pattern.cells;
          const auto cell = outside ? TagPattern::unknown : scene.pattern.at(u, v);
          sum += cell == TagPattern::unknown ? scene.surroundings
                 : cell == TagPattern::black ? scene.black
                                             : scene.white;
        }
      image(row, column) = sum / (rays * rays);
    }
  return image;
}

cv::Mat1b expose(const cv::Mat1d& light, const Sensor& sensor, ToneCurve curve) {
  std::mt19937_64 random(sensor.seed);
  std::normal_distribution<double> normal;
  cv::Mat1b image(light.rows, light.cols);
  for (int row = 0; row < light.rows; ++row)
    for (int column = 0; column < light.cols; ++column) {
      double level = light(row, column);
      level += normal(random) * std::sqrt(sensor.read_noise * sensor.read_noise + sensor.gain * std::max(level, 0.0));
      level = toned(level, sensor, curve);
      image(row, column) = static_cast<unsigned char>(std::clamp(std::lround(level), 0L, 255L));
    }
  return image;
}

Eigen::Matrix3d view(const TagPattern& pattern, double side_px, double focal_px, const Vector2d& principal,
                     const Vector2d& centre, double tilt, double tilt_axis, double roll) {
  const Eigen::Vector3d axis(std::cos(tilt_axis), std::sin(tilt_axis), 0.0);
  const Eigen::Matrix3d rotation =
      (Eigen::AngleAxisd(tilt, axis) * Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitZ())).toRotationMatrix();
  const Eigen::Vector3d sight((centre.x() - principal.x()) / focal_px, (centre.y() - principal.y()) / focal_px, 1.0);
  Eigen::Matrix3d camera;
  camera << focal_px, 0.0, principal.x(), 0.0, focal_px, principal.y(), 0.0, 0.0, 1.0;
  // The distance that gives the wanted mean side, found by repetition: the side is nearly inverse to it.
  double distance = focal_px * pattern.border_cells / side_px;
  Eigen::Matrix3d result;
  for (int i = 0; i < 20; ++i) {
    Eigen::Matrix3d plane;
    plane << rotation.col(0), rotation.col(1), distance * sight;
    result = camera * plane;
    double mean = 0.0;
    const double half = 0.5 * pattern.border_cells;
    const std::array<Vector2d, 4> corner = {Vector2d(-half, -half), Vector2d(half, -half), Vector2d(half, half),
                                            Vector2d(-half, half)};
    for (std::size_t k = 0; k < 4; ++k)
      mean += 0.25 * ((result * corner[(k + 1) % 4].homogeneous()).hnormalized() -
                      (result * corner[k].homogeneous()).hnormalized())
                         .norm();
    distance *= mean / side_px;
  }
  return result;
}

Eigen::Matrix3d image_by_corners(const TagPattern& pattern, const Corners& px) {
  const double half = 0.5 * pattern.border_cells;
  const std::array<Vector2d, 4> tag = {Vector2d(-half, -half), Vector2d(half, -half), Vector2d(half, half),
                                       Vector2d(-half, half)};
  Eigen::Matrix<double, 8, 8> m = Eigen::Matrix<double, 8, 8>::Zero();
  Eigen::Matrix<double, 8, 1> b;
  for (int k = 0; k < 4; ++k) {
    const Vector2d& t = tag[static_cast<std::size_t>(k)];
    const Vector2d& p = px[static_cast<std::size_t>(k)];
    m.row(2 * k) << t.x(), t.y(), 1.0, 0.0, 0.0, 0.0, -t.x() * p.x(), -t.y() * p.x();
    m.row(2 * k + 1) << 0.0, 0.0, 0.0, t.x(), t.y(), 1.0, -t.x() * p.y(), -t.y() * p.y();
    b[2 * k] = p.x();
    b[2 * k + 1] = p.y();
  }
  const Eigen::Matrix<double, 8, 1> h = m.fullPivLu().solve(b);
  Eigen::Matrix3d result;
  result << h[0], h[1], h[2], h[3], h[4], h[5], h[6], h[7], 1.0;
  return result;
}

Eigen::Matrix<double, 8, 8> corner_information(const Scene& scene, const Sensor& sensor, ToneCurve curve) {
  const cv::Mat1d middle = light(scene);
  const Corners seen = true_corners(scene);
  const auto undistorted = [&](const Vector2d& pixel) -> Vector2d {
    if (!scene.camera) return pixel;
    const Vector2d ideal = unproject(*scene.camera, pixel).value();
    return {scene.camera->fx * ideal.x() + scene.camera->cx, scene.camera->fy * ideal.y() + scene.camera->cy};
  };
  using Change = std::function<void(Scene&, double)>;
  std::vector<std::pair<Change, double>> changes;
  for (std::size_t k = 0; k < 4; ++k)
    for (int axis = 0; axis < 2; ++axis)
      changes.emplace_back(
          [&, k, axis](Scene& s, double step) {
            Corners moved = seen;
            moved[k][axis] += step;
            for (Vector2d& corner : moved) corner = undistorted(corner);
            s.image_by_tag = image_by_corners(s.pattern, moved);
          },
          0.02);
  changes.emplace_back([](Scene& s, double step) { s.blur_px += step; }, 0.01);
  changes.emplace_back([](Scene& s, double step) { s.white += step; }, 1.0);
  changes.emplace_back([](Scene& s, double step) { s.black += step; }, 1.0);
  changes.emplace_back([](Scene& s, double step) { s.slope.x() += step; }, 1e-4);
  changes.emplace_back([](Scene& s, double step) { s.slope.y() += step; }, 1e-4);
  const auto count = static_cast<Eigen::Index>(changes.size());
  // What the far edge of the margin says is not the tag's: pixels that see it carry nothing.
  Scene other = scene;
  other.surroundings += 1.0;
  const cv::Mat1d beyond = light(other);
  std::vector<cv::Mat1d> slope;
  for (const auto& [change, step] : changes) {
    Scene up = scene;
    Scene down = scene;
    change(up, step);
    change(down, -step);
    slope.emplace_back((light(up) - light(down)) / (2.0 * step));
  }
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(count, count);
  for (int row = 0; row < middle.rows; ++row)
    for (int column = 0; column < middle.cols; ++column) {
      if (beyond(row, column) - middle(row, column) > 0.02) continue;
      const double level = middle(row, column);
      const double grey = toned(level, sensor, curve);
      const double by_light = (toned(level + 0.01, sensor, curve) - toned(level - 0.01, sensor, curve)) / 0.02;
      if (grey < 0.5 || grey > 254.5) continue;
      const double variance =
          (sensor.read_noise * sensor.read_noise + sensor.gain * std::max(level, 0.0)) * by_light * by_light +
          1.0 / 12.0;
      Eigen::VectorXd by(count);
      for (Eigen::Index i = 0; i < count; ++i) by[i] = by_light * slope[static_cast<std::size_t>(i)](row, column);
      information += by * by.transpose() / variance;
    }
  const Eigen::Index rest = count - 8;
  return information.topLeftCorner(8, 8) -
         information.topRightCorner(8, rest) *
             information.bottomRightCorner(rest, rest).ldlt().solve(information.bottomLeftCorner(rest, 8));
}

}  // namespace tagdock::rendering
