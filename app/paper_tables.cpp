#include "app/paper_tables.h"

#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <map>
#include <memory>
#include <optional>
#include <random>
#include <vector>

#include <nlohmann/json.hpp>

#include "app/camera_file.h"
#include "app/csv_table.h"
#include "app/failure.h"
#include "app/image_file.h"
#include "app/simulation/renderer.h"
#include "detection/tag_locator.h"
#include "detection/tag_pose.h"
#include "planning/pose2.h"

namespace tagdock {
namespace {

constexpr double tag_size = 0.16;
constexpr double focal_px = 1400.0;
constexpr std::array<CornerMethod, 5> methods = {CornerMethod::apriltag, CornerMethod::tanh, CornerMethod::filter,
                                                 CornerMethod::erf, CornerMethod::best};

/// As printed in the paper [px]; tables 1 and 2.
struct Printed {
  const char* name;
  char axis;
  double sigma_r, mu_r, sigma_p, mu_p;
};
constexpr std::array<Printed, 6> printed_1 = {{{"AprilTag3", 'y', 34.3947e-3, 41.3505e-3, 61.6882e-3, 175.3330e-3},
                                               {"Adv. Det.", 'y', 12.8442e-3, 8.0157e-3, 50.2945e-3, 40.9599e-3},
                                               {"Filter-Method", 'y', 7.9674e-3, 3.3684e-3, 28.7507e-3, 25.1204e-3},
                                               {"AprilTag3", 'z', 8.7379e-3, 11.7599e-3, 37.1436e-3, 53.6931e-3},
                                               {"Adv. Det.", 'z', 0.2610e-3, 0.3851e-3, 1.3879e-3, 3.9553e-3},
                                               {"Filter-Method", 'z', 0.1545e-3, 0.1760e-3, 1.0208e-3, 2.9557e-3}}};
constexpr std::array<Printed, 6> printed_2 = {{{"AprilTag3", 'y', 2.5950e-2, 4.1752e-2, 0.0, 0.0},
                                               {"Adv. Det.", 'y', 3.1498e-2, 4.6555e-2, 0.0, 0.0},
                                               {"Filter-Method", 'y', 2.1715e-2, 2.4423e-2, 0.0, 0.0},
                                               {"AprilTag3", 'z', 3.2529e-2, 6.2448e-2, 0.0, 0.0},
                                               {"Adv. Det.", 'z', 2.6678e-2, 5.5096e-2, 0.0, 0.0},
                                               {"Filter-Method", 'z', 2.2467e-2, 3.9345e-2, 0.0, 0.0}}};

struct Moments {
  double sum = 0.0, squares = 0.0;
  int count = 0;

  void add(double value) {
    sum += value;
    squares += value * value;
    ++count;
  }
  [[nodiscard]] double mean() const { return count > 0 ? sum / count : 0.0; }
  [[nodiscard]] double sigma() const {
    return count > 1 ? std::sqrt(std::max(0.0, (squares - sum * sum / count) / (count - 1))) : 0.0;
  }
};

struct Errors {
  Moments reprojection, position;
  int refused = 0;
};

/// An image of one tag, with what is known of it.
struct Picture {
  cv::Mat1b gray;
  char axis = 'y';
  CameraModel camera;  ///< as it is believed to be
  double size = tag_size;
  std::optional<Corners> truth;
  std::optional<Eigen::Isometry3d> T_camera_tag;  ///< of a reference
};

Picture rendered(int table, char axis, std::mt19937_64& random) {
  std::uniform_real_distribution<double> unit(0.0, 1.0);
  Picture picture;
  picture.axis = axis;
  CameraModel camera{320, 320, focal_px, focal_px, 159.5, 159.5};
  Scene scene;
  scene.white = 0.9;
  scene.black = 0.1;
  scene.lamp.strength = 0.0;
  scene.lamp.ambient = 1.0;
  scene.border_modules = 1.0;
  scene.room.wall = scene.room.floor = scene.room.marking = scene.room.cabinet = scene.white;
  Sensor sensor;
  sensor.levels_per_ms = 40.0;  // of 5 ms: black 20, white 180
  sensor.black_level = 0.0;
  sensor.psf_sigma_px = table == 1 ? 0.5 : 0.8;
  sensor.read_noise = table == 1 ? 0.0 : 1.5;
  sensor.electrons_per_level = table == 1 ? 0.0 : 40.0;
  sensor.vignetting = table == 1 ? 0.0 : 0.06;
  BoardTag tag;
  tag.id = static_cast<int>(586.0 * unit(random));
  tag.size = tag_size;
  // The station's tag faces the arriving robot; here the tag itself turns, about its vertical or its normal.
  const double turn = axis == 'y' ? radians(150.0 * unit(random) - 75.0) : radians(90.0 * unit(random));
  const Eigen::Vector3d about = axis == 'y' ? Eigen::Vector3d::UnitY() : Eigen::Vector3d::UnitZ();
  const double distance = 1.4 * std::pow(6.7 / 1.4, unit(random));
  Eigen::Isometry3d T_camera_tag = Eigen::Isometry3d::Identity();
  T_camera_tag.linear() = Eigen::AngleAxisd(turn, about).toRotationMatrix();
  T_camera_tag.translation() = Eigen::Vector3d(0.0, 0.0, distance);
  // The station frame has z up and x into the wall; the tag stands in it as on a wall.
  tag.T_station_tag = upright_tag(0.0, 0.0, 1.0, 0.0);
  scene.board.tags = {tag};
  Exposure exposure;
  exposure.T_station_camera = {tag.T_station_tag * T_camera_tag.inverse()};
  const Renderer renderer(scene, camera, sensor);
  const Rendering image = renderer.render(exposure, random());
  picture.gray = image.gray;
  picture.truth = renderer.true_tags(exposure).at(0).corners_px;
  picture.camera = camera;
  if (table == 2) {  // what a calibration leaves: a thousandth of the focal length, half a pixel, a little distortion
    std::normal_distribution<double> normal;
    picture.camera.fx *= 1.0 + 1e-3 * normal(random);
    picture.camera.fy = picture.camera.fx;
    picture.camera.cx += 0.5 * normal(random);
    picture.camera.cy += 0.5 * normal(random);
  }
  return picture;
}

std::optional<Eigen::Isometry3d> reference_pose(const CsvTable& table, std::size_t row) {
  const std::array<const char*, 7> columns = {"tx", "ty", "tz", "qx", "qy", "qz", "qw"};
  std::array<double, 7> values{};
  for (std::size_t i = 0; i < columns.size(); ++i) {
    const auto value = table.number(row, columns[i]);
    if (!value) return std::nullopt;
    values[i] = *value;
  }
  const Eigen::Quaterniond q(values[6], values[3], values[4], values[5]);
  if (std::abs(q.norm() - 1.0) > 1e-3) table.refuse(row, "qx,qy,qz,qw is no unit quaternion");
  Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
  T.linear() = q.normalized().toRotationMatrix();
  T.translation() << values[0], values[1], values[2];
  return T;
}

std::vector<Picture> read_pictures(const PaperTableOptions& options) {
  if (options.camera.empty()) throw Failure(ExitCode::usage, "--images needs --camera FILE");
  if (!(options.tag_size > 0.0)) throw Failure(ExitCode::usage, "--images needs --tag-size, in m");
  const CameraFile camera = CameraFile::load(options.camera);
  const std::filesystem::path folder(options.folder);
  const CsvTable table = CsvTable::load(folder / "reference.csv");
  (void)table.column("image");
  (void)table.column("axis");
  std::vector<Picture> pictures;
  for (std::size_t row = 0; row < table.rows(); ++row) {
    const std::string axis = table.text(row, "axis");
    if (axis != "y" && axis != "z") table.refuse(row, "axis is " + axis + "; y or z is meant");
    const auto image = read_grey(folder / table.text(row, "image"));
    if (const std::string* sentence = std::get_if<std::string>(&image)) throw Failure(ExitCode::usage, *sentence);
    Picture picture;
    picture.gray = std::get<cv::Mat1b>(image);
    camera.require_size(picture.gray.cols, picture.gray.rows, table.text(row, "image"));
    picture.axis = axis[0];
    picture.camera = camera.camera();
    picture.size = options.tag_size;
    picture.T_camera_tag = reference_pose(table, row);
    pictures.push_back(picture);
  }
  return pictures;
}

/// Adds what one method says of one picture.
void look(const Picture& picture, const TagDetection& coarse, const std::string& family, CornerMethod method,
          Errors& errors) {
  const Refinement refined = refine(picture.gray, family, coarse, method, picture.camera);
  const RefinedTag* tag = std::get_if<RefinedTag>(&refined);
  const std::vector<TagPose> poses =
      tag != nullptr ? tag_poses(*tag, picture.size, picture.camera) : std::vector<TagPose>{};
  if (poses.empty()) {
    ++errors.refused;
    return;
  }
  const Eigen::Isometry3d T = picture.T_camera_tag.value_or(poses[0].T_camera_tag);
  const TagPoints points = tag_corners(picture.size);
  for (std::size_t k = 0; k < 4; ++k) {
    errors.reprojection.add((tag->corners_px[k] - project(picture.camera, T * points[k])).norm());
    if (picture.truth) errors.position.add((tag->corners_px[k] - (*picture.truth)[k]).norm());
  }
}

}  // namespace

int print_paper_table(int table, const PaperTableOptions& options) {
  std::map<std::pair<char, CornerMethod>, Errors> ours;
  TagDetectorConfig config;
  config.family = options.family;
  config.decimate = 1;
  std::unique_ptr<TagDetector> detector;
  try {
    detector = std::make_unique<TagDetector>(config);
  } catch (const std::invalid_argument& error) {
    throw Failure(ExitCode::usage, error.what());
  }
  int missed = 0;
  const auto use = [&](const Picture& picture) {
    const std::vector<TagDetection> found = detector->detect(picture.gray);
    if (found.size() != 1) {
      ++missed;
      return;
    }
    for (const CornerMethod method : methods)
      look(picture, found[0], options.family, method, ours[{picture.axis, method}]);
  };
  const bool real = !options.folder.empty();
  if (real) {
    for (const Picture& picture : read_pictures(options)) use(picture);
  } else {
    std::mt19937_64 random(options.seed);
    for (const char axis : {'y', 'z'})
      for (int i = 0; i < options.images; ++i) use(rendered(table, axis, random));
  }

  const auto& printed = table == 1 ? printed_1 : printed_2;
  if (options.json) {
    nlohmann::json rows = nlohmann::json::array();
    for (const Printed& row : printed) {
      nlohmann::json one{{"method", row.name},
                         {"source", "paper"},
                         {"axis", std::string(1, row.axis)},
                         {"sigma_r", row.sigma_r},
                         {"mu_r", row.mu_r}};
      if (table == 1) one.update({{"sigma_p", row.sigma_p}, {"mu_p", row.mu_p}});
      rows.push_back(one);
    }
    for (const auto& [key, errors] : ours) {
      nlohmann::json one{{"method", word(key.second)},         {"source", real ? "images" : "rendered"},
                         {"axis", std::string(1, key.first)},  {"sigma_r", errors.reprojection.sigma()},
                         {"mu_r", errors.reprojection.mean()}, {"corners", errors.reprojection.count},
                         {"refused", errors.refused}};
      if (errors.position.count > 0)
        one.update({{"sigma_p", errors.position.sigma()}, {"mu_p", errors.position.mean()}});
      rows.push_back(one);
    }
    std::cout << nlohmann::json{{"table", table}, {"missed", missed}, {"rows", rows}}.dump(1) << "\n";
    return static_cast<int>(ExitCode::done);
  }
  const auto line = [](const char* name, double sigma_r, double mu_r, double sigma_p, double mu_p, const char* more) {
    std::printf("  %-24s %9.2f %9.2f", name, 1e3 * sigma_r, 1e3 * mu_r);
    if (mu_p > 0.0)
      std::printf(" %9.2f %9.2f", 1e3 * sigma_p, 1e3 * mu_p);
    else
      std::printf(" %9s %9s", "-", "-");
    std::printf("  %s\n", more);
  };
  std::printf("Table %d of Richter et al. and the same by us, 1e-3 px; r reprojection, p position of a corner\n",
              table);
  for (const char axis : {'y', 'z'}) {
    std::printf("rotation about %c\n  %-24s %9s %9s %9s %9s\n", axis, "", "sigma_r", "mu_r", "sigma_p", "mu_p");
    for (const Printed& row : printed)
      if (row.axis == axis)
        line((std::string("paper: ") + row.name).c_str(), row.sigma_r, row.mu_r, row.sigma_p, row.mu_p, "");
    for (const CornerMethod method : methods) {
      const Errors& errors = ours[{axis, method}];
      const std::string more = std::to_string(errors.reprojection.count / 4) + " tags" +
                               (errors.refused > 0 ? ", " + std::to_string(errors.refused) + " refused" : "");
      line((std::string("ours: ") + std::string(word(method))).c_str(), errors.reprojection.sigma(),
           errors.reprojection.mean(), errors.position.sigma(), errors.position.mean(), more.c_str());
    }
  }
  if (missed > 0) std::printf("%d images without exactly one tag were left out\n", missed);
  return static_cast<int>(ExitCode::done);
}

void add_paper_tables(CLI::App& evaluate, Action& action) {
  for (const int table : {1, 2}) {
    auto options = std::make_shared<PaperTableOptions>();
    CLI::App* verb = evaluate.add_subcommand("paper-table" + std::to_string(table),
                                             table == 1 ? "the paper's Table 1 (simulated corners) beside ours"
                                                        : "the paper's Table 2 (robot arm) beside ours");
    verb->add_option("--count", options->images, "rendered images for each axis")
        ->check(CLI::Range(1, 100000))
        ->capture_default_str();
    verb->add_option("--seed", options->seed, "of places, ids and noise")->capture_default_str();
    verb->add_flag("--json", options->json, "one JSON object instead of a table; px");
    if (table == 2) {
      verb->add_option("--images", options->folder,
                       "folder of real images with reference.csv: image,axis (y or z) and, if an arm or tracker tells "
                       "it, tx,ty,tz,qx,qy,qz,qw of T_camera_tag; then only reprojection is given");
      verb->add_option("--camera", options->camera, "camera file of these");
      verb->add_option("--tag-size", options->tag_size, "side of the black square [m]");
      verb->add_option("--family", options->family, "tag family")->capture_default_str();
    }
    verb->footer(
        "r: distance of a corner from where the pose (or the reference) puts it; p: from where it truly is; mean mu "
        "and\n"
        "standard deviation sigma over corners. Rendered: a 0.16 m tag on the axis of a 1400 px lens, 1.4 to 6.7 m "
        "away,\n"
        "turned by -75 to 75 degrees about y or 0 to 90 about z; table 1 blur 0.5 px without noise, table 2 blur 0.8 "
        "px,\n"
        "noise, vignetting, a slightly wrong camera model. These choices are ours; the paper states none.");
    verb->callback(
        [table, options, &action] { action = [table, options] { return print_paper_table(table, *options); }; });
  }
}

}  // namespace tagdock
