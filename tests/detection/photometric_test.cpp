#include <cmath>
#include <numbers>
#include <random>

#include <catch2/catch.hpp>

#include "detection/photometric_refiner.h"
#include "detection/tag_pattern.h"
#include "tests/detection/tag_rendering.h"

namespace tagdock {
namespace {

using rendering::Scene;
using rendering::Sensor;

/// A tag at a random place, roll and tilt axis of a small image.
Scene random_scene(const std::string& family, int id, double side_px, double tilt, std::mt19937_64& random) {
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  Scene scene;
  scene.pattern = tag_pattern(family, id);
  const double extent =
      side_px * 1.45 * scene.pattern.cells / scene.pattern.border_cells * (1.0 + 0.5 * std::sin(tilt));
  scene.width = scene.height = static_cast<int>(extent) + 16;
  const Eigen::Vector2d centre(0.5 * scene.width + unit(random), 0.5 * scene.height + unit(random));
  const double turn = 2.0 * std::numbers::pi;
  scene.image_by_tag = rendering::view(scene.pattern, side_px, 1400.0, {0.5 * scene.width, 0.5 * scene.height}, centre,
                                       tilt, turn * unit(random), turn * unit(random));
  return scene;
}

TagDetection coarse_detection(const Scene& scene, int id, double jitter_px, std::mt19937_64& random) {
  std::normal_distribution<double> normal(0.0, jitter_px);
  TagDetection coarse;
  coarse.id = id;
  coarse.corners_px = rendering::true_corners(scene);
  for (Eigen::Vector2d& corner : coarse.corners_px) corner += Eigen::Vector2d(normal(random), normal(random));
  return coarse;
}

double rms(const Corners& found, const Corners& truth) {
  double sum = 0.0;
  for (std::size_t k = 0; k < 4; ++k) sum += (found[k] - truth[k]).squaredNorm();
  return std::sqrt(sum / 8.0);
}

}  // namespace

TEST_CASE("a rendered edge equals an integral over the pixel by quadrature") {
  // One step from black to white through a Gaussian, integrated over the pixel on a 96 x 96 grid of points.
  for (const double angle_deg : {0.0, 1.0, 3.0, 20.0, 45.0})
    for (const double blur : {0.3, 0.7, 2.5}) {
      CAPTURE(angle_deg, blur);
      const double angle = angle_deg * std::numbers::pi / 180.0;
      Scene scene;
      scene.pattern.cells = scene.pattern.border_cells = 1;
      scene.pattern.cell = {TagPattern::black};
      scene.surroundings = 180.0;
      scene.width = scene.height = 12;
      scene.blur_px = blur;
      // A cell so large that only its left edge is in view; the edge passes (5.3, 5.6).
      const double size = 400.0;
      scene.image_by_tag << size * std::cos(angle), -size * std::sin(angle), 5.3 + 0.5 * size * std::cos(angle),
          size * std::sin(angle), size * std::cos(angle), 5.6 + 0.5 * size * std::sin(angle), 0.0, 0.0, 1.0;
      const cv::Mat1d image = rendering::light(scene);
      double worst = 0.0;
      double mean = 0.0;
      for (int row = 0; row < image.rows; ++row)
        for (int column = 0; column < image.cols; ++column) {
          double share = 0.0;
          for (int i = 0; i < 96; ++i)
            for (int j = 0; j < 96; ++j) {
              const double x = column + (i + 0.5) / 96.0 - 0.5 - 5.3;
              const double y = row + (j + 0.5) / 96.0 - 0.5 - 5.6;
              share += 0.5 * std::erfc((x * std::cos(angle) + y * std::sin(angle)) / (blur * std::sqrt(2.0)));
            }
          const double expected = 20.0 + 160.0 * share / (96.0 * 96.0);
          worst = std::max(worst, std::abs(image(row, column) - expected));
          mean += (image(row, column) - expected) / image.total();
        }
      // 0.05 of 160 grey levels: a tenth of the rounding, and 1e-3 px of edge at worst.
      CHECK(worst < 0.05);
      CHECK(std::abs(mean) < 0.005);
    }
}

TEST_CASE("a clean 100 px tag is found to hundredths of a pixel whatever its family") {
  std::mt19937_64 random(20261);
  for (const std::string family :
       {"tag36h11", "tag25h9", "tag16h5", "tagStandard41h12", "tagStandard52h13", "tagCircle21h7", "tagCircle49h12"}) {
    CAPTURE(family);
    for (const int id : {0, 7}) {
      const Scene scene = random_scene(family, id, 100.0, 0.5, random);
      const cv::Mat1b image = rendering::expose(rendering::light(scene), Sensor{2.0, 0.0, 1.0, random()});
      const Refinement result = refine_photometric(image, family, coarse_detection(scene, id, 0.2, random), {});
      REQUIRE(std::holds_alternative<RefinedTag>(result));
      const RefinedTag& tag = std::get<RefinedTag>(result);
      CAPTURE(tag.terms, tag.chi2_per_pixel);
      // The bound is about 0.0035 px for tag36h11; three times that is no accident of noise.
      CHECK(rms(tag.corners_px, rendering::true_corners(scene)) < 0.012);
    }
  }
}

}  // namespace tagdock
