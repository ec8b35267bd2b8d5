// Accuracy of the full-tag fit on freshly rendered images, condition by condition, against the Cramer-Rao bound of the
// same images; then its speed. `photometric_bench --images 45 --bounds 4 --seed 1 --only tilt` chooses.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <functional>
#include <iostream>
#include <map>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include <Eigen/LU>
#include <benchmark/benchmark.h>
#include <opencv2/imgcodecs.hpp>

#include "detection/photometric_refiner.h"
#include "detection/tag_pattern.h"
#include "tests/detection/tag_rendering.h"

namespace tagdock {
namespace {

using Eigen::Vector2d;
using rendering::Scene;
using rendering::Sensor;

constexpr const char* family = "tag36h11";

struct Shot {
  Scene scene;
  Sensor sensor;
  bool camera = false;  ///< the estimator knows the lens
  int jpeg = 0;         ///< quality, 0 for none
};

double uniform(std::mt19937_64& random, double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(random);
}

/// The base condition: 100 px, tilt 30 degrees, blur 0.7, contrast 160, noise 2, anything else random.
Shot base(std::mt19937_64& random, double side_px = 100.0, double tilt_deg = 30.0, double focal_px = 1000.0) {
  Shot shot;
  Scene& scene = shot.scene;
  scene.pattern = tag_pattern(family, std::uniform_int_distribution<int>(0, 586)(random));
  const double tilt = tilt_deg * std::numbers::pi / 180.0;
  const Vector2d principal(0.0, 0.0);
  const Vector2d centre(uniform(random, 0.0, 1.0), uniform(random, 0.0, 1.0));
  scene.image_by_tag = rendering::view(scene.pattern, side_px, focal_px, principal, centre, tilt,
                                       uniform(random, 0.0, 6.283), uniform(random, 0.0, 6.283));
  return shot;
}

/// Moves the tag into an image that just holds it.
void frame_it(Shot& shot) {
  Scene& scene = shot.scene;
  scene.width = scene.height = 1;
  Vector2d low(1e9, 1e9);
  Vector2d high(-1e9, -1e9);
  const double half = 0.5 * scene.pattern.cells;
  for (int i = 0; i <= 8; ++i)
    for (const Vector2d& place : {Vector2d(-half, half * (i / 4.0 - 1.0)), Vector2d(half, half * (i / 4.0 - 1.0)),
                                  Vector2d(half * (i / 4.0 - 1.0), -half), Vector2d(half * (i / 4.0 - 1.0), half)}) {
      Vector2d pixel = (scene.image_by_tag * place.homogeneous()).hnormalized();
      if (scene.camera) {
        const CameraModel& camera = *scene.camera;
        pixel = project(camera, {(pixel.x() - camera.cx) / camera.fx, (pixel.y() - camera.cy) / camera.fy, 1.0});
      }
      low = low.cwiseMin(pixel);
      high = high.cwiseMax(pixel);
    }
  const double margin = 6.0 + 3.0 * scene.blur_px;
  const Vector2d shift = (low.array() - margin).floor();
  Eigen::Matrix3d move = Eigen::Matrix3d::Identity();
  move(0, 2) = -shift.x();
  move(1, 2) = -shift.y();
  scene.image_by_tag = move * scene.image_by_tag;
  if (scene.camera) {
    scene.camera->cx -= shift.x();
    scene.camera->cy -= shift.y();
  }
  scene.width = static_cast<int>(std::ceil(high.x() - shift.x() + margin));
  scene.height = static_cast<int>(std::ceil(high.y() - shift.y() + margin));
}

struct Condition {
  std::string name;
  std::function<Shot(std::mt19937_64&)> draw;
};

using Change = std::function<void(Shot&, std::mt19937_64&)>;

Condition changed(const std::string& name, const Change& change) {
  return {name, [change](std::mt19937_64& random) {
            Shot shot = base(random);
            change(shot, random);
            return shot;
          }};
}

Shot under_barrel(std::mt19937_64& random, double side_px) {
  Shot shot;
  Scene& scene = shot.scene;
  scene.pattern = tag_pattern(family, std::uniform_int_distribution<int>(0, 586)(random));
  CameraModel camera;
  camera.width = 1280;
  camera.height = 1024;
  camera.fx = camera.fy = 900.0;
  camera.cx = 639.5;
  camera.cy = 511.5;
  camera.k1 = -0.25;
  camera.k2 = 0.06;
  const double sx = uniform(random, 0.0, 1.0) < 0.5 ? -1.0 : 1.0;
  const double sy = uniform(random, 0.0, 1.0) < 0.5 ? -1.0 : 1.0;
  const Vector2d centre(639.5 + sx * uniform(random, 420.0, 520.0), 511.5 + sy * uniform(random, 320.0, 400.0));
  scene.image_by_tag = rendering::view(scene.pattern, side_px, 900.0, {639.5, 511.5}, centre, 0.5236,
                                       uniform(random, 0.0, 6.283), uniform(random, 0.0, 6.283));
  scene.camera = camera;
  shot.camera = true;
  return shot;
}

rendering::Patch beside_a_side(const Scene&, std::mt19937_64& random, double from, double to, double inner,
                               double outer, double level) {
  rendering::Patch patch;
  const int side = std::uniform_int_distribution<int>(0, 3)(random);
  for (const Vector2d& p : {Vector2d(from, inner), Vector2d(to, inner), Vector2d(to, outer), Vector2d(from, outer)}) {
    Vector2d turned = p;
    for (int k = 0; k < side; ++k) turned = Vector2d(-turned.y(), turned.x());
    patch.outline.push_back(turned);
  }
  patch.level = level;
  return patch;
}

std::vector<Condition> conditions() {
  std::vector<Condition> all;
  all.push_back(changed("base", [](Shot&, std::mt19937_64&) {}));
  for (const double blur : {0.3, 0.5, 1.0, 1.5, 2.0, 2.5})
    all.push_back(changed("blur " + std::to_string(blur).substr(0, 3),
                          [blur](Shot& shot, std::mt19937_64&) { shot.scene.blur_px = blur; }));
  for (const double noise : {0.0, 0.5, 1.0, 4.0, 7.0})
    all.push_back(changed("noise " + std::to_string(noise).substr(0, 3),
                          [noise](Shot& shot, std::mt19937_64&) { shot.sensor.read_noise = noise; }));
  for (const double contrast : {30.0, 80.0, 220.0})
    all.push_back(
        changed("contrast " + std::to_string(static_cast<int>(contrast)), [contrast](Shot& s, std::mt19937_64&) {
          s.scene.black = contrast > 200.0 ? 15.0 : 20.0;
          s.scene.white = s.scene.black + contrast;
          s.scene.surroundings = s.scene.black + 0.5 * contrast;
        }));
  for (const double side : {20.0, 30.0, 40.0, 60.0, 160.0, 300.0})
    all.push_back({"side " + std::to_string(static_cast<int>(side)),
                   [side](std::mt19937_64& random) { return base(random, side); }});
  for (const double tilt : {0.0, 15.0, 45.0, 60.0, 75.0})
    all.push_back({"tilt " + std::to_string(static_cast<int>(tilt)),
                   [tilt](std::mt19937_64& random) { return base(random, 100.0, tilt); }});
  for (const double side : {160.0, 90.0, 55.0, 33.0})
    for (const double noise : {0.0, 2.0})
      for (const bool about_y : {true, false})
        all.push_back({std::string("paper ") + (about_y ? "y " : "z ") + std::to_string(static_cast<int>(side)) +
                           " noise " + std::to_string(static_cast<int>(noise)),
                       [side, noise, about_y](std::mt19937_64& random) {
                         Shot shot = base(random);
                         const double turn = about_y ? uniform(random, -1.309, 1.309) : 0.0;
                         const double roll = about_y ? 0.0 : uniform(random, 0.0, 1.5708);
                         shot.scene.image_by_tag = rendering::view(shot.scene.pattern, side, 1400.0, {0.0, 0.0},
                                                                   {0.0, 0.0}, turn, 1.5708, roll);
                         // On the axis the distance, not the side, is what the paper's series keeps.
                         shot.scene.blur_px = 0.5;
                         shot.scene.surroundings = shot.scene.white;
                         shot.sensor.read_noise = noise;
                         return shot;
                       }});
  all.push_back(changed("light slope 0.6 %/px", [](Shot& shot, std::mt19937_64& random) {
    const double angle = uniform(random, 0.0, 6.283);
    shot.scene.white = 120.0;
    shot.scene.black = 15.0;
    shot.scene.slope = 0.006 * Vector2d(std::cos(angle), std::sin(angle));
  }));
  all.push_back(changed("gamma 2.2", [](Shot& shot, std::mt19937_64&) { shot.sensor.tone = 1.0 / 2.2; }));
  all.push_back(changed("bleed 0.05", [](Shot& shot, std::mt19937_64&) { shot.scene.bleed = 0.05; }));
  all.push_back(changed("bleed -0.04", [](Shot& shot, std::mt19937_64&) { shot.scene.bleed = -0.04; }));
  all.push_back(changed("saturated white", [](Shot& shot, std::mt19937_64&) {
    shot.scene.white = 320.0;
    shot.scene.black = 30.0;
    shot.scene.surroundings = 180.0;
  }));
  all.push_back(changed("occluder", [](Shot& shot, std::mt19937_64& random) {
    const double from = uniform(random, -3.5, 1.5);
    shot.scene.patches.push_back(beside_a_side(shot.scene, random, from, from + 2.0, 4.0 - 1.0 / 3.0, 5.5, 170.0));
  }));
  all.push_back(changed("dark neighbour", [](Shot& shot, std::mt19937_64& random) {
    shot.scene.patches.push_back(beside_a_side(shot.scene, random, -5.5, 5.5, 4.5, 6.5, 20.0));
  }));
  all.push_back(changed("shadow", [](Shot& shot, std::mt19937_64& random) {
    // Not a shadow's law (it would scale what lies under it) but a grey card over a corner.
    shot.scene.patches.push_back(beside_a_side(shot.scene, random, 2.5, 6.0, 2.5, 6.0, 90.0));
  }));
  for (const double path : {2.0, 5.0})
    all.push_back(
        changed("motion " + std::to_string(static_cast<int>(path)), [path](Shot& shot, std::mt19937_64& random) {
          const double angle = uniform(random, 0.0, 6.283);
          shot.scene.motion = path * Vector2d(std::cos(angle), std::sin(angle));
        }));
  all.push_back({"barrel 100", [](std::mt19937_64& random) { return under_barrel(random, 100.0); }});
  all.push_back({"barrel 60", [](std::mt19937_64& random) { return under_barrel(random, 60.0); }});
  for (const int quality : {90, 60})
    all.push_back(
        changed("jpeg " + std::to_string(quality), [quality](Shot& s, std::mt19937_64&) { s.jpeg = quality; }));
  all.push_back(changed("photon noise", [](Shot& shot, std::mt19937_64&) {
    shot.sensor.read_noise = 1.0;
    shot.sensor.gain = 0.08;
  }));
  all.push_back({"33 px defocused", [](std::mt19937_64& random) {
                   Shot shot = base(random, 33.0);
                   shot.scene.blur_px = 1.5;
                   return shot;
                 }});
  all.push_back({"everything, mildly", [](std::mt19937_64& random) {
                   Shot shot = under_barrel(random, 80.0);
                   shot.scene.slope = Vector2d(0.001, -0.001);
                   shot.scene.bleed = 0.02;
                   shot.scene.motion = Vector2d(1.0, 0.5);
                   shot.sensor.tone = 1.0 / 1.4;
                   return shot;
                 }});
  return all;
}

struct Options {
  int images = 12;
  int bounds = 2;
  unsigned seed = 1;
  std::string only;
};

double cpu_ms() { return 1e3 * static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

void accuracy(const Options& options) {
  std::printf("%-22s %8s %8s %6s %8s %8s %6s %6s %6s %7s  %s\n", "condition", "rms", "bound", "eff", "outward", "worst",
              "NEES", "chi2", "lost", "ms", "terms (share)");
  double pooled_error = 0.0;
  double pooled_bound = 0.0;
  int pooled = 0;
  int index = 0;
  for (const Condition& condition : conditions()) {
    ++index;
    if (condition.name.find(options.only) == std::string::npos) continue;
    std::mt19937_64 random(options.seed * 1000003ULL + static_cast<unsigned>(index));
    double squares = 0.0;
    double outward = 0.0;
    double worst = 0.0;
    double nees = 0.0;
    double chi2 = 0.0;
    double time = 0.0;
    double bound = 0.0;
    int found = 0;
    int lost = 0;
    std::map<std::string, int> terms;
    for (int i = 0; i < options.images; ++i) {
      Shot shot = condition.draw(random);
      frame_it(shot);
      shot.sensor.seed = random();
      if (i < options.bounds)
        bound += rendering::corner_information(shot.scene, shot.sensor).inverse().trace() / 8.0 / options.bounds;
      cv::Mat1b image = rendering::expose(rendering::light(shot.scene), shot.sensor);
      if (shot.jpeg > 0) {
        std::vector<unsigned char> bytes;
        cv::imencode(".jpg", image, bytes, {cv::IMWRITE_JPEG_QUALITY, shot.jpeg});
        image = cv::imdecode(bytes, cv::IMREAD_GRAYSCALE);
      }
      const Corners truth = rendering::true_corners(shot.scene);
      TagDetection coarse;
      std::normal_distribution<double> jitter(0.0, 0.15);
      coarse.corners_px = truth;
      for (Vector2d& corner : coarse.corners_px) corner += Vector2d(jitter(random), jitter(random));
      // The id is drawn inside; ask the pattern for it.
      for (coarse.id = 0; tag_pattern(family, coarse.id).cell != shot.scene.pattern.cell;) ++coarse.id;
      const double start = cpu_ms();
      const Refinement result =
          refine_photometric(image, family, coarse, {}, shot.camera ? shot.scene.camera : std::nullopt);
      time += cpu_ms() - start;
      if (const auto* why = std::get_if<Unrefined>(&result)) {
        ++lost;
        ++terms[std::string(word(*why))];
        continue;
      }
      const RefinedTag& tag = std::get<RefinedTag>(result);
      Eigen::Matrix<double, 8, 1> error;
      Vector2d centre = Vector2d::Zero();
      for (const Vector2d& corner : truth) centre += 0.25 * corner;
      for (std::size_t k = 0; k < 4; ++k) {
        const Vector2d e = tag.corners_px[k] - truth[k];
        error.segment<2>(2 * static_cast<Eigen::Index>(k)) = e;
        outward += 0.25 * e.dot((truth[k] - centre).normalized());
        worst = std::max(worst, e.norm());
      }
      squares += error.squaredNorm() / 8.0;
      nees += error.dot(tag.covariance_px2.ldlt().solve(error)) / 8.0;
      chi2 += tag.chi2_per_pixel;
      ++terms[tag.terms];
      ++found;
    }
    std::string words;
    for (const auto& [term, count] : terms) words += term + " " + std::to_string(count) + "  ";
    const double n = std::max(found, 1);
    const double rms = std::sqrt(squares / n);
    std::printf("%-22s %8.4f %8.4f %6.2f %+8.4f %8.4f %6.2f %6.2f %6d %7.2f  %s\n", condition.name.c_str(), rms,
                std::sqrt(bound), std::sqrt(bound) / rms, outward / n, worst, nees / n, chi2 / n, lost,
                time / options.images, words.c_str());
    std::fflush(stdout);
    pooled_error += squares / n;
    pooled_bound += bound;
    ++pooled;
  }
  if (pooled > 0)
    std::printf("%-22s %8.4f %8.4f %6.2f\n", "pooled", std::sqrt(pooled_error / pooled),
                std::sqrt(pooled_bound / pooled), std::sqrt(pooled_bound / pooled_error));
}

void refine_100_px(benchmark::State& state) {
  std::mt19937_64 random(17);
  std::vector<std::pair<cv::Mat1b, TagDetection>> cases;
  for (int i = 0; i < 8; ++i) {
    Shot shot = base(random, static_cast<double>(state.range(0)));
    frame_it(shot);
    shot.sensor.seed = random();
    TagDetection coarse;
    coarse.corners_px = rendering::true_corners(shot.scene);
    for (Vector2d& corner : coarse.corners_px) corner += Vector2d(0.1, -0.1);
    for (coarse.id = 0; tag_pattern(family, coarse.id).cell != shot.scene.pattern.cell;) ++coarse.id;
    cases.emplace_back(rendering::expose(rendering::light(shot.scene), shot.sensor), coarse);
  }
  std::size_t next = 0;
  for (auto _ : state) {
    const auto& [image, coarse] = cases[next++ % cases.size()];
    benchmark::DoNotOptimize(refine_photometric(image, family, coarse, {}));
  }
}
BENCHMARK(refine_100_px)->Arg(33)->Arg(60)->Arg(100)->Arg(160)->Unit(benchmark::kMillisecond);

}  // namespace
}  // namespace tagdock

int main(int argc, char** argv) {
  benchmark::Initialize(&argc, argv);
  tagdock::Options options;
  for (int i = 1; i + 1 < argc; i += 2) {
    const std::string name = argv[i];
    if (name == "--images") options.images = std::atoi(argv[i + 1]);
    if (name == "--bounds") options.bounds = std::atoi(argv[i + 1]);
    if (name == "--seed") options.seed = static_cast<unsigned>(std::atoi(argv[i + 1]));
    if (name == "--only") options.only = argv[i + 1];
  }
  if (options.images > 0) tagdock::accuracy(options);
  benchmark::RunSpecifiedBenchmarks();
}
