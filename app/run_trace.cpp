#include "app/run_trace.h"

#include <cmath>
#include <cstdio>
#include <fstream>
#include <sstream>
#include <string>

#include "app/failure.h"

namespace tagdock {

std::optional<StartLook> start_look(const RunTrace& trace) {
  constexpr double still = 2e-4;  // m and rad
  Pose2 sum;
  int count = 0;
  for (const TracePoint& point : trace) {
    const Pose2& first = trace.front().camera_point;
    const Pose2& now = point.camera_point;
    if (std::hypot(now.x - first.x, now.y - first.y) > still || std::abs(wrap_angle(now.yaw - first.yaw)) > still)
      break;
    if (!point.seen) continue;
    ++count;
    sum.x += point.seen->x;
    sum.y += point.seen->y;
    sum.yaw += wrap_angle(point.seen->yaw - first.yaw);
  }
  if (count == 0) return std::nullopt;
  const Pose2& truth = trace.front().camera_point;
  return StartLook{truth, {sum.x / count, sum.y / count, wrap_angle(truth.yaw + sum.yaw / count)}};
}

void write_trace(const std::filesystem::path& file, const RunTrace& trace) {
  std::ofstream stream(file, std::ios::binary);
  stream << "time_s,x,y,yaw,reprojection_px,seen_x,seen_y,seen_yaw\n";
  char text[256];
  for (const TracePoint& point : trace) {
    const Pose2& pose = point.camera_point;
    std::snprintf(text, sizeof text, "%.3f,%.6f,%.6f,%.7f,", point.time_s, pose.x, pose.y, pose.yaw);
    stream << text;
    if (point.reprojection_px) {
      std::snprintf(text, sizeof text, "%.5f", *point.reprojection_px);
      stream << text;
    }
    if (point.seen) {
      std::snprintf(text, sizeof text, ",%.6f,%.6f,%.7f\n", point.seen->x, point.seen->y, point.seen->yaw);
      stream << text;
    } else {
      stream << ",,,\n";
    }
  }
  stream.flush();
  if (!stream) throw Failure(ExitCode::usage, file.string() + ": cannot be written (is the disk full?)");
}

RunTrace read_trace(const std::filesystem::path& file) {
  std::ifstream stream(file);
  RunTrace trace;
  std::string one;
  std::getline(stream, one);
  for (int number = 2; std::getline(stream, one); ++number) {
    TracePoint point;
    Pose2& pose = point.camera_point;
    double reprojection = 0.0;
    Pose2 seen;
    const int read = std::sscanf(one.c_str(), "%lf,%lf,%lf,%lf,%lf,%lf,%lf,%lf", &point.time_s, &pose.x, &pose.y,
                                 &pose.yaw, &reprojection, &seen.x, &seen.y, &seen.yaw);
    if (read < 4)
      throw Failure(ExitCode::usage, file.string() + ":" + std::to_string(number) +
                                         ": must have time_s,x,y,yaw and, with a sighting, what it saw");
    if (read > 4) point.reprojection_px = reprojection;
    if (read == 8) point.seen = seen;
    trace.push_back(point);
  }
  return trace;
}

}  // namespace tagdock
