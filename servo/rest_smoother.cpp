#include "servo/rest_smoother.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>

#include <Eigen/Cholesky>
#include <ceres/ceres.h>

namespace tagdock {
namespace {

// Where the start is farther off [px] nothing is smoothed: a chassis that shakes by 0.1 degrees moves corners by 2 px
// (1 sigma), survey and lens leave less than one.
constexpr double not_explained = 30.0;

// Where a tag's corners are seen, by pose (x, y, yaw of the base at the wanted odometry), shake (roll, pitch, height)
// and lasting errors of the corners [px].
class TagCost final : public ceres::SizedCostFunction<8, 3, 3, 8> {
 public:
  TagCost(const Rig& rig, const TagPoints& points_station, const CornersSeen& seen, const Pose2& since, double sigma_px)
      : rig_(rig), points_(points_station), seen_(seen), since_(since), weight_(1.0 / sigma_px) {}

  bool Evaluate(const double* const* parameters, double* residuals, double** jacobians) const override {
    const double* pose = parameters[0];
    const double* shake = parameters[1];
    const double* lasting = parameters[2];
    const Pose2 T_station_base = Pose2{pose[0], pose[1], pose[2]} * since_;
    const Eigen::Vector3d& lens_base = rig_.T_base_camera.translation();
    const Pose2 lens = T_station_base * Pose2{lens_base.x(), lens_base.y(), 0.0};
    const Eigen::Vector3d lens_station(lens.x, lens.y, lens_base.z() + shake[2]);
    const Eigen::AngleAxisd turn(T_station_base.yaw, Eigen::Vector3d::UnitZ());
    const Eigen::AngleAxisd pitch(shake[1], Eigen::Vector3d::UnitY());
    const Eigen::AngleAxisd roll(shake[0], Eigen::Vector3d::UnitX());
    const Eigen::Matrix3d R_camera_station = (turn * pitch * roll * rig_.T_base_camera.linear()).transpose();
    const std::array<Eigen::Vector3d, 3> axes = {Eigen::Vector3d::UnitZ(), turn * (pitch * Eigen::Vector3d::UnitX()),
                                                 turn * Eigen::Vector3d::UnitY()};
    const Eigen::Vector3d lens_by_yaw(-(lens.y - pose[1]), lens.x - pose[0], 0.0);
    for (int corner = 0; corner < 4; ++corner) {
      const Eigen::Vector3d from_lens = points_[corner] - lens_station;
      const Eigen::Vector3d point_camera = R_camera_station * from_lens;
      if (point_camera.z() < 1e-3) return false;
      const Projection projection = project_with_jacobian(rig_.camera, point_camera);
      for (int axis = 0; axis < 2; ++axis) {
        const int row = 2 * corner + axis;
        residuals[row] = weight_ * (projection.pixel[axis] + lasting[row] - seen_.corners_px[corner][axis]);
      }
      if (jacobians == nullptr) continue;
      using Rows = Eigen::Matrix<double, 2, 3>;
      const Rows by_station = weight_ * projection.by_point * R_camera_station;
      // A turn of the camera about an axis moves a point against it.
      const auto by_turn = [&](const Eigen::Vector3d& axis) -> Eigen::Vector2d {
        return -by_station * axis.cross(from_lens);
      };
      if (jacobians[0] != nullptr) {
        Eigen::Map<Eigen::Matrix<double, 8, 3, Eigen::RowMajor>> by_pose(jacobians[0]);
        by_pose.block<2, 2>(2 * corner, 0) = -by_station.leftCols<2>();
        by_pose.block<2, 1>(2 * corner, 2) = by_turn(axes[0]) - by_station * lens_by_yaw;
      }
      if (jacobians[1] != nullptr) {
        Eigen::Map<Eigen::Matrix<double, 8, 3, Eigen::RowMajor>> by_shake(jacobians[1]);
        by_shake.block<2, 1>(2 * corner, 0) = by_turn(axes[1]);
        by_shake.block<2, 1>(2 * corner, 1) = by_turn(axes[2]);
        by_shake.block<2, 1>(2 * corner, 2) = -by_station.col(2);
      }
    }
    if (jacobians != nullptr && jacobians[2] != nullptr) {
      Eigen::Map<Eigen::Matrix<double, 8, 8, Eigen::RowMajor>> by_lasting(jacobians[2]);
      by_lasting = weight_ * Eigen::Matrix<double, 8, 8>::Identity();
    }
    return true;
  }

 private:
  const Rig& rig_;
  TagPoints points_;
  const CornersSeen& seen_;
  Pose2 since_;  ///< from the wanted odometry pose to the frame's
  double weight_;
};

// Values that are about zero.
template <int count>
class AboutZero final : public ceres::SizedCostFunction<count, count> {
 public:
  explicit AboutZero(const Eigen::Matrix<double, count, 1>& sigma) : weight_(sigma.cwiseInverse()) {}
  bool Evaluate(const double* const* parameters, double* residuals, double** jacobians) const override {
    for (int i = 0; i < count; ++i) residuals[i] = weight_[i] * parameters[0][i];
    if (jacobians == nullptr || jacobians[0] == nullptr) return true;
    Eigen::Map<Eigen::Matrix<double, count, count, Eigen::RowMajor>> by_values(jacobians[0]);
    by_values = weight_.asDiagonal();
    return true;
  }

 private:
  Eigen::Matrix<double, count, 1> weight_;
};

// Covariance of the pose: the inverse of the whole information, of which everything but the pose is eliminated.
std::optional<Eigen::Matrix3d> pose_covariance(ceres::Problem& problem, double* pose) {
  ceres::Problem::EvaluateOptions options;
  options.apply_loss_function = false;
  options.parameter_blocks = {pose};
  std::vector<double*> blocks;
  problem.GetParameterBlocks(&blocks);
  for (double* block : blocks)
    if (block != pose) options.parameter_blocks.push_back(block);
  ceres::CRSMatrix jacobian;
  if (!problem.Evaluate(options, nullptr, nullptr, nullptr, &jacobian)) return std::nullopt;
  Eigen::MatrixXd information = Eigen::MatrixXd::Zero(jacobian.num_cols, jacobian.num_cols);
  for (int row = 0; row < jacobian.num_rows; ++row)
    for (int i = jacobian.rows[row]; i < jacobian.rows[row + 1]; ++i)
      for (int j = jacobian.rows[row]; j < jacobian.rows[row + 1]; ++j)
        information(jacobian.cols[i], jacobian.cols[j]) += jacobian.values[i] * jacobian.values[j];
  const Eigen::MatrixXd of_pose = information.ldlt().solve(Eigen::MatrixXd::Identity(jacobian.num_cols, 3));
  const Eigen::Matrix3d covariance = of_pose.topRows<3>();
  if (!covariance.allFinite() || covariance.diagonal().minCoeff() <= 0.0) return std::nullopt;
  return 0.5 * (covariance + covariance.transpose());
}

}  // namespace

RestSighting rest_sighting(const PlanarSighting& planar, const BoardSighting& seen, const Pose2& T_odom_base) {
  RestSighting rest{planar, T_odom_base, {}};
  for (const RefinedTag& tag : seen.tags)
    rest.tags.push_back({tag.id, tag.corners_px, tag.covariance_px2.trace() / 8.0});
  return rest;
}

std::optional<SmoothedRest> smooth_rest(std::span<const RestSighting> sightings, const Pose2& T_odom_base,
                                        const Pose2& start, const Rig& rig, const Board& board,
                                        const RestSmootherConfig& config) {
  if (sightings.size() < 2) return std::nullopt;
  std::map<int, double*> lasting;
  std::map<int, TagPoints> points;
  for (const BoardTag& tag : board.tags) points[tag.id] = corners_station(tag);

  // Where everything lies is decided before the problem keeps pointers to it.
  double claimed = 0.0;
  int seen_tags = 0;
  for (const RestSighting& sighting : sightings)
    for (const CornersSeen& tag : sighting.tags) {
      if (points.find(tag.id) == points.end()) return std::nullopt;
      lasting.try_emplace(tag.id, nullptr);
      claimed += tag.variance_px2;
      ++seen_tags;
    }
  if (seen_tags == 0) return std::nullopt;
  // Pose, lasting errors and shakes in one piece of memory: Ceres sorts what it is given by address, and the same
  // sightings must give the same result to the last bit.
  std::vector<double> values(3 + 8 * lasting.size() + 3 * sightings.size(), 0.0);
  double* const pose = values.data();
  pose[0] = start.x;
  pose[1] = start.y;
  pose[2] = start.yaw;
  double* next = pose + 3;
  for (auto& [id, errors] : lasting) {
    errors = next;
    next += 8;
  }
  const auto shake = [first = next](std::size_t i) { return first + 3 * i; };

  ceres::Problem problem;
  struct Term {
    ceres::ResidualBlockId block;
    double sigma_px;
  };
  std::vector<Term> terms;
  ceres::LossFunctionWrapper* loss = nullptr;  // the problem's from the first block on
  const Eigen::Vector3d shake_sigma(config.sigma_roll, config.sigma_pitch, config.sigma_height);
  auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (std::size_t i = 0; i < sightings.size(); ++i) {
    const Pose2 since = between(T_odom_base, sightings[i].T_odom_base);
    bool any = false;
    for (const CornersSeen& tag : sightings[i].tags) {
      const double sigma_px = std::max(config.least_noise_px, std::sqrt(tag.variance_px2));
      auto cost = std::make_unique<TagCost>(rig, points[tag.id], tag, since, sigma_px);
      const std::array<const double*, 3> at = {pose, shake(i), lasting[tag.id]};
      std::array<double, 8> misfit{};
      if (!cost->Evaluate(at.data(), misfit.data(), nullptr)) return std::nullopt;
      for (const double value : misfit)
        if (!(std::abs(value) * sigma_px < not_explained)) return std::nullopt;
      if (loss == nullptr) loss = new ceres::LossFunctionWrapper(nullptr, ceres::TAKE_OWNERSHIP);
      terms.push_back({problem.AddResidualBlock(cost.release(), loss, pose, shake(i), lasting[tag.id]), sigma_px});
      any = true;
    }
    if (!any) continue;
    problem.AddResidualBlock(new AboutZero<3>(shake_sigma), nullptr, shake(i));
    ordering->AddElementToGroup(shake(i), 0);
  }
  if (terms.empty()) return std::nullopt;
  // Counted once for each frame, as the shakes are: otherwise the answer would move with the number of frames, and not
  // cancel between a teaching with 40 and a docking with 20.
  const double frames = static_cast<double>(seen_tags) / static_cast<double>(lasting.size());
  const double lasting_sigma = config.lasting_px / std::sqrt(frames);
  for (auto& [id, errors] : lasting) {
    problem.AddResidualBlock(new AboutZero<8>(Eigen::Matrix<double, 8, 1>::Constant(lasting_sigma)), nullptr, errors);
    ordering->AddElementToGroup(errors, 1);
  }
  ordering->AddElementToGroup(pose, 1);

  ceres::Solver::Options options;
  options.linear_solver_type = ceres::DENSE_SCHUR;
  options.linear_solver_ordering = ordering;
  options.max_num_iterations = config.iterations;
  options.function_tolerance = options.parameter_tolerance = 1e-12;
  options.num_threads = 1;
  options.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(options, &problem, &summary);
  // From the start everything looks like an outlier: the chassis shakes by a hundred times the noise. So the quadratic
  // answer comes first, and only what it does not explain counts less.
  loss->Reset(new ceres::HuberLoss(config.outlier * std::sqrt(8.0)), ceres::TAKE_OWNERSHIP);
  ceres::Solve(options, &problem, &summary);
  if (!summary.IsSolutionUsable() || !std::isfinite(pose[0] + pose[1] + pose[2])) return std::nullopt;

  const std::optional<Eigen::Matrix3d> whole = pose_covariance(problem, pose);
  if (!whole) return std::nullopt;
  // Scatter of the corners about what stays, by the values that are left over after pose, shakes and lasting errors.
  double squares = 0.0;
  double variance = 0.0;
  for (const Term& term : terms) {
    std::array<double, 8> residuals{};
    double cost = 0.0;
    problem.EvaluateResidualBlock(term.block, false, &cost, residuals.data(), nullptr);
    for (const double value : residuals) squares += value * value * term.sigma_px * term.sigma_px;
    variance += term.sigma_px * term.sigma_px;
  }
  const double left_over =
      8.0 * seen_tags - 8.0 * static_cast<double>(lasting.size()) - 3.0 * static_cast<double>(sightings.size());
  constexpr double enough = 20.0;  // values; fewer measure a variance worse than to a third
  SmoothedRest rest;
  rest.T_station_base = {pose[0], pose[1], wrap_angle(pose[2])};
  const double mean_variance = variance / seen_tags;
  const double scatter2 = left_over >= enough ? squares / left_over : mean_variance;
  rest.scatter_px = std::sqrt(scatter2);
  rest.chi2 = claimed > 0.0 ? scatter2 * seen_tags / claimed : 0.0;
  double sum = 0.0;
  for (const auto& [id, errors] : lasting)
    for (int i = 0; i < 8; ++i) sum += errors[i] * errors[i];
  rest.lasting_px = std::sqrt(sum / (8.0 * static_cast<double>(lasting.size())));
  // The whole covariance is that of corners whose mean over the frames is wrong by lasting errors and by noise.
  rest.covariance_per_px2 = *whole / (lasting_sigma * lasting_sigma + mean_variance / frames);
  rest.covariance = scatter2 / frames * rest.covariance_per_px2;
  return rest;
}

}  // namespace tagdock
