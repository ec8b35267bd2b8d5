#include "app/docking_report.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace tagdock {
namespace {

const Fix* fix_of(const Phase& phase) {
  if (const Docked* docked = std::get_if<Docked>(&phase)) return &docked->fix;
  if (const Failed* failed = std::get_if<Failed>(&phase); failed != nullptr && failed->fix) return &*failed->fix;
  return nullptr;
}

nlohmann::ordered_json pose_json(const Pose2& pose) {
  return {{"x", pose.x}, {"y", pose.y}, {"yaw", wrap_angle(pose.yaw)}};
}

std::string error_words(const Pose2& error) {
  char text[96];
  std::snprintf(text, sizeof text, "x %+.1f mm, y %+.1f mm, yaw %+.2f deg", 1e3 * error.x, 1e3 * error.y,
                degrees(wrap_angle(error.yaw)));
  return text;
}

}  // namespace

double quantile(std::vector<double> values, double p) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  const double place = p * static_cast<double>(values.size() - 1);
  const auto below = static_cast<std::size_t>(std::floor(place));
  const std::size_t above = std::min(below + 1, values.size() - 1);
  return values[below] + (place - static_cast<double>(below)) * (values[above] - values[below]);
}

ExitCode exit_code(const DockingReport& report) {
  if (report.interrupted) return ExitCode::interrupted;
  if (std::holds_alternative<Docked>(report.last) || std::holds_alternative<Undocked>(report.last))
    return ExitCode::done;
  const std::optional<Reason> reason = reason_of(report.last);
  if (!reason) return ExitCode::internal;
  switch (reason->cause) {
    case Cause::tag_never_seen:
    case Cause::wrong_tags:
      return ExitCode::tag_never_seen;
    case Cause::camera_lost:
    case Cause::camera_slow:
      return ExitCode::camera;
    case Cause::odometry_stale:
    case Cause::odometry_invalid:
    case Cause::odometry_jump:
    case Cause::robot_link:
    case Cause::stalled:
    case Cause::slipped:
      return ExitCode::robot_link;
    case Cause::stopped_by_person:
    case Cause::cancelled:
      return ExitCode::stopped;
    default:
      return ExitCode::failed;
  }
}

nlohmann::ordered_json to_json(const DockingReport& report) {
  nlohmann::ordered_json json;
  json["schema"] = "tagdock-docking/1";
  json["result"] = report.interrupted ? "interrupted" : std::string(name(report.last));
  const std::optional<Reason> reason = reason_of(report.last);
  json["reason"] = reason ? reason->sentence : report.interrupted ? "interrupted by a person" : "";
  std::string cause = reason ? std::string(word(reason->cause)) : "";
  std::replace(cause.begin(), cause.end(), ' ', '_');
  json["cause"] = cause;
  json["exit_code"] = static_cast<int>(exit_code(report));
  json["attempts"] = job_of(report.last).attempts;
  json["duration_s"] = std::chrono::duration<double>(report.duration).count();
  nlohmann::ordered_json estimated = nullptr;
  if (const Fix* fix = fix_of(report.last)) {
    estimated = pose_json(fix->error);
    for (int row = 0; row < 3; ++row)
      estimated["covariance"].push_back({fix->covariance(row, 0), fix->covariance(row, 1), fix->covariance(row, 2)});
    estimated["sightings"] = fix->sightings;
    estimated["chi2"] = fix->chi2;
    estimated["taught"] = report.taught;
  }
  json["final"]["pose_error_estimated"] = estimated;
  json["final"]["pose_error_true"] =
      report.true_error ? pose_json(*report.true_error) : nlohmann::ordered_json(nullptr);
  json["phases"] = nlohmann::ordered_json::array();
  for (const auto& phase : report.phases)
    json["phases"].push_back({{"name", phase.name}, {"start_ns", phase.start.count()}, {"end_ns", phase.end.count()}});
  if (report.stands) json["final"]["camera_point_estimated"] = pose_json(*report.stands);
  json["camera"] = {{"frames", report.camera.received},
                    {"used", report.frame_ages_ms.size()},
                    {"lost", report.camera.lost},
                    {"incomplete", report.camera.incomplete},
                    {"overwritten", report.camera.overwritten},
                    {"reconnects", report.camera.reconnects},
                    {"age_p50_ms", quantile(report.frame_ages_ms, 0.5)},
                    {"age_p95_ms", quantile(report.frame_ages_ms, 0.95)},
                    {"age_p99_ms", quantile(report.frame_ages_ms, 0.99)}};
  json["sightings"] = report.sightings;
  json["seed"] = report.seed;
  return json;
}

std::string summary(const DockingReport& report) {
  std::string text;
  const std::optional<Reason> reason = reason_of(report.last);
  const int attempts = job_of(report.last).attempts;
  char line[160];
  std::snprintf(line, sizeof line, "%s after %.1f s and %d attempt%s",
                report.interrupted ? "interrupted" : std::string(name(report.last)).c_str(),
                std::chrono::duration<double>(report.duration).count(), attempts, attempts == 1 ? "" : "s");
  text += line;
  if (reason) text += ": " + reason->sentence;
  text += "\n";
  if (const Fix* fix = fix_of(report.last)) {
    std::snprintf(line, sizeof line, "  (sigma %.1f mm, %.1f mm, %.2f deg; %d sightings)",
                  1e3 * std::sqrt(fix->covariance(0, 0)), 1e3 * std::sqrt(fix->covariance(1, 1)),
                  degrees(std::sqrt(fix->covariance(2, 2))), fix->sightings);
    text += "final error, estimated: " + error_words(fix->error) + line + "\n";
    if (!report.taught)
      text +=
          "  against a docking pose that was not taught: what camera calibration and board survey leave is not in it\n";
  }
  if (report.true_error && !std::holds_alternative<Undocked>(report.last))
    text += "final error, true:      " + error_words(*report.true_error) + "\n";
  if (report.stands && std::holds_alternative<Undocked>(report.last)) {
    std::snprintf(line, sizeof line,
                  "the camera stands %.3f m before the board, %+.1f mm to the left of its middle, turned %+.2f deg\n",
                  -report.stands->x, 1e3 * report.stands->y, degrees(wrap_angle(report.stands->yaw)));
    text += line;
  }
  std::snprintf(line, sizeof line,
                "camera: %zu frames used of %llu received, %llu lost, age %.0f ms (95 %%: %.0f ms)\n",
                report.frame_ages_ms.size(), static_cast<unsigned long long>(report.camera.received),
                static_cast<unsigned long long>(report.camera.lost), quantile(report.frame_ages_ms, 0.5),
                quantile(report.frame_ages_ms, 0.95));
  return text + line;
}

}  // namespace tagdock
