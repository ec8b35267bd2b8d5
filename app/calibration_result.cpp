#include "app/calibration_result.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <fstream>
#include <iostream>

#include "app/failure.h"
#include "planning/pose2.h"

namespace tagdock {
namespace {

using Json = nlohmann::ordered_json;

std::string scalar(const Json& value) {
  std::string text = value.is_null() ? "~" : value.dump();
  // YAML 1.1 takes a number with an exponent and without a point for a word.
  if (value.is_number_float()) {
    const std::size_t exponent = text.find('e');
    if (exponent != std::string::npos && text.find('.') == std::string::npos) text.insert(exponent, ".0");
  }
  return text;
}

std::string on_one_line(const Json& value) {
  if (!value.is_structured()) return scalar(value);
  std::string text;
  for (const auto& [key, inner] : value.items()) {
    if (!text.empty()) text += ", ";
    if (value.is_object()) text += key + ": ";
    text += on_one_line(inner);
  }
  return value.is_object() ? "{" + text + "}" : "[" + text + "]";
}

void write(std::string& text, const Json& map, int indent) {
  const std::string space(static_cast<std::size_t>(indent), ' ');
  for (const auto& [key, value] : map.items()) {
    text += space + key + ":";
    const bool rows = value.is_array() && !value.empty() && value.front().is_structured();
    if (value.is_object() && on_one_line(value).size() + key.size() > 110) {
      text += "\n";
      write(text, value, indent + 2);
    } else if (rows) {
      text += "\n";
      for (const Json& row : value) text += space + "  - " + on_one_line(row) + "\n";
    } else {
      text += " " + on_one_line(value) + "\n";
    }
  }
}

}  // namespace

Json camera_block(const CameraModel& camera) {
  std::vector<double> dist{camera.k1, camera.k2, camera.p1, camera.p2, camera.k3};
  if (camera.k4 != 0.0 || camera.k5 != 0.0 || camera.k6 != 0.0)
    dist.insert(dist.end(), {camera.k4, camera.k5, camera.k6});
  return {{"width", camera.width}, {"height", camera.height}, {"fx", camera.fx}, {"fy", camera.fy},
          {"cx", camera.cx},       {"cy", camera.cy},         {"dist", dist}};
}

Json transform_block(const Eigen::Isometry3d& T) {
  Eigen::Quaterniond q(T.linear());
  q.normalize();
  return {{"t", {T.translation().x(), T.translation().y(), T.translation().z()}},
          {"q_xyzw", {q.x(), q.y(), q.z(), q.w()}}};
}

Json board_block(const Board& board) {
  Json tags = Json::array();
  for (const BoardTag& tag : board.tags)
    tags.push_back({{"id", tag.id}, {"size", tag.size}, {"T_station_tag", transform_block(tag.T_station_tag)}});
  return {{"family", board.family}, {"tags", tags}};
}

Json hand_eye_block(const HandEyeProblem& problem, const HandEyeResult& result) {
  Json block;
  block["camera"] = camera_block(problem.camera);
  block["T_base_cam"] = transform_block(result.T_base_camera);
  if (problem.by_wheels)
    block["odometry"] = {
        {"r_left", result.odometry.r_left}, {"r_right", result.odometry.r_right}, {"track", result.odometry.track}};
  block["T_base_cam_sigma"] = {{"xy_mm", 1000.0 * result.xy_sigma},
                               {"z_mm", 1000.0 * result.z_sigma},
                               {"rot_deg", degrees(result.rotation_sigma)}};
  block["unobservable"] = Json::array();
  Json cures = Json::array();
  for (const Unobservable& open : result.unobservable) {
    block["unobservable"].push_back(open.word);
    cures.push_back({{"direction", open.word}, {"cure", open.cure}});
  }
  // What `dock` may lean on: a height that the drive left open is no measurement.
  block["height_known"] = std::none_of(result.unobservable.begin(), result.unobservable.end(),
                                       [](const Unobservable& open) { return open.word == "height"; });
  block["rejected_views"] = Json::array();
  Json stops = Json::array();
  for (const StopResidual& stop : result.stops) {
    if (!stop.used && stop.corners > 0) block["rejected_views"].push_back(stop.id);
    stops.push_back({{"stop", stop.id},
                     {"used", stop.used},
                     {"reason", stop.reason},
                     {"frontal", stop.frontal},
                     {"bearing_deg", stop.bearing_deg},
                     {"distance", stop.distance},
                     {"corners", stop.corners},
                     {"corners_set_aside", stop.corners_set_aside},
                     {"corner_rms_px", stop.corner_rms_px},
                     {"base_mm", stop.base_mm},
                     {"base_deg", stop.base_deg}});
  }
  block["verdict"] = result.complaints.empty() ? "good" : "refused";
  Json quality;
  quality["kind"] = "hand-eye";
  quality["reasons"] = result.complaints;
  quality["cures"] = cures;
  quality["chi2_per_residual"] = result.chi2_per_residual;
  quality["corner_noise_over_stated"] = result.corner_scale;
  quality["motion_noise_over_stated"] = result.motion_scale;
  if (problem.by_wheels) {
    quality["floor_tilt_sigma_deg"] = degrees(result.floor_tilt_sigma);
    quality["odometry_sigma"] = {{"r_left", std::sqrt(result.covariance(6, 6))},
                                 {"r_right", std::sqrt(result.covariance(7, 7))},
                                 {"track", std::sqrt(result.covariance(8, 8))}};
  }
  quality["of_camera"] = {{"known", !problem.camera_covariance.isZero(0.0)},
                          {"xy_mm", 1000.0 * result.camera_xy_sigma},
                          {"rot_deg", degrees(result.camera_rotation_sigma)}};
  quality["heading_spread_deg"] = degrees(result.heading_spread);
  quality["travel"] = result.travel;
  quality["posterior_over_prior"] = result.direction_ratios;
  quality["posterior_over_prior_of"] = result.direction_words;
  quality["T_reference_board"] = transform_block(result.T_reference_board);
  const Eigen::Isometry3d off = result.T_base_camera.inverse() * result.visp.T_base_camera;
  quality["visp"] = {{"solved", result.visp.solved}};
  if (result.visp.solved)
    quality["visp"] = {
        {"solved", true},
        {"T_base_cam", transform_block(result.visp.T_base_camera)},
        {"differs_xy_mm",
         1000.0 * (result.visp.T_base_camera.translation() - result.T_base_camera.translation()).head<2>().norm()},
        {"differs_deg", degrees(Eigen::AngleAxisd(off.linear()).angle())}};
  quality["stops"] = stops;
  block["quality"] = quality;
  std::vector<double> covariance(static_cast<std::size_t>(result.covariance.size()));
  Eigen::Map<Eigen::MatrixXd>(covariance.data(), result.covariance.rows(), result.covariance.cols()) =
      result.covariance;
  block["T_base_cam_covariance"] = covariance;
  return block;
}

Json intrinsics_block(const IntrinsicsResult& result, const std::vector<std::string>& unreadable) {
  const auto finite = [](double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); };
  Json block;
  block["camera"] = camera_block(result.camera);
  block["projection_sigma_px"] = {{"max", finite(result.sigma_max_px)}, {"center", finite(result.sigma_center_px)}};
  block["rejected_views"] = Json::array();
  Json views = Json::array();
  int used = 0;
  for (const ViewResidual& view : result.views) {
    used += view.used ? 1 : 0;
    if (!view.used) block["rejected_views"].push_back(view.name);
    views.push_back({{"name", view.name},
                     {"used", view.used},
                     {"reason", view.reason},
                     {"corners", view.corners},
                     {"corners_set_aside", view.corners_set_aside},
                     {"rms_px", view.rms_px},
                     {"blur_px", view.blur_px},
                     {"tilt_deg", view.tilt_deg},
                     {"distance", view.distance}});
  }
  block["verdict"] = result.complaints.empty() ? "good" : "refused";
  Json quality;
  quality["kind"] = "intrinsics";
  quality["reasons"] = result.complaints;
  quality["missing"] = result.missing;
  quality["views_used"] = used;
  quality["lens_model"] = std::string(word(result.lens));
  Json ladder = Json::array();
  for (const IntrinsicsResult::Step& step : result.ladder)
    ladder.push_back({{"lens_model", std::string(word(step.lens))}, {"held_out_sigmas", step.held_out}});
  quality["ladder"] = ladder;
  quality["rms_px"] = result.rms_px;
  quality["corner_noise_over_fit"] = result.noise_scale;
  quality["neighbours_agree"] = result.neighbours_agree;
  quality["systematic_px"] = result.systematic_px;
  // Too few views for two halves: nothing was compared, and a zero would say that they agree.
  const bool halved = result.halves_expected_px > 0.0;
  quality["halves_differ_px"] = halved ? finite(result.halves_px) : Json(nullptr);
  quality["halves_expected_px"] = halved ? finite(result.halves_expected_px) : Json(nullptr);
  quality["board_bow_mm"] = 1000.0 * result.board.bow();
  quality["board_x_over_y"] = 1.0 + result.board.value[BoardShape::stretch];
  quality["unreadable"] = unreadable;
  quality["views"] = views;
  block["quality"] = quality;
  block["camera_covariance"] =
      std::vector<double>(result.covariance.data(), result.covariance.data() + result.covariance.size());
  return block;
}

std::string to_yaml(const Json& value) {
  std::string text;
  write(text, value, 0);
  return text;
}

void write_result(const std::filesystem::path& file, const nlohmann::ordered_json& block) {
  if (block.value("verdict", "") == "refused") {
    std::ifstream before(file);
    std::string row;
    bool good = false;
    while (!good && std::getline(before, row)) good = row == "verdict: good" || row == "verdict: \"good\"";
    if (good) {
      const std::filesystem::path kept = file.string() + ".good";
      std::error_code error;
      std::filesystem::rename(file, kept, error);
      if (error) throw Failure(ExitCode::usage, "--output " + file.string() + ": " + error.message());
      std::cerr << file.string() << ": the good calibration in it is kept as " << kept.string() << "\n";
    }
  }
  write_whole(file, to_yaml(block));
}

void write_whole(const std::filesystem::path& file, const std::string& text, const std::string& option) {
  const std::filesystem::path beside = file.string() + ".part";
  {
    std::ofstream stream(beside, std::ios::binary | std::ios::trunc);
    stream << text;
    stream.flush();
    if (!stream) throw Failure(ExitCode::usage, option + " " + file.string() + ": cannot be written");
  }
  std::error_code error;
  std::filesystem::rename(beside, file, error);
  if (error) throw Failure(ExitCode::usage, option + " " + file.string() + ": " + error.message());
}

}  // namespace tagdock
