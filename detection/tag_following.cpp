#include "detection/tag_following.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include <visp3/core/vpColVector.h>
#include <visp3/core/vpException.h>
#include <visp3/core/vpExponentialMap.h>
#include <visp3/core/vpHomogeneousMatrix.h>
#include <visp3/core/vpMatrix.h>
#include <visp3/core/vpRobust.h>

#include "detection/tag_pattern.h"

namespace tagdock {
namespace {

using Vector2 = Eigen::Vector2d;
using Vector3 = Eigen::Vector3d;

constexpr double least_side_px = 16.0;  ///< of a tag whose cells can be told apart
constexpr double widest_ideal = 2.0;    ///< lens models fold over beyond
constexpr double search_cells = 0.9;    ///< farther away lies the next border
constexpr double most_search_px = 30.0;
constexpr double least_contrast = 8.0;  ///< grey levels over two pixels; less is no border of a tag
constexpr std::size_t least_borders = 12;

/// A tag as it should be seen.
struct Expected {
  const BoardTag* tag;
  TagPattern pattern;
  Corners corners_px;
  double cell_px;  ///< least, over the sides
};

/// A point of a border in the model.
struct Border {
  Vector3 station;  ///< the point
  Vector3 along;    ///< a point beside it on the border
  int step;         ///< +1: white on the left of point -> along
};

std::optional<double> grey_at(const cv::Mat1b& gray, const Vector2& at) {
  if (!(at.x() >= 0.0 && at.y() >= 0.0 && at.x() < gray.cols - 1.0 && at.y() < gray.rows - 1.0)) return std::nullopt;
  const int column = static_cast<int>(at.x());
  const int row = static_cast<int>(at.y());
  const double a = at.x() - column;
  const double b = at.y() - row;
  return (1.0 - b) * ((1.0 - a) * gray(row, column) + a * gray(row, column + 1)) +
         b * ((1.0 - a) * gray(row + 1, column) + a * gray(row + 1, column + 1));
}

/// A place of the tag, given in cells from the print's upper left corner.
Vector3 station_of(const BoardTag& tag, const TagPattern& pattern, double u, double v) {
  const double cell = tag.size / pattern.border_cells;
  const double middle = 0.5 * pattern.cells;
  return tag.T_station_tag * Vector3((u - middle) * cell, (v - middle) * cell, 0.0);
}

std::vector<Expected> expected_tags(const cv::Mat1b& gray, const Board& board, const CameraModel& camera,
                                    const Eigen::Isometry3d& T_camera_station, double border_px) {
  std::vector<Expected> tags;
  for (const BoardTag& tag : board.tags) {
    const Eigen::Isometry3d T_camera_tag = T_camera_station * tag.T_station_tag;
    if (!(T_camera_tag.linear().col(2).dot(T_camera_tag.translation()) > 0.0)) continue;  // seen from behind
    Expected one{&tag, {}, {}, 1e9};
    const TagPoints corners = corners_station(tag);
    bool inside = true;
    for (std::size_t k = 0; k < 4 && inside; ++k) {
      const Vector3 corner = T_camera_station * corners[k];
      inside = corner.z() > 0.0 && corner.head<2>().cwiseAbs().maxCoeff() < widest_ideal * corner.z();
      if (!inside) break;
      one.corners_px[k] = project(camera, corner);
      inside = one.corners_px[k].x() >= border_px && one.corners_px[k].y() >= border_px &&
               one.corners_px[k].x() <= gray.cols - 1 - border_px && one.corners_px[k].y() <= gray.rows - 1 - border_px;
    }
    if (!inside) continue;
    double shortest = 1e9;
    for (std::size_t k = 0; k < 4; ++k)
      shortest = std::min(shortest, (one.corners_px[(k + 1) % 4] - one.corners_px[k]).norm());
    if (shortest < least_side_px) continue;
    one.pattern = tag_pattern(board.family, tag.id);
    one.cell_px = shortest / one.pattern.border_cells;
    tags.push_back(std::move(one));
  }
  return tags;
}

/// The middles of the outline's pieces that separate black from white.
std::vector<Border> outline(const Expected& one) {
  const TagPattern& pattern = one.pattern;
  const int first = (pattern.cells - pattern.border_cells) / 2;
  const int last = first + pattern.border_cells;
  const auto known = [&](int column, int row) {
    return column >= 0 && row >= 0 && column < pattern.cells && row < pattern.cells ? pattern.at(column, row)
                                                                                    : TagPattern::unknown;
  };
  std::vector<Border> borders;
  const auto add = [&](double u, double v, double du, double dv, TagPattern::Cell left, TagPattern::Cell right) {
    if (left == right || left == TagPattern::unknown || right == TagPattern::unknown) return;
    borders.push_back({station_of(*one.tag, pattern, u, v), station_of(*one.tag, pattern, u + du, v + dv),
                       left == TagPattern::white ? 1 : -1});
  };
  // Left of the direction of travel, y running down, is upwards when going right.
  for (int i = first; i < last; ++i) {
    const double middle = i + 0.5;
    add(middle, first, 0.3, 0.0, known(i, first - 1), known(i, first));
    add(middle, last, 0.3, 0.0, known(i, last - 1), known(i, last));
    add(first, middle, 0.0, -0.3, known(first - 1, i), known(first, i));
    add(last, middle, 0.0, -0.3, known(last - 1, i), known(last, i));
  }
  return borders;
}

/// Where along a normal the grey step of the wanted sign is steepest [px]; none if there is no step.
std::optional<double> step_along(const cv::Mat1b& gray, const Vector2& from, const Vector2& normal, int sign,
                                 double reach_px) {
  const int reach = std::max(2, static_cast<int>(std::ceil(reach_px)));
  std::array<double, 2 * 32 + 3> grey{};
  for (int i = -reach - 1; i <= reach + 1; ++i) {
    const auto value = grey_at(gray, from + i * normal);
    if (!value) return std::nullopt;
    grey[static_cast<std::size_t>(i + reach + 1)] = sign * *value;
  }
  const auto slope = [&](int i) {
    const auto k = static_cast<std::size_t>(i + reach + 1);
    return grey[k + 1] - grey[k - 1];
  };
  int best = 0;
  double steepest = 0.0;
  for (int i = -reach; i <= reach; ++i)
    if (slope(i) > steepest) {
      steepest = slope(i);
      best = i;
    }
  if (steepest < least_contrast) return std::nullopt;
  if (best == -reach || best == reach) return best;
  const double before = slope(best - 1);
  const double after = slope(best + 1);
  const double bend = before - 2.0 * steepest + after;
  return bend < 0.0 ? best + std::clamp(0.5 * (before - after) / bend, -0.5, 0.5) : best;
}

vpHomogeneousMatrix in_visp(const Eigen::Isometry3d& T) {
  vpHomogeneousMatrix M;
  for (unsigned int row = 0; row < 3; ++row)
    for (unsigned int column = 0; column < 4; ++column) M[row][column] = T(row, column);
  return M;
}

Eigen::Isometry3d from_visp(const vpHomogeneousMatrix& M) {
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  for (unsigned int row = 0; row < 3; ++row)
    for (unsigned int column = 0; column < 4; ++column) T(row, column) = M[row][column];
  T.linear() = Eigen::Quaterniond(T.linear()).normalized().toRotationMatrix();
  return T;
}

/// A grey step in the plane z = 1: the line that the model's point shall come to.
struct Target {
  Vector3 station;
  Vector2 normal;
  double distance;
};

/// The grey steps near the borders as a pose shows them.
std::vector<Target> targets(const cv::Mat1b& gray, const std::vector<Expected>& tags, const CameraModel& camera,
                            const Eigen::Isometry3d& T_camera_station, double most_px) {
  std::vector<Target> found;
  for (const Expected& one : tags)
    for (const Border& border : outline(one)) {
      const Vector3 point = T_camera_station * border.station;
      const Vector3 beside = T_camera_station * border.along;
      if (!(point.z() > 0.0 && beside.z() > 0.0)) continue;
      const Vector2 pixel = project(camera, point);
      const Vector2 along = project(camera, beside) - pixel;
      if (!(along.norm() > 0.0)) continue;
      const Vector2 normal = Vector2(along.y(), -along.x()).normalized();  // to the left as seen, y down
      const auto offset = step_along(gray, pixel, normal, border.step, std::min(search_cells * one.cell_px, most_px));
      if (!offset) continue;
      const auto ideal = unproject(camera, pixel + *offset * normal);
      if (!ideal) continue;
      const Vector2 ideal_along = beside.hnormalized() - point.hnormalized();
      const Vector2 ideal_normal = Vector2(ideal_along.y(), -ideal_along.x()).normalized();
      found.push_back({border.station, ideal_normal, ideal_normal.dot(*ideal)});
    }
  return found;
}

/// Virtual visual servoing: the pose that brings the model's points to their lines, outliers weighed down.
std::optional<Eigen::Isometry3d> servo_to(const std::vector<Target>& targets, const Eigen::Isometry3d& start) {
  if (targets.size() < least_borders) return std::nullopt;
  const auto count = static_cast<unsigned int>(targets.size());
  constexpr int most_steps = 15;
  constexpr double settled = 1e-8;  // [m and rad], squared
  vpHomogeneousMatrix cMo = in_visp(start);
  vpMatrix L(count, 6);
  vpColVector error(count);
  vpColVector weights(count);
  vpRobust robust;
  robust.setMinMedianAbsoluteDeviation(2e-4);  // a fifth of a pixel at a focal length of 1000
  try {
    for (int step = 0; step < most_steps; ++step) {
      const Eigen::Isometry3d T = from_visp(cMo);
      for (unsigned int i = 0; i < count; ++i) {
        const Target& target = targets[i];
        const Vector3 point = T * target.station;
        if (!(point.z() > 0.0)) return std::nullopt;
        const double x = point.x() / point.z();
        const double y = point.y() / point.z();
        const double z = point.z();
        error[i] = target.normal.dot(Vector2(x, y)) - target.distance;
        const Eigen::Matrix<double, 2, 6> by = (Eigen::Matrix<double, 2, 6>() << -1.0 / z, 0.0, x / z, x * y,
                                                -(1.0 + x * x), y, 0.0, -1.0 / z, y / z, 1.0 + y * y, -x * y, -x)
                                                   .finished();
        const Eigen::Matrix<double, 1, 6> row = target.normal.transpose() * by;
        for (unsigned int k = 0; k < 6; ++k) L[i][k] = row[k];
      }
      robust.MEstimator(vpRobust::TUKEY, error, weights);
      vpMatrix LtWL(6, 6, 0.0);
      vpColVector LtWe(6, 0.0);
      for (unsigned int i = 0; i < count; ++i)
        for (unsigned int k = 0; k < 6; ++k) {
          for (unsigned int l = 0; l < 6; ++l) LtWL[k][l] += weights[i] * L[i][k] * L[i][l];
          LtWe[k] += weights[i] * L[i][k] * error[i];
        }
      const vpColVector velocity = -1.0 * (LtWL.pseudoInverse(1e-12) * LtWe);
      cMo = vpExponentialMap::direct(velocity).inverse() * cMo;
      if (velocity.sumSquare() < settled) break;
    }
  } catch (const vpException&) {
    return std::nullopt;
  }
  const Eigen::Isometry3d T = from_visp(cMo);
  if (!T.matrix().allFinite()) return std::nullopt;
  return T;
}

/// Reads the code at the places of the cells; none if it is not this tag.
std::optional<TagDetection> read(const cv::Mat1b& gray, const Expected& one, const CameraModel& camera,
                                 const Eigen::Isometry3d& T_camera_station, int max_hamming, double border_px) {
  const TagPattern& pattern = one.pattern;
  std::vector<double> greys;
  double black = 0.0;
  double white = 0.0;
  int blacks = 0;
  int whites = 0;
  for (int row = 0; row < pattern.cells; ++row)
    for (int column = 0; column < pattern.cells; ++column) {
      const Vector3 point = T_camera_station * station_of(*one.tag, pattern, column + 0.5, row + 0.5);
      const auto grey = point.z() > 0.0 ? grey_at(gray, project(camera, point)) : std::nullopt;
      greys.push_back(grey.value_or(-1.0));
      if (!grey) continue;
      if (pattern.at(column, row) == TagPattern::black) {
        black += *grey;
        ++blacks;
      } else if (pattern.at(column, row) == TagPattern::white) {
        white += *grey;
        ++whites;
      }
    }
  if (blacks == 0 || whites == 0) return std::nullopt;
  const double middle = 0.5 * (black / blacks + white / whites);
  if (white / whites - black / blacks < least_contrast) return std::nullopt;
  const int first = (pattern.cells - pattern.border_cells) / 2;
  const int last = first + pattern.border_cells - 1;
  int wrong = 0;
  double margin = 0.0;
  int read_cells = 0;
  for (int row = 0; row < pattern.cells; ++row)
    for (int column = 0; column < pattern.cells; ++column) {
      const double grey = greys[static_cast<std::size_t>(row * pattern.cells + column)];
      const TagPattern::Cell cell = pattern.at(column, row);
      const bool inside = column >= first && row >= first && column <= last && row <= last;
      if (cell == TagPattern::unknown) continue;
      if (grey < 0.0) {
        if (inside) return std::nullopt;
        continue;
      }
      // Beyond the square a margin says nothing of the code, and may be narrow.
      const bool data_outside =
          !inside && std::find(pattern.cell.begin(), pattern.cell.end(), TagPattern::unknown) == pattern.cell.end() &&
          first > 1;
      if (!inside && !data_outside) continue;
      wrong += (grey > middle) != (cell == TagPattern::white);
      margin += std::abs(grey - middle);
      ++read_cells;
    }
  if (wrong > max_hamming) return std::nullopt;
  TagDetection detection;
  detection.id = one.tag->id;
  detection.hamming = wrong;
  detection.margin = margin / std::max(read_cells, 1);
  detection.modules = pattern.border_cells;
  const TagPoints corners = corners_station(*one.tag);
  for (std::size_t k = 0; k < 4; ++k) {
    detection.corners_px[k] = project(camera, T_camera_station * corners[k]);
    const Vector2& at = detection.corners_px[k];
    if (!(at.x() >= border_px && at.y() >= border_px && at.x() <= gray.cols - 1 - border_px &&
          at.y() <= gray.rows - 1 - border_px))
      return std::nullopt;
  }
  return detection;
}

}  // namespace

FollowedTags follow_tags(const cv::Mat1b& gray, const Board& board, const CameraModel& camera,
                         const Eigen::Isometry3d& predicted, int max_hamming, double border_px) {
  FollowedTags followed;
  if (!predicted.matrix().allFinite() || gray.cols < 4 || gray.rows < 4) return followed;
  const std::vector<Expected> tags = expected_tags(gray, board, camera, predicted, border_px);
  followed.expected = static_cast<int>(tags.size());
  followed.T_camera_station = predicted;
  if (tags.empty()) return followed;
  // A wide look, then a close one whose normals are right.
  for (const double most_px : {most_search_px, 3.0}) {
    const auto T = servo_to(targets(gray, tags, camera, followed.T_camera_station, most_px), followed.T_camera_station);
    if (!T) return followed;
    followed.T_camera_station = *T;
  }
  for (const Expected& one : tags)
    if (const auto detection = read(gray, one, camera, followed.T_camera_station, max_hamming, border_px))
      followed.tags.push_back(*detection);
  std::sort(followed.tags.begin(), followed.tags.end(), [](const auto& a, const auto& b) { return a.id < b.id; });
  return followed;
}

}  // namespace tagdock
