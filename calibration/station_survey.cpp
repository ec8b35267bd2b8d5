#include "calibration/station_survey.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <memory>
#include <sstream>
#include <stdexcept>

#include <Eigen/Cholesky>
#include <ceres/ceres.h>

#include "calibration/lens_projection.h"

namespace tagdock {
namespace {

using Eigen::Isometry3d;
using Eigen::Vector3d;

constexpr double least_sigma_px = 0.02;  // no corner is known better, whatever its fit says

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

struct CornerResidual {
  LensValues lens;
  Vector3d point_tag;
  Eigen::Vector2d pixel;
  double sigma_px;

  template <typename T>
  bool operator()(const T* station_by_tag, const T* camera_by_station, T* residual) const {
    const auto moved = [](const T* pose, const Eigen::Matrix<T, 3, 1>& point) -> Eigen::Matrix<T, 3, 1> {
      return Eigen::Map<const Eigen::Quaternion<T>>(pose) * point + Eigen::Map<const Eigen::Matrix<T, 3, 1>>(pose + 4);
    };
    const Eigen::Matrix<T, 3, 1> at =
        moved(camera_by_station, moved(station_by_tag, Eigen::Matrix<T, 3, 1>(point_tag.cast<T>())));
    if (at.z() < T(1e-3)) return false;
    const Eigen::Matrix<T, 2, 1> seen = project_point(lens.data(), at);
    residual[0] = (seen.x() - pixel.x()) / sigma_px;
    residual[1] = (seen.y() - pixel.y()) / sigma_px;
    return true;
  }
};

std::string figure(double value, int digits = 2) {
  std::ostringstream text;
  text.precision(digits);
  text << value;
  return text.str();
}

/// Root of the mean square of what was added.
struct Rms {
  double squares = 0.0;
  double count = 0.0;
  void add(const Eigen::Vector2d& residual) {
    squares += residual.squaredNorm();
    count += 2.0;
  }
  [[nodiscard]] double value() const { return std::sqrt(squares / std::max(1.0, count)); }
};

/// What is said of corners that leave too much; nothing if they do not.
void judge_residuals(BoardSurvey& survey, const Rms& all, const std::map<int, Rms>& by_tag,
                     const std::vector<Rms>& by_picture) {
  // Corners of sharp tags leave 0.05 to 0.2 px. Half a pixel at a metre and f = 1000 px is half a millimetre across,
  // and of one sign where the lens or a size is wrong. Guesses, which surveys of real boards would settle.
  constexpr double most_rms_px = 0.5;
  constexpr double matters_px = 0.2;
  constexpr double most_over_claimed = 4.0;
  const bool much = survey.rms_px > most_rms_px;
  if (!much && !(survey.over_claimed > most_over_claimed && survey.rms_px > matters_px)) return;
  std::string sentence = "corners leave " + figure(survey.rms_px) + " px rms, " + figure(survey.over_claimed) +
                         " times what they were measured to (limits " + figure(most_rms_px) + " px, or " +
                         figure(most_over_claimed) + " times and " + figure(matters_px) + " px)";
  std::size_t worst = 0;
  for (std::size_t i = 0; i < by_picture.size(); ++i)
    if (by_picture[i].value() > by_picture[worst].value()) worst = i;
  const Rms others{all.squares - by_picture[worst].squares, all.count - by_picture[worst].count};
  auto tag = by_tag.begin();
  for (auto it = by_tag.begin(); it != by_tag.end(); ++it)
    if (it->second.value() > tag->second.value()) tag = it;
  if (by_picture.size() > 2 && others.value() < 0.5 * by_picture[worst].value())
    sentence += "; most in " + survey.pictures[worst].name + " (" + figure(by_picture[worst].value()) +
                " px, the others " + figure(others.value()) +
                "): take it out if board or camera moved in it, or take it again";
  else
    sentence += "; most at tag " + std::to_string(tag->first) + " (" + figure(tag->second.value()) +
                " px): check that the camera file is of this camera, lens and focus (`calibrate intrinsics` anew), "
                "that the board file has the tags' sizes as measured, that every plate is flat, and that no tag moved "
                "between pictures";
  survey.complaints.push_back(sentence);
}

double median(std::vector<double> values) {
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

}  // namespace

BoardSurvey survey_board(const std::vector<TagView>& views, const Board& board, const CameraModel& camera,
                         int reference_id) {
  const BoardTag* reference = find_tag(board, reference_id);
  if (reference == nullptr) throw std::invalid_argument("the board has no tag " + std::to_string(reference_id));
  std::map<int, Pose> tags;
  std::map<int, int> seen_in;
  for (const BoardTag& tag : board.tags) tags[tag.id] = pose_of(tag.T_station_tag);
  std::vector<Pose> cameras;
  std::vector<const TagView*> used;
  for (const TagView& view : views) {
    std::vector<SeenPoint> points;
    std::size_t of_board = 0;
    for (const TagView::Tag& seen : view.tags) {
      const BoardTag* tag = find_tag(board, seen.id);
      if (tag == nullptr) continue;
      ++of_board;
      const TagPoints at = corners_station(*tag);
      for (std::size_t i = 0; i < 4; ++i) points.push_back({seen.id, at[i], seen.corners_px[i], seen.sigma_px});
    }
    if (of_board < 2) continue;  // says nothing about how tags stand to each other
    const std::vector<Isometry3d> poses = board_poses(points, camera);
    if (poses.empty()) continue;
    cameras.push_back(pose_of(poses.front()));
    used.push_back(&view);
    for (const TagView::Tag& seen : view.tags)
      if (find_tag(board, seen.id) != nullptr) ++seen_in[seen.id];
  }
  if (used.empty() || seen_in[reference_id] == 0)
    throw std::invalid_argument("no picture shows tag " + std::to_string(reference_id) +
                                " with another tag of the board");

  ceres::Problem problem;
  const LensValues lens = lens_of(camera);
  const auto manifold = [] {
    return new ceres::ProductManifold<ceres::EigenQuaternionManifold, ceres::EuclideanManifold<3>>{};
  };
  double count = 0.0;
  for (std::size_t i = 0; i < used.size(); ++i) {
    problem.AddParameterBlock(cameras[i].data(), 7, manifold());
    for (const TagView::Tag& seen : used[i]->tags) {
      const BoardTag* tag = find_tag(board, seen.id);
      if (tag == nullptr) continue;
      if (!problem.HasParameterBlock(tags[seen.id].data()))
        problem.AddParameterBlock(tags[seen.id].data(), 7, manifold());
      const TagPoints corners = tag_corners(tag->size);
      for (std::size_t k = 0; k < 4; ++k) {
        problem.AddResidualBlock(new ceres::AutoDiffCostFunction<CornerResidual, 2, 7, 7>(new CornerResidual{
                                     lens, corners[k], seen.corners_px[k], std::max(least_sigma_px, seen.sigma_px)}),
                                 new ceres::HuberLoss(2.5), tags[seen.id].data(), cameras[i].data());
        count += 2.0;
      }
    }
  }
  problem.SetParameterBlockConstant(tags[reference_id].data());
  ceres::Solver::Options how;
  how.linear_solver_type = ceres::SPARSE_NORMAL_CHOLESKY;
  how.max_num_iterations = 60;
  how.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(how, &problem, &summary);

  BoardSurvey survey;
  survey.board = board;
  const double freedom = count - 6.0 * static_cast<double>(used.size() + seen_in.size() - 1);
  const double scale = std::sqrt(std::max(1.0, 2.0 * summary.final_cost / std::max(1.0, freedom)));
  ceres::Covariance::Options options;
  options.algorithm_type = ceres::DENSE_SVD;
  options.null_space_rank = -1;
  ceres::Covariance covariance(options);
  std::vector<std::pair<const double*, const double*>> wanted;
  for (const auto& [id, times] : seen_in)
    if (times > 0 && id != reference_id) wanted.emplace_back(tags[id].data(), tags[id].data());
  const bool known = !wanted.empty() && covariance.Compute(wanted, &problem);
  for (BoardTag& tag : survey.board.tags) {
    if (tag.id == reference_id) continue;
    BoardSurvey::Moved moved;
    moved.id = tag.id;
    moved.views = seen_in[tag.id];
    if (moved.views == 0) {
      survey.complaints.push_back("tag " + std::to_string(tag.id) + " is in no picture together with another one");
      survey.tags.push_back(moved);
      continue;
    }
    const Isometry3d before = tag.T_station_tag;
    tag.T_station_tag = isometry(tags[tag.id]);
    moved.offset_mm = 1000.0 * (tag.T_station_tag.translation() - before.translation()).norm();
    moved.angle_deg = degrees(Eigen::AngleAxisd(before.linear().transpose() * tag.T_station_tag.linear()).angle());
    if (known) {
      Eigen::Matrix<double, 6, 6, Eigen::RowMajor> C;
      covariance.GetCovarianceBlockInTangentSpace(tags[tag.id].data(), tags[tag.id].data(), C.data());
      // Ceres' step of a quaternion is half a rotation vector.
      moved.sigma_deg = degrees(2.0 * scale * std::sqrt(C.diagonal().head<3>().sum()));
      moved.sigma_mm = 1000.0 * scale * std::sqrt(C.diagonal().tail<3>().sum());
    }
    constexpr double most_sigma_mm = 1.0;  // a third of the 3 mm that docking aims at
    if (!known || moved.sigma_mm > most_sigma_mm)
      survey.complaints.push_back("the place of tag " + std::to_string(tag.id) +
                                  " is not known to 1 mm: add pictures from closer by and from both sides");
    survey.tags.push_back(moved);
  }
  Rms all;
  Rms whitened;
  std::map<int, Rms> by_tag;
  std::vector<Rms> by_picture(used.size());
  for (std::size_t i = 0; i < used.size(); ++i) {
    for (const TagView::Tag& seen : used[i]->tags) {
      const BoardTag* tag = find_tag(survey.board, seen.id);
      if (tag == nullptr) continue;
      const TagPoints at = corners_station(*tag);
      for (std::size_t k = 0; k < 4; ++k) {
        const Eigen::Vector2d left = project(camera, isometry(cameras[i]) * at[k]) - seen.corners_px[k];
        all.add(left);
        whitened.add(left / std::max(least_sigma_px, seen.sigma_px));
        by_tag[seen.id].add(left);
        by_picture[i].add(left);
      }
    }
    survey.pictures.push_back({used[i]->name, by_picture[i].value()});
  }
  for (BoardSurvey::Moved& tag : survey.tags)
    if (by_tag.contains(tag.id)) tag.rms_px = by_tag[tag.id].value();
  survey.rms_px = all.value();
  survey.over_claimed = std::sqrt(whitened.squares / std::max(1.0, freedom));
  judge_residuals(survey, all, by_tag, by_picture);
  const Vector3d first = survey.board.tags.front().T_station_tag.linear().col(2);
  const Vector3d last = survey.board.tags.back().T_station_tag.linear().col(2);
  survey.wing_angle_deg = degrees(std::acos(std::clamp(first.dot(last), -1.0, 1.0)));
  return survey;
}

Taught teach_in(const std::vector<Pose2>& poses) {
  Taught taught;
  if (poses.empty()) {
    taught.complaints.emplace_back("no docking by hand was given");
    return taught;
  }
  std::vector<double> x;
  std::vector<double> y;
  std::vector<double> yaw;
  for (const Pose2& pose : poses) {
    x.push_back(pose.x);
    y.push_back(pose.y);
    yaw.push_back(wrap_angle(pose.yaw - poses.front().yaw));
  }
  const double middle[] = {median(x), median(y), median(yaw)};
  std::vector<std::size_t> good;
  constexpr double far = 0.01;             // m: a person stops within millimetres
  constexpr double turned = radians(1.0);  // rad
  for (std::size_t i = 0; i < poses.size(); ++i) {
    if (std::hypot(x[i] - middle[0], y[i] - middle[1]) > far || std::abs(yaw[i] - middle[2]) > turned)
      taught.outliers.push_back(i);
    else
      good.push_back(i);
  }
  if (2 * good.size() <= poses.size()) {
    taught.complaints.emplace_back("the dockings by hand differ by more than 10 mm or 1 degree: do them again");
    return taught;
  }
  const double n = static_cast<double>(good.size());
  double mean_yaw = 0.0;
  for (const std::size_t i : good) {
    taught.mean.x += x[i] / n;
    taught.mean.y += y[i] / n;
    mean_yaw += yaw[i] / n;
  }
  taught.mean.yaw = wrap_angle(poses.front().yaw + mean_yaw);
  for (const std::size_t i : good) {
    taught.spread.x += (x[i] - taught.mean.x) * (x[i] - taught.mean.x);
    taught.spread.y += (y[i] - taught.mean.y) * (y[i] - taught.mean.y);
    taught.spread.yaw += (yaw[i] - mean_yaw) * (yaw[i] - mean_yaw);
  }
  const double freedom = std::max(1.0, n - 1.0);
  taught.spread = {std::sqrt(taught.spread.x / freedom), std::sqrt(taught.spread.y / freedom),
                   std::sqrt(taught.spread.yaw / freedom)};
  constexpr std::size_t enough = 3;
  if (good.size() < enough)
    taught.complaints.push_back("only " + std::to_string(good.size()) +
                                " dockings by hand; three or more tell how well they agree");
  return taught;
}

}  // namespace tagdock
