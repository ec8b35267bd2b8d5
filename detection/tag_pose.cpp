#include "detection/tag_pose.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <Eigen/SVD>
#include <visp3/core/vpException.h>
#include <visp3/core/vpPoint.h>
#include <visp3/vision/vpPose.h>

namespace tagdock {
namespace {

using Vector6 = Eigen::Matrix<double, 6, 1>;
using Vector8 = Eigen::Matrix<double, 8, 1>;
using Matrix8 = Eigen::Matrix<double, 8, 8>;

constexpr double least_depth = 1e-3;  ///< m; nearer points are taken to be behind the camera
/// Two minima that differ by less are one [rad].
constexpr double same_rotation = 1e-4;
/// A difference of chi-square of 10 settles which of two poses it is (notes on detection, section 11).
constexpr double settled_log_odds = 5.0;

/// One tag's share of the fit.
struct Term {
  TagPoints points;  ///< in the frame that is sought
  Corners corners_px;
  Matrix8 whitening;  ///< W with W cov W^T = 1
  bool independent;   ///< W is diagonal
  double side_px;
};

struct Fit {
  Eigen::Isometry3d T_camera_frame;
  Matrix6 information;
  double chi2;  ///< of the corners alone
  double cost;  ///< chi2 and the prior's share
  double reprojection_rms_px;
};

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

/// Whether corners are finite, convex and run clockwise as a tag seen from its front does.
bool seen_from_the_front(const Corners& corners) {
  for (const Eigen::Vector2d& corner : corners)
    if (!corner.allFinite()) return false;
  for (int i = 0; i < 4; ++i)
    if (!(cross(corners[(i + 1) % 4] - corners[i], corners[(i + 2) % 4] - corners[(i + 1) % 4]) > 0.0)) return false;
  return true;
}

std::optional<Term> term(const RefinedTag& tag, const TagPoints& points) {
  if (!seen_from_the_front(tag.corners_px) || !tag.covariance_px2.allFinite()) return std::nullopt;
  Term made{points, tag.corners_px, Matrix8::Zero(), tag.covariance_px2.isDiagonal(0.0), 0.0};
  if (made.independent) {
    if (!(tag.covariance_px2.diagonal().minCoeff() > 0.0)) return std::nullopt;
    made.whitening.diagonal() = tag.covariance_px2.diagonal().cwiseSqrt().cwiseInverse();
  } else {
    const Eigen::LLT<Matrix8> factor(tag.covariance_px2);
    if (factor.info() != Eigen::Success) return std::nullopt;
    made.whitening = factor.matrixL().solve(Matrix8::Identity());
  }
  if (!made.whitening.allFinite()) return std::nullopt;
  for (int i = 0; i < 4; ++i) made.side_px += 0.25 * (tag.corners_px[(i + 1) % 4] - tag.corners_px[i]).norm();
  return made;
}

Eigen::Matrix3d skew(const Eigen::Vector3d& v) {
  Eigen::Matrix3d matrix;
  matrix << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return matrix;
}

/// Normal equations at a pose; none where a point is behind the camera.
struct Equations {
  Matrix6 information = Matrix6::Zero();
  Vector6 gradient = Vector6::Zero();
  double chi2 = 0.0;
  double cost = 0.0;
  double squared_px = 0.0;
};

std::optional<Equations> equations_at(const Eigen::Isometry3d& T_camera_frame, std::span<const Term> terms,
                                      const CameraModel& camera, const std::optional<GroundPrior>& prior) {
  Equations equations;
  for (const Term& one : terms) {
    Vector8 residual;
    Eigen::Matrix<double, 8, 6> jacobian;
    for (int i = 0; i < 4; ++i) {
      const Eigen::Vector3d point_camera = T_camera_frame * one.points[i];
      if (!(point_camera.z() > least_depth)) return std::nullopt;
      const Projection seen = project_with_jacobian(camera, point_camera);
      residual.segment<2>(2 * i) = seen.pixel - one.corners_px[i];
      for (int row = 0; row < 2; ++row) {
        const auto by = seen.by_point.row(row);
        const int k = 2 * i + row;
        jacobian.block<1, 3>(k, 0) = by;
        // -by * skew(point), without the zeros
        jacobian(k, 3) = -by[1] * point_camera.z() + by[2] * point_camera.y();
        jacobian(k, 4) = by[0] * point_camera.z() - by[2] * point_camera.x();
        jacobian(k, 5) = -by[0] * point_camera.y() + by[1] * point_camera.x();
      }
    }
    equations.squared_px += residual.squaredNorm();
    // lazyProduct: Eigen takes these for large matrices, and packs and blocks them.
    Vector8 white;
    Eigen::Matrix<double, 8, 6> white_jacobian;
    if (one.independent) {
      white = one.whitening.diagonal().cwiseProduct(residual);
      white_jacobian = one.whitening.diagonal().asDiagonal() * jacobian;
    } else {
      white = one.whitening.lazyProduct(residual);
      white_jacobian = one.whitening.lazyProduct(jacobian);
    }
    // Half of a symmetric product.
    for (int column = 0; column < 6; ++column)
      for (int row = 0; row <= column; ++row)
        equations.information(row, column) += white_jacobian.col(row).dot(white_jacobian.col(column));
    equations.gradient += white_jacobian.transpose() * white;
    equations.chi2 += white.squaredNorm();
  }
  equations.cost = equations.chi2;
  if (prior) {
    const PriorEquations ground = ground_equations(*prior, T_camera_frame);
    equations.information += ground.information;
    equations.gradient += ground.gradient;
    equations.cost += ground.cost;
  }
  equations.information.triangularView<Eigen::StrictlyLower>() = equations.information.transpose();
  if (!std::isfinite(equations.cost) || !equations.information.allFinite()) return std::nullopt;
  return equations;
}

constexpr double first_damping = 1e-4;

/// Levenberg-Marquardt from one start; none if it does not end at a minimum in front of the camera.
/// @param damping  of the first step; small where the start is known to be near
/// @param enough   a step smaller than this is the last [m, rad]; 0: the cost must have settled, too
std::optional<Fit> fit_pose(const Eigen::Isometry3d& start, std::span<const Term> terms, const CameraModel& camera,
                            const std::optional<GroundPrior>& prior, double damping = first_damping,
                            double enough = 0.0) {
  constexpr int most_steps = 60;
  Eigen::Isometry3d T = start;
  std::optional<Equations> here = equations_at(T, terms, camera, prior);
  if (!here) return std::nullopt;
  for (int step = 0; step < most_steps; ++step) {
    Matrix6 damped = here->information;
    damped.diagonal() *= 1.0 + damping;
    const Vector6 motion = -damped.ldlt().solve(here->gradient);
    if (!motion.allFinite()) return std::nullopt;
    const Eigen::Isometry3d T_next = moved(motion, T);
    const std::optional<Equations> next = equations_at(T_next, terms, camera, prior);
    if (next && next->cost <= here->cost) {
      const bool settled = here->cost - next->cost <= 1e-12 * (1.0 + here->cost) && motion.norm() < 1e-7;
      T = T_next;
      here = next;
      damping = std::max(1e-9, 0.2 * damping);
      if (settled || motion.norm() < enough) break;
    } else {
      // Near the minimum rounding decides whether the cost falls. A step of this size, rejected, changes nothing more.
      constexpr double nothing = 1e-10;  // m and rad
      if (next && motion.norm() < nothing) break;
      damping *= 8.0;
      if (damping > 1e9) break;  // no step goes down any more: this is the minimum to the last bit
    }
  }
  const double coordinates = 8.0 * static_cast<double>(terms.size());
  return Fit{T, here->information, here->chi2, here->cost, std::sqrt(here->squared_px / coordinates)};
}

/// The tag shows its front: its normal, which points into the wall, leads away from the camera.
bool faces_camera(const Eigen::Isometry3d& T_camera_tag) {
  return T_camera_tag.linear().col(2).dot(T_camera_tag.translation()) > 0.0;
}

/// The other pose that explains a flat tag, exact for a tag seen from far: turning it over, about its centre and in the
/// plane square to the line of sight, leaves its outline.
Eigen::Isometry3d mirrored(const Eigen::Isometry3d& T_camera_tag) {
  const Eigen::Vector3d sight = T_camera_tag.translation().normalized();
  Eigen::Isometry3d other = T_camera_tag;
  other.linear() = (Eigen::Matrix3d::Identity() - 2.0 * sight * sight.transpose()) * T_camera_tag.linear() *
                   Eigen::Vector3d(1.0, 1.0, -1.0).asDiagonal();
  return other;
}

/// From the homography of four ideal points (x/z, y/z): a start that is right up to noise.
std::optional<Eigen::Isometry3d> pose_from_homography(const Corners& ideal, const TagPoints& points) {
  Eigen::Matrix<double, 8, 9> rows = Eigen::Matrix<double, 8, 9>::Zero();
  const double scale = points[2].x();
  for (int i = 0; i < 4; ++i) {
    const Eigen::RowVector3d point(points[i].x() / scale, points[i].y() / scale, 1.0);
    rows.block<1, 3>(2 * i, 0) = point;
    rows.block<1, 3>(2 * i, 6) = -ideal[i].x() * point;
    rows.block<1, 3>(2 * i + 1, 3) = point;
    rows.block<1, 3>(2 * i + 1, 6) = -ideal[i].y() * point;
  }
  const Eigen::JacobiSVD<Eigen::Matrix<double, 8, 9>> svd(rows, Eigen::ComputeFullV);
  Eigen::Matrix3d homography = svd.matrixV().col(8).reshaped<Eigen::RowMajor>(3, 3);
  homography.leftCols<2>() /= scale;
  if (homography(2, 2) < 0.0) homography = -homography;
  const double length = std::sqrt(homography.col(0).norm() * homography.col(1).norm());
  if (!(length > 0.0) || !homography.allFinite()) return std::nullopt;
  homography /= length;
  Eigen::Matrix3d axes;
  axes << homography.col(0), homography.col(1), homography.col(0).cross(homography.col(1));
  const Eigen::JacobiSVD<Eigen::Matrix3d> nearest(axes, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = nearest.matrixU() * nearest.matrixV().transpose();
  T.translation() = homography.col(2);
  if (!T.matrix().allFinite() || !(T.linear().determinant() > 0.0) || !(T.translation().z() > 0.0)) return std::nullopt;
  return T;
}

/// The same improved by ViSP's virtual visual servoing; unchanged where that does not end well.
Eigen::Isometry3d by_virtual_servoing(const Eigen::Isometry3d& start, const Corners& ideal, const TagPoints& points) {
  vpHomogeneousMatrix cMo;
  for (unsigned int row = 0; row < 3; ++row)
    for (unsigned int column = 0; column < 4; ++column) cMo[row][column] = start(row, column);
  try {
    vpPose pose;
    pose.setVvsIterMax(30);
    for (int i = 0; i < 4; ++i) {
      vpPoint point(points[i].x(), points[i].y(), points[i].z());
      point.set_x(ideal[i].x());
      point.set_y(ideal[i].y());
      pose.addPoint(point);
    }
    if (!pose.computePose(vpPose::VIRTUAL_VS, cMo)) return start;
  } catch (const vpException&) {
    return start;
  }
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  for (unsigned int row = 0; row < 3; ++row)
    for (unsigned int column = 0; column < 4; ++column) T(row, column) = cMo[row][column];
  const bool sound = T.matrix().allFinite() && T.translation().z() > 0.0 && T.linear().isUnitary(1e-6);
  return sound ? T : start;
}

/// Starts of a single tag: ViSP's, and the mirrored one.
std::vector<Eigen::Isometry3d> starts(const Corners& corners_px, double size, const CameraModel& camera) {
  Corners ideal;
  for (int i = 0; i < 4; ++i) {
    const std::optional<Eigen::Vector2d> place = unproject(camera, corners_px[i]);
    if (!place) return {};
    ideal[i] = *place;
  }
  const TagPoints points = tag_corners(size);
  const std::optional<Eigen::Isometry3d> rough = pose_from_homography(ideal, points);
  if (!rough) return {};
  const Eigen::Isometry3d fine = by_virtual_servoing(*rough, ideal, points);
  return {fine, mirrored(fine)};
}

double rotation_between(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
  return Eigen::AngleAxisd(a.linear().transpose() * b.linear()).angle();
}

/// Minima by rising cost, each once.
std::vector<Fit> distinct(std::vector<Fit> fits) {
  std::sort(fits.begin(), fits.end(), [](const Fit& a, const Fit& b) { return a.cost < b.cost; });
  std::vector<Fit> kept;
  for (const Fit& fit : fits)
    if (std::none_of(kept.begin(), kept.end(), [&](const Fit& other) {
          return rotation_between(fit.T_camera_frame, other.T_camera_frame) < same_rotation;
        }))
      kept.push_back(fit);
  return kept;
}

/// How much larger the corners' variance is than stated, as far as the fit can tell; never below 1.
double inflation(double chi2, double coordinates, double parameters) {
  return std::max(1.0, chi2 / std::max(1.0, coordinates - parameters));
}

std::optional<Matrix6> covariance_of(const Matrix6& information, double inflated) {
  const Eigen::LLT<Matrix6> factor(information);
  if (factor.info() != Eigen::Success) return std::nullopt;
  const Matrix6 covariance = inflated * factor.solve(Matrix6::Identity());
  if (!covariance.allFinite()) return std::nullopt;
  return covariance;
}

bool sane(double size, const CameraModel& camera) {
  try {
    check(camera);
  } catch (const std::invalid_argument&) {
    return false;
  }
  return std::isfinite(size) && size > 0.0;
}

/// Corners of one tag under the pose, worst case: how far from those seen [px].
double rms_of(const Term& one, const Eigen::Isometry3d& T_camera_frame, const CameraModel& camera) {
  double squares = 0.0;
  for (int i = 0; i < 4; ++i)
    squares += (project(camera, T_camera_frame * one.points[i]) - one.corners_px[i]).squaredNorm();
  return std::sqrt(squares / 8.0);
}

}  // namespace

std::string_view word(Unseen reason) {
  switch (reason) {
    case Unseen::no_tag:
      return "no_tag";
    case Unseen::other_tags:
      return "other_tags";
    case Unseen::duplicate_tag:
      return "duplicate_tag";
    case Unseen::no_pose:
      return "no_pose";
    case Unseen::layout_mismatch:
      return "layout_mismatch";
  }
  return "unknown";
}

PriorEquations ground_equations(const GroundPrior& prior, const Eigen::Isometry3d& T_camera_station) {
  // With the station's up direction u and the lens-to-station vector t in the base frame: a base that is rolled and
  // pitched by small angles sees u = (-pitch, roll, 1), and its origin stands -u . t above the station's floor.
  const Eigen::Matrix3d R_base_camera = prior.T_base_camera.rotation();
  const Eigen::Vector3d up_camera = T_camera_station.linear().col(2);
  const Eigen::Vector3d up_base = R_base_camera * up_camera;
  // The base's origin in the camera frame.
  const Eigen::Vector3d base_camera = -(R_base_camera.transpose() * prior.T_base_camera.translation());
  const Eigen::Vector3d from_station = base_camera - T_camera_station.translation();
  Eigen::Vector3d residual(up_base.x() / prior.sigma_pitch, up_base.y() / prior.sigma_roll,
                           up_camera.dot(from_station) / prior.sigma_height);
  // A small motion on the left: d up = -[up] r, d translation = d - [translation] r.
  const Eigen::Matrix3d up_by_turn = -skew(up_camera);
  Eigen::Matrix<double, 3, 6> jacobian = Eigen::Matrix<double, 3, 6>::Zero();
  jacobian.block<1, 3>(0, 3) = R_base_camera.row(0) * up_by_turn / prior.sigma_pitch;
  jacobian.block<1, 3>(1, 3) = R_base_camera.row(1) * up_by_turn / prior.sigma_roll;
  jacobian.block<1, 3>(2, 0) = -up_camera.transpose() / prior.sigma_height;
  jacobian.block<1, 3>(2, 3) =
      (from_station.transpose() * up_by_turn + up_camera.transpose() * skew(T_camera_station.translation())) /
      prior.sigma_height;
  return {jacobian.transpose() * jacobian, jacobian.transpose() * residual, residual.squaredNorm()};
}

Eigen::Isometry3d moved(const Vector6& motion, const Eigen::Isometry3d& T_camera_frame) {
  const Eigen::Vector3d turn = motion.tail<3>();
  const double angle = turn.norm();
  Eigen::Isometry3d moved = Eigen::Isometry3d::Identity();
  if (angle > 0.0) moved.linear() = Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix();
  moved.translation() = motion.head<3>();
  moved = moved * T_camera_frame;
  moved.linear() = Eigen::Quaterniond(moved.linear()).normalized().toRotationMatrix();
  return moved;
}

std::string_view word(PoseSource source) {
  switch (source) {
    case PoseSource::corners:
      return "corners";
    case PoseSource::pixels:
      return "pixels";
    case PoseSource::corners_contradict_board:
      return "corners_contradict_board";
    case PoseSource::corners_tag_unfitted:
      return "corners_tag_unfitted";
    case PoseSource::corners_pixels_unsettled:
      return "corners_pixels_unsettled";
  }
  return "unknown";
}

std::vector<TagPose> tag_poses(const RefinedTag& tag, double size, const CameraModel& camera) {
  if (!sane(size, camera)) return {};
  const std::optional<Term> one = term(tag, tag_corners(size));
  if (!one) return {};
  std::vector<Fit> fits;
  for (const Eigen::Isometry3d& start : starts(tag.corners_px, size, camera)) {
    const std::optional<Fit> fit = fit_pose(start, {&*one, 1}, camera, std::nullopt);
    if (fit && faces_camera(fit->T_camera_frame)) fits.push_back(*fit);
  }
  std::vector<TagPose> poses;
  for (const Fit& fit : distinct(std::move(fits))) {
    const auto covariance = covariance_of(fit.information, inflation(fit.chi2, 8.0, 6.0));
    if (covariance && poses.size() < 2)
      poses.push_back({fit.T_camera_frame, *covariance, fit.reprojection_rms_px, fit.chi2});
  }
  return poses;
}

Sighting board_pose(std::span<const RefinedTag> tags, const Board& board, const CameraModel& camera,
                    const std::optional<GroundPrior>& prior, const std::optional<Eigen::Isometry3d>& guess,
                    PoseStarts from) {
  if (tags.empty()) return Unseen::no_tag;
  std::vector<Term> terms;
  std::vector<Eigen::Isometry3d> starts_station;
  BoardSighting sighting;
  terms.reserve(tags.size());
  sighting.tags.reserve(tags.size());
  for (const RefinedTag& tag : tags) {
    const BoardTag* known = find_tag(board, tag.id);
    if (known == nullptr) continue;
    if (std::any_of(sighting.tags.begin(), sighting.tags.end(), [&](const RefinedTag& t) { return t.id == tag.id; }))
      return Unseen::duplicate_tag;
    if (!sane(known->size, camera)) return Unseen::no_pose;
    const std::optional<Term> one = term(tag, corners_station(*known));
    if (!one) return Unseen::no_pose;
    terms.push_back(*one);
    sighting.tags.push_back(tag);
    if (from == PoseStarts::only_guess) continue;
    for (const Eigen::Isometry3d& T_camera_tag : starts(tag.corners_px, known->size, camera))
      starts_station.push_back(T_camera_tag * known->T_station_tag.inverse());
  }
  if (terms.empty()) return Unseen::other_tags;
  if (guess && guess->matrix().allFinite()) starts_station.push_back(*guess);

  std::vector<Fit> fits;
  // From near, plain Gauss-Newton; after a step of 1e-7 less than 1e-9 is left, a ten-thousandth of the best sigma.
  const bool near = from == PoseStarts::only_guess;
  const double damping = near ? 1e-9 : first_damping;
  const double enough = near ? 1e-7 : 0.0;
  for (const Eigen::Isometry3d& start : starts_station) {
    const std::optional<Fit> fit = fit_pose(start, terms, camera, prior, damping, enough);
    const bool all_face = fit && std::all_of(sighting.tags.begin(), sighting.tags.end(), [&](const RefinedTag& tag) {
                            return faces_camera(fit->T_camera_frame * find_tag(board, tag.id)->T_station_tag);
                          });
    if (all_face) fits.push_back(*fit);
  }
  const std::vector<Fit> minima = distinct(std::move(fits));
  if (minima.empty()) return terms.size() > 1 ? Unseen::layout_mismatch : Unseen::no_pose;
  const Fit& best = minima.front();

  // A tag hung 5 mm from its place, or one of another size, stands out by more than this; a lens model or a print that
  // is a little wrong does not.
  for (const Term& one : terms)
    if (!(rms_of(one, best.T_camera_frame, camera) <= std::max(1.0, 0.03 * one.side_px)))
      return terms.size() > 1 ? Unseen::layout_mismatch : Unseen::no_pose;

  const double coordinates = 8.0 * static_cast<double>(terms.size()) + (prior ? 3.0 : 0.0);
  const double inflated = inflation(best.cost, coordinates, 6.0);
  const auto covariance = covariance_of(best.information, inflated);
  if (!covariance) return Unseen::no_pose;
  sighting.T_camera_station = best.T_camera_frame;
  sighting.covariance = *covariance;
  sighting.reprojection_rms_px = best.reprojection_rms_px;
  sighting.chi2_per_coordinate = best.cost / std::max(1.0, coordinates - 6.0);
  sighting.log_odds = std::numeric_limits<double>::infinity();
  if (minima.size() > 1) {
    sighting.log_odds = 0.5 * (minima[1].cost - best.cost) / inflated;
    if (sighting.log_odds < settled_log_odds) sighting.T_camera_station_mirrored = minima[1].T_camera_frame;
  }
  std::sort(sighting.tags.begin(), sighting.tags.end(), [](const auto& a, const auto& b) { return a.id < b.id; });
  return sighting;
}

}  // namespace tagdock
