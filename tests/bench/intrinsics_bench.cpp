// The rows of the table that need pictures: intrinsics_bench [seeds] [row ...]; `dump ROW SEED DIR [VIEWS]`
// writes the pictures and the target of one run instead; `corners ROW SEEDS` says what corners are wrong by; `opencv
// DIR` compares on OpenCV's sample pictures left01.jpg .. right14.jpg (Debian: opencv-doc).
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <set>
#include <string>
#include <vector>

#include <opencv2/calib3d.hpp>
#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>
#include <visp3/vision/vpCalibration.h>

#include "app/calibration_images.h"
#include "app/target_file.h"
#include "detection/saddle_refiner.h"
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
  bool fisheye = false;             ///< an equidistant lens of 90 degrees, as a rational model to 0.0001
  std::optional<LensModel> lens{};  ///< forced on the solution
};

struct Shot {
  cv::Mat1b picture;
  bool bad = false;
};

struct Case {
  CameraModel camera;
  std::vector<Shot> shots;
  double shown = 0.0;                    ///< corners that lie in the pictures
  std::vector<Eigen::Isometry3d> poses;  ///< T_camera_board of the good ones, which come first
};

Case take(const Row& row, int seed) {
  std::mt19937_64 random(static_cast<std::uint64_t>(1000 + seed));
  const auto between = [&](double least, double most) {
    return std::uniform_real_distribution<double>(least, most)(random);
  };
  Case result;
  result.camera = random_camera(random);
  if (row.fisheye) {
    // Pade's fraction of arctan(r) / r.
    const double focal = between(600.0, 680.0);
    result.camera.fx = result.camera.fy = focal;
    result.camera.k1 = 735.0 / 945.0;
    result.camera.k2 = 64.0 / 945.0;
    result.camera.k4 = 1050.0 / 945.0;
    result.camera.k5 = 225.0 / 945.0;
  }
  BoardScene scene;
  scene.camera = result.camera;
  if (row.bowed) {
    scene.bow = between(0.001, 0.0018);
    scene.bow_skew = between(0.0, 0.3);
  }
  const TargetLayout layout = layouts_of(row.target).front();
  const std::vector<Eigen::Isometry3d> poses = views_of(row.target, result.camera, row.views, random, row.poor);
  result.poses = poses;
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

/// Root of the mean square of what a camera leaves of views that it was not solved from, their poses fitted to it.
double left_by(const CameraModel& camera, const std::vector<CalibrationView>& views) {
  double squares = 0.0;
  double count = 0.0;
  for (const CalibrationView& view : views) {
    const std::vector<Eigen::Isometry3d> poses = board_poses(view.corners, camera);
    if (poses.empty()) continue;
    const double rms = reprojection_rms(view.corners, camera, poses.front());
    squares += rms * rms * static_cast<double>(view.corners.size());
    count += static_cast<double>(view.corners.size());
  }
  return std::sqrt(squares / count);
}

/// OpenCV's own pictures of a chessboard of 9 x 6 inner corners, real ones of two cameras: each solver takes the even
/// views, and the odd ones say how good it is. Corners are ours for all, and OpenCV's for all beside it.
int opencv_pictures(const std::filesystem::path& folder) {
  const cv::Size inside(9, 6);
  constexpr double square = 0.025;  // m; its size changes no camera
  for (const char* const side : {"left", "right"}) {
    std::vector<cv::Mat1b> pictures;
    std::vector<std::vector<cv::Point2f>> coarse;
    for (int number = 1; number <= 14; ++number) {
      char name[32];
      std::snprintf(name, sizeof name, "%s%02d.jpg", side, number);
      const cv::Mat1b gray = cv::imread((folder / name).string(), cv::IMREAD_GRAYSCALE);
      std::vector<cv::Point2f> corners;
      if (gray.empty() || !cv::findChessboardCorners(gray, inside, corners)) continue;
      pictures.push_back(gray);
      coarse.push_back(corners);
    }
    if (pictures.size() < 8) {
      std::fprintf(stderr, "%s: fewer than eight pictures %s01.jpg .. 14 that show the board\n", folder.c_str(), side);
      return 2;
    }
    const int width = pictures.front().cols;
    const int height = pictures.front().rows;
    const auto all_views = [&](bool ours, const std::optional<CameraModel>& camera) {
      std::vector<CalibrationView> views;
      for (std::size_t i = 0; i < pictures.size(); ++i) {
        CalibrationView view;
        view.name = side + std::to_string(i);
        view.marks_found = view.corners_expected = inside.area();
        view.contrast = 100.0;
        std::vector<cv::Point2f> fine = coarse[i];
        cv::cornerSubPix(pictures[i], fine, cv::Size(5, 5), cv::Size(-1, -1),
                         cv::TermCriteria(cv::TermCriteria::EPS + cv::TermCriteria::COUNT, 40, 0.001));
        for (int row = 0; row < inside.height; ++row)
          for (int column = 0; column < inside.width; ++column) {
            const auto at = [&](int r, int c) {
              const cv::Point2f& p = fine[static_cast<std::size_t>(r * inside.width + c)];
              return Eigen::Vector2d(p.x, p.y);
            };
            const int left = std::max(0, column - 1), right = std::min(inside.width - 1, column + 1);
            const int up = std::max(0, row - 1), down = std::min(inside.height - 1, row + 1);
            SaddleGuess guess;
            guess.pixel = at(row, column);
            guess.pixel_by_drawn.col(0) = (at(row, right) - at(row, left)) / (right - left);
            guess.pixel_by_drawn.col(1) = (at(down, column) - at(up, column)) / (down - up);
            guess.reach = 0.45;
            guess.clearance = 0.45;
            SeenPoint seen{row * inside.width + column, {square * column, square * row, 0.0}, guess.pixel, 0.1};
            if (ours) {
              const std::optional<Saddle> saddle = refine_saddle(pictures[i], guess, camera);
              if (!saddle) continue;
              seen.pixel = saddle->pixel;
              seen.sigma_px = std::sqrt(0.5 * saddle->covariance_px2.trace());
            }
            view.corners.push_back(seen);
          }
        views.push_back(view);
      }
      return views;
    };
    const auto half = [](const std::vector<CalibrationView>& views, std::size_t which) {
      std::vector<CalibrationView> some;
      for (std::size_t i = which; i < views.size(); i += 2) some.push_back(views[i]);
      return some;
    };
    IntrinsicsConfig quick;
    quick.lens_only = true;
    const CameraModel lens = calibrate_intrinsics(all_views(true, std::nullopt), width, height, quick).camera;
    const std::vector<CalibrationView> ours = all_views(true, lens);
    const std::vector<CalibrationView> theirs = all_views(false, std::nullopt);
    const IntrinsicsResult whole = calibrate_intrinsics(ours, width, height);
    std::printf(
        "%s: %zu pictures, lens %s, left %.3f px, sigma %.3f px, neighbours %.2f, halves %.2f of %.2f px, bow %.2f "
        "mm%s\n",
        side, pictures.size(), std::string(word(whole.lens)).c_str(), whole.rms_px, whole.sigma_max_px,
        whole.neighbours_agree, whole.halves_px, whole.halves_expected_px, 1000.0 * whole.board.bow(),
        whole.complaints.empty() ? "" : "  refused");
    for (const std::string& complaint : whole.complaints) std::printf("    refused: %s\n", complaint.c_str());
    for (const bool own : {true, false}) {
      const std::vector<CalibrationView>& corners = own ? ours : theirs;
      double squares[3] = {0.0, 0.0, 0.0};
      for (std::size_t which = 0; which < 2; ++which) {
        const std::vector<CalibrationView> solved = half(corners, which);
        const std::vector<CalibrationView> unseen = half(corners, 1 - which);
        const IntrinsicsResult result = calibrate_intrinsics(solved, width, height);
        const CameraModel cameras[] = {result.camera, by_opencv(solved, result), by_visp(solved, result)};
        for (int k = 0; k < 3; ++k) squares[k] += 0.5 * std::pow(left_by(cameras[k], unseen), 2);
      }
      std::printf(
          "    %s corners, unseen half: tagdock %.4f px, OpenCV calibrateCamera %.4f px, ViSP vpCalibration %.4f px\n",
          own ? "our" : "cornerSubPix", std::sqrt(squares[0]), std::sqrt(squares[1]), std::sqrt(squares[2]));
    }
  }
  return 0;
}

void measure(const Row& row, int seeds) {
  std::vector<double> largest, rms, claim, sigma, seconds, found, recall, false_rejects, halves, noise, opencv,
      opencv_rms, visp;
  int refused = 0;
  std::string lenses;
  std::vector<double> agree, systematic;
  for (int seed = 1; seed <= seeds; ++seed) {
    const Case shots = take(row, seed);
    const std::clock_t begin = std::clock();
    TargetFinder finder(row.target);
    std::vector<TargetView> seen;
    std::vector<CalibrationView> views;
    for (std::size_t i = 0; i < shots.shots.size(); ++i) {
      seen.push_back(finder.find_coarsely(shots.shots[i].picture));
      views.push_back(view_of(std::to_string(i), seen.back()));
    }
    IntrinsicsConfig quick;
    quick.lens_only = true;
    const CameraModel lens = calibrate_intrinsics(views, shots.camera.width, shots.camera.height, quick).camera;
    for (std::size_t i = 0; i < shots.shots.size(); ++i)
      if (!seen[i].corners.empty())
        views[i] = view_of(std::to_string(i), finder.refine(shots.shots[i].picture, seen[i], lens));
    IntrinsicsConfig config;
    config.flat_board = row.flat_board;
    config.lens = row.lens;
    const IntrinsicsResult result = calibrate_intrinsics(views, shots.camera.width, shots.camera.height, config);
    seconds.push_back(static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC);
    const ImageMap error = projection_difference(shots.camera, result.camera);
    constexpr int most_for_peers = 5;  // ViSP takes its time
    if (!row.poor && seed <= most_for_peers) {
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
    agree.push_back(result.neighbours_agree);
    systematic.push_back(result.systematic_px);
    lenses += std::to_string(static_cast<int>(result.lens));
    double corners = 0.0;
    int bad = 0;
    int bad_found = 0;
    int good_rejected = 0;
    for (std::size_t i = 0; i < views.size(); ++i) {
      if (!shots.shots[i].bad) corners += static_cast<double>(views[i].corners.size());
      bad += shots.shots[i].bad ? 1 : 0;
      bad_found += shots.shots[i].bad && !result.views[i].used ? 1 : 0;
      good_rejected += !shots.shots[i].bad && !result.views[i].used ? 1 : 0;
    }
    found.push_back(bad > 0 ? 100.0 * bad_found / bad : 100.0);
    false_rejects.push_back(good_rejected);
    recall.push_back(100.0 * corners / shots.shown);
    if (seed == 1)
      for (const std::string& complaint : result.complaints) std::printf("    refused: %s\n", complaint.c_str());
    if (seed == 1 && !result.complaints.empty())
      for (const std::string& sentence : result.missing) std::printf("    add: %s\n", sentence.c_str());
  }
  std::printf(
      "%-28s max %.3f (worst %.3f) rms %.4f px  sigma %.3f error/sigma %.2f  corners %.1f %% left %.3f px  bad found "
      "%.0f %% good rejected %.0f (worst %.0f)  halves %.2f neighbours %.2f systematic %.4f px  refused %d/%d  lens %s "
      " "
      "%.2f s CPU\n",
      row.name.c_str(), quantile(largest, 0.5), quantile(largest, 1.0), quantile(rms, 0.5), quantile(sigma, 0.5),
      quantile(claim, 0.5), quantile(recall, 0.5), quantile(noise, 0.5), quantile(found, 0.5),
      quantile(false_rejects, 0.5), quantile(false_rejects, 1.0), quantile(halves, 0.5), quantile(agree, 0.5),
      quantile(systematic, 0.5), refused, seeds, lenses.c_str(), quantile(seconds, 0.5));
  if (!opencv.empty())
    std::printf("    the same corners: OpenCV max %.3f rms %.4f px; ViSP max %.2f px\n", quantile(opencv, 0.5),
                quantile(opencv_rms, 0.5), quantile(visp, 0.5));
  std::fflush(stdout);
}

/// What the corners of a row's pictures are wrong by, against their claimed sigma: by the place in the picture and in
/// the tag, with the lens unknown to the corner fit and with the true lens.
void corner_errors(const Row& row, int seeds) {
  TargetFinder finder(row.target);
  for (const bool lens : {false, true}) {
    Eigen::ArrayXXd radial = Eigen::ArrayXXd::Zero(5, 3);  // by radius: count, sum of radial error, of its square
    double squares = 0.0, claimed = 0.0, whitened = 0.0, count = 0.0, far = 0.0;
    Eigen::Vector2d mean = Eigen::Vector2d::Zero();
    std::map<int, double> view_means;
    double of_views = 0.0, views = 0.0, of_views_expected = 0.0;
    double outward = 0.0, outward2 = 0.0;
    for (int seed = 1; seed <= seeds; ++seed) {
      const Case shots = take(row, seed);
      const TargetLayout layout = layouts_of(row.target).front();
      std::map<int, Eigen::Vector2d> drawn;
      for (const TargetLayout::Corner& corner : layout.corners) drawn[corner.id] = corner.drawn;
      for (std::size_t i = 0; i < shots.shots.size(); ++i) {
        TargetView view = finder.find(shots.shots[i].picture);
        if (lens) view = finder.refine(shots.shots[i].picture, view, shots.camera);
        Eigen::Vector2d sum = Eigen::Vector2d::Zero();
        double variance = 0.0;
        const auto at = [&](const Eigen::Vector2d& p) {
          return project(shots.camera, shots.poses[i] * Eigen::Vector3d(p.x(), p.y(), 0.0));
        };
        for (const SeenPoint& seen : view.corners) {
          const Eigen::Vector2d error = seen.pixel - at(drawn[seen.id]);
          const double ratio = error.norm() / (std::sqrt(2.0) * seen.sigma_px);
          if (ratio > 8.0) far += 1.0;
          squares += 0.5 * error.squaredNorm();
          claimed += seen.sigma_px * seen.sigma_px;
          whitened += std::min(64.0, ratio * ratio);
          count += 1.0;
          mean += error;
          sum += error;
          variance += seen.sigma_px * seen.sigma_px;
          const Eigen::Vector2d out = seen.pixel - Eigen::Vector2d(shots.camera.cx, shots.camera.cy);
          const auto bin = std::min<Eigen::Index>(4, static_cast<Eigen::Index>(out.norm() / 160.0));
          const double along = error.dot(out.normalized());
          radial.row(bin) += Eigen::Array3d(1.0, along, along * along).transpose();
          if (row.target.type == CalibrationTarget::Type::taggrid) {
            Eigen::Vector2d centre = Eigen::Vector2d::Zero();
            for (int k = 0; k < 4; ++k) centre += 0.25 * drawn[seen.id - seen.id % 4 + k];
            const double o = error.dot((at(drawn[seen.id]) - at(centre)).normalized());
            outward += o;
            outward2 += o * o;
          }
        }
        const double n = static_cast<double>(view.corners.size());
        if (n > 0.0) {
          of_views += sum.squaredNorm() / (n * n);
          of_views_expected += 2.0 * variance / (n * n);
          views += 1.0;
        }
      }
    }
    std::printf("%s, lens %s: corners %.0f rms %.4f px claimed %.4f whitened %.2f far %.0f mean %.4f %.4f\n",
                row.name.c_str(), lens ? "known" : "unknown", count, std::sqrt(squares / count),
                std::sqrt(claimed / count), std::sqrt(whitened / count), far, mean.x() / count, mean.y() / count);
    std::printf("    mean over a view's corners: rms %.5f px, claims explain %.5f\n", std::sqrt(of_views / views),
                std::sqrt(of_views_expected / views));
    std::printf("    outward in the tag: %.5f +- %.5f\n", outward / count, std::sqrt(outward2) / count);
    for (Eigen::Index bin = 0; bin < 5; ++bin)
      std::printf("    radius %3d px: radial mean %.5f +- %.5f\n", static_cast<int>(160 * bin + 80),
                  radial(bin, 1) / radial(bin, 0), std::sqrt(radial(bin, 2)) / radial(bin, 0));
  }
}

}  // namespace

int main(int argc, char** argv) {
  const CalibrationTarget charuco = charuco_board();
  const CalibrationTarget taggrid = tag_board(CalibrationTarget::Type::taggrid);
  const CalibrationTarget aprilgrid = tag_board(CalibrationTarget::Type::aprilgrid);
  std::vector<Row> rows(10);
  rows[0] = Row{"charuco", charuco, 30, false, false, false, false};
  rows[1] = Row{"bowed", charuco, 30, true, false, false, false};
  rows[2] = Row{"bowed_taken_for_flat", charuco, 30, true, false, false, true};
  rows[3] = Row{"taggrid", taggrid, 16, false, false, false, false};
  rows[4] = Row{"aprilgrid", aprilgrid, 20, false, false, false, false};
  rows[5] = Row{"bad_views", charuco, 20, false, true, false, false};
  rows[6] = Row{"poor", charuco, 12, false, false, true, false};
  rows[7] = Row{"lens_taken_for_k1", charuco, 30, false, false, false, false, false, LensModel::k1};
  rows[8] = Row{"fisheye", charuco, 30, false, false, false, false, true, std::nullopt};
  rows[9] = Row{"fisheye_taken_for_k1_k2", charuco, 30, false, false, false, false, true, LensModel::k1_k2};
  if (argc == 3 && std::string(argv[1]) == "opencv") return opencv_pictures(argv[2]);
  if ((argc == 5 || argc == 6) && std::string(argv[1]) == "dump") {
    for (Row& row : rows) {
      if (row.name != argv[2]) continue;
      if (argc == 6) row.views = std::atoi(argv[5]);
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
  if (argc == 4 && std::string(argv[1]) == "corners") {
    for (const Row& row : rows)
      if (row.name == argv[2]) corner_errors(row, std::atoi(argv[3]));
    return 0;
  }
  const int seeds = argc > 1 ? std::atoi(argv[1]) : 5;
  std::set<std::string> wanted;
  for (int i = 2; i < argc; ++i) wanted.insert(argv[i]);
  std::printf("medians over %d seeds\n", seeds);
  for (const Row& row : rows)
    if (wanted.empty() || wanted.contains(row.name)) measure(row, seeds);
  return 0;
}
