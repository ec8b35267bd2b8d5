#include "calibration/hand_eye.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <sstream>
#include <stdexcept>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <ceres/ceres.h>

#include "calibration/intrinsics.h"
#include "calibration/lens_projection.h"
#include "calibration/visp_hand_eye.h"
#include "planning/pose2.h"

namespace tagdock {
namespace {

using Eigen::Index;
using Eigen::Isometry3d;
using Eigen::Matrix3d;
using Eigen::MatrixXd;
using Eigen::Quaterniond;
using Eigen::Vector3d;
using Eigen::VectorXd;

// What is known of any rig before it is measured (notes on calibration, section 4).
constexpr double weak_translation = 1.0;         // m
constexpr double weak_rotation = radians(30.0);  // rad
constexpr double weak_wheels = 0.05;             // relative
// A direction counts as determined when the data know it better than any drawing does: 50 mm, 6 degrees, 2 % of wheels.
// Written as a share of a wide prior, so that directions of different units compare.
constexpr double narrowed = 0.2;
constexpr double wide_translation = 0.05 / narrowed;       // m
constexpr double wide_rotation = radians(6.0) / narrowed;  // rad
constexpr double wide_wheels = 0.02 / narrowed;            // relative
// A base on wheels leans less than this; a tracker body that leans more is not on a planar base.
constexpr double most_planar_lean = radians(0.5);
constexpr double frontal_cone = radians(25.0);  // the paper, section 4.2
constexpr std::size_t least_oblique_stops = 8;  // below that the frontal views of a single tag are kept, too
constexpr double robust_sigma = 2.5;            // where a corner's square turns into its modulus
constexpr double outlier_sigma = 5.0;

// ---- states and residuals ------------------------------------------------------------------------------------------

struct Motion {
  Quaterniond rotation = Quaterniond::Identity();
  Vector3d translation = Vector3d::Zero();

  Motion() = default;
  explicit Motion(const Isometry3d& T) : rotation(T.linear()), translation(T.translation()) { rotation.normalize(); }
  [[nodiscard]] Isometry3d pose() const {
    Isometry3d T = Isometry3d::Identity();
    T.linear() = rotation.normalized().toRotationMatrix();
    T.translation() = translation;
    return T;
  }
};

template <typename T>
using V3 = Eigen::Matrix<T, 3, 1>;
template <typename T>
using Turn = Eigen::Map<const Eigen::Quaternion<T>>;
template <typename T>
using Place = Eigen::Map<const V3<T>>;

struct CornerResidual {
  LensValues lens;
  SeenPoint seen;

  template <typename T>
  bool operator()(const T* q_base_camera, const T* t_base_camera, const T* q_board, const T* t_board, const T* q_stop,
                  const T* t_stop, T* residual) const {
    const V3<T> point_reference = Turn<T>(q_board) * seen.point_board.cast<T>() + Place<T>(t_board);
    const V3<T> point_base = Turn<T>(q_stop).conjugate() * V3<T>(point_reference - Place<T>(t_stop));
    const V3<T> point_camera = Turn<T>(q_base_camera).conjugate() * V3<T>(point_base - Place<T>(t_base_camera));
    if (point_camera.z() < T(1e-3)) return false;
    const Eigen::Matrix<T, 2, 1> pixel = project_point(lens.data(), point_camera);
    residual[0] = (pixel.x() - seen.pixel.x()) / seen.sigma_px;
    residual[1] = (pixel.y() - seen.pixel.y()) / seen.sigma_px;
    return true;
  }
};

/// A measured pose: translation, and turn about the axes of the frame on the left.
struct PoseResidual {
  Isometry3d measured;
  double sigma_m;
  double sigma_rad;

  template <typename T>
  bool operator()(const T* q, const T* t, T* residual) const {
    const Quaterniond q_measured(measured.linear());
    Eigen::Quaternion<T> difference = Turn<T>(q) * q_measured.cast<T>().conjugate();
    if (difference.w() < T(0.0)) difference.coeffs() = -difference.coeffs();
    for (int i = 0; i < 3; ++i) {
      residual[i] = (t[i] - measured.translation()[i]) / sigma_m;
      residual[3 + i] = 2.0 * difference.vec()[i] / sigma_rad;
    }
    return true;
  }
};

/// The base stands on the floor: height and the two leans are small.
struct FloorResidual {
  double sigma_z;
  double sigma_tilt;

  template <typename T>
  bool operator()(const T* q, const T* t, T* residual) const {
    const V3<T> up = Turn<T>(q) * V3<T>(T(0.0), T(0.0), T(1.0));
    residual[0] = t[2] / sigma_z;
    residual[1] = up.x() / sigma_tilt;
    residual[2] = up.y() / sigma_tilt;
    return true;
  }
};

using Arcs = std::vector<std::array<double, 2>>;

/// Where a base gets whose wheels turn by these angles: x, y, yaw; arcs are integrated exactly.
template <typename T>
std::array<T, 3> rolled(const Arcs& arcs, const T& r_left, const T& r_right, const T& track) {
  std::array<T, 3> pose{T(0.0), T(0.0), T(0.0)};
  for (const std::array<double, 2>& arc : arcs) {
    const T left = r_left * arc[0];
    const T right = r_right * arc[1];
    const T turn = (right - left) / track;
    const T half = 0.5 * turn;
    const T sinc = half * half < T(1e-12) ? 1.0 - half * half / 6.0 : sin(half) / half;
    const T chord = 0.5 * (left + right) * sinc;
    pose[0] += chord * cos(pose[2] + half);
    pose[1] += chord * sin(pose[2] + half);
    pose[2] += turn;
  }
  return pose;
}

template <typename T>
T yaw_of(const Eigen::Quaternion<T>& q) {
  return atan2(2.0 * (q.w() * q.z() + q.x() * q.y()), 1.0 - 2.0 * (q.y() * q.y() + q.z() * q.z()));
}

struct WheelResidual {
  Arcs arcs;
  OdometryModel nominal;
  Matrix3d whitening;

  template <typename T>
  bool operator()(const T* q_from, const T* t_from, const T* q_to, const T* t_to, const T* scales, T* residual) const {
    const std::array<T, 3> driven =
        rolled(arcs, T(nominal.r_left * scales[0]), T(nominal.r_right * scales[1]), T(nominal.track * scales[2]));
    const Eigen::Quaternion<T> from(q_from[3], q_from[0], q_from[1], q_from[2]);
    const Eigen::Quaternion<T> to(q_to[3], q_to[0], q_to[1], q_to[2]);
    const T yaw = yaw_of(from);
    const T dx = t_to[0] - t_from[0];
    const T dy = t_to[1] - t_from[1];
    V3<T> error;
    error[0] = cos(yaw) * dx + sin(yaw) * dy - driven[0];
    error[1] = -sin(yaw) * dx + cos(yaw) * dy - driven[1];
    const T turn = yaw_of(to) - yaw - driven[2];
    error[2] = atan2(sin(turn), cos(turn));
    const V3<T> white = whitening.cast<T>() * error;
    for (int i = 0; i < 3; ++i) residual[i] = white[i];
    return true;
  }
};

struct AnchorResidual {
  template <typename T>
  bool operator()(const T* q, const T* t, T* residual) const {
    residual[0] = t[0] * 1e6;
    residual[1] = t[1] * 1e6;
    residual[2] = yaw_of(Eigen::Quaternion<T>(q[3], q[0], q[1], q[2])) * 1e6;
    return true;
  }
};

struct ScaleResidual {
  template <typename T>
  bool operator()(const T* scales, T* residual) const {
    for (int i = 0; i < 3; ++i) residual[i] = (scales[i] - 1.0) / weak_wheels;
    return true;
  }
};

struct HeightResidual {
  Measured height;
  template <typename T>
  bool operator()(const T* t, T* residual) const {
    residual[0] = (t[2] - height.value) / height.sigma;
    return true;
  }
};

// ---- start values --------------------------------------------------------------------------------------------------

double yaw_of(const Isometry3d& T) { return std::atan2(T.linear()(1, 0), T.linear()(0, 0)); }

Vector3d rotation_vector(const Matrix3d& rotation) {
  const Eigen::AngleAxisd turn(rotation);
  return turn.angle() * turn.axis();
}

Isometry3d planar(double x, double y, double yaw) {
  Isometry3d T = Isometry3d::Identity();
  T.linear() = Eigen::AngleAxisd(yaw, Vector3d::UnitZ()).toRotationMatrix();
  T.translation() << x, y, 0.0;
  return T;
}

/// What the start values are made from: stops that see the board, with the poses that explain what they see.
struct SeeingStop {
  std::size_t stop;
  std::vector<Isometry3d> T_camera_board;  ///< one or two
  std::size_t chosen = 0;
  [[nodiscard]] const Isometry3d& pose() const { return T_camera_board[chosen]; }
};

/// The base's upright axis in the camera frame from the axes of relative turns; straight ahead and level without turns.
Vector3d upright_camera(const std::vector<SeeingStop>& seeing, const std::vector<Isometry3d>& T_reference_base) {
  Vector3d sum = Vector3d::Zero();
  double turns = 0.0;
  for (std::size_t i = 0; i < seeing.size(); ++i)
    for (std::size_t j = i + 1; j < seeing.size(); ++j) {
      const double turn =
          wrap_angle(yaw_of(T_reference_base[seeing[j].stop]) - yaw_of(T_reference_base[seeing[i].stop]));
      const Matrix3d R_camera = seeing[i].pose().linear() * seeing[j].pose().linear().transpose();
      sum += turn * rotation_vector(R_camera);
      turns += turn * turn;
    }
  const double least_turn = radians(3.0);
  if (turns < least_turn * least_turn * static_cast<double>(seeing.size()) || sum.norm() < 1e-12)
    return -Vector3d::UnitY();
  return sum.normalized();
}

/// Closed form for a planar base: the upright axis, then yaw and place linearly from the translations.
Isometry3d planar_start(const std::vector<SeeingStop>& seeing, const std::vector<Isometry3d>& T_reference_base,
                        double height) {
  const Vector3d up = upright_camera(seeing, T_reference_base);
  Vector3d ahead = Vector3d::UnitZ() - up.z() * up;
  if (ahead.norm() < 0.1) ahead = Vector3d::UnitY() - up.y() * up;  // looks straight up or down
  ahead.normalize();
  Matrix3d level;
  level.row(0) = ahead.transpose();
  level.row(1) = up.cross(ahead).transpose();
  level.row(2) = up.transpose();

  // (R_B - 1) t - Rz(yaw) level t_A = -t_B, linear in tx, ty, cos yaw, sin yaw.
  Eigen::Matrix4d information = Eigen::Matrix4d::Zero();
  Eigen::Vector4d right = Eigen::Vector4d::Zero();
  for (std::size_t i = 0; i < seeing.size(); ++i)
    for (std::size_t j = i + 1; j < seeing.size(); ++j) {
      const Isometry3d B = T_reference_base[seeing[i].stop].inverse() * T_reference_base[seeing[j].stop];
      const Isometry3d A = seeing[i].pose() * seeing[j].pose().inverse();
      const Eigen::Vector2d a = (level * A.translation()).head<2>();
      Eigen::Matrix<double, 2, 4> rows;
      rows.leftCols<2>() = B.linear().topLeftCorner<2, 2>() - Eigen::Matrix2d::Identity();
      rows.rightCols<2>() << -a.x(), a.y(), -a.y(), -a.x();
      information += rows.transpose() * rows;
      right -= rows.transpose() * B.translation().head<2>();
    }
  // Where the drive leaves a direction open, the camera looks ahead from above the axle.
  const double weight = 1e-6 * static_cast<double>(seeing.size() * seeing.size());
  information.diagonal().array() += weight;
  right[2] += weight;
  const Eigen::Vector4d solution = information.ldlt().solve(right);
  Isometry3d T = Isometry3d::Identity();
  T.linear() = Eigen::AngleAxisd(std::atan2(solution[3], solution[2]), Vector3d::UnitZ()).toRotationMatrix() * level;
  T.translation() << solution[0], solution[1], height;
  return T;
}

/// The board in the reference frame: of all stops' poses the one nearest to all others.
Isometry3d medoid_board(const std::vector<SeeingStop>& seeing, const std::vector<Isometry3d>& T_reference_base,
                        const Isometry3d& T_base_camera) {
  std::vector<Isometry3d> all;
  for (const SeeingStop& stop : seeing)
    for (const Isometry3d& pose : stop.T_camera_board)
      all.push_back(T_reference_base[stop.stop] * T_base_camera * pose);
  double least = std::numeric_limits<double>::infinity();
  Isometry3d best = all.front();
  for (const Isometry3d& candidate : all) {
    double sum = 0.0;
    for (const Isometry3d& other : all)  // robust: beyond 10 degrees all are equally wrong
      sum += std::min(radians(10.0), Quaterniond(candidate.linear()).angularDistance(Quaterniond(other.linear()))) +
             std::min(0.3, (candidate.translation() - other.translation()).norm());
    if (sum < least) {
      least = sum;
      best = candidate;
    }
  }
  return best;
}

void choose_branches(std::vector<SeeingStop>& seeing, const std::vector<Isometry3d>& T_reference_base,
                     const Isometry3d& T_base_camera, const Isometry3d& T_reference_board) {
  for (SeeingStop& stop : seeing) {
    const Isometry3d expected = (T_reference_base[stop.stop] * T_base_camera).inverse() * T_reference_board;
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < stop.T_camera_board.size(); ++i) {
      const double angle = Quaterniond(stop.T_camera_board[i].linear()).angularDistance(Quaterniond(expected.linear()));
      if (angle < least) {
        least = angle;
        stop.chosen = i;
      }
    }
  }
}

// ---- the joint solution --------------------------------------------------------------------------------------------

/// Scales of the noise that the problem states, estimated from what the solution leaves.
struct Noise {
  double corner = 1.0;
  double motion = 1.0;
  double floor_tilt = radians(0.05);
  double floor_z = 0.0005;
};

enum class Kind { corner, motion, floor, anchor, prior };

struct State {
  Motion X;
  Motion board;
  std::vector<Motion> stops;
  std::array<double, 3> wheels{1.0, 1.0, 1.0};  ///< relative to nominal
};

Matrix3d wheel_whitening(const HandEyeProblem& problem, const Arcs& arcs, double scale) {
  const auto pose = [&](const Arcs& turned) {
    const std::array<double, 3> p =
        rolled(turned, problem.nominal.r_left, problem.nominal.r_right, problem.nominal.track);
    return Vector3d(p[0], p[1], p[2]);
  };
  // Wheels that only slip along their planes leave no sideways noise; a tenth of a millimetre and of a milliradian keep
  // the covariance of a single arc regular.
  Matrix3d covariance = Vector3d(1e-8, 1e-8, 1e-8).asDiagonal();
  const double rate = scale * problem.wheel_noise_rad_per_sqrt_rad;
  const double least = scale * problem.wheel_noise_floor_rad;
  for (std::size_t i = 0; i < arcs.size(); ++i)
    for (std::size_t wheel = 0; wheel < 2; ++wheel) {
      Arcs moved = arcs;
      constexpr double step = 1e-5;
      moved[i][wheel] += step;
      const Vector3d up = pose(moved);
      moved[i][wheel] -= 2.0 * step;
      const Vector3d by_angle = (up - pose(moved)) / (2.0 * step);
      covariance += by_angle * by_angle.transpose() * (rate * rate * std::abs(arcs[i][wheel]) + least * least);
    }
  const Eigen::LLT<Matrix3d> lower(covariance);
  return lower.matrixL().solve(Matrix3d::Identity());
}

/// The problem in Ceres' hands.
class Joint {
 public:
  Joint(const HandEyeProblem& problem, const std::vector<std::vector<SeenPoint>>& corners, State& state,
        const Noise& noise, const Isometry3d& prior)
      : problem_(problem), state_(state), solver_(options()) {
    const LensValues lens = lens_of(problem.camera);
    add_motion(state.X);
    add_motion(state.board);
    for (Motion& stop : state.stops) add_motion(stop);
    if (problem.by_wheels) solver_.AddParameterBlock(state.wheels.data(), 3);
    for (std::size_t i = 0; i < corners.size(); ++i)
      for (SeenPoint seen : corners[i]) {
        seen.sigma_px *= noise.corner;
        add(Kind::corner, i,
            new ceres::AutoDiffCostFunction<CornerResidual, 2, 4, 3, 4, 3, 4, 3>(new CornerResidual{lens, seen}),
            new ceres::HuberLoss(robust_sigma),
            {q(state.X), t(state.X), q(state.board), t(state.board), q(state.stops[i]), t(state.stops[i])});
      }
    for (std::size_t i = 0; i < state.stops.size(); ++i) {
      Motion& stop = state.stops[i];
      if (!problem.by_wheels) {
        add(Kind::motion, i,
            pose_cost(*problem.stops[i].T_tracker_base, problem.tracker_sigma_m * noise.motion,
                      problem.tracker_sigma_rad * noise.motion),
            nullptr, {q(stop), t(stop)});
        continue;
      }
      add(Kind::floor, i,
          new ceres::AutoDiffCostFunction<FloorResidual, 3, 4, 3>(new FloorResidual{noise.floor_z, noise.floor_tilt}),
          nullptr, {q(stop), t(stop)});
      if (i + 1 < state.stops.size()) {
        const Arcs& arcs = problem.stops[i].wheels_to_next;
        add(Kind::motion, i,
            new ceres::AutoDiffCostFunction<WheelResidual, 3, 4, 3, 4, 3, 3>(
                new WheelResidual{arcs, problem.nominal, wheel_whitening(problem, arcs, noise.motion)}),
            nullptr, {q(stop), t(stop), q(state.stops[i + 1]), t(state.stops[i + 1]), state.wheels.data()});
      }
    }
    if (problem.by_wheels)
      add(Kind::anchor, 0, new ceres::AutoDiffCostFunction<AnchorResidual, 3, 4, 3>(new AnchorResidual), nullptr,
          {q(state.stops[0]), t(state.stops[0])});
    if (problem.board)
      add(Kind::anchor, 0, pose_cost(problem.board->T_tracker_board, problem.board->sigma_m, problem.board->sigma_rad),
          nullptr, {q(state.board), t(state.board)});
    if (problem.camera_height)
      add(Kind::anchor, 0,
          new ceres::AutoDiffCostFunction<HeightResidual, 1, 3>(new HeightResidual{*problem.camera_height}), nullptr,
          {t(state.X)});
    add(Kind::prior, 0, pose_cost(prior, weak_translation, weak_rotation), nullptr, {q(state.X), t(state.X)});
    if (problem.by_wheels)
      add(Kind::prior, 0, new ceres::AutoDiffCostFunction<ScaleResidual, 3, 3>(new ScaleResidual), nullptr,
          {state.wheels.data()});
  }

  double solve(int iterations, bool hold_wheels) {
    if (problem_.by_wheels) {
      if (hold_wheels)
        solver_.SetParameterBlockConstant(state_.wheels.data());
      else
        solver_.SetParameterBlockVariable(state_.wheels.data());
    }
    ceres::Solver::Options how;
    how.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
    how.max_num_iterations = iterations;
    how.function_tolerance = 1e-9;
    how.parameter_tolerance = 1e-10;
    how.num_threads = 1;
    how.logging_type = ceres::SILENT;
    ceres::Solver::Summary summary;
    ceres::Solve(how, &solver_, &summary);
    return summary.IsSolutionUsable() ? summary.final_cost : std::numeric_limits<double>::infinity();
  }

  struct Linear {
    MatrixXd jacobian;  ///< dense: rows as residuals, columns X (t 3, turn 3), wheels (3 or 0), board 6, stops 6 each
    VectorXd residuals;
    std::vector<Kind> kinds;
    std::vector<std::size_t> stops;
  };

  /// Derivatives without the robust loss; turns in rad about the axes of the frame on the left.
  Linear linearise() {
    if (problem_.by_wheels) solver_.SetParameterBlockVariable(state_.wheels.data());
    ceres::Problem::EvaluateOptions how;
    how.apply_loss_function = false;
    how.parameter_blocks = {t(state_.X), q(state_.X)};
    if (problem_.by_wheels) how.parameter_blocks.push_back(state_.wheels.data());
    how.parameter_blocks.push_back(t(state_.board));
    how.parameter_blocks.push_back(q(state_.board));
    for (Motion& stop : state_.stops) {
      how.parameter_blocks.push_back(t(stop));
      how.parameter_blocks.push_back(q(stop));
    }
    how.residual_blocks = blocks_;
    ceres::CRSMatrix sparse;
    std::vector<double> residuals;
    solver_.Evaluate(how, nullptr, &residuals, nullptr, &sparse);
    Linear linear;
    linear.jacobian = MatrixXd::Zero(sparse.num_rows, sparse.num_cols);
    for (int row = 0; row < sparse.num_rows; ++row)
      for (int k = sparse.rows[static_cast<std::size_t>(row)]; k < sparse.rows[static_cast<std::size_t>(row) + 1]; ++k)
        linear.jacobian(row, sparse.cols[static_cast<std::size_t>(k)]) = sparse.values[static_cast<std::size_t>(k)];
    // Ceres' step of a quaternion is half a rotation vector.
    Index column = 0;
    const auto halve = [&] {
      linear.jacobian.middleCols(column + 3, 3) *= 0.5;
      column += 6;
    };
    halve();
    if (problem_.by_wheels) column += 3;
    for (std::size_t i = 0; i <= state_.stops.size(); ++i) halve();
    linear.residuals = Eigen::Map<const VectorXd>(residuals.data(), static_cast<Index>(residuals.size()));
    for (std::size_t i = 0; i < blocks_.size(); ++i) {
      const int size = solver_.GetCostFunctionForResidualBlock(blocks_[i])->num_residuals();
      linear.kinds.insert(linear.kinds.end(), static_cast<std::size_t>(size), kinds_[i]);
      linear.stops.insert(linear.stops.end(), static_cast<std::size_t>(size), of_stop_[i]);
    }
    return linear;
  }

 private:
  static ceres::Problem::Options options() {
    ceres::Problem::Options options;
    options.manifold_ownership = ceres::TAKE_OWNERSHIP;
    return options;
  }
  static ceres::CostFunction* pose_cost(const Isometry3d& measured, double sigma_m, double sigma_rad) {
    return new ceres::AutoDiffCostFunction<PoseResidual, 6, 4, 3>(new PoseResidual{measured, sigma_m, sigma_rad});
  }
  static double* q(Motion& motion) { return motion.rotation.coeffs().data(); }
  static double* t(Motion& motion) { return motion.translation.data(); }

  void add_motion(Motion& motion) {
    solver_.AddParameterBlock(q(motion), 4, new ceres::EigenQuaternionManifold);
    solver_.AddParameterBlock(t(motion), 3);
  }
  void add(Kind kind, std::size_t stop, ceres::CostFunction* cost, ceres::LossFunction* loss,
           const std::vector<double*>& parameters) {
    blocks_.push_back(solver_.AddResidualBlock(cost, loss, parameters));
    kinds_.push_back(kind);
    of_stop_.push_back(stop);
  }

  const HandEyeProblem& problem_;
  State& state_;
  ceres::Problem solver_;
  std::vector<ceres::ResidualBlockId> blocks_;
  std::vector<Kind> kinds_;
  std::vector<std::size_t> of_stop_;
};

// ---- what the drive determines -------------------------------------------------------------------------------------

struct Direction {
  std::string word;
  VectorXd unit;
};

std::vector<Direction> directions(bool wheels) {
  const Index count = wheels ? 9 : 6;
  std::vector<Direction> all;
  const char* const words[] = {"tx", "ty", "height", "roll", "pitch", "yaw", "r_left", "r_right", "track"};
  for (Index i = 0; i < count; ++i) all.push_back({words[i], VectorXd::Unit(count, i)});
  if (wheels) {
    VectorXd common = VectorXd::Zero(count);
    common.tail<3>().setConstant(1.0 / std::sqrt(3.0));
    all.push_back({"odometry_scale", common});
  }
  return all;
}

std::string cure_of(const std::string& word, bool wheels) {
  if (word == "height")
    return wheels ? "measure the lens' height above the floor by tape and give it (camera_height_hint, or "
                    "--camera-height); a planar robot cannot see it, and `dock` takes no rig without it"
                  : "survey the board in the tracker's frame (T_tracker_board), or give the lens' height by tape "
                    "(--camera-height); a planar robot cannot see it, and `dock` takes no rig without it";
  if (word == "roll" || word == "pitch")
    return "turn: add stops whose headings differ by 40 degrees or more, with the board in view";
  if (word == "yaw") return "drive: add stops that are 1 m or more apart, not only turns on the spot";
  if (word == "tx" || word == "ty")
    return "turn: add stops on an arc of 110 degrees around the board, or turns on the spot at two places";
  if (word == "track") return "turn: add at least 90 degrees of turning between stops, to both sides";
  if (word == "odometry_scale") return "drive: add at least 1 m of straight driving between stops that see the board";
  return "drive curves to both sides between stops that see the board";
}

/// What each column is made of most, every word once.
std::vector<std::string> words_of(const MatrixXd& columns, const std::vector<Direction>& all) {
  std::vector<std::string> words(static_cast<std::size_t>(columns.cols()));
  std::vector<bool> taken(all.size(), false);
  for (Index round = 0; round < columns.cols(); ++round) {
    double most = -1.0;
    std::size_t column = 0;
    std::size_t word = 0;
    for (std::size_t c = 0; c < words.size(); ++c)
      for (std::size_t w = 0; words[c].empty() && w < all.size(); ++w) {
        const double share = std::abs(columns.col(static_cast<Index>(c)).dot(all[w].unit));
        if (taken[w] || share <= most) continue;
        most = share;
        column = c;
        word = w;
      }
    words[column] = all[word].word;
    taken[word] = true;
  }
  return words;
}

/// One word per direction that the information leaves open, the strongest first.
std::vector<std::string> open_words(const MatrixXd& whitened_information, bool wheels, HandEyeResult& result) {
  const Eigen::SelfAdjointEigenSolver<MatrixXd> eigen(whitened_information);
  const VectorXd ratio = (1.0 + eigen.eigenvalues().array().max(0.0)).rsqrt();
  // The information ascends, so the ratios descend.
  result.direction_ratios.assign(ratio.data(), ratio.data() + ratio.size());
  result.direction_words = words_of(eigen.eigenvectors(), directions(wheels));
  std::reverse(result.direction_ratios.begin(), result.direction_ratios.end());
  std::reverse(result.direction_words.begin(), result.direction_words.end());
  Index open = 0;
  while (open < ratio.size() && ratio[open] > narrowed) ++open;
  MatrixXd basis = eigen.eigenvectors().leftCols(open);
  std::vector<std::string> words;
  const std::vector<Direction> all = directions(wheels);
  for (Index k = 0; k < open; ++k) {
    double most = -1.0;
    const Direction* chosen = nullptr;
    for (const Direction& direction : all) {
      const double share = (basis.transpose() * direction.unit).norm();
      if (share > most + 1e-9) {
        most = share;
        chosen = &direction;
      }
    }
    words.push_back(chosen->word);
    // What is left of the open space beside the named direction.
    const VectorXd along = (basis.transpose() * chosen->unit).normalized();
    const Eigen::HouseholderQR<MatrixXd> turned(along);
    basis = (basis * MatrixXd(turned.householderQ())).rightCols(basis.cols() - 1).eval();
  }
  // Radii whose common scale is open are open themselves; in a spin their difference trades with ty, too.
  if (std::find(words.begin(), words.end(), "odometry_scale") != words.end())
    std::erase_if(words, [](const std::string& name) { return name == "r_left" || name == "r_right"; });
  return words;
}

/// Information on the first `kept` parameters when all others are free.
MatrixXd marginal_information(const MatrixXd& information, Index kept) {
  const Index rest = information.rows() - kept;
  const MatrixXd cross = information.topRightCorner(kept, rest);
  const MatrixXd inner = information.bottomRightCorner(rest, rest);
  return information.topLeftCorner(kept, kept) - cross * inner.ldlt().solve(cross.transpose());
}

MatrixXd information_of(const Joint::Linear& linear, bool with_priors) {
  MatrixXd jacobian = linear.jacobian;
  if (!with_priors)
    for (Index row = 0; row < jacobian.rows(); ++row)
      if (linear.kinds[static_cast<std::size_t>(row)] == Kind::prior) jacobian.row(row).setZero();
  MatrixXd information = MatrixXd::Zero(jacobian.cols(), jacobian.cols());
  information.selfadjointView<Eigen::Lower>().rankUpdate(jacobian.transpose());
  return information.selfadjointView<Eigen::Lower>();
}

/// The same stops as a planar base would stand, without the leans that measurement noise alone pretends: those would
/// make the camera's height look observable.
State levelled(const State& state) {
  State level = state;
  Vector3d up = Vector3d::Zero();
  for (const Motion& stop : state.stops) up += stop.rotation * Vector3d::UnitZ();
  up.normalize();
  double worst = 0.0;
  double height = 0.0;
  for (const Motion& stop : state.stops) {
    worst = std::max(worst, std::acos(std::min(1.0, up.dot(stop.rotation * Vector3d::UnitZ()))));
    height += up.dot(stop.translation) / static_cast<double>(state.stops.size());
  }
  if (worst > most_planar_lean) return level;
  for (Motion& stop : level.stops) {
    stop.rotation = Quaterniond::FromTwoVectors(stop.rotation * Vector3d::UnitZ(), up) * stop.rotation;
    stop.translation += (height - up.dot(stop.translation)) * up;
  }
  return level;
}

/// Sum of squares over redundancy of one kind of residual: 1 when its stated noise is true.
struct Component {
  double squares = 0.0;
  double redundancy = 0.0;
  [[nodiscard]] double factor() const { return squares / std::max(1.0, redundancy); }
};

Component component(const Joint::Linear& linear, const MatrixXd& covariance, Kind kind, int part = -1) {
  Component result;
  int within = 0;
  for (Index row = 0; row < linear.jacobian.rows(); ++row) {
    if (linear.kinds[static_cast<std::size_t>(row)] != kind) {
      within = 0;
      continue;
    }
    const int place = within++ % 3;
    if (part >= 0 && (place == 0 ? 0 : 1) != part) continue;
    // Corner residuals count as far as the robust loss lets them.
    const double value = linear.residuals[row];
    const double square = value * value;
    result.squares += kind == Kind::corner && std::abs(value) > robust_sigma
                          ? robust_sigma * (2.0 * std::abs(value) - robust_sigma)
                          : square;
    result.redundancy += 1.0;
  }
  // Redundancy: 1 minus the leverage of each row. All leverages sum to the number of parameters, so that of the many
  // corners is what the few other rows leave.
  const bool many = kind == Kind::corner;
  MatrixXd rows(linear.jacobian.rows(), linear.jacobian.cols());
  Index next = 0;
  within = 0;
  for (Index row = 0; row < linear.jacobian.rows(); ++row) {
    const bool same = linear.kinds[static_cast<std::size_t>(row)] == kind;
    const int place = same ? within++ % 3 : 0;
    if (!same) within = 0;
    if (many ? same : (!same || (part >= 0 && (place == 0 ? 0 : 1) != part))) continue;
    rows.row(next++) = linear.jacobian.row(row);
  }
  const double leverage = (rows.topRows(next) * covariance).cwiseProduct(rows.topRows(next)).sum();
  result.redundancy -= many ? static_cast<double>(linear.jacobian.cols()) - leverage : leverage;
  return result;
}

/// How the solution moves with the lens: all parameters by the twelve values.
MatrixXd step_by_lens(const HandEyeProblem& problem, const std::vector<std::vector<SeenPoint>>& corners,
                      const State& state, const Noise& noise, const Joint::Linear& linear, const MatrixXd& covariance) {
  MatrixXd by_lens = MatrixXd::Zero(linear.jacobian.rows(), lens_values);
  Index row = 0;  // corners come first, stop by stop
  for (std::size_t i = 0; i < corners.size(); ++i) {
    const Isometry3d T_camera_board = (state.stops[i].pose() * state.X.pose()).inverse() * state.board.pose();
    for (const SeenPoint& seen : corners[i]) {
      const Vector3d at = T_camera_board * seen.point_board;
      by_lens.middleRows<2>(row) =
          pixel_by_lens(problem.camera, at.head<2>() / at.z()) / (noise.corner * seen.sigma_px);
      row += 2;
    }
  }
  return -covariance * (linear.jacobian.transpose() * by_lens);
}

}  // namespace

HandEyeResult calibrate_hand_eye(const HandEyeProblem& problem) {
  HandEyeResult result;
  // 1. The board's poses at the stops, each for itself.
  std::vector<SeeingStop> seeing;
  std::vector<std::vector<SeenPoint>> corners(problem.stops.size());
  for (std::size_t i = 0; i < problem.stops.size(); ++i) {
    const HandEyeStop& stop = problem.stops[i];
    StopResidual report;
    report.id = stop.id;
    report.corners = static_cast<int>(stop.corners.size());
    std::vector<Isometry3d> poses = board_poses(stop.corners, problem.camera);
    if (poses.empty()) {
      report.used = false;
      report.reason = stop.corners.empty() ? "the board is not in view" : "no pose explains its corners";
    } else {
      corners[i] = stop.corners;
      seeing.push_back({i, poses, 0});
      const Vector3d normal = poses[0].linear().col(2);
      const Vector3d sight = poses[0].translation().normalized();
      report.bearing_deg = degrees(std::acos(std::clamp(normal.dot(sight), -1.0, 1.0)));
      report.distance = poses[0].translation().norm();
    }
    result.stops.push_back(report);
  }
  // 2. Nearly frontal views of a single flat tag leave its tilt open. The paper leaves them out; we keep them out of
  // everything that is made from tag poses (start values, ViSP's solution), but not out of the joint solution, which
  // sees pixels: there they halve the error (30 stops before one tag: 2.4 mm without, 0.9 mm with them, 95 % of ten
  // drives).
  std::vector<SeeingStop> all_seeing = seeing;
  const bool single_tag =
      std::all_of(seeing.begin(), seeing.end(), [&](const SeeingStop& s) { return corners[s.stop].size() <= 4; });
  if (single_tag) {
    const auto frontal = [&](const SeeingStop& s) { return result.stops[s.stop].bearing_deg < degrees(frontal_cone); };
    const auto oblique = seeing.size() - static_cast<std::size_t>(std::count_if(seeing.begin(), seeing.end(), frontal));
    if (oblique >= least_oblique_stops && oblique < seeing.size()) {
      for (const SeeingStop& s : seeing) {
        if (!frontal(s)) continue;
        result.stops[s.stop].frontal = true;
        if (!problem.leave_out_frontal) continue;
        corners[s.stop].clear();
        result.stops[s.stop].used = false;
        result.stops[s.stop].reason = "within 25 degrees of the tag's normal";
      }
      std::erase_if(seeing, frontal);
      if (problem.leave_out_frontal) all_seeing = seeing;
    }
  }
  if (seeing.size() < 3)
    throw std::invalid_argument("only " + std::to_string(seeing.size()) +
                                " stops see the board; at least 3 are needed, 13 are good");

  // 3. Where the base stood, by tracker or by nominal wheels.
  std::vector<Isometry3d> T_reference_base;
  std::array<double, 3> at{0.0, 0.0, 0.0};
  for (const HandEyeStop& stop : problem.stops) {
    if (!problem.by_wheels) {
      if (!stop.T_tracker_base)
        throw std::invalid_argument("stop " + std::to_string(stop.id) + " has no pose of the tracker");
      T_reference_base.push_back(*stop.T_tracker_base);
      continue;
    }
    T_reference_base.push_back(planar(at[0], at[1], at[2]));
    const std::array<double, 3> way =
        rolled(stop.wheels_to_next, problem.nominal.r_left, problem.nominal.r_right, problem.nominal.track);
    const Pose2 next = Pose2{at[0], at[1], at[2]} * Pose2{way[0], way[1], way[2]};
    at = {next.x, next.y, next.yaw};
  }
  for (const SeeingStop& a : seeing)
    for (const SeeingStop& b : seeing) {
      result.heading_spread =
          std::max(result.heading_spread,
                   std::abs(wrap_angle(yaw_of(T_reference_base[a.stop]) - yaw_of(T_reference_base[b.stop]))));
      result.travel = std::max(
          result.travel, (T_reference_base[a.stop].translation() - T_reference_base[b.stop].translation()).norm());
    }

  // 4. Start values: closed form, the branch of each flat board's pose by agreement with the others; ViSP as a second.
  const double height = problem.camera_height ? problem.camera_height->value : 0.0;
  Isometry3d start = planar_start(seeing, T_reference_base, height);
  for (int round = 0; round < 3; ++round) {
    choose_branches(seeing, T_reference_base, start, medoid_board(seeing, T_reference_base, start));
    start = planar_start(seeing, T_reference_base, height);
  }
  std::vector<Isometry3d> T_camera_board;
  std::vector<Isometry3d> T_seen;
  for (const SeeingStop& s : seeing) {
    T_camera_board.push_back(s.pose());
    T_seen.push_back(T_reference_base[s.stop]);
  }
  result.visp = visp_hand_eye(T_camera_board, T_seen);
  std::vector<Isometry3d> starts{start};
  if (result.visp.solved) {
    Isometry3d visp = result.visp.T_base_camera;
    visp.translation().z() = height;  // arbitrary on a planar base
    starts.push_back(visp);
  }
  for (const double yaw : {0.0, 90.0, 180.0, 270.0}) {
    Isometry3d turned = start;
    turned.linear() = Eigen::AngleAxisd(radians(yaw), Vector3d::UnitZ()).toRotationMatrix() * start.linear();
    if (yaw != 0.0) starts.push_back(turned);
  }

  seeing = all_seeing;
  choose_branches(seeing, T_reference_base, start, medoid_board(seeing, T_reference_base, start));

  // 5. The joint solution from the best start: wheels held first, then free.
  Noise noise;
  State state;
  double least = std::numeric_limits<double>::infinity();
  double enough = 0.0;  // a start whose cost says that the model explains the data
  for (const SeeingStop& s : seeing) enough += 4.0 * static_cast<double>(corners[s.stop].size());
  for (const Isometry3d& X : starts) {
    State trial;
    trial.X = Motion(X);
    trial.board = Motion(medoid_board(seeing, T_reference_base, X));
    // The stops start where the pictures put them: from the wheels' sum the solution can fall into a false minimum.
    for (const Isometry3d& T : T_reference_base) trial.stops.emplace_back(T);
    if (problem.by_wheels)
      for (const SeeingStop& s : seeing) {
        const Isometry3d seen = trial.board.pose() * s.pose().inverse() * X.inverse();
        trial.stops[s.stop] = Motion(planar(seen.translation().x(), seen.translation().y(), yaw_of(seen)));
      }
    Joint joint(problem, corners, trial, noise, start);
    if (problem.by_wheels) joint.solve(15, true);
    const double cost = joint.solve(30, false);
    if (cost < least) {
      least = cost;
      state = trial;
    }
    if (least < enough) break;
  }
  if (!std::isfinite(least))
    throw std::invalid_argument("no camera pose explains the corners; are ids and frames right?");

  // 6. The noise as it is: variance components of corners, motion and floor; outliers set aside; solved again.
  const Index kept = problem.by_wheels ? 9 : 6;
  MatrixXd covariance;
  Joint::Linear linear;
  for (int round = 0; round < 4; ++round) {
    Joint joint(problem, corners, state, noise, start);
    joint.solve(20, false);
    linear = joint.linearise();
    covariance =
        information_of(linear, true).ldlt().solve(MatrixXd::Identity(linear.jacobian.cols(), linear.jacobian.cols()));
    if (round == 3) break;
    // What is stated counts as if it had been measured with so many residuals: from a hundred residuals two components
    // are told apart so badly that wrong weights would cost more than the little that a true statement is off.
    constexpr double stated = 30.0;
    const auto rescaled = [&](double scale, const Component& part, double lowest) {
      const double variance = (scale * scale * part.squares + stated) / (std::max(0.0, part.redundancy) + stated);
      return std::clamp(std::sqrt(variance), lowest, 20.0);
    };
    noise.corner = rescaled(noise.corner, component(linear, covariance, Kind::corner), 0.2);
    noise.motion = rescaled(noise.motion, component(linear, covariance, Kind::motion), 0.3);
    if (problem.by_wheels) {
      const Component z = component(linear, covariance, Kind::floor, 0);
      if (z.redundancy > 3.0) noise.floor_z = std::clamp(noise.floor_z * std::sqrt(z.factor()), 2e-5, 5e-3);
      const Component tilt = component(linear, covariance, Kind::floor, 1);
      if (tilt.redundancy > 3.0)
        noise.floor_tilt = std::clamp(noise.floor_tilt * std::sqrt(tilt.factor()), radians(0.001), radians(0.5));
    }
    for (std::size_t i = 0; i < corners.size(); ++i) {
      const Isometry3d T = (state.stops[i].pose() * state.X.pose()).inverse() * state.board.pose();
      const std::size_t before = corners[i].size();
      std::erase_if(corners[i], [&](const SeenPoint& seen) {
        return (project(problem.camera, T * seen.point_board) - seen.pixel).norm() >
               outlier_sigma * std::sqrt(2.0) * seen.sigma_px * std::max(1.0, noise.corner);
      });
      result.stops[i].corners_set_aside += static_cast<int>(before - corners[i].size());
    }
  }

  // 7. What it is worth.
  const Component corner_part = component(linear, covariance, Kind::corner);
  const Component motion_part = component(linear, covariance, Kind::motion);
  result.chi2_per_residual =
      (corner_part.squares + motion_part.squares) / std::max(1.0, corner_part.redundancy + motion_part.redundancy);
  result.corner_scale = noise.corner;
  result.motion_scale = noise.motion;
  result.floor_tilt_sigma = problem.by_wheels ? noise.floor_tilt : 0.0;
  result.T_base_camera = state.X.pose();
  result.T_reference_board = state.board.pose();
  if (problem.by_wheels)
    result.odometry = {problem.nominal.r_left * state.wheels[0], problem.nominal.r_right * state.wheels[1],
                       problem.nominal.track * state.wheels[2]};
  // The camera's own uncertainty moves all corners together, which no residual shows.
  const MatrixXd by_lens = step_by_lens(problem, corners, state, noise, linear, covariance).topRows(kept);
  const MatrixXd of_camera = by_lens * problem.camera_covariance * by_lens.transpose();
  result.camera_xy_sigma = std::sqrt(0.5 * (of_camera(0, 0) + of_camera(1, 1)));
  result.camera_rotation_sigma = std::sqrt(of_camera.diagonal().segment<3>(3).sum());
  result.covariance = covariance.topLeftCorner(kept, kept) + of_camera;
  if (problem.by_wheels) {
    const Vector3d unit(problem.nominal.r_left, problem.nominal.r_right, problem.nominal.track);
    result.covariance.rightCols(3) = (result.covariance.rightCols(3) * unit.asDiagonal()).eval();
    result.covariance.bottomRows(3) = (unit.asDiagonal() * result.covariance.bottomRows(3)).eval();
  }
  result.xy_sigma = std::sqrt(0.5 * (result.covariance(0, 0) + result.covariance(1, 1)));
  result.z_sigma = std::sqrt(result.covariance(2, 2));
  result.rotation_sigma = std::sqrt(result.covariance.diagonal().segment<3>(3).sum());

  // 8. What the drive determines.
  {
    State level = levelled(state);
    Joint joint(problem, corners, level, noise, start);
    MatrixXd information = marginal_information(information_of(joint.linearise(), false), kept);
    VectorXd unit(kept);
    unit.head<3>().setConstant(wide_translation);
    unit.segment<3>(3).setConstant(wide_rotation);
    if (problem.by_wheels) unit.tail<3>().setConstant(wide_wheels);
    information = (unit.asDiagonal() * information * unit.asDiagonal()).eval();
    const std::vector<std::string> words = open_words(information, problem.by_wheels, result);
    for (const std::string& open : words) result.unobservable.push_back({open, cure_of(open, problem.by_wheels)});
  }

  // 9. Stop by stop.
  for (std::size_t i = 0; i < problem.stops.size(); ++i) {
    StopResidual& report = result.stops[i];
    const Isometry3d base = state.stops[i].pose();
    const Isometry3d T_camera_board_i = (base * state.X.pose()).inverse() * state.board.pose();
    if (!problem.stops[i].corners.empty()) report.T_board_camera = T_camera_board_i.inverse();
    if (!corners[i].empty()) report.corner_rms_px = reprojection_rms(corners[i], problem.camera, T_camera_board_i);
    if (!problem.by_wheels) {
      const Isometry3d off = problem.stops[i].T_tracker_base->inverse() * base;
      report.base_mm = 1000.0 * off.translation().norm();
      report.base_deg = degrees(Eigen::AngleAxisd(off.linear()).angle());
    } else if (i + 1 < problem.stops.size()) {
      const std::array<double, 3> way = rolled(problem.stops[i].wheels_to_next, result.odometry.r_left,
                                               result.odometry.r_right, result.odometry.track);
      const Isometry3d off = planar(way[0], way[1], way[2]).inverse() * base.inverse() * state.stops[i + 1].pose();
      report.base_mm = 1000.0 * off.translation().head<2>().norm();
      report.base_deg = degrees(std::abs(yaw_of(off)));
    }
  }

  // 10. Is it good? Beyond what the paper reached after its hand-eye (3 mm, 0.15 degrees) it would not help docking.
  for (const Unobservable& open : result.unobservable)
    if (open.word != "height")
      result.complaints.push_back(open.word + " is not determined by this drive: " + open.cure);
  const double most_xy = 0.003;
  const double most_rotation = radians(0.15);
  const auto figure = [](double value, int digits) {
    std::ostringstream text;
    text.precision(digits);
    text << value;
    return text.str();
  };
  if (result.complaints.empty() && result.xy_sigma > most_xy)
    result.complaints.push_back("the camera's place on the base is known to " + figure(1000.0 * result.xy_sigma, 3) +
                                " mm only (limit 3 mm): add stops with headings further apart (now " +
                                figure(degrees(result.heading_spread), 3) + " degrees)");
  if (result.complaints.empty() && result.rotation_sigma > most_rotation)
    result.complaints.push_back("the camera's direction is known to " + figure(degrees(result.rotation_sigma), 3) +
                                " degrees only (limit 0.15): add stops further apart and closer to the board");
  return result;
}

}  // namespace tagdock
