// Accuracy, honesty and CPU time of all corner methods on the same freshly rendered images, condition by condition,
// against the Cramer-Rao bound of the same images; a tracked frame against a searched one; the photograph of
// visp-images-data against one plane and one camera.
//   detection_bench accuracy [--images 12] [--bounds 2] [--seed 1] [--only WORD] [--methods best,tanh] [--output DIR]
//   detection_bench frame | joint | photograph
// Conditions "foreign ..." are made by another renderer or with a tone curve, a defocus or a coding that the model does
// not know. `joint` compares a board's pose from corners with that from all pixels. `accuracy` writes DIR/accuracy.csv
// and plots of the error over size, tilt, noise and blur.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iostream>
#include <map>
#include <memory>
#include <numbers>
#include <random>
#include <string>
#include <vector>

#include <Eigen/LU>
#include <opencv2/aruco.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <visp3/detection/vpDetectorAprilTag.h>
#include <visp3/mbt/vpMbGenericTracker.h>

#include "app/svg.h"
#include "calibration/rig.h"
#include "detection/tag_locator.h"
#include "detection/tag_pattern.h"
#include "planning/pose2.h"
#include "tests/detection/scene_rendering.h"
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
  bool camera = false;                   ///< the estimator knows the lens
  int jpeg = 0;                          ///< quality, 0 for none
  int rays = 0;                          ///< if given, the image is traced with so many rays a pixel and direction
  double disc_px = 0.0;                  ///< radius of the circle of confusion of those
  rendering::ToneCurve curve = nullptr;  ///< in the place of the sensor's power
  double focal_px = 1000.0;
  Vector2d principal = Vector2d::Zero();

  /// The camera that the pose is sought with.
  [[nodiscard]] CameraModel pinhole() const {
    if (scene.camera) return *scene.camera;
    CameraModel model;
    model.width = scene.width;
    model.height = scene.height;
    model.fx = model.fy = focal_px;
    model.cx = principal.x();
    model.cy = principal.y();
    return model;
  }
};

double uniform(std::mt19937_64& random, double low, double high) {
  return std::uniform_real_distribution<double>(low, high)(random);
}

/// The base condition: 100 px, tilt 30 degrees, blur 0.7, contrast 160, noise 2, anything else random.
Shot base(std::mt19937_64& random, double side_px = 100.0, double tilt_deg = 30.0, double focal_px = 1000.0) {
  Shot shot;
  shot.focal_px = focal_px;
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
  shot.principal -= shift;
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
                         shot.focal_px = 1400.0;
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
  all.push_back({"everything mildly", [](std::mt19937_64& random) {
                   Shot shot = under_barrel(random, 80.0);
                   shot.scene.slope = Vector2d(0.001, -0.001);
                   shot.scene.bleed = 0.02;
                   shot.scene.motion = Vector2d(1.0, 0.5);
                   shot.sensor.tone = 1.0 / 1.4;
                   return shot;
                 }});
  all.push_back(changed("foreign sRGB", [](Shot& shot, std::mt19937_64&) { shot.curve = rendering::srgb; }));
  all.push_back(changed("foreign Rec. 709", [](Shot& shot, std::mt19937_64&) { shot.curve = rendering::rec709; }));
  all.push_back({"foreign Rec. 709 40 px", [](std::mt19937_64& random) {
                   Shot shot = base(random, 40.0);
                   shot.curve = rendering::rec709;
                   return shot;
                 }});
  all.push_back(changed("foreign sRGB jpeg 90", [](Shot& shot, std::mt19937_64&) {
    shot.curve = rendering::srgb;
    shot.jpeg = 90;
  }));
  all.push_back(changed("foreign 4x4 points", [](Shot& shot, std::mt19937_64&) {
    shot.rays = 4;
    shot.scene.blur_px = 0.3;  // of the bound: the sharpest that it can be computed for
    shot.sensor.read_noise = 1.0;
  }));
  for (const double radius : {1.0, 2.0, 3.0})
    all.push_back(
        changed("foreign disc " + std::to_string(static_cast<int>(radius)), [radius](Shot& shot, std::mt19937_64&) {
          shot.rays = 16;
          shot.disc_px = radius;
          shot.scene.blur_px = 0.5 * radius;  // of the bound: as wide a Gaussian
        }));
  return all;
}

double cpu_ms() {
  std::timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

struct Options {
  std::string what = "accuracy";
  int images = 12;
  int bounds = 2;
  unsigned seed = 1;
  std::string only;
  std::string methods;
  std::string output;
};

/// An image with what all methods may know of it.
struct Example {
  cv::Mat1b gray;
  Corners truth;
  int id = 0;
  std::optional<CameraModel> camera;
  CameraModel pinhole;                    ///< to seek the pose with
  Eigen::Vector3d normal;                 ///< of the tag, into the wall, in the camera frame
  Eigen::Matrix<double, 8, 8> bound_px2;  ///< of the corners
  std::vector<TagDetection> found;        ///< by AprilTag 3, decimate 1
};

struct Answer {
  Corners corners_px;
  std::optional<Eigen::Matrix<double, 8, 8>> covariance_px2;
  double chi2 = 0.0;
  std::string terms;
  double ms = 0.0;
};

/// A method: corners of the tag with that id, or none.
struct Method {
  std::string name;
  std::function<std::optional<Answer>(const Example&)> look;
};

const TagDetection* with_id(const std::vector<TagDetection>& found, int id) {
  for (const TagDetection& detection : found)
    if (detection.id == id) return &detection;
  return nullptr;
}

Method detector_method(const std::string& name, int decimate) {
  TagDetectorConfig config;
  config.decimate = decimate;
  const auto detector = std::make_shared<TagDetector>(config);
  return {name, [detector](const Example& example) -> std::optional<Answer> {
            const double start = cpu_ms();
            const auto found = detector->detect(example.gray);
            const double ms = cpu_ms() - start;
            const TagDetection* const tag = with_id(found, example.id);
            if (tag == nullptr) return std::nullopt;
            return Answer{tag->corners_px, std::nullopt, 0.0, "", ms};
          }};
}

Method refining(CornerMethod method) {
  return {std::string(word(method)), [method](const Example& example) -> std::optional<Answer> {
            const TagDetection* const tag = with_id(example.found, example.id);
            if (tag == nullptr) return std::nullopt;
            const double start = cpu_ms();
            const Refinement result = refine(example.gray, family, *tag, method, example.camera);
            const double ms = cpu_ms() - start;
            const RefinedTag* const refined = std::get_if<RefinedTag>(&result);
            if (refined == nullptr) return std::nullopt;
            return Answer{refined->corners_px, refined->covariance_px2, refined->chi2_per_pixel, refined->terms, ms};
          }};
}

Method aruco(const std::string& name, int refinement) {
  return {name, [refinement](const Example& example) -> std::optional<Answer> {
            const double start = cpu_ms();
            const auto dictionary = cv::aruco::getPredefinedDictionary(cv::aruco::DICT_APRILTAG_36h11);
            const auto parameters = cv::aruco::DetectorParameters::create();
            parameters->cornerRefinementMethod = refinement;
            std::vector<std::vector<cv::Point2f>> corners;
            std::vector<int> ids;
            cv::aruco::detectMarkers(example.gray, dictionary, corners, ids, parameters);
            const double ms = cpu_ms() - start;
            for (std::size_t i = 0; i < ids.size(); ++i) {
              if (ids[i] != example.id) continue;
              // The dictionary is printed turned by half a turn against AprilTag's own.
              Answer answer;
              for (std::size_t k = 0; k < 4; ++k) {
                const cv::Point2f& p = corners[i][(k + 2) % 4];
                answer.corners_px[k] = {p.x, p.y};
              }
              answer.ms = ms;
              return answer;
            }
            return std::nullopt;
          }};
}

std::vector<Method> all_methods() {
  std::vector<Method> methods = {detector_method("apriltag d1", 1), detector_method("apriltag d2", 2)};
  methods.push_back({"cornerSubPix", [](const Example& example) -> std::optional<Answer> {
                       const TagDetection* const tag = with_id(example.found, example.id);
                       if (tag == nullptr) return std::nullopt;
                       std::vector<cv::Point2f> points;
                       for (const Vector2d& p : tag->corners_px)
                         points.emplace_back(static_cast<float>(p.x()), static_cast<float>(p.y()));
                       const double start = cpu_ms();
                       cv::cornerSubPix(example.gray, points, {3, 3}, {-1, -1},
                                        {cv::TermCriteria::COUNT | cv::TermCriteria::EPS, 40, 1e-3});
                       Answer answer;
                       answer.ms = cpu_ms() - start;
                       for (std::size_t k = 0; k < 4; ++k) answer.corners_px[k] = {points[k].x, points[k].y};
                       return answer;
                     }});
  methods.push_back({"ViSP", [](const Example& example) -> std::optional<Answer> {
                       vpDetectorAprilTag detector(vpDetectorAprilTag::TAG_36h11);
                       vpImage<unsigned char> image(static_cast<unsigned>(example.gray.rows),
                                                    static_cast<unsigned>(example.gray.cols));
                       for (int row = 0; row < example.gray.rows; ++row)
                         std::copy_n(example.gray[row], example.gray.cols, image[static_cast<unsigned>(row)]);
                       const double start = cpu_ms();
                       detector.detect(image);
                       const double ms = cpu_ms() - start;
                       const std::vector<int> ids = detector.getTagsId();
                       for (std::size_t i = 0; i < ids.size(); ++i) {
                         if (ids[i] != example.id) continue;
                         Answer answer;
                         // Bottom left first and counter-clockwise; AprilTag's half pixel is still in them.
                         for (std::size_t k = 0; k < 4; ++k) {
                           const vpImagePoint& p = detector.getPolygon(i)[3 - k];
                           answer.corners_px[k] = {p.get_u(), p.get_v()};
                         }
                         answer.ms = ms;
                         return answer;
                       }
                       return std::nullopt;
                     }});
  methods.push_back(aruco("aruco NONE", cv::aruco::CORNER_REFINE_NONE));
  methods.push_back(aruco("aruco SUBPIX", cv::aruco::CORNER_REFINE_SUBPIX));
  methods.push_back(aruco("aruco CONTOUR", cv::aruco::CORNER_REFINE_CONTOUR));
  methods.push_back(aruco("aruco APRILTAG", cv::aruco::CORNER_REFINE_APRILTAG));
  for (const CornerMethod method : {CornerMethod::tanh, CornerMethod::filter, CornerMethod::erf, CornerMethod::best})
    methods.push_back(refining(method));
  return methods;
}

/// The tag's normal by its true homography.
Eigen::Vector3d true_normal(const Eigen::Matrix3d& image_by_tag, const CameraModel& camera) {
  Eigen::Matrix3d K;
  K << camera.fx, 0.0, camera.cx, 0.0, camera.fy, camera.cy, 0.0, 0.0, 1.0;
  const Eigen::Matrix3d axes = K.inverse() * image_by_tag;
  return axes.col(0).cross(axes.col(1)).normalized();
}

/// Is the likelier pose another one: its normal off by more than 2 degrees and 8 times what the bound of the corners
/// makes of it, or none at all (notes on detection, section 4)?
bool flipped(const Answer& answer, const Example& example) {
  constexpr double size = 0.16;
  RefinedTag truth;
  truth.corners_px = example.truth;
  truth.covariance_px2 = example.bound_px2;
  double allowed = 0.0;
  for (const TagPose& pose : tag_poses(truth, size, example.pinhole))
    if (pose.T_camera_tag.linear().col(2).dot(example.normal) > std::cos(1e-3))
      allowed = 8.0 * std::sqrt(pose.covariance.bottomRightCorner<3, 3>().trace());
  RefinedTag seen;
  seen.corners_px = answer.corners_px;
  seen.covariance_px2 = answer.covariance_px2.value_or(0.01 * Eigen::Matrix<double, 8, 8>::Identity());
  const std::vector<TagPose> poses = tag_poses(seen, size, example.pinhole);
  if (poses.empty()) return true;
  const double cosine = std::clamp(poses.front().T_camera_tag.linear().col(2).dot(example.normal), -1.0, 1.0);
  return std::acos(cosine) > std::max(radians(2.0), allowed);
}

/// What one method did under one condition.
struct Score {
  double squares = 0.0;  ///< of coordinates, gross ones left out
  double outward = 0.0;
  double worst = 0.0;
  double nees = 0.0;
  double chi2 = 0.0;
  int found = 0, gross = 0, with_covariance = 0, flips = 0;
  std::vector<double> ms;
  std::map<std::string, int> terms;

  void add(const Answer& answer, const Corners& truth) {
    Eigen::Matrix<double, 8, 1> error;
    Vector2d centre = Vector2d::Zero();
    double side = 0.0;
    for (std::size_t k = 0; k < 4; ++k) {
      centre += 0.25 * truth[k];
      side += 0.25 * (truth[(k + 1) % 4] - truth[k]).norm();
    }
    double out = 0.0;
    double most = 0.0;
    for (std::size_t k = 0; k < 4; ++k) {
      const Vector2d e = answer.corners_px[k] - truth[k];
      error.segment<2>(2 * static_cast<Eigen::Index>(k)) = e;
      out += 0.25 * e.dot((truth[k] - centre).normalized());
      most = std::max(most, e.norm());
    }
    ms.push_back(answer.ms);
    ++found;
    if (most > std::max(2.0, 0.03 * side)) {
      ++gross;
      return;
    }
    worst = std::max(worst, most);
    outward += out;
    squares += error.squaredNorm() / 8.0;
    chi2 += answer.chi2;
    ++terms[answer.terms];
    if (!answer.covariance_px2) return;
    nees += error.dot(answer.covariance_px2->ldlt().solve(error)) / 8.0;
    ++with_covariance;
  }
  [[nodiscard]] int fine() const { return std::max(1, found - gross); }
  [[nodiscard]] double rms() const { return std::sqrt(squares / fine()); }
  [[nodiscard]] double median_ms() const {
    if (ms.empty()) return 0.0;
    std::vector<double> sorted = ms;
    std::nth_element(sorted.begin(), sorted.begin() + static_cast<std::ptrdiff_t>(sorted.size() / 2), sorted.end());
    return sorted[sorted.size() / 2];
  }
};

/// The error of each method over one quantity, from the conditions "NAME VALUE" and the base.
void plot(const std::string& file, const std::string& name, double at_base, const std::vector<Method>& methods,
          const std::map<std::string, std::vector<Score>>& scores, const std::map<std::string, double>& bounds) {
  const std::array<const char*, 6> colours = {"#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377"};
  std::vector<std::pair<double, std::string>> places;
  for (const auto& [condition, all] : scores)
    if (condition.rfind(name + " ", 0) == 0) places.emplace_back(std::atof(condition.c_str() + name.size()), condition);
  if (scores.contains("base")) places.emplace_back(at_base, "base");
  std::sort(places.begin(), places.end());
  if (places.size() < 2) return;
  std::vector<Curve> curves;
  Curve bound{{}, "stroke:#000;stroke-dasharray:4 3", "bound"};
  for (const auto& [value, condition] : places)
    bound.points.emplace_back(value, std::log10(std::max(bounds.at(condition), 1e-5)));
  curves.push_back(bound);
  std::size_t colour = 0;
  for (std::size_t m = 0; m < methods.size(); ++m) {
    const std::string& method = methods[m].name;
    if (method != "apriltag d1" && method != "cornerSubPix" && method != "aruco SUBPIX" && method != "tanh" &&
        method != "erf" && method != "best")
      continue;
    Curve curve{{}, std::string("stroke-width:2;stroke:") + colours[colour++ % colours.size()], method};
    for (const auto& [value, condition] : places)
      if (const Score& score = scores.at(condition)[m]; score.found > score.gross)
        curve.points.emplace_back(value, std::log10(std::max(score.rms(), 1e-5)));
    curves.push_back(curve);
  }
  Svg svg(820, 420);
  draw_diagram(svg, {0, 0}, 820, 420, "", "log10 of the rms corner error [px] over " + name, "", curves);
  std::ofstream(file) << svg.text();
}

void accuracy(const Options& options) {
  std::vector<Method> methods;
  for (Method& method : all_methods())
    if (options.methods.empty() || ("," + options.methods + ",").find("," + method.name + ",") != std::string::npos)
      methods.push_back(std::move(method));
  if (methods.empty()) {
    std::printf("no such method: %s\n", options.methods.c_str());
    return;
  }
  const TagDetector finder([] {
    TagDetectorConfig config;
    config.decimate = 1;
    return config;
  }());
  std::map<std::string, std::vector<Score>> scores;
  std::map<std::string, double> bounds;
  std::ofstream csv;
  if (!options.output.empty()) {
    std::filesystem::create_directories(options.output);
    csv.open(options.output + "/accuracy.csv");
    csv << "condition,method,images,found,gross,rms_px,bound_px,efficiency,outward_px,worst_px,nees,chi2,median_ms,"
           "flips\n";
  }
  std::printf("rms corner error per coordinate [px]; efficiency = bound / rms; NEES per coordinate; ms: median CPU\n");
  std::printf("%-22s %8s", "condition", "bound");
  for (const Method& method : methods) std::printf(" %14s", method.name.c_str());
  std::printf("  %5s %5s %5s %6s %6s %5s  terms of %s\n", "eff", "NEES", "chi2", "ms", "/tanh", "flips",
              methods.back().name.c_str());
  std::vector<int> flips(methods.size(), 0);
  int shots = 0;
  double pooled_error = 0.0;
  double pooled_bound = 0.0;
  int index = 0;
  for (const Condition& condition : conditions()) {
    ++index;
    if (condition.name.find(options.only) == std::string::npos) continue;
    std::mt19937_64 random(options.seed * 1000003ULL + static_cast<unsigned>(index));
    std::vector<Score>& all = scores[condition.name];
    all.resize(methods.size());
    double bound = 0.0;
    Eigen::Matrix<double, 8, 8> bound_px2 = Eigen::Matrix<double, 8, 8>::Identity();
    for (int i = 0; i < options.images; ++i) {
      Shot shot = condition.draw(random);
      frame_it(shot);
      shot.sensor.seed = random();
      if (i < options.bounds) {
        bound_px2 = rendering::corner_information(shot.scene, shot.sensor, shot.curve).inverse();
        bound += bound_px2.trace() / 8.0 / options.bounds;
      }
      Example example;
      example.bound_px2 = bound_px2;
      example.pinhole = shot.pinhole();
      example.normal = true_normal(shot.scene.image_by_tag, example.pinhole);
      example.gray = rendering::expose(
          shot.rays > 0 ? rendering::traced_light(shot.scene, shot.rays, shot.disc_px, shot.sensor.seed + 1)
                        : rendering::light(shot.scene),
          shot.sensor, shot.curve);
      if (shot.jpeg > 0) {
        std::vector<unsigned char> bytes;
        cv::imencode(".jpg", example.gray, bytes, {cv::IMWRITE_JPEG_QUALITY, shot.jpeg});
        example.gray = cv::imdecode(bytes, cv::IMREAD_GRAYSCALE);
      }
      example.truth = rendering::true_corners(shot.scene);
      for (example.id = 0; tag_pattern(family, example.id).cell != shot.scene.pattern.cell;) ++example.id;
      if (shot.camera) example.camera = shot.scene.camera;
      example.found = finder.detect(example.gray);
      for (std::size_t m = 0; m < methods.size(); ++m)
        if (const auto answer = methods[m].look(example)) {
          all[m].add(*answer, example.truth);
          all[m].flips += flipped(*answer, example) ? 1 : 0;
        }
      ++shots;
    }
    bounds[condition.name] = std::sqrt(bound);
    const Score& best = all.back();
    const auto by_tanh = std::find_if(methods.begin(), methods.end(), [](const Method& m) { return m.name == "tanh"; });
    const double tanh_ms =
        by_tanh == methods.end() ? 0.0 : all[static_cast<std::size_t>(by_tanh - methods.begin())].median_ms();
    for (std::size_t m = 0; m < methods.size(); ++m) flips[m] += all[m].flips;
    std::string words;
    for (const auto& [term, count] : best.terms) words += term + " " + std::to_string(count) + "  ";
    std::printf("%-22s %8.4f", condition.name.c_str(), std::sqrt(bound));
    for (std::size_t m = 0; m < methods.size(); ++m) {
      const Score& score = all[m];
      std::string more;
      if (score.found < options.images) more += "-" + std::to_string(options.images - score.found);
      if (score.gross > 0) more += "!" + std::to_string(score.gross);
      std::printf(" %8.4f%-6s", score.rms(), more.c_str());
      if (csv.is_open())
        csv << condition.name << ',' << methods[m].name << ',' << options.images << ',' << score.found << ','
            << score.gross << ',' << score.rms() << ',' << std::sqrt(bound) << ',' << std::sqrt(bound) / score.rms()
            << ',' << score.outward / score.fine() << ',' << score.worst << ','
            << score.nees / std::max(1, score.with_covariance) << ',' << score.chi2 / score.fine() << ','
            << score.median_ms() << ',' << score.flips << '\n';
    }
    std::printf("  %5.2f %5.2f %5.2f %6.2f %6.2f %5d  %s\n", std::sqrt(bound) / best.rms(),
                best.nees / std::max(1, best.with_covariance), best.chi2 / best.fine(), best.median_ms(),
                tanh_ms > 0.0 ? best.median_ms() / tanh_ms : 0.0, best.flips, words.c_str());
    std::fflush(stdout);
    // The bound knows the renderer, so what is foreign to the model is no part of its efficiency.
    if (condition.name.rfind("foreign", 0) == 0) continue;
    pooled_error += best.squares / best.fine();
    pooled_bound += bound;
  }
  std::printf("after a number: -n tags missed, !n off by more than 2 px or 3 %% of the side and left out\n");
  if (pooled_error > 0.0)
    std::printf("%s, all but foreign ones pooled: efficiency %.2f\n", methods.back().name.c_str(),
                std::sqrt(pooled_bound / pooled_error));
  std::printf("poses flipped (the likelier one's normal off by more than 2 degrees and 8 bounds), of %d images:",
              shots);
  for (std::size_t m = 0; m < methods.size(); ++m) std::printf("  %s %d", methods[m].name.c_str(), flips[m]);
  std::printf("\n");
  if (options.output.empty()) return;
  plot(options.output + "/over_side.svg", "side", 100.0, methods, scores, bounds);
  plot(options.output + "/over_tilt.svg", "tilt", 30.0, methods, scores, bounds);
  plot(options.output + "/over_noise.svg", "noise", 2.0, methods, scores, bounds);
  plot(options.output + "/over_blur.svg", "blur", 0.7, methods, scores, bounds);
}

// ---- a tracked frame -----------------------------------------------------------------------------------------------

double median(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  return values.empty() ? 0.0 : values[values.size() / 2];
}

vpHomogeneousMatrix in_visp(const Eigen::Isometry3d& T) {
  vpHomogeneousMatrix M;
  for (unsigned row = 0; row < 3; ++row)
    for (unsigned column = 0; column < 4; ++column) M[row][column] = T(row, column);
  return M;
}

/// The default board's three tags on a 1280x1024 frame, the camera a few centimetres on from the pose that is known.
void frame() {
  const Rig rig = default_rig();
  const Board board = default_board(0.35);
  TagLocatorConfig config;
  const TagLocator locator(rig, board, config);
  config.follow = false;
  const TagLocator searching(rig, board, config);
  TagDetectorConfig whole;
  whole.decimate = 1;
  const TagDetector apriltag(whole);
  const std::string model = (std::filesystem::temp_directory_path() / "tagdock_bench_board.cao").string();
  {
    std::ofstream cao(model);
    cao << "V1\n" << 4 * board.tags.size() << "\n";
    for (const BoardTag& tag : board.tags)
      for (const Eigen::Vector3d& corner : corners_station(tag))
        cao << corner.x() << " " << corner.y() << " " << corner.z() << "\n";
    cao << "0\n0\n" << board.tags.size() << "\n";
    // Counter-clockwise as seen from the front.
    for (std::size_t i = 0; i < board.tags.size(); ++i)
      cao << "4 " << 4 * i + 3 << " " << 4 * i + 2 << " " << 4 * i + 1 << " " << 4 * i << "\n";
    cao << "0\n0\n";
  }
  vpMbGenericTracker tracker(1, vpMbGenericTracker::EDGE_TRACKER);
  vpMe me;
  me.setMaskSize(5);
  me.setMaskNumber(180);
  me.setRange(9);
  me.setThreshold(5000);
  me.setMu1(0.5);
  me.setMu2(0.5);
  me.setSampleStep(3);
  tracker.setMovingEdge(me);
  vpCameraParameters camera;
  camera.initPersProjWithoutDistortion(rig.camera.fx, rig.camera.fy, rig.camera.cx, rig.camera.cy);
  tracker.setCameraParameters(camera);
  tracker.loadModel(model);
  std::mt19937_64 random(5);
  std::uniform_real_distribution<double> unit(-1.0, 1.0);
  std::vector<double> tracked_ms, searched_ms, apriltag_ms, mbt_ms, ratios;
  double tracked_squares = 0.0, searched_squares = 0.0, mbt_squares = 0.0;
  int tracked = 0, frames = 0, mbt = 0;
  for (; frames < 12; ++frames) {
    const auto pose_at = [&](double x, double y, double yaw) {
      Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
      T.translation() << x, y, 0.0;
      T.linear() = Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
      return Eigen::Isometry3d((T * rig.T_base_camera).inverse());
    };
    const double x = -2.6 + 0.5 * unit(random);
    const double y = 0.15 * unit(random);
    const double yaw = radians(4.0) * unit(random);
    const Eigen::Isometry3d truth = pose_at(x, y, yaw);
    const Eigen::Isometry3d predicted =
        pose_at(x - 0.01 * unit(random), y + 0.003 * unit(random), yaw + radians(0.2) * unit(random));
    cv::Mat1d grey(rig.camera.height, rig.camera.width, 120.0);
    for (const BoardTag& tag : board.tags) {
      testing::Scene scene;
      scene.camera = rig.camera;
      scene.family = board.family;
      scene.id = tag.id;
      scene.size = tag.size;
      scene.T_camera_tag = truth * tag.T_station_tag;
      testing::render_into(grey, scene);
    }
    const Frame image{testing::digitised(grey, 2.0, random), std::chrono::milliseconds(40), 1};
    const auto off = [&](const Eigen::Isometry3d& T) {
      return (T.inverse().translation() - truth.inverse().translation()).squaredNorm();
    };
    double start = cpu_ms();
    (void)apriltag.detect(image.gray);
    apriltag_ms.push_back(cpu_ms() - start);
    start = cpu_ms();
    const Sighting followed = locator.locate(image, predicted);
    tracked_ms.push_back(cpu_ms() - start);
    ratios.push_back(tracked_ms.back() / apriltag_ms.back());
    if (const auto* seen = std::get_if<BoardSighting>(&followed)) {
      tracked += seen->followed ? 1 : 0;
      tracked_squares += off(seen->T_camera_station);
    }
    start = cpu_ms();
    const Sighting searched = searching.locate(image, predicted);
    searched_ms.push_back(cpu_ms() - start);
    if (const auto* seen = std::get_if<BoardSighting>(&searched)) searched_squares += off(seen->T_camera_station);
    try {
      vpImage<unsigned char> visp(static_cast<unsigned>(image.gray.rows), static_cast<unsigned>(image.gray.cols));
      for (int row = 0; row < image.gray.rows; ++row)
        std::copy_n(image.gray[row], image.gray.cols, visp[static_cast<unsigned>(row)]);
      tracker.initFromPose(visp, in_visp(predicted));
      start = cpu_ms();
      tracker.track(visp);
      mbt_ms.push_back(cpu_ms() - start);
      const vpHomogeneousMatrix M = tracker.getPose();
      Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
      for (unsigned row = 0; row < 3; ++row)
        for (unsigned column = 0; column < 4; ++column) T(row, column) = M[row][column];
      mbt_squares += off(T);
      ++mbt;
    } catch (const vpException& error) {
      std::printf("vpMbGenericTracker: %s\n", error.what());
    }
  }
  std::filesystem::remove(model);
  const auto mm = [](double squares, int count) { return 1e3 * std::sqrt(squares / std::max(1, count)); };
  std::printf("1280x1024, three tags, %d frames; CPU median [ms], rms of the lens' position [mm]\n", frames);
  std::printf("AprilTag 3, decimate 1, whole frame  %7.2f\n", median(apriltag_ms));
  std::printf("followed, refined, pose              %7.2f  %6.3f   followed %d, ratio to AprilTag %.3f\n",
              median(tracked_ms), mm(tracked_squares, frames), tracked, median(ratios));
  std::printf("region searched, refined, pose       %7.2f  %6.3f\n", median(searched_ms), mm(searched_squares, frames));
  std::printf("vpMbGenericTracker, edges            %7.2f  %6.3f   %d frames\n", median(mbt_ms), mm(mbt_squares, mbt),
              mbt);
}

// ---- a board's pose from corners and from pixels -------------------------------------------------------------------

/// The default V board from near and far; roll, pitch and height of the robot as the prior has them.
void joint(int images, unsigned seed) {
  const Rig rig = default_rig();
  const Board board = default_board(0.35);
  TagLocatorConfig config;
  const TagLocator corners(rig, board, config);
  config.joint = true;
  const TagLocator pixels(rig, board, config);
  std::printf(
      "pose of the V board, %d frames a range; rms of the lens' position [mm] and of its turning [deg], mean\n"
      "squared normalised error per coordinate, CPU median [ms] with prediction\n",
      images);
  for (const double range : {0.6, 1.0, 2.0}) {
    std::mt19937_64 random(seed * 7919ULL + static_cast<unsigned>(10.0 * range));
    std::normal_distribution<double> normal;
    struct Sum {
      double position = 0.0, turn = 0.0, nees = 0.0;
      int count = 0, tags = 0;
      std::vector<double> ms;
      std::map<std::string, int> sources;
    };
    std::array<Sum, 2> sums;
    std::vector<double> ratios;
    for (int i = 0; i < images; ++i) {
      Eigen::Isometry3d T_station_base = Eigen::Isometry3d::Identity();
      T_station_base.translation() << -range - uniform(random, 0.3, 0.4), uniform(random, -0.05, 0.05) * range,
          1e-3 * config.sigma_height_mm * normal(random);
      T_station_base.linear() =
          (Eigen::AngleAxisd(radians(uniform(random, -4.0, 4.0)), Eigen::Vector3d::UnitZ()) *
           Eigen::AngleAxisd(radians(config.sigma_pitch_deg) * normal(random), Eigen::Vector3d::UnitY()) *
           Eigen::AngleAxisd(radians(config.sigma_roll_deg) * normal(random), Eigen::Vector3d::UnitX()))
              .toRotationMatrix();
      const Eigen::Isometry3d truth = (T_station_base * rig.T_base_camera).inverse();
      cv::Mat1d grey(rig.camera.height, rig.camera.width, 120.0);
      for (const BoardTag& tag : board.tags) {
        testing::Scene scene;
        scene.camera = rig.camera;
        scene.family = board.family;
        scene.id = tag.id;
        scene.size = tag.size;
        scene.T_camera_tag = truth * tag.T_station_tag;
        testing::render_into(grey, scene);
      }
      const Frame frame{testing::digitised(grey, 2.0, random), std::chrono::milliseconds(40), 1};
      for (std::size_t k = 0; k < 2; ++k) {
        const double start = cpu_ms();
        const Sighting sighting = (k == 0 ? corners : pixels).locate(frame, truth);
        sums[k].ms.push_back(cpu_ms() - start);
        const auto* seen = std::get_if<BoardSighting>(&sighting);
        if (seen == nullptr) continue;
        ++sums[k].sources[std::string(word(seen->source))];
        const Eigen::Isometry3d off = seen->T_camera_station * truth.inverse();
        const Eigen::AngleAxisd turn(off.linear());
        Eigen::Matrix<double, 6, 1> error;
        error << off.translation(), turn.angle() * turn.axis();
        sums[k].position +=
            (seen->T_camera_station.inverse().translation() - truth.inverse().translation()).squaredNorm();
        sums[k].turn += turn.angle() * turn.angle();
        sums[k].nees += error.dot(seen->covariance.ldlt().solve(error)) / 6.0;
        sums[k].tags += static_cast<int>(seen->tags.size());
        ++sums[k].count;
      }
      ratios.push_back(sums[1].ms.back() / sums[0].ms.back());
    }
    for (std::size_t k = 0; k < 2; ++k) {
      const Sum& sum = sums[k];
      const double n = std::max(1, sum.count);
      std::printf("%.1f m  %-7s %7.4f mm  %8.5f deg  NEES %5.2f  %6.2f ms  seen %d, tags %.1f ", range,
                  k == 0 ? "corners" : "pixels", 1e3 * std::sqrt(sum.position / n),
                  std::sqrt(sum.turn / n) * 180.0 / std::numbers::pi, sum.nees / n, median(sum.ms), sum.count,
                  sum.tags / n);
      for (const auto& [source, count] : sum.sources) std::printf(" %s %d", source.c_str(), count);
      std::printf("\n");
    }
    std::printf("       ratio of CPU time, median %.2f\n", median(ratios));
    std::fflush(stdout);
  }
}

// ---- the photograph ------------------------------------------------------------------------------------------------

/// One plane and one camera for equal squares lying anywhere on the plane: homography of the plane (8), radial
/// distortion (2, about the image's centre), and each square's place and turn (3); the first one is the plane's frame.
/// Levenberg-Marquardt with numeric derivatives over all corners.
struct PlaneModel {
  static constexpr int shared = 10;
  std::vector<Corners> seen;
  Vector2d middle;
  double scale;

  [[nodiscard]] Vector2d predict(const Eigen::VectorXd& p, std::size_t square, std::size_t corner) const {
    static const std::array<Vector2d, 4> unit = {Vector2d(-0.5, -0.5), Vector2d(0.5, -0.5), Vector2d(0.5, 0.5),
                                                 Vector2d(-0.5, 0.5)};
    Vector2d place = unit[corner];
    if (square > 0) {
      const Eigen::Index k = shared + 3 * (static_cast<Eigen::Index>(square) - 1);
      place = Eigen::Rotation2Dd(p[k + 2]) * place + Vector2d(p[k], p[k + 1]);
    }
    Eigen::Matrix3d H;
    H << p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7], 1.0;
    const Vector2d ideal = (H * place.homogeneous()).hnormalized();
    const Vector2d from = (ideal - middle) / scale;
    const double r2 = from.squaredNorm();
    return ideal + (ideal - middle) * (p[8] * r2 + p[9] * r2 * r2);
  }

  [[nodiscard]] Eigen::VectorXd residuals(const Eigen::VectorXd& p) const {
    Eigen::VectorXd r(8 * static_cast<Eigen::Index>(seen.size()));
    for (std::size_t s = 0; s < seen.size(); ++s)
      for (std::size_t k = 0; k < 4; ++k)
        r.segment<2>(static_cast<Eigen::Index>(8 * s + 2 * k)) = predict(p, s, k) - seen[s][k];
    return r;
  }

  /// @param held  parameters below this index stay
  Eigen::VectorXd fit(Eigen::VectorXd p, Eigen::Index held = 0) const {
    double lambda = 1e-3;
    Eigen::VectorXd r = residuals(p);
    for (int step = 0; step < 200; ++step) {
      Eigen::MatrixXd J(r.size(), p.size() - held);
      for (Eigen::Index i = held; i < p.size(); ++i) {
        Eigen::VectorXd up = p;
        const double h = 1e-6 * std::max(1.0, std::abs(p[i]));
        up[i] += h;
        J.col(i - held) = (residuals(up) - r) / h;
      }
      Eigen::MatrixXd A = J.transpose() * J;
      A.diagonal() *= 1.0 + lambda;
      Eigen::VectorXd next = p;
      next.tail(p.size() - held) -= A.ldlt().solve(J.transpose() * r);
      const Eigen::VectorXd after = residuals(next);
      if (after.squaredNorm() < r.squaredNorm()) {
        const bool settled = r.squaredNorm() - after.squaredNorm() < 1e-10 * r.squaredNorm();
        p = next;
        r = after;
        lambda *= 0.2;
        if (settled) break;
      } else {
        lambda *= 8.0;
        if (lambda > 1e12) break;
      }
    }
    return p;
  }

  /// From the first square's corners, and each other square's place in that frame.
  [[nodiscard]] Eigen::VectorXd start() const {
    Eigen::VectorXd p = Eigen::VectorXd::Zero(shared + 3 * (static_cast<Eigen::Index>(seen.size()) - 1));
    TagPattern unit_square;
    unit_square.cells = unit_square.border_cells = 1;
    const Eigen::Matrix3d H = rendering::image_by_corners(unit_square, seen[0]);
    for (int i = 0; i < 8; ++i) p[i] = H(i / 3, i % 3);
    const Eigen::Matrix3d back = H.inverse();
    for (std::size_t s = 1; s < seen.size(); ++s) {
      Vector2d centre = Vector2d::Zero();
      std::array<Vector2d, 4> on_plane;
      for (std::size_t k = 0; k < 4; ++k) {
        on_plane[k] = (back * seen[s][k].homogeneous()).hnormalized();
        centre += 0.25 * on_plane[k];
      }
      const Vector2d side = on_plane[1] - on_plane[0];
      p.segment<3>(shared + 3 * (static_cast<Eigen::Index>(s) - 1)) << centre.x(), centre.y(),
          std::atan2(side.y(), side.x());
    }
    return p;
  }
};

void photograph() {
  const char* const file = "/usr/share/visp-images-data/ViSP-images/AprilTag/AprilTag.pgm";
  const cv::Mat1b gray = cv::imread(file, cv::IMREAD_GRAYSCALE);
  if (gray.empty()) {
    std::printf("%s is missing: apt install visp-images-data\n", file);
    return;
  }
  TagDetectorConfig config;
  config.decimate = 1;
  const auto found = TagDetector(config).detect(gray);
  std::printf(
      "%zu equal squares on one plane: rms of all corners against one plane and camera, and with each square\n"
      "left out of the plane and the camera [px per coordinate]\n",
      found.size());
  std::map<CornerMethod, std::pair<double, double>> rms;
  std::map<CornerMethod, Eigen::VectorXd> residuals;
  std::map<CornerMethod, double> stated;
  for (const CornerMethod method :
       {CornerMethod::apriltag, CornerMethod::tanh, CornerMethod::filter, CornerMethod::erf, CornerMethod::best}) {
    PlaneModel model{{}, Vector2d(0.5 * (gray.cols - 1), 0.5 * (gray.rows - 1)), 0.5 * gray.cols};
    for (const TagDetection& detection : found) {
      Refinement refined = refine(gray, family, detection, method, std::nullopt);
      if (!std::holds_alternative<RefinedTag>(refined))
        refined = refine(gray, family, detection, CornerMethod::apriltag, std::nullopt);
      model.seen.push_back(std::get<RefinedTag>(refined).corners_px);
      stated[method] += std::get<RefinedTag>(refined).covariance_px2.trace() / static_cast<double>(8 * found.size());
    }
    const Eigen::VectorXd p = model.fit(model.start());
    residuals[method] = model.residuals(p);
    const double all = std::sqrt(residuals[method].squaredNorm() / static_cast<double>(8 * found.size()));
    // Each square but the first (whose place is the frame) is left out once; then only its place and turn are fitted.
    double squares = 0.0;
    for (std::size_t out = 1; out < model.seen.size(); ++out) {
      PlaneModel others = model;
      others.seen.erase(others.seen.begin() + static_cast<std::ptrdiff_t>(out));
      const Eigen::VectorXd rest = others.fit(others.start());
      PlaneModel one = model;
      one.seen = {model.seen[0], model.seen[out]};
      Eigen::VectorXd q = one.start();
      q.head(PlaneModel::shared) = rest.head(PlaneModel::shared);
      // The place again, by the plane of the others.
      const auto index = PlaneModel::shared + 3 * (static_cast<Eigen::Index>(out) - 1);
      q.tail<3>() = p.segment<3>(index);
      const Eigen::VectorXd placed = one.fit(q, PlaneModel::shared);
      squares += one.residuals(placed).tail<8>().squaredNorm() / 8.0;
    }
    rms[method] = {all, std::sqrt(squares / static_cast<double>(model.seen.size() - 1))};
    std::printf("%-9s all %.4f   left out %.4f   ratio to apriltag %.2f, %.2f\n", word(method).data(),
                rms[method].first, rms[method].second, rms[method].first / rms[CornerMethod::apriltag].first,
                rms[method].second / rms[CornerMethod::apriltag].second);
  }
  // What methods of different kinds leave alike is not theirs: print, sheet, lens and what the camera did to edges.
  for (const auto& [method, own] : residuals)
    std::printf("%-9s stated sigma %.4f px   correlation of its residuals with those of best %.2f\n",
                word(method).data(), std::sqrt(stated[method]),
                own.dot(residuals[CornerMethod::best]) / (own.norm() * residuals[CornerMethod::best].norm()));
}

}  // namespace
}  // namespace tagdock

int main(int argc, char** argv) {
  tagdock::Options options;
  int i = 1;
  if (argc > 1 && argv[1][0] != '-') options.what = argv[i++];
  for (; i + 1 < argc; i += 2) {
    const std::string name = argv[i];
    if (name == "--images") options.images = std::atoi(argv[i + 1]);
    if (name == "--bounds") options.bounds = std::atoi(argv[i + 1]);
    if (name == "--seed") options.seed = static_cast<unsigned>(std::atoi(argv[i + 1]));
    if (name == "--only") options.only = argv[i + 1];
    if (name == "--methods") options.methods = argv[i + 1];
    if (name == "--output") options.output = argv[i + 1];
  }
  if (options.what == "frame")
    tagdock::frame();
  else if (options.what == "joint")
    tagdock::joint(options.images, options.seed);
  else if (options.what == "photograph")
    tagdock::photograph();
  else
    tagdock::accuracy(options);
}
