// Verb: images -> tags, corners, poses.
#include "app/detect.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <ctime>
#include <filesystem>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <optional>
#include <set>
#include <sstream>
#include <stdexcept>
#include <string>
#include <vector>

#include <Eigen/Eigenvalues>
#include <nlohmann/json.hpp>
#include <opencv2/imgcodecs.hpp>

#include "app/annotation.h"
#include "app/camera_file.h"
#include "app/csv_table.h"
#include "app/explanation.h"
#include "app/failure.h"
#include "app/image_file.h"
#include "app/verbs.h"
#include "detection/photometric_refiner.h"
#include "detection/tag_locator.h"
#include "detection/tag_pose.h"
#include "planning/pose2.h"

namespace tagdock {
namespace {

/// One image to be looked at, and what is known of it.
struct Job {
  std::string name;            ///< exactly as given
  std::filesystem::path file;  ///< where it is
  std::string family;
  double tag_size = 0.0;              ///< 0: not known
  std::optional<CameraModel> camera;  ///< from the list; its size is the image's
};

/// One tag of an image, as it is reported.
struct Found {
  RefinedTag tag;
  std::string refused;  ///< why the corners are the library's own; empty if they were refined
  double size = 0.0;
  std::vector<TagPose> poses;
  double log_odds = 0.0;  ///< of the first pose against the second; only with two
  std::string warnings;   ///< on the pose, words joined by '+'
  double time_ms = 0.0;
};

struct Seen {
  const Job* job;
  cv::Size size;
  std::optional<CameraModel> camera;
  std::vector<Found> tags;
};

// ---- reading -------------------------------------------------------------------------------------------------------

[[noreturn]] void refuse(const std::string& sentence) { throw Failure(ExitCode::usage, sentence); }

std::optional<CameraModel> listed_camera(const CsvTable& table, std::size_t row) {
  CameraModel camera;
  camera.width = camera.height = 1;  // the image's size is put in once it is read
  const std::pair<const char*, double*> needed[] = {
      {"fx", &camera.fx}, {"fy", &camera.fy}, {"cx", &camera.cx}, {"cy", &camera.cy}};
  int given = 0;
  std::string missing;
  for (const auto& [column, place] : needed) {
    const std::optional<double> value = table.number(row, column);
    if (value) {
      *place = *value;
      ++given;
    } else {
      missing = column;
    }
  }
  if (given == 0) return std::nullopt;
  if (given < 4) table.refuse(row, missing + " is missing, but other values of a camera are given");
  const std::pair<const char*, double*> optional[] = {
      {"k1", &camera.k1}, {"k2", &camera.k2}, {"p1", &camera.p1}, {"p2", &camera.p2}, {"k3", &camera.k3}};
  for (const auto& [column, place] : optional) *place = table.number(row, column).value_or(0.0);
  try {
    check(camera);
  } catch (const std::invalid_argument& error) {
    table.refuse(row, error.what());
  }
  return camera;
}

std::vector<Job> jobs_of(const DetectOptions& options) {
  std::vector<Job> jobs;
  for (const std::string& image : options.images) {
    const std::filesystem::path file =
        options.root.empty() ? std::filesystem::path(image) : std::filesystem::path(options.root) / image;
    jobs.push_back({image, file, options.family, options.tag_size, std::nullopt});
  }
  if (!options.list.empty()) {
    const CsvTable table = CsvTable::load(options.list);
    (void)table.column("image");
    const std::filesystem::path root =
        options.root.empty() ? std::filesystem::path(options.list).parent_path() : std::filesystem::path(options.root);
    for (std::size_t row = 0; row < table.rows(); ++row) {
      Job job{table.text(row, "image"), {}, options.family, options.tag_size, std::nullopt};
      if (job.name.empty()) table.refuse(row, "image is empty");
      job.file = root / job.name;
      if (const std::string family = table.text(row, "family"); !family.empty()) job.family = family;
      job.tag_size = table.number(row, "tag_size").value_or(options.tag_size);
      if (job.tag_size < 0.0) table.refuse(row, "tag_size must be positive");
      job.camera = listed_camera(table, row);
      jobs.push_back(job);
    }
  }
  return jobs;
}

std::map<int, double> sizes_of(const std::string& file) {
  std::map<int, double> sizes;
  if (file.empty()) return sizes;
  const CsvTable table = CsvTable::load(file);
  const std::string size_column = table.has("tag_size") ? "tag_size" : "size";
  (void)table.column("id");
  (void)table.column(size_column);
  for (std::size_t row = 0; row < table.rows(); ++row) {
    const std::optional<double> id = table.number(row, "id");
    const std::optional<double> size = table.number(row, size_column);
    if (!id || *id != std::floor(*id) || *id < 0 || *id > 1e9) table.refuse(row, "id must be a whole number");
    if (!size || !(*size > 0.0)) table.refuse(row, size_column + " must be positive");
    if (!sizes.emplace(static_cast<int>(*id), *size).second)
      table.refuse(row, "the tag " + table.text(row, "id") + " is given twice");
  }
  return sizes;
}

// ---- seeing --------------------------------------------------------------------------------------------------------

double cpu_ms() {
  std::timespec now{};
  clock_gettime(CLOCK_THREAD_CPUTIME_ID, &now);
  return 1e3 * static_cast<double>(now.tv_sec) + 1e-6 * static_cast<double>(now.tv_nsec);
}

/// Odds of 150 to 1 settle which of two poses it is (notes on detection, section 11).
constexpr double settled_log_odds = 5.0;

/// Near frontal the turn of a flat tag about axes in its plane enters the image by its square: where its sigma is half
/// of the turn itself, or 3 degrees, the image does not tell it.
bool yaw_undetermined(const TagPose& pose) {
  const Eigen::Matrix3d R = pose.T_camera_tag.linear();
  const Eigen::Vector3d sight = pose.T_camera_tag.translation().normalized();
  const double tilt = std::acos(std::clamp(sight.dot(R.col(2)), -1.0, 1.0));
  const Eigen::Matrix<double, 3, 2> in_plane = R.leftCols<2>();
  const Eigen::Matrix2d covariance = in_plane.transpose() * pose.covariance.bottomRightCorner<3, 3>() * in_plane;
  const double sigma = std::sqrt(Eigen::SelfAdjointEigenSolver<Eigen::Matrix2d>(covariance).eigenvalues().maxCoeff());
  return !(sigma < 0.5 * tilt && sigma < radians(3.0));
}

Found look_at(const cv::Mat1b& gray, const std::string& family, const TagDetection& detection, CornerMethod method,
              const std::optional<CameraModel>& camera, double size) {
  const double start = cpu_ms();
  Found found;
  Refinement refined = refine(gray, family, detection, method, camera);
  if (const Unrefined* reason = std::get_if<Unrefined>(&refined)) {
    found.refused = word(*reason);
    refined = refine(gray, family, detection, CornerMethod::apriltag, camera);
  }
  found.tag = std::get<RefinedTag>(refined);
  found.size = size;
  if (camera && size > 0.0) found.poses = tag_poses(found.tag, size, *camera);
  if (found.poses.size() > 1) {
    // Two degrees of freedom are left over by a pose; a chi-square above says that the corners are worse than stated.
    const double inflation = std::max(1.0, found.poses[0].chi2 / 2.0);
    found.log_odds = 0.5 * (found.poses[1].chi2 - found.poses[0].chi2) / inflation;
  }
  found.time_ms = cpu_ms() - start;
  if (found.poses.size() > 1 && found.log_odds < settled_log_odds) found.warnings = "ambiguous";
  if (!found.poses.empty() && yaw_undetermined(found.poses[0]))
    found.warnings += found.warnings.empty() ? "yaw_undetermined" : "+yaw_undetermined";
  return found;
}

/// Families whose codes differ in few bits decode in clutter too; there black and white must lie as the code says.
bool is_clutter(const cv::Mat1b& gray, const std::string& family, const TagDetection& detection,
                const std::optional<CameraModel>& camera) {
  if (family != "tag16h5" && family != "tag25h9") return false;
  const Refinement whole = refine_photometric(gray, family, detection, PhotometricConfig{}, camera);
  const Unrefined* reason = std::get_if<Unrefined>(&whole);
  return reason != nullptr && *reason != Unrefined::too_few_pixels;
}

// ---- writing -------------------------------------------------------------------------------------------------------

constexpr std::array<const char*, 6> pose_axes{"x", "y", "z", "a", "b", "c"};

std::string header() {
  std::string line = "image,id";
  for (int i = 0; i < 4; ++i) line += ",x" + std::to_string(i) + ",y" + std::to_string(i);
  line += ",time_ms,tx,ty,tz,qx,qy,qz,qw,hamming,margin,residual_rms,chi2";
  for (int i = 0; i < 4; ++i) line += ",sigma_x" + std::to_string(i) + ",sigma_y" + std::to_string(i);
  for (std::size_t i = 0; i < 6; ++i)
    for (std::size_t j = i; j < 6; ++j) line.append(",s").append(pose_axes[i]).append(pose_axes[j]);
  line += ",reprojection_rms,tx2,ty2,tz2,qx2,qy2,qz2,qw2,log_odds,blur_px,terms,unrefined,tag_size,pose_warnings";
  return line;
}

std::string exact(double value) {
  char text[40];
  std::snprintf(text, sizeof text, "%.17g", value);
  return text;
}

std::array<double, 7> pose_values(const Eigen::Isometry3d& pose) {
  Eigen::Quaterniond q(pose.linear());
  q.normalize();
  if (q.w() < 0.0) q.coeffs() = -q.coeffs();
  const Eigen::Vector3d t = pose.translation();
  return {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w()};
}

std::string csv_line(const std::string& image, const Found& found) {
  std::string line = image + "," + std::to_string(found.tag.id);
  const auto add = [&line](double value) { line += "," + exact(value); };
  const auto leave = [&line](int count) { line.append(static_cast<std::size_t>(count), ','); };
  for (const Eigen::Vector2d& corner : found.tag.corners_px) {
    add(corner.x());
    add(corner.y());
  }
  add(found.time_ms);
  const bool posed = !found.poses.empty();
  if (posed)
    for (const double value : pose_values(found.poses[0].T_camera_tag)) add(value);
  else
    leave(7);
  line += "," + std::to_string(found.tag.hamming);
  add(found.tag.margin);
  add(found.tag.residual_rms);
  add(found.tag.chi2_per_pixel);
  for (int i = 0; i < 8; ++i) add(std::sqrt(std::max(0.0, found.tag.covariance_px2(i, i))));
  if (posed) {
    for (int i = 0; i < 6; ++i)
      for (int j = i; j < 6; ++j) add(found.poses[0].covariance(i, j));
    add(found.poses[0].reprojection_rms_px);
  } else {
    leave(22);
  }
  if (found.poses.size() > 1) {
    for (const double value : pose_values(found.poses[1].T_camera_tag)) add(value);
    add(found.log_odds);
  } else {
    leave(8);
  }
  add(found.tag.blur_px);
  line += "," + found.tag.terms + "," + found.refused + ",";
  if (found.size > 0.0) line += exact(found.size);
  line += "," + found.warnings;
  return line;
}

nlohmann::json json_pose(const TagPose& pose) {
  nlohmann::json covariance = nlohmann::json::array();
  for (int i = 0; i < 6; ++i) {
    nlohmann::json row = nlohmann::json::array();
    for (int j = 0; j < 6; ++j) row.push_back(pose.covariance(i, j));
    covariance.push_back(row);
  }
  return {{"T_camera_tag", pose_values(pose.T_camera_tag)},
          {"covariance", covariance},
          {"reprojection_rms_px", pose.reprojection_rms_px},
          {"chi2", pose.chi2}};
}

nlohmann::json json_tag(const Found& found) {
  nlohmann::json corners = nlohmann::json::array();
  for (const Eigen::Vector2d& corner : found.tag.corners_px) corners.push_back({corner.x(), corner.y()});
  nlohmann::json sigmas = nlohmann::json::array();
  for (int i = 0; i < 8; ++i) sigmas.push_back(std::sqrt(std::max(0.0, found.tag.covariance_px2(i, i))));
  nlohmann::json poses = nlohmann::json::array();
  for (const TagPose& pose : found.poses) poses.push_back(json_pose(pose));
  nlohmann::json tag{{"id", found.tag.id},
                     {"corners_px", corners},
                     {"sigma_px", sigmas},
                     {"hamming", found.tag.hamming},
                     {"margin", found.tag.margin},
                     {"residual_rms", found.tag.residual_rms},
                     {"chi2_per_pixel", found.tag.chi2_per_pixel},
                     {"blur_px", found.tag.blur_px},
                     {"terms", found.tag.terms},
                     {"unrefined", found.refused},
                     {"time_ms", found.time_ms},
                     {"pose_warnings", found.warnings},
                     {"poses", poses}};
  if (found.poses.size() > 1) tag["log_odds"] = found.log_odds;
  if (found.size > 0.0) tag["tag_size"] = found.size;
  return tag;
}

/// Annotated pictures in one folder, named after their images; two images of one name get a number.
class Album {
 public:
  explicit Album(const std::string& folder) : folder_(folder) {
    if (folder.empty()) return;
    std::error_code error;
    std::filesystem::create_directories(folder_, error);
    if (error || !std::filesystem::is_directory(folder_))
      refuse("--annotate " + folder + ": the folder cannot be made");
  }

  void add(const cv::Mat1b& gray, const Seen& seen) {
    if (folder_.empty()) return;
    std::vector<DrawnTag> tags;
    for (const Found& found : seen.tags) {
      DrawnTag tag{found.tag.id, found.tag.corners_px, std::nullopt, found.size, found.tag.covariance_px2};
      if (!found.poses.empty()) tag.T_camera_tag = found.poses[0].T_camera_tag;
      tags.push_back(tag);
    }
    const std::string stem = seen.job->file.stem().string();
    std::string name = stem;
    for (int copy = 2; !used_.insert(name).second; ++copy) name = stem + "-" + std::to_string(copy);
    const std::filesystem::path file = folder_ / (name + ".png");
    bool written = false;
    try {
      written = cv::imwrite(file.string(), annotated(gray, tags, seen.camera));
    } catch (const cv::Exception&) {
      written = false;
    }
    if (!written) refuse(file.string() + ": cannot be written");
  }

 private:
  std::filesystem::path folder_;
  std::set<std::string> used_;
};

/// Where the result goes: a file or stdout, as CSV line by line or as one JSON object at the end.
class Report {
 public:
  Report(const DetectOptions& options, std::ostream& out) : name_(options.output), out_(out), json_(options.json) {
    if (!name_.empty()) {
      file_.open(name_, std::ios::binary | std::ios::trunc);
      if (!file_) refuse("--output " + name_ + ": cannot be written");
    }
    if (!json_) stream() << header() << "\n";
  }

  void add(const Seen& seen) {
    if (!json_) {
      for (const Found& found : seen.tags) stream() << csv_line(seen.job->name, found) << "\n";
      return;
    }
    nlohmann::json tags = nlohmann::json::array();
    for (const Found& found : seen.tags) tags.push_back(json_tag(found));
    images_.push_back(
        {{"image", seen.job->name}, {"width", seen.size.width}, {"height", seen.size.height}, {"tags", tags}});
  }

  void add_unreadable(const Job& job, const std::string& sentence) {
    unreadable_.push_back({{"image", job.name}, {"reason", sentence}});
  }

  void finish() {
    if (json_) {
      const nlohmann::json whole{{"images", images_}, {"unreadable", unreadable_}};
      // A file name may hold any bytes; those that are no UTF-8 are replaced rather than fatal.
      stream() << whole.dump(1, ' ', false, nlohmann::json::error_handler_t::replace) << "\n";
    }
    stream().flush();
    if (!stream()) refuse((name_.empty() ? "stdout" : name_) + ": not everything could be written");
  }

 private:
  std::ostream& stream() { return name_.empty() ? out_ : file_; }

  std::string name_;
  std::ostream& out_;
  bool json_;
  std::ofstream file_;
  nlohmann::json images_ = nlohmann::json::array();
  nlohmann::json unreadable_ = nlohmann::json::array();
};

/// Detectors by family, each made once: their tables take up to a second.
class Detectors {
 public:
  explicit Detectors(const DetectOptions& options) : options_(options) {}

  const TagDetector& of(const std::string& family) {
    std::unique_ptr<TagDetector>& detector = made_[family];
    if (!detector) {
      TagDetectorConfig config;
      config.family = family;
      config.decimate = options_.decimate;
      config.max_hamming = options_.max_hamming;
      try {
        detector = std::make_unique<TagDetector>(config);
      } catch (const std::invalid_argument& error) {
        refuse(error.what());
      }
    }
    return *detector;
  }

 private:
  const DetectOptions& options_;
  std::map<std::string, std::unique_ptr<TagDetector>> made_;
};

/// The camera of one image: the list's own, else the file's, which must be of the image's size.
std::optional<CameraModel> camera_of(const Job& job, const std::optional<CameraFile>& file, const cv::Size& size) {
  if (job.camera) {
    CameraModel camera = *job.camera;
    camera.width = size.width;
    camera.height = size.height;
    return camera;
  }
  if (!file) return std::nullopt;
  file->require_size(size.width, size.height, job.name);
  return file->camera();
}

}  // namespace

int explain_image(const DetectOptions& options) {
  if (!options.images.empty() || !options.list.empty()) refuse("--explain takes one image, without others or a list");
  if (options.method != "best") refuse("--explain shows the method best; --method " + options.method + " has no page");
  const Job job{options.explain, options.explain, options.family, options.tag_size, std::nullopt};
  const auto image = read_grey(job.file);
  if (const std::string* sentence = std::get_if<std::string>(&image)) refuse(*sentence);
  const cv::Mat1b& gray = std::get<cv::Mat1b>(image);
  const std::optional<CameraFile> file =
      options.camera.empty() ? std::nullopt : std::optional(CameraFile::load(options.camera));
  const std::optional<CameraModel> camera = camera_of(job, file, gray.size());
  Detectors detectors(options);
  const std::vector<TagDetection> detections = detectors.of(job.family).detect(gray);
  std::error_code error;
  std::filesystem::create_directories(options.pages, error);
  if (error || !std::filesystem::is_directory(options.pages)) refuse("--pages " + options.pages + ": cannot be made");
  std::set<std::string> used;
  for (const TagDetection& detection : detections) {
    const auto explained = explain_photometric(gray, job.family, detection, PhotometricConfig{}, camera);
    if (const Unrefined* reason = std::get_if<Unrefined>(&explained)) {
      std::cerr << "tagdock: tag " << detection.id << " has no page: " << word(*reason) << "\n";
      continue;
    }
    const std::string stem = job.file.stem().string() + "-tag" + std::to_string(detection.id);
    std::string name = stem;
    for (int copy = 2; !used.insert(name).second; ++copy) name = stem + "-" + std::to_string(copy);
    const std::filesystem::path page = std::filesystem::path(options.pages) / (name + ".html");
    std::ofstream stream(page, std::ios::binary | std::ios::trunc);
    stream << explanation_page(gray, job.name, job.family, std::get<PhotometricExplanation>(explained));
    stream.flush();
    if (!stream) refuse(page.string() + ": cannot be written");
    std::cout << page.string() << "\n";
  }
  if (detections.empty()) std::cerr << "tagdock: " << job.name << ": no tag of " << job.family << "\n";
  return static_cast<int>(ExitCode::done);
}

int detect_images(const DetectOptions& options, std::ostream& out) {
  const std::optional<CornerMethod> method = corner_method(options.method);
  if (!method) refuse("--method " + options.method + " is unknown; known are apriltag, tanh, filter, erf, best");
  if (options.images.empty() && options.list.empty()) refuse("detect needs images or --list FILE.csv");
  if (!(options.tag_size >= 0.0 && std::isfinite(options.tag_size))) refuse("--tag-size must be positive, in m");
  const std::optional<CameraFile> camera =
      options.camera.empty() ? std::nullopt : std::optional(CameraFile::load(options.camera));
  const std::map<int, double> sizes = sizes_of(options.sizes);
  const std::vector<Job> jobs = jobs_of(options);
  Detectors detectors(options);
  for (const Job& job : jobs) (void)detectors.of(job.family);  // a wrong family is known before the work begins
  Album album(options.annotate);
  Report report(options, out);

  bool all_read = true;
  for (const Job& job : jobs) {
    const auto image = read_grey(job.file);
    if (const std::string* sentence = std::get_if<std::string>(&image)) {
      std::cerr << "tagdock: " << *sentence << "\n";
      report.add_unreadable(job, *sentence);
      all_read = false;
      continue;
    }
    const cv::Mat1b& gray = std::get<cv::Mat1b>(image);
    Seen seen{&job, gray.size(), camera_of(job, camera, gray.size()), {}};
    for (const TagDetection& detection : detectors.of(job.family).detect(gray)) {
      if (is_clutter(gray, job.family, detection, seen.camera)) {
        std::cerr << "tagdock: " << job.name << ": " << job.family << " " << detection.id
                  << " is not shown: its code was read, but black and white do not lie as on that tag\n";
        continue;
      }
      const auto size = sizes.find(detection.id);
      seen.tags.push_back(look_at(gray, job.family, detection, *method, seen.camera,
                                  size == sizes.end() ? job.tag_size : size->second));
    }
    report.add(seen);
    album.add(gray, seen);
  }
  report.finish();
  return static_cast<int>(all_read ? ExitCode::done : ExitCode::usage);
}

namespace {

const char* const details =
    "Output, one line a tag (SI, px; pixel (0, 0) is the centre of the top-left pixel):\n"
    "  image,id              as given; the tag's number\n"
    "  x0,y0..x3,y3          corners as the tag is read: top left, top right, bottom right, bottom left\n"
    "  time_ms               CPU time of this tag's refinement and pose\n"
    "  tx,ty,tz,qx,qy,qz,qw  T_camera_tag (camera x right, y down, z out of the lens; tag x right, y down, z into the\n"
    "                        wall); empty without camera or size, or if no pose explains the corners\n"
    "  hamming,margin        corrected bits; AprilTag's decision margin\n"
    "  residual_rms,chi2     grey levels; per pixel, about 1 if the model explains the image, 0 if it cannot tell\n"
    "  sigma_x0..sigma_y3    1-sigma of each coordinate\n"
    "  sxx,sxy..scc          upper triangle, row by row, of the pose's 6x6 covariance: x y z [m] and a b c, turns "
    "about\n"
    "                        the camera's x y z [rad], of a small motion on the left of T_camera_tag\n"
    "  reprojection_rms      px, of the pose\n"
    "  tx2..qw2,log_odds     the second pose that explains a flat tag, and the log of the odds of the first against "
    "it\n"
    "  blur_px,terms         sigma of the edges' spread; which terms of the model were on\n"
    "  unrefined             empty, or why the corners are the library's own: too_few_pixels, left_the_edge,\n"
    "                        did_not_converge, not_a_quadrilateral, other_pattern\n"
    "  tag_size              m, as used\n"
    "  pose_warnings         empty, or words joined by +: ambiguous (the odds of the poses are below 150 to 1),\n"
    "                        yaw_undetermined (near frontal: turns about axes in the tag's plane are not told)\n"
    "--json writes one object {images: [{image, width, height, tags: [{id, corners_px, sigma_px, hamming, margin,\n"
    "  residual_rms, chi2_per_pixel, blur_px, terms, unrefined, time_ms, pose_warnings, tag_size, log_odds, poses: "
    "[{T_camera_tag,\n"
    "  covariance, reprojection_rms_px, chi2}]}]}], unreadable: [{image, reason}]}.\n"
    "Exit code 2 if an image could not be read; the others are still done.";

}  // namespace

void add_detect(CLI::App& program, Action& action) {
  const auto options = std::make_shared<DetectOptions>();
  CLI::App* verb = program.add_subcommand("detect", "images -> tags, corners, poses");
  verb->add_option("images", options->images, "image files (PNG, JPEG, PGM ...; 8 or 16 bit, grey or colour)");
  verb->add_option("--list", options->list,
                   "CSV with the column image and, if wanted, family,tag_size,fx,fy,cx,cy,k1,k2,p1,p2,k3 per image");
  verb->add_option("--root", options->root, "folder that image paths are relative to (default: the list's own)");
  verb->add_option(
      "--camera", options->camera,
      "camera file: ROS camera_info, OpenCV YAML, ViSP XML, Kalibr camchain, mrcal .cameramodel, rig YAML");
  verb->add_option("--family", options->family, "tag family")->capture_default_str();
  verb->add_option("--tag-size", options->tag_size, "side of the black square [m]");
  verb->add_option("--sizes", options->sizes, "CSV id,size: side of the black square per tag [m]");
  verb->add_option("--method", options->method, "corners: apriltag, tanh, filter, erf or best")->capture_default_str();
  verb->add_option("--decimate", options->decimate, "find on an image this much smaller, 1 to 4; 1 finds the most")
      ->capture_default_str();
  verb->add_option("--max-hamming", options->max_hamming, "corrected bits allowed, 0 to 2")->capture_default_str();
  verb->add_option("--output", options->output, "write there instead of to stdout");
  verb->add_option("--annotate", options->annotate,
                   "folder for pictures with outline, id, corners, axes, magnified uncertainty and residuals");
  verb->add_option("--explain", options->explain, "instead: one HTML page per tag of this image, on how it was fitted");
  verb->add_option("--pages", options->pages, "folder for the pages of --explain")->capture_default_str();
  verb->add_flag("--json", options->json, "one JSON object instead of CSV");
  verb->footer(details);
  verb->callback([options, &action] {
    action = [options] { return options->explain.empty() ? detect_images(*options) : explain_image(*options); };
  });
}

}  // namespace tagdock
