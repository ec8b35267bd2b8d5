#include "app/replay_difference.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdio>
#include <map>
#include <optional>
#include <sstream>

#include <Eigen/Geometry>

namespace tagdock {
namespace {

std::vector<std::string> split(const std::string& line) {
  std::vector<std::string> fields;
  std::istringstream stream(line);
  for (std::string field; std::getline(stream, field, ',');) fields.push_back(field);
  return fields;
}

double number(const std::string& text) {
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size() ? value : std::nan("");
}

/// Pose of the station by frame, none where it was not seen.
using Poses = std::map<std::string, std::optional<Eigen::Isometry3d>>;

Poses poses_of(const std::vector<std::string>& lines) {
  Poses poses;
  for (const std::string& line : lines) {
    const auto fields = split(line);
    if (fields.size() < 3) continue;
    std::optional<Eigen::Isometry3d>& pose = poses[fields[1]];
    if (fields[2] != "board" || fields.size() < 10) continue;
    const Eigen::Vector3d t(number(fields[3]), number(fields[4]), number(fields[5]));
    const Eigen::Quaterniond q(number(fields[9]), number(fields[6]), number(fields[7]), number(fields[8]));
    if (!t.allFinite() || !q.coeffs().allFinite() || q.norm() < 0.5) continue;
    pose = Eigen::Translation3d(t) * q.normalized();
  }
  return poses;
}

double quantile(std::vector<double>& values, double part) {
  if (values.empty()) return 0.0;
  std::sort(values.begin(), values.end());
  return values[static_cast<std::size_t>(part * static_cast<double>(values.size() - 1))];
}

std::string phases_of(const std::vector<std::string>& lines, double until_ns) {
  std::string text;
  for (const std::string& line : lines)
    if (const auto fields = split(line); fields.size() >= 3 && !(number(fields[0]) > until_ns))
      text += (text.empty() ? fields[1] + " > " : " > ") + fields[2];
  return text;
}

}  // namespace

ReplayDifference difference(const Session& session, const ReplayResult& result) {
  ReplayDifference made;
  const Poses then = poses_of(session.sightings);
  const Poses now = poses_of(result.sighting_lines);
  std::vector<double> shifts, turns;
  for (const auto& [frame, pose] : now) {
    const auto found = then.find(frame);
    const bool seen_then = found != then.end() && found->second.has_value();
    if (pose && seen_then) {
      ++made.seen_by_both;
      const Eigen::Isometry3d change = found->second->inverse() * *pose;
      shifts.push_back(1e3 * (pose->translation() - found->second->translation()).norm());
      turns.push_back(Eigen::AngleAxisd(change.linear()).angle() * 180.0 / 3.14159265358979323846);
    } else if (pose) {
      ++made.only_replayed;
    } else if (seen_then) {
      ++made.only_recorded;
    }
  }
  made.shift_median_mm = quantile(shifts, 0.5);
  made.shift_95_mm = quantile(shifts, 0.95);
  made.shift_largest_mm = quantile(shifts, 1.0);
  made.turn_median_deg = quantile(turns, 0.5);
  made.turn_95_deg = quantile(turns, 0.95);
  made.turn_largest_deg = quantile(turns, 1.0);

  made.commands_compared = std::min(session.commands.size(), result.command_lines.size());
  for (std::size_t i = 0; i < made.commands_compared; ++i) {
    if (session.commands[i] == result.command_lines[i]) continue;
    const auto old_fields = split(session.commands[i]);
    const auto new_fields = split(result.command_lines[i]);
    if (old_fields.size() < 4 || new_fields.size() < 4) continue;
    ++made.commands_different;
    const double linear = std::abs(number(new_fields[1]) - number(old_fields[1]));
    const double angular = std::abs(number(new_fields[2]) - number(old_fields[2]));
    if (std::isfinite(linear)) made.linear_largest = std::max(made.linear_largest, linear);
    if (std::isfinite(angular)) made.angular_largest = std::max(made.angular_largest, angular);
    if (!made.first_different_command.empty()) continue;
    char text[300];
    std::snprintf(text, sizeof text, "%.2f s, %s: %.4f m/s and %.4f rad/s then, %.4f m/s and %.4f rad/s (%s) now",
                  1e-9 * number(old_fields[0]), old_fields[3].c_str(), number(old_fields[1]), number(old_fields[2]),
                  number(new_fields[1]), number(new_fields[2]), new_fields[3].c_str());
    made.first_different_command = text;
  }
  const auto last = result.command_lines.empty() ? std::vector<std::string>{} : split(result.command_lines.back());
  const double until_ns = last.empty() ? 0.0 : number(last.front());
  made.phases_recorded = phases_of(session.phases, result.ended_early ? until_ns : HUGE_VAL);
  made.phases_replayed = phases_of(result.phase_lines, HUGE_VAL);
  return made;
}

std::string words(const ReplayDifference& difference) {
  char text[600];
  std::snprintf(text, sizeof text,
                "seen: the board in %llu frames then and now, in %llu only then, in %llu only now\n"
                "      the station stands apart by %.2f mm (95 %%: %.2f, largest %.2f) and %.3f deg (95 %%: %.3f, "
                "largest %.3f)\n"
                "done: %llu of %llu commands differ, by up to %.4f m/s and %.4f rad/s, on the motion as recorded\n",
                static_cast<unsigned long long>(difference.seen_by_both),
                static_cast<unsigned long long>(difference.only_recorded),
                static_cast<unsigned long long>(difference.only_replayed), difference.shift_median_mm,
                difference.shift_95_mm, difference.shift_largest_mm, difference.turn_median_deg, difference.turn_95_deg,
                difference.turn_largest_deg, static_cast<unsigned long long>(difference.commands_different),
                static_cast<unsigned long long>(difference.commands_compared), difference.linear_largest,
                difference.angular_largest);
  std::string all(text);
  if (!difference.first_different_command.empty()) all += "      first at " + difference.first_different_command + "\n";
  if (difference.phases_recorded == difference.phases_replayed)
    all += "phases: the same\n";
  else
    all += "phases then: " + difference.phases_recorded + "\nphases now:  " + difference.phases_replayed + "\n";
  return all;
}

}  // namespace tagdock
