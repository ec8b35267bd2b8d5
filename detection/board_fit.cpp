#include "detection/board_fit.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include <Eigen/Cholesky>
#include <Eigen/LU>

namespace tagdock {
namespace {

using A = TagAppearance;

/// Chance alone passes this in one of a thousand boards [sigmas of a normal variable].
constexpr double one_of_a_thousand = 3.09;

/// The value that a chi-square variable exceeds by that chance (Wilson and Hilferty 1931).
double largest_by_chance(double degrees) {
  const double c = 2.0 / (9.0 * degrees);
  return degrees * std::pow(1.0 - c + one_of_a_thousand * std::sqrt(c), 3.0);
}

/// Homography from a tag's image places to its modules, last entry 1; none if the tag is behind the lens.
std::optional<Eigen::Matrix<double, 8, 1>> homography(const Eigen::Isometry3d& T_camera_tag, double module,
                                                      const TagRegion& region, const CameraModel& camera) {
  Eigen::Matrix3d ideal_by_tag;
  ideal_by_tag << T_camera_tag.linear().col(0) * module, T_camera_tag.linear().col(1) * module,
      T_camera_tag.translation();
  Eigen::Matrix3d place_by_ideal;
  place_by_ideal << camera.fx, 0.0, camera.cx - region.centre.x(), 0.0, camera.fy, camera.cy - region.centre.y(), 0.0,
      0.0, region.side_px;
  const Eigen::Matrix3d inverse = (place_by_ideal * ideal_by_tag).inverse();
  if (!(T_camera_tag.translation().z() > 0.0) || !inverse.allFinite() || inverse(2, 2) == 0.0) return std::nullopt;
  Eigen::Matrix<double, 8, 1> g;
  for (Eigen::Index i = 0; i < 8; ++i) g[i] = inverse(i / 3, i % 3) / inverse(2, 2);
  return g;
}

/// The fit's unknowns: pose, blur of all, then each tag's own.
class JointFit {
 public:
  JointFit(std::span<FittedTag> tags, const Board& board, const CameraModel& camera,
           const std::optional<GroundPrior>& prior, const Eigen::Isometry3d& T_camera_station)
      : tags_(tags), camera_(camera), prior_(prior), T_(T_camera_station), common_blur_(blurs_agree()) {
    Eigen::Index next = common_blur_ ? 9 : 6;
    for (FittedTag& one : tags_) {
      placed_.push_back(find_tag(board, one.tag.id));
      std::vector<std::pair<int, Eigen::Index>> own;  // appearance parameter, unknown
      for (const int parameter : one.free) {
        if (parameter < A::white) continue;
        const bool blur = parameter >= A::blur_xx && parameter <= A::blur_yy;
        own.emplace_back(parameter, blur && common_blur_ ? 6 + parameter - A::blur_xx : next++);
      }
      unknowns_.push_back(std::move(own));
    }
    count_ = next;
  }

  /// True if a minimum was reached.
  bool run() {
    if (!place(T_)) return false;
    if (common_blur_) share_blur();
    State here = look();
    for (int step = 0; step < most_steps; ++step) {
      const Eigen::LLT<Eigen::MatrixXd> factor(here.hessian);
      if (factor.info() != Eigen::Success) return false;
      const Eigen::VectorXd motion = -factor.solve(here.gradient);
      const double predicted = -motion.dot(here.gradient);
      if (!motion.allFinite()) return false;
      const Eigen::Isometry3d T_before = T_;
      std::vector<TagAppearance> before;
      for (const FittedTag& one : tags_) before.push_back(one.model.appearance());
      if (!move(motion)) return false;
      // A step that gains less moves nothing by more than a tenth of its sigma; the next one would be its square.
      if (predicted < 0.01) return true;
      const State next = look();
      if (!(next.cost <= here.cost + 1e-6 * std::abs(here.cost))) {
        T_ = T_before;
        for (std::size_t i = 0; i < tags_.size(); ++i) tags_[i].model.set(before[i]);
        return false;
      }
      here = next;
    }
    return false;
  }

  [[nodiscard]] const Eigen::Isometry3d& T_camera_station() const { return T_; }

  /// The sandwich of the pose, everything else marginal; each tag's pixels scatter as its own fit found.
  [[nodiscard]] std::optional<Matrix6> covariance() {
    const State here = look();
    const Eigen::LLT<Eigen::MatrixXd> factor(here.hessian);
    if (factor.info() != Eigen::Success) return std::nullopt;
    Eigen::MatrixXd scatter = here.prior;
    for (std::size_t i = 0; i < tags_.size(); ++i) {
      const Eigen::MatrixXd by = derivatives(i);
      scatter += tags_[i].inflation * by.transpose() * tags_[i].model.scatter(tags_[i].samples).pixels * by;
    }
    const Eigen::MatrixXd half = factor.solve(scatter);
    const Matrix6 covariance = Eigen::MatrixXd(factor.solve(half.transpose())).topLeftCorner<6, 6>();
    if (!covariance.allFinite()) return std::nullopt;
    return covariance;
  }

 private:
  static constexpr int most_steps = 10;

  struct State {
    double cost = 0.0;
    Eigen::VectorXd gradient;
    Eigen::MatrixXd hessian;
    Eigen::MatrixXd prior;  ///< the prior's part of the hessian
  };

  /// Do the tags' own blurs differ by no more than chance? A way of motion makes them incomparable.
  [[nodiscard]] bool blurs_agree() const {
    if (tags_.size() < 2) return false;
    Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
    Eigen::Vector3d weighted = Eigen::Vector3d::Zero();
    double squares = 0.0;
    for (FittedTag& one : tags_) {
      if (!one.model.appearance().motion_px.isZero(0.0)) return false;
      const Eigen::MatrixXd all = reduced(one.model.equations(one.samples).hessian, one.free);
      Eigen::MatrixXd unit = Eigen::MatrixXd::Zero(all.rows(), 3);
      for (std::size_t i = 0; i < one.free.size(); ++i)
        if (one.free[i] >= A::blur_xx && one.free[i] <= A::blur_yy)
          unit(static_cast<Eigen::Index>(i), one.free[i] - A::blur_xx) = 1.0;
      const Eigen::Matrix3d covariance = unit.transpose() * all.ldlt().solve(unit);
      const Eigen::Matrix3d own = (one.inflation * covariance).inverse();
      const Eigen::Vector3d blur = one.model.appearance().value.segment<3>(A::blur_xx);
      if (!own.allFinite()) return false;
      information += own;
      weighted += own * blur;
      squares += blur.dot(own * blur);
    }
    const double chi2 = squares - weighted.dot(information.ldlt().solve(weighted));
    return chi2 < largest_by_chance(3.0 * static_cast<double>(tags_.size() - 1));
  }

  void share_blur() {
    Eigen::Vector3d mean = Eigen::Vector3d::Zero();
    for (const FittedTag& one : tags_)
      mean += one.model.appearance().value.segment<3>(A::blur_xx) / static_cast<double>(tags_.size());
    for (FittedTag& one : tags_) {
      TagAppearance appearance = one.model.appearance();
      appearance.value.segment<3>(A::blur_xx) = mean;
      one.model.set(appearance);
    }
  }

  [[nodiscard]] std::optional<Eigen::Matrix<double, 8, 1>> homography_of(std::size_t i,
                                                                         const Eigen::Isometry3d& T) const {
    const double module = placed_[i]->size / tags_[i].model.pattern().border_cells;
    return homography(T * placed_[i]->T_station_tag, module, tags_[i].region, camera_);
  }

  bool place(const Eigen::Isometry3d& T) {
    T_ = T;
    for (std::size_t i = 0; i < tags_.size(); ++i) {
      const auto g = homography_of(i, T);
      if (!g) return false;
      TagAppearance appearance = tags_[i].model.appearance();
      appearance.value.head<8>() = *g;
      tags_[i].model.set(appearance);
    }
    return true;
  }

  bool move(const Eigen::VectorXd& motion) {
    for (std::size_t i = 0; i < tags_.size(); ++i) {
      TagAppearance appearance = tags_[i].model.appearance();
      for (const auto& [parameter, unknown] : unknowns_[i]) appearance.value[parameter] += motion[unknown];
      if (!plausible(appearance.value)) return false;
      tags_[i].model.set(appearance);
    }
    return place(moved(motion.head<6>(), T_));
  }

  /// d(appearance)/d(unknowns) of a tag.
  [[nodiscard]] Eigen::MatrixXd derivatives(std::size_t i) const {
    Eigen::MatrixXd by = Eigen::MatrixXd::Zero(A::count, count_);
    constexpr double step = 1e-6;  // m and rad; the homography bends over metres
    for (Eigen::Index k = 0; k < 6; ++k) {
      const auto up = homography_of(i, moved(step * Eigen::Matrix<double, 6, 1>::Unit(k), T_));
      const auto down = homography_of(i, moved(-step * Eigen::Matrix<double, 6, 1>::Unit(k), T_));
      if (up && down) by.col(k).head<8>() = (*up - *down) / (2.0 * step);
    }
    for (const auto& [parameter, unknown] : unknowns_[i]) by(parameter, unknown) = 1.0;
    return by;
  }

  State look() {
    State state{0.0, Eigen::VectorXd::Zero(count_), Eigen::MatrixXd::Zero(count_, count_),
                Eigen::MatrixXd::Zero(count_, count_)};
    for (std::size_t i = 0; i < tags_.size(); ++i) {
      const Equations own = held_equations(tags_[i].model, tags_[i].samples);
      const Eigen::MatrixXd by = derivatives(i);
      state.cost += own.cost;
      state.gradient += by.transpose() * own.gradient;
      state.hessian += by.transpose() * own.hessian * by;
    }
    if (prior_) {
      const PriorEquations own = ground_equations(*prior_, T_);
      state.cost += own.cost;
      state.gradient.head<6>() += own.gradient;
      state.prior.topLeftCorner<6, 6>() = own.information;
      state.hessian += state.prior;
    }
    return state;
  }

  std::span<FittedTag> tags_;
  const CameraModel& camera_;
  const std::optional<GroundPrior>& prior_;
  Eigen::Isometry3d T_;
  bool common_blur_;
  std::vector<const BoardTag*> placed_;
  std::vector<std::vector<std::pair<int, Eigen::Index>>> unknowns_;
  Eigen::Index count_ = 0;
};

}  // namespace

PoseSource fit_board(std::span<FittedTag> tags, const Board& board, const CameraModel& camera,
                     const std::optional<GroundPrior>& prior, BoardSighting& sighting) {
  const double degrees = 8.0 * static_cast<double>(tags.size()) + (prior ? 3.0 : 0.0) - 6.0;
  if (sighting.chi2_per_coordinate * degrees > largest_by_chance(degrees)) return PoseSource::corners_contradict_board;
  JointFit fit(tags, board, camera, prior, sighting.T_camera_station);
  if (!fit.run()) return PoseSource::corners_pixels_unsettled;
  const auto covariance = fit.covariance();
  if (!covariance) return PoseSource::corners_pixels_unsettled;
  sighting.T_camera_station = fit.T_camera_station();
  sighting.covariance = *covariance;
  return PoseSource::pixels;
}

}  // namespace tagdock
