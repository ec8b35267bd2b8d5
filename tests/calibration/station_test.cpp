#include <algorithm>
#include <cmath>
#include <random>
#include <stdexcept>

#include <catch2/catch.hpp>

#include "calibration/rig.h"
#include "calibration/rig_check.h"
#include "calibration/station_survey.h"
#include "calibration/wizard.h"
#include "tests/calibration/board_rendering.h"
#include "tests/calibration/synthetic_drive.h"

using namespace tagdock;
using namespace tagdock::testing;

namespace {

/// The default board folded to another angle.
Board folded_board() {
  Board board = default_board(0.35);
  board.tags[0].T_station_tag = upright_tag(0.004, 0.202, 0.351, -0.55);
  board.tags[2].T_station_tag = upright_tag(-0.003, -0.199, 0.349, 0.50);
  return board;
}

/// Twelve pictures from 0.9 to 1.1 m and 35 degrees to both sides, corners with 0.05 px of noise.
std::vector<TagView> pictures_of(const Board& real) {
  std::mt19937_64 random(4);
  std::normal_distribution<double> normal(0.0, 0.05);
  const Rig rig = default_rig();
  std::vector<TagView> views;
  for (int i = 0; i < 12; ++i) {
    const double bearing = -0.6 + 0.11 * i;
    const double distance = 0.9 + 0.05 * (i % 5);
    Eigen::Isometry3d T_station_base = Eigen::Isometry3d::Identity();
    T_station_base.linear() = Eigen::AngleAxisd(-bearing, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    T_station_base.translation() << -distance * std::cos(bearing), distance * std::sin(bearing), 0.0;
    const Eigen::Isometry3d T_camera_station = (T_station_base * level_camera(0.0, 0.35)).inverse();
    TagView view{std::to_string(i), {}};
    for (const BoardTag& tag : real.tags) {
      TagView::Tag seen{tag.id, {}, 0.05};
      const TagPoints at = corners_station(tag);
      for (std::size_t k = 0; k < 4; ++k)
        seen.corners_px[k] =
            project(rig.camera, T_camera_station * at[k]) + Eigen::Vector2d(normal(random), normal(random));
      view.tags.push_back(seen);
    }
    views.push_back(view);
  }
  return views;
}

}  // namespace

TEST_CASE("a V board that was folded to another angle is surveyed to tenths of a millimetre") {
  const Board drawn = default_board(0.35);
  const Board real = folded_board();
  const Rig rig = default_rig();
  const std::vector<TagView> views = pictures_of(real);
  const BoardSurvey survey = survey_board(views, drawn, rig.camera, 1);
  CHECK(survey.complaints.empty());
  for (const std::size_t i : {std::size_t{0}, std::size_t{2}}) {
    const double off =
        (survey.board.tags[i].T_station_tag.translation() - real.tags[i].T_station_tag.translation()).norm();
    const BoardSurvey::Moved& claim = survey.tags[i == 0 ? 0 : 1];
    CHECK(1000.0 * off < 3.0 * claim.sigma_mm);
    CHECK(1000.0 * off < 0.6);     // 0.05 px at a metre is 0.04 mm across and 0.3 mm along the sight
    CHECK(claim.offset_mm > 2.0);  // the board differs from its drawing
  }
  CHECK(survey.board.tags[1].T_station_tag.isApprox(drawn.tags[1].T_station_tag));
  CHECK_THROWS_AS(survey_board({}, drawn, rig.camera, 1), std::invalid_argument);
  CHECK(survey.pictures.size() == 12);
  CHECK(survey.over_claimed == Approx(1.0).margin(0.15));  // 288 coordinates less 84 unknowns: 5 % by chance
}

TEST_CASE("a survey whose corners leave too much is refused, with the number and what to look at") {
  const Board drawn = default_board(0.35);
  const Rig rig = default_rig();
  const std::vector<TagView> good = pictures_of(folded_board());

  std::vector<TagView> moved = good;
  for (TagView::Tag& tag : moved[5].tags)
    if (tag.id == 2)
      for (Eigen::Vector2d& corner : tag.corners_px) corner.x() += 8.0;
  const BoardSurvey one = survey_board(moved, drawn, rig.camera, 1);
  REQUIRE(one.complaints.size() == 1);
  CHECK(one.complaints[0].find("most in 5 (") != std::string::npos);
  CHECK(one.complaints[0].find("take it again") != std::string::npos);

  CameraModel other = rig.camera;  // of another lens
  other.k1 -= 0.3;
  const BoardSurvey wrong = survey_board(good, drawn, other, 1);
  REQUIRE_FALSE(wrong.complaints.empty());
  const std::string told = wrong.complaints.back();
  CHECK(told.find("corners leave") == 0);
  CHECK(told.find("check that the camera file") != std::string::npos);

  Board larger = drawn;  // sizes that are not those of the prints
  for (BoardTag& tag : larger.tags) tag.size *= 1.0 + 0.05 * tag.id;
  const BoardSurvey sized = survey_board(good, larger, rig.camera, 1);
  INFO(sized.rms_px << " px, " << sized.over_claimed);
  CHECK_FALSE(sized.complaints.empty());
}

TEST_CASE("dockings by hand are averaged, and one that went wrong is left out") {
  const Taught taught =
      teach_in({{-0.6, 0.001, 3.14}, {-0.602, -0.001, -3.14}, {-0.598, 0.0, 3.139}, {-0.57, 0.0, 3.14}});
  CHECK(taught.complaints.empty());
  CHECK(taught.outliers == std::vector<std::size_t>{3});
  CHECK(taught.mean.x == Approx(-0.6));
  CHECK(std::abs(taught.mean.yaw) > 3.13);  // across the turn of the circle
  CHECK_FALSE(teach_in({{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}).complaints.empty());
}

TEST_CASE("the check says that a rig holds, and that a camera bumped by half a degree does not") {
  Drive how;
  how.sees = Drive::Sees::grid;
  how.stops = 6;
  how.seed = 3;
  const DriveData data = drive(how);
  Rig rig;
  rig.camera = data.problem.camera;
  rig.T_base_camera = data.truth.T_base_camera;
  CHECK(check_rig(data.problem, rig).holds);
  rig.T_base_camera.linear() =
      Eigen::AngleAxisd(0.009, Eigen::Vector3d::UnitZ()).toRotationMatrix() * rig.T_base_camera.linear();
  CHECK_FALSE(check_rig(data.problem, rig).holds);
}

TEST_CASE("the wizard takes a still new view by itself, refuses a moving or known one, and asks for tilted views") {
  std::mt19937_64 random(9);
  const CalibrationTarget target = charuco_board();
  const TargetLayout layout = layouts_of(target).front();
  const CameraModel camera = random_camera(random);
  WizardState state;
  state.width = 1280;
  state.height = 1024;
  for (const TargetLayout::Corner& corner : layout.corners) state.board.push_back(corner.point);
  const WizardConfig config;
  std::normal_distribution<double> normal(0.0, 0.05);
  const auto seen = [&](const Eigen::Isometry3d& pose) {
    CalibrationView view;
    view.name = "v" + std::to_string(state.kept.size());
    view.marks_found = 30;
    view.contrast = 100.0;
    for (const TargetLayout::Corner& corner : layout.corners)
      view.corners.push_back({corner.id, corner.point,
                              project(camera, pose * corner.point) + Eigen::Vector2d(normal(random), normal(random)),
                              0.05});
    view.corners_expected = static_cast<int>(view.corners.size());
    return view;
  };
  CHECK(advice(state, config).find("0 of the first") != std::string::npos);
  const std::vector<Eigen::Isometry3d> poses = views_of(target, camera, 20, random);
  const auto offer = [&](const Eigen::Isometry3d& pose) {
    const WizardStep made = step(state, seen(pose), config, false);
    state = made.next;
    return made.keep;
  };
  CHECK_FALSE(offer(poses[0]));  // nothing to compare with: it may be moving
  CHECK(offer(poses[0]));        // still
  CHECK_FALSE(offer(poses[0]));  // known
  CHECK_FALSE(offer(poses[1]));  // moved
  CHECK(offer(poses[1]));
  for (std::size_t i = 2; i < poses.size() && !state.finished; ++i) {
    CHECK_FALSE(offer(poses[i]));
    offer(poses[i]);
    if (state.kept.size() == 6) CHECK(advice(state, config).find("hold the board") != std::string::npos);
  }
  CHECK(state.finished);
  CHECK(state.result->sigma_max_px < 0.5);
}
