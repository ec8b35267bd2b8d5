// What a calibration's uncertainty is over the image, and which view would lower it most.
#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>
#include <Eigen/LU>

#include "calibration/intrinsics.h"
#include "calibration/lens_projection.h"
#include "planning/pose2.h"

namespace tagdock {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Matrix12 = Eigen::Matrix<double, 12, 12>;
using Matrix212 = Eigen::Matrix<double, 2, 12>;

/// Derivatives of the picture by the lens at the places of a grid, without what a turn of the camera explains.
std::vector<Matrix212> by_lens_without_turn(const CameraModel& camera, const std::vector<Vector2d>& pixels) {
  std::vector<Matrix212> G;
  std::vector<Eigen::Matrix<double, 2, 3>> R;
  Matrix3d information = Matrix3d::Zero();
  Eigen::Matrix<double, 3, 12> cross = Eigen::Matrix<double, 3, 12>::Zero();
  for (const Vector2d& pixel : pixels) {
    const std::optional<Vector2d> ideal = unproject(camera, pixel);
    if (!ideal) {  // the lens model folds over: nothing is known there, and the caller sees a zero row
      G.push_back(Matrix212::Zero());
      R.push_back(Eigen::Matrix<double, 2, 3>::Zero());
      continue;
    }
    G.push_back(pixel_by_lens(camera, *ideal));
    const Vector3d sight = ideal->homogeneous();
    Matrix3d by_turn;
    by_turn << 0.0, sight.z(), -sight.y(), -sight.z(), 0.0, sight.x(), sight.y(), -sight.x(), 0.0;
    R.push_back(project_with_jacobian(camera, sight).by_point * by_turn);
    information += R.back().transpose() * R.back();
    cross += R.back().transpose() * G.back();
  }
  const Eigen::Matrix<double, 3, 12> turn = information.ldlt().solve(cross);
  for (std::size_t i = 0; i < G.size(); ++i) G[i] -= R[i] * turn;
  return G;
}

}  // namespace

Matrix212 pixel_by_lens(const CameraModel& camera, const Vector2d& ideal) {
  const LensValues lens = lens_of(camera);
  Matrix212 J;
  for (std::size_t i = 0; i < lens.size(); ++i) {
    const double step = i < 4 ? 1e-3 : 1e-6;
    LensValues up = lens;
    LensValues down = lens;
    up[i] += step;
    down[i] -= step;
    const Vector3d sight = ideal.homogeneous();
    J.col(static_cast<Eigen::Index>(i)) =
        (project_point<double>(up.data(), sight) - project_point<double>(down.data(), sight)) / (2.0 * step);
  }
  return J;
}

ImageMap projection_sigma(const CameraModel& camera, const Matrix12& covariance, int columns, int rows) {
  ImageMap map{columns, rows, image_grid(camera.width, camera.height, columns, rows), {}};
  for (const Matrix212& J : by_lens_without_turn(camera, map.pixels))
    map.values.emplace_back(std::sqrt(std::max(0.0, (J * covariance * J.transpose()).trace())), 0.0);
  return map;
}

std::vector<ViewWish> next_best_views(const IntrinsicsResult& result, const std::vector<Vector3d>& points,
                                      std::size_t count) {
  const CameraModel& camera = result.camera;
  std::vector<Eigen::Index> active;
  for (Eigen::Index i = 0; i < 12; ++i)
    if (result.covariance(i, i) > 0.0) active.push_back(i);
  const auto used = static_cast<Eigen::Index>(active.size());
  if (used == 0 || points.size() < 4) return {};
  const auto taken = [&](const Matrix12& whole) {
    Eigen::MatrixXd part(used, used);
    for (Eigen::Index a = 0; a < used; ++a)
      for (Eigen::Index b = 0; b < used; ++b)
        part(a, b) = whole(active[static_cast<std::size_t>(a)], active[static_cast<std::size_t>(b)]);
    return part;
  };
  const Eigen::MatrixXd information = taken(result.covariance).inverse();
  Matrix12 weight = Matrix12::Zero();
  const std::vector<Vector2d> grid = image_grid(camera.width, camera.height, 12, 9);
  for (const Matrix212& J : by_lens_without_turn(camera, grid)) weight += J.transpose() * J;
  const Eigen::MatrixXd wanted = taken(weight) / static_cast<double>(grid.size());

  Vector3d centre = Vector3d::Zero();
  for (const Vector3d& point : points) centre += point / static_cast<double>(points.size());
  double half = 0.0;
  for (const Vector3d& point : points) half = std::max(half, (point - centre).norm());
  double sigma = 0.05 * result.noise_scale;  // px, if nothing is known
  if (result.rms_px > 0.0) sigma = result.rms_px;

  struct Place {
    const char* word;
    double x, y;
  };
  constexpr Place places[] = {{"in the middle of the picture", 0.5, 0.5},
                              {"towards the top left corner", 0.2, 0.2},
                              {"towards the top right corner", 0.8, 0.2},
                              {"towards the bottom left corner", 0.2, 0.8},
                              {"towards the bottom right corner", 0.8, 0.8}};
  struct Lean {
    const char* word;
    double x, y;  // axis of the turn, in the camera frame
  };
  constexpr Lean leans[] = {{"facing the camera", 0.0, 0.0},
                            {"with its left edge 40 degrees nearer", 0.0, 1.0},
                            {"with its right edge 40 degrees nearer", 0.0, -1.0},
                            {"with its top edge 40 degrees nearer", -1.0, 0.0},
                            {"with its bottom edge 40 degrees nearer", 1.0, 0.0}};
  struct Size {
    const char* word;
    double share;  // of the picture's width that the board's diagonal covers
  };
  constexpr Size sizes[] = {{"filling two thirds of the picture", 0.85}, {"filling a third of the picture", 0.42}};

  std::vector<ViewWish> wishes;
  for (const Place& place : places)
    for (const Lean& lean : leans)
      for (const Size& size : sizes) {
        const Vector2d pixel(place.x * camera.width, place.y * camera.height);
        const std::optional<Vector2d> ideal = unproject(camera, pixel);
        if (!ideal) continue;
        ViewWish wish;
        const double depth = camera.fx * 2.0 * half / (size.share * camera.width);
        Matrix3d turn = Matrix3d::Identity();
        if (lean.x != 0.0 || lean.y != 0.0)
          turn = Eigen::AngleAxisd(radians(40.0), Vector3d(lean.x, lean.y, 0.0)).toRotationMatrix();
        wish.T_camera_board.linear() = turn;
        wish.T_camera_board.translation() = depth * Vector3d(ideal->homogeneous()) - turn * centre;
        // What its corners tell of the lens when its pose is free.
        Eigen::MatrixXd A = Eigen::MatrixXd::Zero(12, 12);
        Eigen::MatrixXd B = Eigen::MatrixXd::Zero(12, 6);
        Eigen::Matrix<double, 6, 6> C = Eigen::Matrix<double, 6, 6>::Identity() * 1e-9;
        int seen = 0;
        for (const Vector3d& point : points) {
          const Vector3d at = wish.T_camera_board * point;
          if (at.z() < 0.02) continue;
          const Projection projection = project_with_jacobian(camera, at);
          if (projection.pixel.x() < 5 || projection.pixel.y() < 5 || projection.pixel.x() > camera.width - 6 ||
              projection.pixel.y() > camera.height - 6)
            continue;
          ++seen;
          const Matrix212 by_lens = pixel_by_lens(camera, at.head<2>() / at.z());
          Eigen::Matrix<double, 3, 6> by_pose;
          Matrix3d by_turn;
          by_turn << 0.0, at.z(), -at.y(), -at.z(), 0.0, at.x(), at.y(), -at.x(), 0.0;
          by_pose << Matrix3d::Identity(), by_turn;
          const Eigen::Matrix<double, 2, 6> J = projection.by_point * by_pose;
          A += by_lens.transpose() * by_lens;
          B += by_lens.transpose() * J;
          C += J.transpose() * J;
        }
        if (seen < 8) continue;
        const Matrix12 gain = (A - B * C.ldlt().solve(B.transpose())) / (sigma * sigma);
        const Eigen::MatrixXd covariance = (information + taken(gain)).inverse();
        wish.sigma_after_px = std::sqrt(std::max(0.0, (wanted * covariance).trace()));
        wish.sentence = std::string("hold the board ") + place.word + ", " + size.word + ", " + lean.word;
        wishes.push_back(wish);
      }
  std::stable_sort(wishes.begin(), wishes.end(),
                   [](const ViewWish& a, const ViewWish& b) { return a.sigma_after_px < b.sigma_after_px; });
  if (wishes.size() > count) wishes.resize(count);
  return wishes;
}

}  // namespace tagdock
