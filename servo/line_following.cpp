#include "servo/line_following.h"

#include <algorithm>
#include <cmath>

namespace tagdock {
namespace {

double seconds(std::chrono::nanoseconds time) { return std::chrono::duration<double>(time).count(); }

// Distance from the camera point to the board along the line, and where the board's middle stands beside it.
struct BoardOnLine {
  double distance = 0.0;
  double lateral = 0.0;
};

BoardOnLine board_on_line(const LineTarget& target, const Pose2& T_goal_base) {
  const Pose2 T_goal_station = inverse(target.T_station_goal);
  const Pose2 T_goal_camera = T_goal_base * Pose2{target.camera_ahead, 0.0, 0.0};
  return {T_goal_station.x - T_goal_camera.x, T_goal_station.y - T_goal_camera.y};
}

double limit(const LineTarget& target, const BoardOnLine& board, const LineLawConfig& config, bool bare) {
  const double distance = std::max(config.min_view_distance, board.distance);
  const double half_board = std::atan(0.5 * target.board_width / distance);
  const double bearing = std::abs(std::atan2(board.lateral, distance));
  const double free = target.half_view - half_board - bearing - config.view_margin;
  return bare ? std::min(config.max_heading, free) : std::clamp(free, config.min_heading, config.max_heading);
}

// Curvature per heading error that puts both poles at 1/L [1/m].
double heading_gain(double length, double lag) { return (2.0 + lag / length) / length; }

// The law itself; `direction` is +1 forward and -1 in reverse, where the wanted heading changes its sign.
double turn_rate(double lateral, double heading, double heading_limit, double speed, int direction, double length,
                 const LineLawConfig& config) {
  const double slope = std::tan(heading_limit);
  const double wanted = -direction * std::clamp(lateral / (2.0 * length + config.lag), -slope, slope);
  const double curvature =
      std::clamp(heading_gain(length, config.lag) * (wanted - heading), -config.max_curvature, config.max_curvature);
  return std::clamp(curvature * std::max(std::abs(speed), config.turning_speed), -config.max_turn_rate,
                    config.max_turn_rate);
}

double ramped(double last, double target, double dt, const LineLawConfig& config) {
  return std::max(0.0, last + std::clamp(target - last, -config.deceleration * dt, config.acceleration * dt));
}

}  // namespace

double heading_limit(const LineTarget& target, double camera_distance, const LineLawConfig& config, bool bare) {
  const Pose2 T_goal_station = inverse(target.T_station_goal);
  return limit(target, {camera_distance, T_goal_station.y}, config, bare);
}

LineCommand follow_line(const LineTarget& target, const Pose2& T_station_base, const Twist2& last, double wheel_speed,
                        std::chrono::nanoseconds step, bool slow, const LineLawConfig& config) {
  const Pose2 T_goal_base = between(target.T_station_goal, T_station_base);
  LineCommand result;
  result.remaining = -T_goal_base.x;
  result.lateral = T_goal_base.y;
  result.heading = wrap_angle(T_goal_base.yaw);
  if (result.remaining - std::max(0.0, wheel_speed) * config.response_time < config.stop_distance) {
    result.reached = true;
    return result;
  }
  const double rest = std::max(0.0, result.remaining);
  const double target_speed =
      std::min({slow ? config.slow_speed : config.max_speed, config.end_speed + config.speed_per_distance * rest,
                std::sqrt(2.0 * config.braking * rest)});
  result.command.linear = ramped(std::max(0.0, last.linear), target_speed, seconds(step), config);
  result.command.angular =
      turn_rate(result.lateral, result.heading, limit(target, board_on_line(target, T_goal_base), config, false),
                result.command.linear, 1, slow ? config.slow_length : config.length, config);
  return result;
}

LineCommand back_along_line(const LineTarget& target, const Pose2& T_station_base, double camera_distance,
                            const Twist2& last, double wheel_speed, std::chrono::nanoseconds step,
                            const LineLawConfig& config) {
  const Pose2 T_goal_base = between(target.T_station_goal, T_station_base);
  const BoardOnLine board = board_on_line(target, T_goal_base);
  LineCommand result;
  result.remaining = camera_distance - board.distance;
  result.lateral = T_goal_base.y;
  result.heading = wrap_angle(T_goal_base.yaw);
  constexpr double arrival = 0.010;  // m; a back-off has no need to be exact
  if (result.remaining - std::max(0.0, -wheel_speed) * config.response_time < arrival) {
    result.reached = true;
    return result;
  }
  const double target_speed = std::min(config.max_speed, std::sqrt(2.0 * config.braking * result.remaining));
  result.command.linear = -ramped(std::max(0.0, -last.linear), target_speed, seconds(step), config);
  result.command.angular = turn_rate(result.lateral, result.heading, limit(target, board, config, false),
                                     result.command.linear, -1, config.length, config);
  return result;
}

double lateral_left(double lateral, double heading, double distance, double length, double lag) {
  const double slope = heading + lag * (heading_gain(length, lag) * heading + lateral / (length * length));
  return (lateral + (slope + lateral / length) * distance) * std::exp(-distance / length);
}

SwingWatch watch(const SwingWatch& before, double travelled, double heading_error, const SwingConfig& config) {
  SwingWatch now = before;
  std::erase_if(now.changes, [&](double at) { return travelled - at > config.window; });
  const int sign = heading_error > config.threshold ? 1 : heading_error < -config.threshold ? -1 : 0;
  if (sign == 0) return now;
  if (now.sign != 0 && sign != now.sign) now.changes.push_back(travelled);
  now.sign = sign;
  return now;
}

bool swings(const SwingWatch& now, const SwingConfig& config) {
  return static_cast<int>(now.changes.size()) >= config.changes;
}

}  // namespace tagdock
