#include "app/calibration_report.h"

#include <algorithm>
#include <filesystem>
#include <random>
#include <string>
#include <unistd.h>
#include <vector>

#include <Eigen/Geometry>
#include <catch2/catch.hpp>

#include "app/calibration_result.h"
#include "tests/calibration/board_rendering.h"
#include "tests/calibration/synthetic_drive.h"

using namespace tagdock;
using namespace tagdock::testing;
namespace fs = std::filesystem;

namespace {

/// Corners of the ChArUco board with 0.05 px of noise, no pictures.
IntrinsicsResult calibrated(int count) {
  std::mt19937_64 random(11);
  std::normal_distribution<double> normal(0.0, 0.05);
  const CameraModel camera = random_camera(random);
  const TargetLayout layout = layouts_of(charuco_board()).front();
  std::vector<CalibrationView> views;
  for (const Eigen::Isometry3d& pose : views_of(charuco_board(), camera, count, random)) {
    CalibrationView view;
    view.name = "a picture with a long name of the camera's own making " + std::to_string(views.size()) + ".png";
    view.marks_found = 30;
    view.contrast = 100.0;
    for (const TargetLayout::Corner& corner : layout.corners)
      view.corners.push_back({corner.id, corner.point,
                              project(camera, pose * corner.point) + Eigen::Vector2d(normal(random), normal(random)),
                              0.05});
    view.corners_expected = static_cast<int>(view.corners.size());
    views.push_back(view);
  }
  return calibrate_intrinsics(views, camera.width, camera.height);
}

std::string told(const Report& report) {
  std::string text;
  for (const std::string& sentence : report.verdict) text += sentence + "\n";
  for (const std::string& sentence : report.sentences) text += sentence + "\n";
  return text;
}

/// Words of a figure with the room that they take, by what a letter of a sans-serif face is wide at least.
struct Words {
  std::string text;
  Eigen::AlignedBox2d box;
};

std::vector<Words> words_of(const Figure& figure) {
  std::vector<Words> all;
  for (const Figure::Part& part : figure.parts()) {
    const auto* text = std::get_if<Figure::Text>(&part);
    if (text == nullptr || text->words.empty()) continue;
    const double width = 0.5 * text->size * static_cast<double>(text->words.size());
    const double left = text->place.x() - text->anchor * width;
    all.push_back(
        {text->words,
         {Eigen::Vector2d(left, text->place.y() - 0.7 * text->size), Eigen::Vector2d(left + width, text->place.y())}});
  }
  return all;
}

void check_readable(const Report& report) {
  for (const Figure& figure : report.figures) {
    CAPTURE(figure.title());
    const std::vector<Words> words = words_of(figure);
    CHECK(words.size() > 4);  // axes and their numbers
    const Eigen::AlignedBox2d paper(Eigen::Vector2d(0.0, 0.0), Eigen::Vector2d(figure.width(), figure.height()));
    for (std::size_t i = 0; i < words.size(); ++i) {
      CAPTURE(words[i].text);
      CHECK(paper.contains(words[i].box));
      for (std::size_t k = 0; k < i; ++k) {
        CAPTURE(words[k].text);
        CHECK(words[i].box.intersection(words[k].box).isEmpty());
      }
    }
  }
}

std::size_t rows_below(const Figure& figure) {
  std::vector<double> heights;
  for (const Words& words : words_of(figure)) {
    if (words.text.find_first_not_of("0123456789.-") != std::string::npos) continue;
    if (words.box.min().x() < 55.0) continue;  // numbers of the other axis
    const double at = words.box.max().y();
    if (std::find(heights.begin(), heights.end(), at) == heights.end()) heights.push_back(at);
  }
  return heights.size();
}

}  // namespace

TEST_CASE("no words of a report's figures lie on others or leave their figure, and bars have one row of names") {
  const Report camera = intrinsics_report(calibrated(45), 2.0);
  check_readable(camera);
  REQUIRE(camera.figures.back().title() == "residuals by view");
  CHECK(rows_below(camera.figures.back()) == 1);
  Drive how;
  how.way = Drive::Way::zigzag;
  how.sees = Drive::Sees::grid;
  how.by_wheels = true;
  how.height_by_tape = true;
  how.stops = 44;
  DriveData wheels = drive(how);
  const HandEyeResult by_wheels = calibrate_hand_eye(wheels.problem);
  const Report base = hand_eye_report(wheels.problem, by_wheels);
  check_readable(base);
  std::string names;
  for (const Words& words : words_of(base.figures.back())) names += words.text + " ";
  for (const char* direction : {"tx", "height", "yaw", "r_left", "track"})
    CHECK_THAT(names, Catch::Contains(direction));
  how.way = Drive::Way::straight;
  how.by_wheels = false;
  how.stops = 13;
  DriveData straight = drive(how);
  const HandEyeResult unknown = calibrate_hand_eye(straight.problem);
  REQUIRE(unknown.direction_words.size() == 6);
  CHECK(unknown.direction_ratios.back() > 0.5);
  CHECK_THAT(unknown.direction_words.back(), Catch::Equals("tx") || Catch::Equals("ty"));  // no turn tells them
  const Report open = hand_eye_report(straight.problem, unknown);
  check_readable(open);
  CHECK(told(open).find("tx is not determined") != std::string::npos);
  CHECK(told(open).find("Not determined: tx") == std::string::npos);  // said once
  const fs::path folder = fs::temp_directory_path() / ("tagdock_report_" + std::to_string(::getpid()));
  fs::create_directories(folder);
  to_pdf(camera, folder / "camera.pdf");
  to_pdf(base, folder / "base.pdf");
  CHECK(fs::file_size(folder / "camera.pdf") > 10000);
  CHECK(fs::file_size(folder / "base.pdf") > 10000);
  fs::remove_all(folder);
}

TEST_CASE("a report gives no figure that was not computed") {
  const IntrinsicsResult few = calibrated(7);
  REQUIRE(few.halves.values.empty());
  const std::string text = told(intrinsics_report(few, 2.0));
  CHECK_THAT(text, Catch::Contains("were not compared"));
  CHECK_THAT(text, !Catch::Contains("noise explains") && !Catch::Contains("0.000 px"));
  const auto quality = intrinsics_block(few, {})["quality"];
  CHECK(quality["halves_differ_px"].is_null());
  CHECK(quality["halves_expected_px"].is_null());
  const IntrinsicsResult many = calibrated(20);
  CHECK_THAT(told(intrinsics_report(many, 2.0)), Catch::Contains("noise explains"));
  CHECK(intrinsics_block(many, {})["quality"]["halves_expected_px"].get<double>() > 0.0);
}
