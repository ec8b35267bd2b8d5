// The rows of the table that need pictures: intrinsics_bench [seeds] [row ...]; `dump ROW SEED DIR` writes the
// pictures and the target of one run instead.
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <set>
#include <string>
#include <vector>

#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <visp3/vision/vpCalibration.h>

#include "app/calibration_images.h"
#include "app/target_file.h"
#include "tests/calibration/board_rendering.h"

using namespace tagdock;
using namespace tagdock::testing;

namespace {

double quantile(std::vector<double> values, double share) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1, static_cast<std::size_t>(share * static_cast<double>(values.size())))];
}

struct Row {
  std::string name;
  CalibrationTarget target;
  int views = 30;
  bool bowed = false;
  bool bad_views = false;  ///< four of each kind beside them: motion, defocus, saturation, repeated
  bool poor = false;
  bool flat_board = false;
};

struct Shot {
  cv::Mat1b picture;
  bool bad = false;
};

struct Case {
  CameraModel camera;
  std::vector<Shot> shots;
  double shown = 0.0;  ///< corners that lie in the pictures
};

Case take(const Row& row, int seed) {
  std::mt19937_64 random(static_cast<std::uint64_t>(1000 + seed));
  const auto between = [&](double least, double most) {
    return std::uniform_real_distribution<double>(least, most)(random);
  };
  Case result;
  result.camera = random_camera(random);
  BoardScene scene;
  scene.camera = result.camera;
  if (row.bowed) {
    scene.bow = between(0.001, 0.0018);
    scene.bow_skew = between(0.0, 0.3);
  }
  const TargetLayout layout = layouts_of(row.target).front();
  const std::vector<Eigen::Isometry3d> poses = views_of(row.target, result.camera, row.views, random, row.poor);
  for (const Eigen::Isometry3d& pose : poses) {
    scene.T_camera_board = pose;
    result.shots.push_back({render_board(row.target, scene, random), false});
    for (const TargetLayout::Corner& corner : layout.corners) {
      const Eigen::Vector2d p = project(result.camera, pose * Eigen::Vector3d(corner.drawn.x(), corner.drawn.y(), 0.0));
      if (p.x() > 5 && p.y() > 5 && p.x() < result.camera.width - 6 && p.y() < result.camera.height - 6)
        result.shown += 1.0;
    }
  }
  if (row.bad_views)
    for (int i = 0; i < 8; ++i) {
      BoardScene bad = scene;
      bad.T_camera_board = views_of(row.target, result.camera, 1, random).front();
      if (i % 4 == 0) bad.motion = between(4.0, 9.0) * Eigen::Vector2d(between(-1, 1), between(-1, 1)).normalized();
      if (i % 4 == 1) bad.blur_px = between(1.6, 3.0);
      if (i % 4 == 2) bad.gain = between(1.7, 2.5);
      if (i % 4 == 3) bad.T_camera_board = poses[static_cast<std::size_t>(i)];
      result.shots.push_back({render_board(row.target, bad, random), true});
    }
  return result;
}

/// OpenCV's calibrateCamera on the same corners of the same views: flat board, no robust loss.
CameraModel by_opencv(const std::vector<CalibrationView>& views, const IntrinsicsResult& ours) {
  std::vector<std::vector<cv::Point3f>> object;
  std::vector<std::vector<cv::Point2f>> image;
  for (std::size_t i = 0; i < views.size(); ++i) {
    if (!ours.views[i].used) continue;
    object.emplace_back();
    image.emplace_back();
    for (const SeenPoint& seen : views[i].corners) {
      object.back().emplace_back(static_cast<float>(seen.point_board.x()), static_cast<float>(seen.point_board.y()),
                                 0.0F);
      image.back().emplace_back(static_cast<float>(seen.pixel.x()), static_cast<float>(seen.pixel.y()));
    }
  }
  cv::Mat K;
  cv::Mat d;
  std::vector<cv::Mat> rotations, translations;
  cv::calibrateCamera(object, image, cv::Size(ours.camera.width, ours.camera.height), K, d, rotations, translations);
  return {ours.camera.width,  ours.camera.height, K.at<double>(0, 0), K.at<double>(1, 1),
          K.at<double>(0, 2), K.at<double>(1, 2), d.at<double>(0),    d.at<double>(1),
          d.at<double>(2),    d.at<double>(3),    d.at<double>(4)};
}

/// ViSP's vpCalibration on the first eight of them (its dense solver grows steeply): one radial coefficient.
CameraModel by_visp(const std::vector<CalibrationView>& views, const IntrinsicsResult& ours) {
  std::vector<vpCalibration> table;
  for (std::size_t i = 0; i < views.size() && table.size() < 8; ++i) {
    if (!ours.views[i].used) continue;
    vpCalibration one;
    one.clearPoint();
    for (const SeenPoint& seen : views[i].corners) {
      vpImagePoint at(seen.pixel.y(), seen.pixel.x());
      one.addPoint(seen.point_board.x(), seen.point_board.y(), 0.0, at);
    }
    table.push_back(one);
  }
  vpCameraParameters camera;
  camera.initPersProjWithoutDistortion(1100, 1100, 0.5 * ours.camera.width, 0.5 * ours.camera.height);
  double error = 0.0;
  vpCalibration::computeCalibrationMulti(vpCalibration::CALIB_VIRTUAL_VS_DIST, table, camera, error, false);
  return {ours.camera.width, ours.camera.height, camera.get_px(), camera.get_py(),
          camera.get_u0(),   camera.get_v0(),    camera.get_kud()};
}

void measure(const Row& row, int seeds) {
  std::vector<double> largest, rms, claim, sigma, seconds, found, recall, false_rejects, halves, noise, opencv,
      opencv_rms, visp;
  int refused = 0;
  std::string lenses;
  for (int seed = 1; seed <= seeds; ++seed) {
    const Case shots = take(row, seed);
    const auto begin = std::chrono::steady_clock::now();
    TargetFinder finder(row.target);
    const auto look = [&](const std::optional<CameraModel>& camera) {
      std::vector<CalibrationView> views;
      for (std::size_t i = 0; i < shots.shots.size(); ++i)
        views.push_back(view_of(std::to_string(i), finder.find(shots.shots[i].picture, camera)));
      return views;
    };
    IntrinsicsConfig config;
    config.flat_board = row.flat_board;
    std::vector<CalibrationView> views = look(std::nullopt);
    IntrinsicsResult result = calibrate_intrinsics(views, shots.camera.width, shots.camera.height, config);
    if (row.target.type == CalibrationTarget::Type::taggrid) {
      views = look(result.camera);
      result = calibrate_intrinsics(views, shots.camera.width, shots.camera.height, config);
    }
    seconds.push_back(std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
    const ImageMap error = projection_difference(shots.camera, result.camera);
    if (!row.poor) {
      const ImageMap of_opencv = projection_difference(shots.camera, by_opencv(views, result));
      opencv.push_back(of_opencv.largest());
      opencv_rms.push_back(of_opencv.rms());
      visp.push_back(projection_difference(shots.camera, by_visp(views, result)).largest());
    }
    largest.push_back(error.largest());
    rms.push_back(error.rms());
    sigma.push_back(result.sigma_max_px);
    claim.push_back(error.largest() / result.sigma_max_px);
    noise.push_back(result.rms_px);
    halves.push_back(result.halves_px / std::max(1e-9, result.halves_expected_px));
    refused += result.complaints.empty() ? 0 : 1;
    lenses += std::to_string(static_cast<int>(result.lens));
    double seen = 0.0;
    int bad = 0;
    int bad_found = 0;
    int good_rejected = 0;
    for (std::size_t i = 0; i < views.size(); ++i) {
      if (!shots.shots[i].bad) seen += static_cast<double>(views[i].corners.size());
      bad += shots.shots[i].bad ? 1 : 0;
      bad_found += shots.shots[i].bad && !result.views[i].used ? 1 : 0;
      good_rejected += !shots.shots[i].bad && !result.views[i].used ? 1 : 0;
    }
    found.push_back(bad > 0 ? 100.0 * bad_found / bad : 100.0);
    false_rejects.push_back(good_rejected);
    recall.push_back(100.0 * seen / shots.shown);
    if (seed == 1)
      for (const std::string& complaint : result.complaints) std::printf("    refused: %s\n", complaint.c_str());
    if (seed == 1 && !result.complaints.empty())
      for (const std::string& sentence : result.missing) std::printf("    add: %s\n", sentence.c_str());
  }
  std::printf(
      "%-28s max %.3f (worst %.3f) rms %.4f px  sigma %.3f error/sigma %.2f  corners %.1f %% left %.3f px  bad found "
      "%.0f %% good rejected %.0f (worst %.0f)  halves %.2f  refused %d/%d  lens %s  %.2f s\n",
      row.name.c_str(), quantile(largest, 0.5), quantile(largest, 1.0), quantile(rms, 0.5), quantile(sigma, 0.5),
      quantile(claim, 0.5), quantile(recall, 0.5), quantile(noise, 0.5), quantile(found, 0.5),
      quantile(false_rejects, 0.5), quantile(false_rejects, 1.0), quantile(halves, 0.5), refused, seeds, lenses.c_str(),
      quantile(seconds, 0.5));
  if (!opencv.empty())
    std::printf("    the same corners: OpenCV max %.3f rms %.4f px; ViSP max %.2f px\n", quantile(opencv, 0.5),
                quantile(opencv_rms, 0.5), quantile(visp, 0.5));
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  const CalibrationTarget charuco = charuco_board();
  const CalibrationTarget taggrid = tag_board(CalibrationTarget::Type::taggrid);
  const CalibrationTarget aprilgrid = tag_board(CalibrationTarget::Type::aprilgrid);
  std::vector<Row> rows(7);
  rows[0] = Row{"charuco", charuco, 30, false, false, false, false};
  rows[1] = Row{"bowed", charuco, 30, true, false, false, false};
  rows[2] = Row{"bowed_taken_for_flat", charuco, 30, true, false, false, true};
  rows[3] = Row{"taggrid", taggrid, 16, false, false, false, false};
  rows[4] = Row{"aprilgrid", aprilgrid, 20, false, false, false, false};
  rows[5] = Row{"bad_views", charuco, 20, false, true, false, false};
  rows[6] = Row{"poor", charuco, 12, false, false, true, false};
  if (argc == 5 && std::string(argv[1]) == "dump") {
    for (const Row& row : rows) {
      if (row.name != argv[2]) continue;
      const std::filesystem::path folder = argv[4];
      std::filesystem::create_directories(folder / "images");
      const Case shots = take(row, std::atoi(argv[3]));
      for (std::size_t i = 0; i < shots.shots.size(); ++i) {
        char name[64];
        std::snprintf(name, sizeof name, "%03zu%s.png", i, shots.shots[i].bad ? "_bad" : "");
        cv::imwrite((folder / "images" / name).string(), shots.shots[i].picture);
      }
      std::ofstream(folder / "target.yaml") << target_text(row.target);
      return 0;
    }
    return 2;
  }
  const int seeds = argc > 1 ? std::atoi(argv[1]) : 5;
  std::set<std::string> wanted;
  for (int i = 2; i < argc; ++i) wanted.insert(argv[i]);
  std::printf("medians over %d seeds\n", seeds);
  for (const Row& row : rows)
    if (wanted.empty() || wanted.contains(row.name)) measure(row, seeds);
  return 0;
}
