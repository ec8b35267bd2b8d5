#include "calibration/intrinsics.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <memory>
#include <sstream>
#include <stdexcept>

#include <Eigen/Cholesky>
#include <Eigen/LU>
#include <ceres/ceres.h>

#include "calibration/lens_projection.h"
#include "planning/pose2.h"

namespace tagdock {
namespace {

using Eigen::Index;
using Eigen::Isometry3d;
using Eigen::MatrixXd;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Eigen::VectorXd;

constexpr double robust_sigma = 2.5;      // where a corner's square turns into its modulus
constexpr double outlier_sigma = 4.5;     // beyond it a corner is set aside
constexpr double least_sigma_px = 0.015;  // what rendering and rounding leave of any corner
constexpr std::size_t least_views = 5;
constexpr double least_misfit_px = 0.1;  // a view that leaves less does no harm, however good the others are
constexpr double misfit = 3.0;           // a view that leaves so much more than the usual one does not belong
// What boards do: they bend by up to some hundredths of their half size, less in higher orders; prints stretch.
constexpr double bend_share = 0.02;
constexpr double higher_bend_share = 0.003;
constexpr double stretch_share = 0.001;
constexpr double ink_m = 0.0001;     // what printers' ink spreads
constexpr double growth_px = 0.005;  // fits of whole tags were seen to take sides to be 0.002 px off

// ---- the board -----------------------------------------------------------------------------------------------------

template <typename T>
T lift(const T* shape, double u, double v) {
  return shape[0] * (u * u) + shape[1] * (v * v) + shape[2] * (u * v) + shape[3] * (u * u * v * v) +
         shape[4] * (u * u * u) + shape[5] * (v * v * v) + shape[6] * (u * u * v) + shape[7] * (u * v * v) +
         shape[8] * (u * u * u * u) + shape[9] * (v * v * v * v);
}

struct CornerResidual {
  Vector3d point;
  Vector2d uv;
  Vector2d from_centre;
  Vector2d pixel;
  double sigma_px;
  Vector2d outward = Vector2d::Zero();  ///< px, see SeenPoint
  Vector2d ink = Vector2d::Zero();      ///< where ink moves the corner on the board

  template <typename T>
  bool operator()(const T* lens, const T* board, const T* pose, T* residual) const {
    Eigen::Matrix<T, 3, 1> on_board;
    on_board << point.x() + 0.5 * board[BoardShape::stretch] * from_centre.x() + board[BoardShape::ink] * ink.x(),
        point.y() - 0.5 * board[BoardShape::stretch] * from_centre.y() + board[BoardShape::ink] * ink.y(),
        point.z() + lift(board, uv.x(), uv.y());
    const Eigen::Map<const Eigen::Quaternion<T>> rotation(pose);
    const Eigen::Map<const Eigen::Matrix<T, 3, 1>> translation(pose + 4);
    const Eigen::Matrix<T, 3, 1> at = rotation * on_board + translation;
    if (at.z() < T(1e-4)) return false;
    const Eigen::Matrix<T, 2, 1> seen = project_point(lens, at);
    residual[0] = (seen.x() + board[BoardShape::growth] * outward.x() - pixel.x()) / sigma_px;
    residual[1] = (seen.y() + board[BoardShape::growth] * outward.y() - pixel.y()) / sigma_px;
    return true;
  }
};

/// Where ink moves a corner of a free-standing tag on the board, x right and y down, when it spreads by 1.
Vector2d spread_by_ink(const SeenPoint& seen) {
  if (seen.outward.isZero(0.0)) return Vector2d::Zero();
  const int corner = seen.id % 4;  // bottom left, bottom right, top right, top left
  return {corner == 1 || corner == 2 ? 1.0 : -1.0, corner < 2 ? 1.0 : -1.0};
}

struct ShapePrior {
  std::array<double, BoardShape::values> sigma;
  template <typename T>
  bool operator()(const T* board, T* residual) const {
    for (std::size_t i = 0; i < sigma.size(); ++i) residual[i] = board[i] / sigma[i];
    return true;
  }
};

// ---- one solution --------------------------------------------------------------------------------------------------

using Pose = std::array<double, 7>;  // quaternion x y z w, translation

Pose pose_of(const Isometry3d& T) {
  const Eigen::Quaterniond q(T.linear());
  return {q.x(), q.y(), q.z(), q.w(), T.translation().x(), T.translation().y(), T.translation().z()};
}

Isometry3d isometry(const Pose& pose) {
  Isometry3d T = Isometry3d::Identity();
  T.linear() = Eigen::Quaterniond(pose[3], pose[0], pose[1], pose[2]).normalized().toRotationMatrix();
  T.translation() << pose[4], pose[5], pose[6];
  return T;
}

struct Solution {
  LensValues lens{};
  std::array<double, BoardShape::values> board{};
  std::vector<Pose> poses;  ///< of all views; those that were not solved stay as they were
};

/// The views' corners, ready to be solved.
struct Data {
  std::vector<std::vector<SeenPoint>> views;
  BoardShape shape;  ///< centre and half size
  double noise_scale = 1.0;
  [[nodiscard]] CornerResidual* residual(const SeenPoint& seen) const {
    const Vector2d off = (seen.point_board - shape.centre).head<2>();
    return new CornerResidual{seen.point_board,
                              off.cwiseQuotient(shape.half),
                              off,
                              seen.pixel,
                              noise_scale * std::max(least_sigma_px, seen.sigma_px),
                              seen.outward,
                              spread_by_ink(seen)};
  }
};

std::vector<int> held(LensModel model) {
  switch (model) {
    case LensModel::k1:
      return {5, 6, 7, 8, 9, 10, 11};
    case LensModel::k1_k2:
      return {6, 7, 8, 9, 10, 11};
    case LensModel::brown4:
      return {8, 9, 10, 11};
    case LensModel::brown5:
      return {9, 10, 11};
    case LensModel::rational:
      return {};
  }
  return {};
}

enum class Free { all, poses };

/// Ceres' problem of some of the views.
class Bundle {
 public:
  Bundle(const Data& data, const std::vector<std::size_t>& views, LensModel model, bool flat, Free free,
         Solution& solution)
      : solution_(solution), views_(views) {
    ordering_ = std::make_shared<ceres::ParameterBlockOrdering>();
    double* lens = solution.lens.data();
    double* board = solution.board.data();
    const std::vector<int> constant = held(model);
    problem_.AddParameterBlock(lens, lens_values);
    if (!constant.empty()) problem_.SetManifold(lens, new ceres::SubsetManifold(lens_values, constant));
    problem_.AddParameterBlock(board, BoardShape::values);
    for (const std::size_t view : views) {
      double* pose = solution.poses[view].data();
      problem_.AddParameterBlock(
          pose, 7, new ceres::ProductManifold<ceres::EigenQuaternionManifold, ceres::EuclideanManifold<3>>{});
      ordering_->AddElementToGroup(pose, 0);
      for (const SeenPoint& seen : data.views[view])
        blocks_.push_back(problem_.AddResidualBlock(
            new ceres::AutoDiffCostFunction<CornerResidual, 2, lens_values, BoardShape::values, 7>(data.residual(seen)),
            new ceres::HuberLoss(robust_sigma), lens, board, pose));
    }
    ShapePrior prior{};
    const double half = data.shape.half.maxCoeff();
    for (std::size_t i = 0; i < 10; ++i) prior.sigma[i] = half * (i < 4 ? bend_share : higher_bend_share);
    prior.sigma[BoardShape::stretch] = stretch_share;
    prior.sigma[BoardShape::ink] = ink_m;
    prior.sigma[BoardShape::growth] = growth_px;
    blocks_.push_back(problem_.AddResidualBlock(
        new ceres::AutoDiffCostFunction<ShapePrior, BoardShape::values, BoardShape::values>(new ShapePrior(prior)),
        nullptr, board));
    if (flat) problem_.SetParameterBlockConstant(board);
    if (free == Free::poses) {
      problem_.SetParameterBlockConstant(lens);
      problem_.SetParameterBlockConstant(board);
    } else {
      ordering_->AddElementToGroup(lens, 1);
      if (!flat) ordering_->AddElementToGroup(board, 1);
    }
    lens_size_ = free == Free::poses ? 0 : lens_values - static_cast<Index>(constant.size());
    board_size_ = flat || free == Free::poses ? 0 : BoardShape::values;
  }

  double solve(int iterations) {
    ceres::Solver::Options how;
    how.linear_solver_type = lens_size_ > 0 ? ceres::DENSE_SCHUR : ceres::SPARSE_NORMAL_CHOLESKY;
    if (lens_size_ > 0) how.linear_solver_ordering = ordering_;
    how.max_num_iterations = iterations;
    how.function_tolerance = 1e-9;
    how.num_threads = 2;
    how.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(how, &problem_, &summary);
    return summary.IsSolutionUsable() ? summary.final_cost : std::numeric_limits<double>::infinity();
  }

  struct Linear {
    MatrixXd covariance;   ///< of the free lens values and the board, poses free
    MatrixXd by_views;     ///< the same from how much the views scatter, whatever their corners claim
    double squares = 0.0;  ///< of the corner residuals, robust
    double redundancy = 0.0;
  };

  Linear linearise() {
    ceres::Problem::EvaluateOptions how;
    how.apply_loss_function = false;
    how.residual_blocks = blocks_;
    how.parameter_blocks = {solution_.lens.data()};
    if (board_size_ > 0) how.parameter_blocks.push_back(solution_.board.data());
    for (const std::size_t view : views_) how.parameter_blocks.push_back(solution_.poses[view].data());
    ceres::CRSMatrix J;
    std::vector<double> residuals;
    problem_.Evaluate(how, nullptr, &residuals, nullptr, &J);
    const Index kept = lens_size_ + board_size_;
    MatrixXd A = MatrixXd::Zero(kept, kept);
    std::vector<MatrixXd> B(views_.size(), MatrixXd::Zero(kept, 6));
    std::vector<Eigen::Matrix<double, 6, 6>> C(views_.size(), Eigen::Matrix<double, 6, 6>::Identity() * 1e-12);
    Linear linear;
    std::vector<VectorXd> pull(views_.size(), VectorXd::Zero(kept));
    std::vector<Eigen::Matrix<double, 6, 1>> own_pull(views_.size(), Eigen::Matrix<double, 6, 1>::Zero());
    for (int row = 0; row < J.num_rows; ++row) {
      VectorXd shared = VectorXd::Zero(kept);
      Eigen::Matrix<double, 6, 1> own = Eigen::Matrix<double, 6, 1>::Zero();
      std::size_t view = views_.size();
      for (int k = J.rows[static_cast<std::size_t>(row)]; k < J.rows[static_cast<std::size_t>(row) + 1]; ++k) {
        const Index column = J.cols[static_cast<std::size_t>(k)];
        const double value = J.values[static_cast<std::size_t>(k)];
        if (column < kept) {
          shared[column] = value;
        } else {
          view = static_cast<std::size_t>((column - kept) / 6);
          own[(column - kept) % 6] = value;
        }
      }
      A.selfadjointView<Eigen::Lower>().rankUpdate(shared);
      if (view == views_.size()) continue;  // the prior
      B[view] += shared * own.transpose();
      C[view] += own * own.transpose();
      const double left = residuals[static_cast<std::size_t>(row)];
      const double value = std::abs(left);
      const double heard = std::clamp(left, -robust_sigma, robust_sigma);
      pull[view] += heard * shared;
      own_pull[view] += heard * own;
      linear.squares += value > robust_sigma ? robust_sigma * (2.0 * value - robust_sigma) : value * value;
      linear.redundancy += 1.0;
    }
    linear.redundancy -= static_cast<double>(lens_size_) + 6.0 * static_cast<double>(views_.size());
    MatrixXd information = A.selfadjointView<Eigen::Lower>();
    for (std::size_t i = 0; i < views_.size(); ++i) information -= B[i] * C[i].ldlt().solve(B[i].transpose());
    linear.covariance = information.ldlt().solve(MatrixXd::Identity(kept, kept));
    // Corners of a view may err together (motion, light, a lens or board that the model misses), so the sandwich counts
    // views, not corners.
    MatrixXd scatter = MatrixXd::Zero(kept, kept);
    for (std::size_t i = 0; i < views_.size(); ++i) {
      const VectorXd score = pull[i] - B[i] * C[i].ldlt().solve(own_pull[i]);
      scatter += score * score.transpose();
    }
    const auto count = static_cast<double>(views_.size());
    linear.by_views = count / std::max(1.0, count - 1.0) * linear.covariance * scatter * linear.covariance;
    return linear;
  }

  [[nodiscard]] Index lens_size() const { return lens_size_; }

 private:
  ceres::Problem problem_;
  Solution& solution_;
  const std::vector<std::size_t>& views_;
  std::shared_ptr<ceres::ParameterBlockOrdering> ordering_;
  std::vector<ceres::ResidualBlockId> blocks_;
  Index lens_size_ = 0;
  Index board_size_ = 0;
};

Vector2d residual_px(const Data& data, const Solution& solution, std::size_t view, const SeenPoint& seen) {
  const std::unique_ptr<CornerResidual> residual(data.residual(seen));
  double value[2] = {1e9, 1e9};
  if (!(*residual)(solution.lens.data(), solution.board.data(), solution.poses[view].data(), value)) return {1e9, 1e9};
  return residual->sigma_px * Vector2d(value[0], value[1]);
}

/// Root of the mean square in units of each corner's sigma, far ones counted as the robust loss does.
double misfit_of(const Data& data, const Solution& solution, const std::vector<std::size_t>& views) {
  double squares = 0.0;
  double count = 0.0;
  for (const std::size_t view : views)
    for (const SeenPoint& seen : data.views[view]) {
      const Vector2d left =
          residual_px(data, solution, view, seen) / (data.noise_scale * std::max(least_sigma_px, seen.sigma_px));
      for (const double value : {std::abs(left.x()), std::abs(left.y())})
        squares += value > robust_sigma ? robust_sigma * (2.0 * value - robust_sigma) : value * value;
      count += 2.0;
    }
  return std::sqrt(squares / std::max(1.0, count));
}

/// Root of the mean square over a view's coordinates [px].
double rms_of(const Data& data, const Solution& solution, std::size_t view) {
  double squares = 0.0;
  for (const SeenPoint& seen : data.views[view]) squares += residual_px(data, solution, view, seen).squaredNorm();
  return std::sqrt(squares / (2.0 * static_cast<double>(std::max<std::size_t>(1, data.views[view].size()))));
}

Eigen::Matrix<double, 12, 12> spread_out(const MatrixXd& covariance, LensModel model) {
  const std::vector<int> constant = held(model);
  std::vector<Index> free;
  for (int i = 0; i < lens_values; ++i)
    if (std::find(constant.begin(), constant.end(), i) == constant.end()) free.push_back(i);
  Eigen::Matrix<double, 12, 12> whole = Eigen::Matrix<double, 12, 12>::Zero();
  for (std::size_t a = 0; a < free.size(); ++a)
    for (std::size_t b = 0; b < free.size(); ++b)
      whole(free[a], free[b]) = covariance(static_cast<Index>(a), static_cast<Index>(b));
  return whole;
}

/// Focal length and poses to start from: the focal length whose pinhole explains the views best.
Solution start(const Data& data, const std::vector<std::size_t>& views, int width, int height) {
  Solution best;
  double least = std::numeric_limits<double>::infinity();
  std::vector<std::size_t> some;  // the largest and the most tilted tell the focal length; a dozen are enough
  const std::size_t stride = std::max<std::size_t>(1, views.size() / 12);
  for (std::size_t i = 0; i < views.size(); i += stride) some.push_back(views[i]);
  CameraModel chosen;
  for (const double share : {0.35, 0.5, 0.65, 0.8, 0.95, 1.1, 1.3, 1.6, 2.0, 2.6, 3.5}) {
    CameraModel camera{width, height, share * width, share * width, 0.5 * (width - 1), 0.5 * (height - 1)};
    double sum = 0.0;
    for (const std::size_t view : some) {
      const std::vector<Isometry3d> poses = board_poses(data.views[view], camera);
      sum += poses.empty() ? 1e3 : std::min(1e3, reprojection_rms(data.views[view], camera, poses.front()));
    }
    if (sum < least) {
      least = sum;
      chosen = camera;
    }
  }
  best.lens = lens_of(chosen);
  best.poses.assign(data.views.size(), Pose{0, 0, 0, 1, 0, 0, 1});
  for (const std::size_t view : views) {
    const std::vector<Isometry3d> poses = board_poses(data.views[view], chosen);
    if (!poses.empty()) best.poses[view] = pose_of(poses.front());
  }
  return best;
}

std::string figure(double value, int digits = 3) {
  std::ostringstream text;
  text.precision(digits);
  text << value;
  return text.str();
}

/// What views lack, in words: tilts to all sides, and all parts of the picture.
std::vector<std::string> lacking(const IntrinsicsResult& result) {
  std::vector<std::string> sentences;
  double leans[4] = {0, 0, 0, 0};  // views leaning right, down, left, up by 20 degrees or more
  for (const ViewResidual& view : result.views) {
    if (!view.used || view.tilt_deg < 20.0) continue;
    leans[static_cast<int>(std::lround(view.tilt_way_deg / 90.0) + 4) % 4] += 1;
  }
  const char* const sides[] = {"right", "bottom", "left", "top"};
  std::string missing_sides;
  int missing = 0;
  for (int i = 0; i < 4; ++i)
    if (leans[i] < 1) {
      missing_sides += (missing++ > 0 ? ", " : "") + std::string(sides[i]);
    }
  if (missing > 0)
    sentences.push_back("views tilted by 30 to 45 degrees with the " + missing_sides + " edge of the board nearer");
  constexpr int parts = 3;
  int corners[parts][parts] = {};
  for (const CornerLeft& corner : result.corners) {
    const int column = std::clamp(static_cast<int>(corner.pixel.x() * parts / result.camera.width), 0, parts - 1);
    const int row = std::clamp(static_cast<int>(corner.pixel.y() * parts / result.camera.height), 0, parts - 1);
    ++corners[row][column];
  }
  const char* const names[parts][parts] = {
      {"top left", "top", "top right"}, {"left", "middle", "right"}, {"bottom left", "bottom", "bottom right"}};
  std::string empty;
  for (int row = 0; row < parts; ++row)
    for (int column = 0; column < parts; ++column)
      if (corners[row][column] < 0.02 * static_cast<double>(result.corners.size()))
        empty += (empty.empty() ? "" : ", ") + std::string(names[row][column]);
  if (!empty.empty()) sentences.push_back("views with the board in these parts of the picture: " + empty);
  double nearest = 1e9;
  double farthest = 0.0;
  for (const ViewResidual& view : result.views) {
    if (!view.used) continue;
    nearest = std::min(nearest, view.distance);
    farthest = std::max(farthest, view.distance);
  }
  if (farthest < 1.3 * nearest) sentences.emplace_back("views from closer by, the board filling the picture");
  return sentences;
}

/// See IntrinsicsResult::neighbours_agree. Neighbours stand a tenth to a quarter of the board apart, and not on the
/// same tag, whose four corners are fitted together.
double agreement_of_neighbours(const IntrinsicsResult& result) {
  const double diagonal = 2.0 * result.board.half.norm();
  double alike = 0.0;
  double pairs = 0.0;
  double squares = 0.0;
  const std::vector<CornerLeft>& corners = result.corners;
  for (std::size_t begin = 0; begin < corners.size();) {
    std::size_t end = begin;
    while (end < corners.size() && corners[end].view == corners[begin].view) ++end;
    for (std::size_t i = begin; i < end; ++i) {
      squares += corners[i].residual.squaredNorm() / static_cast<double>(corners.size());
      for (std::size_t k = i + 1; k < end; ++k) {
        const double apart = (corners[k].board - corners[i].board).norm() / diagonal;
        if (apart < 0.1 || apart > 0.25) continue;
        if (corners[i].tag >= 0 && corners[i].tag == corners[k].tag) continue;
        alike += corners[i].residual.dot(corners[k].residual);
        pairs += 1.0;
      }
    }
    begin = end;
  }
  return pairs > 0.0 && squares > 0.0 ? alike / pairs / squares : 0.0;
}

}  // namespace

std::string_view word(LensModel model) {
  switch (model) {
    case LensModel::k1:
      return "k1";
    case LensModel::k1_k2:
      return "k1_k2";
    case LensModel::brown4:
      return "k1_k2_p1_p2";
    case LensModel::brown5:
      return "k1_k2_p1_p2_k3";
    case LensModel::rational:
      return "rational";
  }
  return "";
}

Vector3d BoardShape::bent(const Vector3d& point) const {
  const Vector2d off = (point - centre).head<2>();
  const Vector2d uv = off.cwiseQuotient(half);
  return {point.x() + 0.5 * value[stretch] * off.x(), point.y() - 0.5 * value[stretch] * off.y(),
          point.z() + lift(value.data(), uv.x(), uv.y())};
}

double BoardShape::bow() const {
  constexpr int steps = 9;
  Eigen::Matrix<double, steps * steps, 3> plane;
  Eigen::Matrix<double, steps * steps, 1> z;
  for (int i = 0; i < steps; ++i)
    for (int k = 0; k < steps; ++k) {
      const double u = -1.0 + 2.0 * i / (steps - 1);
      const double v = -1.0 + 2.0 * k / (steps - 1);
      plane.row(i * steps + k) << 1.0, u, v;
      z[i * steps + k] = lift(value.data(), u, v);
    }
  const Eigen::Vector3d fitted = (plane.transpose() * plane).ldlt().solve(plane.transpose() * z);
  const Eigen::Matrix<double, steps * steps, 1> left = z - plane * fitted;
  return left.maxCoeff() - left.minCoeff();
}

IntrinsicsResult calibrate_intrinsics(const std::vector<CalibrationView>& all, int width, int height,
                                      const IntrinsicsConfig& config) {
  IntrinsicsResult result;
  result.views = judge_views(all);
  Data data;
  std::vector<std::size_t> used;
  Eigen::AlignedBox3d box;
  for (std::size_t i = 0; i < all.size(); ++i) {
    data.views.push_back(all[i].corners);
    for (const SeenPoint& seen : all[i].corners) box.extend(seen.point_board);
    if (result.views[i].used) used.push_back(i);
  }
  if (used.empty()) throw std::invalid_argument("no picture shows the board well enough to be used");
  data.shape.centre = box.center();
  data.shape.half = (0.5 * box.sizes().head<2>()).cwiseMax(1e-6);
  result.camera = {width, height, 1.0 * width, 1.0 * width, 0.5 * (width - 1), 0.5 * (height - 1)};
  if (used.size() < 3) {
    result.complaints.push_back("only " + std::to_string(used.size()) + " views can be used; at least " +
                                std::to_string(least_views) + " are needed, 20 to 30 are good");
    result.missing = lacking(result);
    result.sigma_max_px = result.sigma_center_px = std::numeric_limits<double>::infinity();
    return result;
  }

  // 1. From a pinhole with the middle as principal point to the full lens, then outliers and misfits out.
  Solution solution = start(data, used, width, height);
  Bundle(data, used, LensModel::k1, true, Free::all, solution).solve(30);
  const LensModel first = config.lens.value_or(LensModel::brown5);
  LensModel lens = std::min(first, LensModel::brown4);
  Bundle(data, used, lens, true, Free::all, solution).solve(30);
  for (int round = 0; round < 3; ++round) {
    lens = first;
    Bundle bundle(data, used, lens, config.flat_board, Free::all, solution);
    bundle.solve(round == 0 ? 40 : 15);
    const Bundle::Linear linear = bundle.linearise();
    data.noise_scale *= std::clamp(std::sqrt(linear.squares / std::max(1.0, linear.redundancy)), 0.3, 100.0);
    // Corners, then whole views.
    std::vector<double> misfits;
    for (const std::size_t view : used) misfits.push_back(misfit_of(data, solution, {view}));
    std::vector<double> sorted = misfits;
    std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2), sorted.end());
    const double usual = sorted[sorted.size() / 2];
    std::vector<std::size_t> kept;
    for (std::size_t i = 0; i < used.size(); ++i) {
      const std::size_t view = used[i];
      if (round > 0 && misfits[i] > misfit * usual && rms_of(data, solution, view) > least_misfit_px &&
          used.size() > least_views) {
        result.views[view].used = false;
        result.views[view].reason = "does not agree with the other views: it leaves " + figure(misfits[i] / usual, 2) +
                                    " times the usual (board or camera moved, or rows read one after the other)";
        continue;
      }
      kept.push_back(view);
      const std::size_t before = data.views[view].size();
      std::vector<SeenPoint> good;
      for (const SeenPoint& seen : data.views[view])
        if (residual_px(data, solution, view, seen).norm() <
            outlier_sigma * std::sqrt(2.0) * data.noise_scale * std::max(least_sigma_px, seen.sigma_px))
          good.push_back(seen);
      if (round > 0 && good.size() >= 6) data.views[view] = good;
      result.views[view].corners_set_aside += static_cast<int>(before - data.views[view].size());
    }
    used = kept;
  }

  // 2. The lens ladder: each model is solved on either half of the views and tried on the other.
  std::vector<std::size_t> halves[2];
  for (std::size_t i = 0; i < used.size(); ++i) halves[i % 2].push_back(used[i]);
  const bool halved = halves[1].size() >= 4 && !config.lens_only;
  std::map<LensModel, std::array<Solution, 2>> solved;
  const auto try_lens = [&](LensModel model) {
    double squares = 0.0;
    for (int half = 0; half < 2; ++half) {
      Solution trial = solution;
      if (model != lens)
        for (const int i : held(model)) trial.lens[static_cast<std::size_t>(i)] = 0.0;
      Bundle(data, halves[half], model, config.flat_board, Free::all, trial).solve(12);
      solved[model][static_cast<std::size_t>(half)] = trial;
      Bundle(data, halves[1 - half], model, config.flat_board, Free::poses, trial).solve(8);
      const double left = misfit_of(data, trial, halves[1 - half]);
      squares += 0.5 * left * left;
    }
    return std::sqrt(squares);
  };
  if (halved && !config.lens) {
    LensModel best = LensModel::brown4;
    double least = std::numeric_limits<double>::infinity();
    for (const LensModel model :
         {LensModel::k1, LensModel::k1_k2, LensModel::brown4, LensModel::brown5, LensModel::rational}) {
      // The last rung only if the one before it was worth its step.
      if (model == LensModel::rational && best != LensModel::brown5) break;
      const double left = try_lens(model);
      result.ladder.push_back({model, left});
      // A richer lens must pay: less error on unseen views. Eight coefficients need a clear gain, since they leave wide
      // uncertainties behind where no corner was seen.
      const double needed = model == LensModel::rational ? 0.99 : 1.0;
      if (left < needed * least) {
        least = left;
        best = model;
      }
    }
    lens = best;
    if (lens != first)
      for (const int i : held(lens)) solution.lens[static_cast<std::size_t>(i)] = 0.0;
  } else if (halved) {
    result.ladder.push_back({lens, try_lens(lens)});
    // The lens was asked for; whether it is good enough is said by richer ones.
    const double asked_for = result.ladder.front().held_out;
    for (const LensModel richer : {LensModel::brown4, LensModel::brown5, LensModel::rational}) {
      if (richer <= lens) continue;
      result.ladder.push_back({richer, try_lens(richer)});
      constexpr double much = 1.1;
      if (asked_for > much * result.ladder.back().held_out && result.complaints.empty())
        result.complaints.push_back("the lens model " + std::string(word(lens)) + " is too poor: on views not seen " +
                                    std::string(word(richer)) + " leaves " +
                                    figure(100.0 * result.ladder.back().held_out / asked_for, 2) +
                                    " % of what it leaves");
    }
  }

  // 3. The solution, and what it is worth.
  Bundle bundle(data, used, lens, config.flat_board, Free::all, solution);
  bundle.solve(40);
  Bundle::Linear linear = bundle.linearise();
  const double factor = std::sqrt(linear.squares / std::max(1.0, linear.redundancy));
  const double inflate = std::max(1.0, factor);
  result.noise_scale = data.noise_scale * factor;
  result.lens = lens;
  result.camera = camera_of(solution.lens, width, height);
  result.board = data.shape;
  result.board.value = solution.board;
  result.covariance = inflate * inflate * spread_out(linear.covariance, lens);
  const double by_corners = projection_sigma(result.camera, result.covariance).rms();
  const double by_views = projection_sigma(result.camera, spread_out(linear.by_views, lens)).rms();
  double wider = std::max(1.0, (by_views * by_views) / (by_corners * by_corners));
  double squares = 0.0;
  for (const std::size_t view : used) {
    ViewResidual& report = result.views[view];
    report.T_camera_board = isometry(solution.poses[view]);
    const Vector3d normal = report.T_camera_board.linear().col(2);
    report.tilt_deg = degrees(std::acos(std::clamp(normal.z(), -1.0, 1.0)));
    report.tilt_way_deg = degrees(std::atan2(normal.y(), normal.x()));
    report.distance = (report.T_camera_board * data.shape.centre).norm();
    double own = 0.0;
    for (const SeenPoint& seen : data.views[view]) {
      const Vector2d left = residual_px(data, solution, view, seen);
      own += left.squaredNorm();
      result.corners.push_back(
          {view, seen.pixel, left, seen.point_board.head<2>(), seen.outward.isZero(0.0) ? -1 : seen.id / 4});
    }
    squares += own;
    report.rms_px = std::sqrt(own / (2.0 * static_cast<double>(data.views[view].size())));
  }
  result.rms_px = std::sqrt(squares / (2.0 * static_cast<double>(std::max<std::size_t>(1, result.corners.size()))));

  result.neighbours_agree = agreement_of_neighbours(result);
  result.systematic_px = std::sqrt(std::max(0.0, result.neighbours_agree)) * result.rms_px;
  // Halves of the same kind of views share what the model misses; neighbours in a view show it.
  constexpr double most_agreement = 0.3;
  constexpr double most_systematic_px = 0.05;
  const bool misfit = result.neighbours_agree > most_agreement && result.systematic_px > most_systematic_px;
  // Corners that err alike are worth fewer: m of them that agree by r have the variance of m / (1 + (m - 1) r) that do
  // not (the design effect: Kish, Survey Sampling, 1965). By chance r stays below 0.1.
  constexpr double chance_agreement = 0.15;
  if (result.neighbours_agree > chance_agreement && result.systematic_px > most_systematic_px) {
    const double in_a_view = static_cast<double>(result.corners.size()) / static_cast<double>(used.size());
    wider = std::max(wider, 1.0 + (in_a_view - 1.0) * result.neighbours_agree);
  }
  result.covariance *= wider;

  // 4. Two halves must differ by what their uncertainties promise, no more.
  double excess = 1.0;
  if (halved) {
    if (!solved.contains(lens)) (void)try_lens(lens);
    ImageMap sigmas[2];
    CameraModel cameras[2];
    for (std::size_t half = 0; half < 2; ++half) {
      Solution& of_half = solved[lens][half];
      cameras[half] = camera_of(of_half.lens, width, height);
      Bundle again(data, halves[half], lens, config.flat_board, Free::all, of_half);
      const Bundle::Linear own = again.linearise();
      sigmas[half] = projection_sigma(cameras[half], spread_out(own.covariance, lens));
    }
    result.halves = projection_difference(cameras[0], cameras[1]);
    result.halves_px = result.halves.rms();
    result.halves_expected_px = std::hypot(sigmas[0].rms(), sigmas[1].rms());
    excess = result.halves_px / std::max(1e-9, result.halves_expected_px);
    constexpr double chance = 1.5;  // by chance alone the ratio reaches this in some per cent of the cases
    if (excess > chance) result.covariance *= excess * excess;
  }
  result.sigma = projection_sigma(result.camera, result.covariance);
  result.sigma_max_px = result.sigma.largest();
  const Eigen::Matrix<double, 12, 12> covariance = result.covariance;
  // The centre by itself: of a grid of three by three.
  result.sigma_center_px = projection_sigma(result.camera, covariance, 25, 19).values[25 * 9 + 12].x();

  // 5. The verdict.
  result.missing = lacking(result);
  if (used.size() < least_views)
    result.complaints.push_back("only " + std::to_string(used.size()) + " views can be used; at least " +
                                std::to_string(least_views) + " are needed, 20 to 30 are good");
  if (!(result.sigma_max_px <= config.most_sigma_px))
    result.complaints.push_back("the projection is known to " + figure(result.sigma_max_px) +
                                " px only at the edge of the picture and to " + figure(result.sigma_center_px) +
                                " px in its middle (limit " + figure(config.most_sigma_px) + " px)");
  constexpr double model_error = 2.0;
  constexpr double matters_px = 0.2;
  if (excess > model_error && result.halves_px > matters_px)
    result.complaints.push_back("two halves of the views differ by " + figure(result.halves_px) + " px, " +
                                figure(excess, 2) +
                                " times what their noise explains: the model of lens or board is wrong, or the board "
                                "moved or bent between views");
  if (misfit)
    result.complaints.push_back("neighbouring corners err alike, by " + figure(result.systematic_px) +
                                " px: the model of lens or board is wrong (a bent board taken for flat, too poor a "
                                "lens model, or rows of the sensor read one after the other)");
  constexpr double most_rms_px = 1.0;
  if (result.rms_px > most_rms_px)
    result.complaints.push_back("corners are off by " + figure(result.rms_px) +
                                " px; is this the right target description (sizes, numbers of squares)?");
  return result;
}

}  // namespace tagdock
