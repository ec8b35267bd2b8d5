#include "app/tracker.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <sstream>

#include <Eigen/Cholesky>
#include <Eigen/Core>

#include "app/failure.h"

namespace tagdock {
namespace {

std::vector<std::string> fields_of(const std::string& line) {
  std::vector<std::string> fields;
  std::string field;
  std::istringstream stream(line);
  while (std::getline(stream, field, ',')) {
    while (!field.empty() && (field.back() == '\r' || field.back() == ' ')) field.pop_back();
    fields.push_back(field);
  }
  return fields;
}

// The pose between two times; none outside or across a gap of more than `longest` seconds.
template <typename Moments, typename TimeOf, typename PoseOf>
std::optional<Pose2> pose_at(const Moments& moments, double time, double longest, TimeOf time_of, PoseOf pose_of) {
  const auto after = std::lower_bound(moments.begin(), moments.end(), time,
                                      [&](const auto& moment, double value) { return time_of(moment) < value; });
  if (after == moments.end() || after == moments.begin()) return std::nullopt;
  const auto before = after - 1;
  const double span = time_of(*after) - time_of(*before);
  if (span > longest || span <= 0.0) return std::nullopt;
  const double share = (time - time_of(*before)) / span;
  const Pose2 a = pose_of(*before);
  const Pose2 b = pose_of(*after);
  return Pose2{a.x + share * (b.x - a.x), a.y + share * (b.y - a.y), a.yaw + share * wrap_angle(b.yaw - a.yaw)};
}

constexpr double longest_gap = 0.5;  // s

std::optional<Pose2> tracker_at(const std::vector<TrackerReading>& tracker, double time) {
  return pose_at(
      tracker, time, longest_gap, [](const TrackerReading& one) { return one.time_s; },
      [](const TrackerReading& one) { return one.T_tracker_body; });
}

std::optional<Pose2> estimate_at(const DrivenWay& way, double time) {
  return pose_at(
      way.estimates, time, longest_gap, [](const DrivenWay::Moment& one) { return one.time_s; },
      [](const DrivenWay::Moment& one) { return one.T_station_base; });
}

// Turn rate [rad/s] and speed [m/s] every `grid` seconds.
constexpr double grid = 0.05;
struct Rates {
  double start = 0.0;
  std::vector<std::array<double, 2>> values;
  std::vector<bool> known;
};

template <typename PoseAt>
Rates rates_of(double start, double end, PoseAt pose_at_time) {
  Rates rates;
  rates.start = start;
  for (double time = start; time < end; time += grid) {
    const std::optional<Pose2> before = pose_at_time(time - grid);
    const std::optional<Pose2> after = pose_at_time(time + grid);
    rates.known.push_back(before && after);
    std::array<double, 2> value{};
    if (before && after)
      value = {wrap_angle(after->yaw - before->yaw) / (2.0 * grid),
               std::hypot(after->x - before->x, after->y - before->y) / (2.0 * grid)};
    rates.values.push_back(value);
  }
  return rates;
}

// How well two series go together when the second is `shift` steps later; the smaller of the two quantities' weights
// is made up by their own sizes.
double agreement(const Rates& a, const Rates& b, int shift) {
  double product = 0.0, square_a = 0.0, square_b = 0.0;
  int count = 0;
  for (std::size_t i = 0; i < a.values.size(); ++i) {
    const auto j = static_cast<std::ptrdiff_t>(i) + shift;
    if (j < 0 || j >= static_cast<std::ptrdiff_t>(b.values.size())) continue;
    if (!a.known[i] || !b.known[static_cast<std::size_t>(j)]) continue;
    for (std::size_t k = 0; k < 2; ++k) {
      const double weight = k == 0 ? 1.0 : 2.0;  // 0.2 m/s weigh as much as 0.4 rad/s
      const double x = weight * a.values[i][k];
      const double y = weight * b.values[static_cast<std::size_t>(j)][k];
      product += x * y;
      square_a += x * x;
      square_b += y * y;
    }
    ++count;
  }
  constexpr int least = 40;  // 2 s
  if (count < least || square_a <= 0.0 || square_b <= 0.0) return -1.0;
  return product / std::sqrt(square_a * square_b);
}

Pose2 plus(const Pose2& pose, const Eigen::Vector3d& step) {
  return {pose.x + step.x(), pose.y + step.y(), wrap_angle(pose.yaw + step.z())};
}

Eigen::Vector3d misfit(const TrackerFrames& frames, const Pose2& T_station_base, const Pose2& T_tracker_body) {
  const Pose2 expected = frames.T_tracker_station * T_station_base * frames.T_base_body;
  return {expected.x - T_tracker_body.x, expected.y - T_tracker_body.y, wrap_angle(expected.yaw - T_tracker_body.yaw)};
}

}  // namespace

std::vector<TrackerReading> read_tracker(const std::filesystem::path& file) {
  std::ifstream stream(file);
  if (!stream) throw Failure(ExitCode::usage, "--tracker " + file.string() + ": cannot be read");
  std::string line;
  std::getline(stream, line);
  const std::vector<std::string> names = fields_of(line);
  const auto column = [&](const std::string& name) {
    const auto found = std::find(names.begin(), names.end(), name);
    return found == names.end() ? -1 : static_cast<int>(found - names.begin());
  };
  const int seconds = column("time_s");
  const int nanoseconds = column("time_ns");
  const int yaw = column("yaw");
  const int yaw_deg = column("yaw_deg");
  const std::array<int, 4> quaternion = {column("qx"), column("qy"), column("qz"), column("qw")};
  const bool turns = *std::min_element(quaternion.begin(), quaternion.end()) >= 0;
  if ((seconds < 0 && nanoseconds < 0) || column("x") < 0 || column("y") < 0 || (yaw < 0 && yaw_deg < 0 && !turns))
    throw Failure(ExitCode::usage, file.string() +
                                       ":1: needs the columns time_s (or time_ns), x, y and yaw (or yaw_deg, "
                                       "or qx, qy, qz, qw); it has '" +
                                       line + "'");
  std::vector<TrackerReading> readings;
  for (int number = 2; std::getline(stream, line); ++number) {
    const std::vector<std::string> fields = fields_of(line);
    if (fields.empty()) continue;
    const auto value = [&](int place) {
      const auto index = static_cast<std::size_t>(place);
      char* end = nullptr;
      const double number_read = index < fields.size() ? std::strtod(fields[index].c_str(), &end) : 0.0;
      if (index >= fields.size() || fields[index].empty() || *end != '\0' || !std::isfinite(number_read))
        throw Failure(ExitCode::usage, file.string() + ":" + std::to_string(number) + ": column " + names[index] +
                                           " is '" + (index < fields.size() ? fields[index] : "") +
                                           "'; it must be a number");
      return number_read;
    };
    TrackerReading reading;
    reading.time_s = seconds >= 0 ? value(seconds) : 1e-9 * value(nanoseconds);
    reading.T_tracker_body.x = value(column("x"));
    reading.T_tracker_body.y = value(column("y"));
    if (yaw >= 0) {
      reading.T_tracker_body.yaw = value(yaw);
    } else if (yaw_deg >= 0) {
      reading.T_tracker_body.yaw = radians(value(yaw_deg));
    } else {
      const double qx = value(quaternion[0]), qy = value(quaternion[1]), qz = value(quaternion[2]),
                   qw = value(quaternion[3]);
      reading.T_tracker_body.yaw = std::atan2(2.0 * (qw * qz + qx * qy), 1.0 - 2.0 * (qy * qy + qz * qz));
    }
    if (!readings.empty() && reading.time_s <= readings.back().time_s)
      throw Failure(ExitCode::usage, file.string() + ":" + std::to_string(number) + ": its time does not rise");
    readings.push_back(reading);
  }
  if (readings.size() < 10) throw Failure(ExitCode::usage, file.string() + ": has fewer than 10 readings");
  return readings;
}

ClockOffset align_clocks(const std::vector<TrackerReading>& tracker, const std::vector<Odometry>& odometry) {
  const auto session_time = [](const Odometry& one) { return std::chrono::duration<double>(one.time).count(); };
  if (odometry.size() < 10)
    throw Failure(ExitCode::usage, "--session: has no odometry to align the tracker's clock by");
  const auto extent = [](const auto& ways, const auto& pose_of) {
    double farthest = 0.0;
    for (const auto& one : ways) {
      const Pose2 way = between(pose_of(ways.front()), pose_of(one));
      farthest = std::max(farthest, std::hypot(way.x, way.y));
    }
    return farthest;
  };
  const double by_odometry = extent(odometry, [](const Odometry& one) { return one.T_odom_base; });
  const double by_tracker = extent(tracker, [](const TrackerReading& one) { return one.T_tracker_body; });
  // Slip and a body far from the axle make no factor of ten of a way.
  constexpr double other_unit = 10.0;
  if (by_odometry > 0.1 && (by_tracker > other_unit * by_odometry || by_tracker < by_odometry / other_unit)) {
    char text[160];
    std::snprintf(
        text, sizeof text,
        "--tracker: its way is %.3g m long, the odometry's %.3g m; lengths must be in m, is it in another unit?",
        by_tracker, by_odometry);
    throw Failure(ExitCode::usage, text);
  }
  const Rates of_odometry = rates_of(session_time(odometry.front()), session_time(odometry.back()), [&](double time) {
    return pose_at(odometry, time, longest_gap, session_time, [](const Odometry& one) { return one.T_odom_base; });
  });
  const Rates of_tracker =
      rates_of(tracker.front().time_s, tracker.back().time_s, [&](double time) { return tracker_at(tracker, time); });
  const int most = static_cast<int>(of_tracker.values.size() + of_odometry.values.size());
  int best = 0;
  double highest = -2.0;
  for (int shift = -most; shift <= most; ++shift) {
    const double here = agreement(of_tracker, of_odometry, shift);
    if (here > highest) {
      highest = here;
      best = shift;
    }
  }
  constexpr double enough = 0.9;
  if (highest < enough)
    throw Failure(ExitCode::usage,
                  "--tracker: its way and the session's odometry do not go together at any shift of the clocks (best "
                  "correlation " +
                      std::to_string(highest) + ", needed 0.9); is it of this docking?");
  // Between the steps by the parabola through the best and its neighbours.
  const double before = agreement(of_tracker, of_odometry, best - 1);
  const double after = agreement(of_tracker, of_odometry, best + 1);
  const double bend = before - 2.0 * highest + after;
  const double between = bend < 0.0 ? std::clamp(0.5 * (before - after) / bend, -0.5, 0.5) : 0.0;
  return {of_odometry.start - of_tracker.start + grid * (best + between), highest};
}

TrackerFit fit_frames(const std::vector<TrackedWay>& ways, const std::optional<Pose2>& T_tracker_station,
                      const std::optional<Pose2>& T_base_body) {
  struct Pair {
    Pose2 T_station_base, T_tracker_body;
  };
  std::vector<Pair> pairs;
  for (const TrackedWay& one : ways)
    for (const TrackerReading& reading : one.tracker)
      if (const auto estimate = estimate_at(one.way, reading.time_s + one.clock.seconds))
        pairs.push_back({*estimate, reading.T_tracker_body});
  if (pairs.size() < 10)
    throw Failure(ExitCode::usage,
                  "--tracker: fewer than 10 of its readings fall into a time at which the robot knew "
                  "where it was");
  TrackerFit fit;
  fit.station_fitted = !T_tracker_station;
  fit.body_fitted = !T_base_body;
  fit.readings = static_cast<int>(pairs.size());
  TrackerFrames& frames = fit.frames;
  frames.T_base_body = T_base_body.value_or(Pose2{});
  frames.T_tracker_station = T_tracker_station.value_or(pairs.front().T_tracker_body *
                                                        inverse(pairs.front().T_station_base * frames.T_base_body));
  // A milliradian weighs as much as a millimetre.
  constexpr double small = 1e-6;
  Eigen::Matrix<double, 6, 6> last_information = Eigen::Matrix<double, 6, 6>::Identity();
  for (int step = 0; step < 30; ++step) {
    Eigen::Matrix<double, 6, 6> information = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::Matrix<double, 6, 1> gradient = Eigen::Matrix<double, 6, 1>::Zero();
    for (const Pair& pair : pairs) {
      const Eigen::Vector3d here = misfit(frames, pair.T_station_base, pair.T_tracker_body);
      Eigen::Matrix<double, 3, 6> slope;
      for (int i = 0; i < 6; ++i) {
        TrackerFrames moved = frames;
        Eigen::Vector3d by = Eigen::Vector3d::Zero();
        by[i % 3] = small;
        Pose2& which = i < 3 ? moved.T_tracker_station : moved.T_base_body;
        which = plus(which, by);
        slope.col(i) = (misfit(moved, pair.T_station_base, pair.T_tracker_body) - here) / small;
      }
      information += slope.transpose() * slope;
      gradient += slope.transpose() * here;
    }
    for (int i = 0; i < 6; ++i) {
      const bool fitted = i < 3 ? fit.station_fitted : fit.body_fitted;
      if (fitted) continue;
      information.row(i).setZero();
      information.col(i).setZero();
      information(i, i) = 1.0;
      gradient[i] = 0.0;
    }
    information.diagonal().array() += 1e-9;
    last_information = information;
    const Eigen::Matrix<double, 6, 1> change = -information.ldlt().solve(gradient);
    frames.T_tracker_station = plus(frames.T_tracker_station, change.head<3>());
    frames.T_base_body = plus(frames.T_base_body, change.tail<3>());
    if (change.norm() < 1e-10) break;
  }
  Eigen::Vector3d squares = Eigen::Vector3d::Zero();
  for (const Pair& pair : pairs)
    squares += misfit(frames, pair.T_station_base, pair.T_tracker_body).cwiseAbs2() / static_cast<double>(pairs.size());
  fit.rms = {std::sqrt(squares.x()), std::sqrt(squares.y()), std::sqrt(squares.z())};
  if (fit.body_fitted) {
    const Eigen::Matrix<double, 6, 6> covariance =
        last_information.ldlt().solve(Eigen::Matrix<double, 6, 6>::Identity());
    // Neighbouring readings share their errors: as if one of a hundred counted.
    constexpr double alike = 100.0;
    fit.body_sigma = std::sqrt(alike * squares.sum() * std::max(covariance(3, 3), covariance(4, 4)));
  }
  return fit;
}

std::optional<Pose2> tracked_base(const TrackedWay& tracked, const TrackerFrames& frames, double session_time_s) {
  constexpr double window = 0.5;  // s
  Eigen::Vector2d sum = Eigen::Vector2d::Zero();
  Eigen::Vector2d direction = Eigen::Vector2d::Zero();
  int count = 0;
  for (const TrackerReading& reading : tracked.tracker) {
    const double time = reading.time_s + tracked.clock.seconds;
    if (time < session_time_s - window || time > session_time_s) continue;
    const Pose2 base = inverse(frames.T_tracker_station) * reading.T_tracker_body * inverse(frames.T_base_body);
    sum += Eigen::Vector2d(base.x, base.y);
    direction += Eigen::Vector2d(std::cos(base.yaw), std::sin(base.yaw));
    ++count;
  }
  if (count == 0) return std::nullopt;
  return Pose2{sum.x() / count, sum.y() / count, std::atan2(direction.y(), direction.x())};
}

}  // namespace tagdock
