#include "planning/sensor_errors.h"

#include <algorithm>
#include <cmath>

namespace tagdock {
namespace {

// The two values beside one, and the second's share; none beyond the last.
struct Between {
  std::size_t low = 0;
  std::size_t high = 0;
  double share = 0.0;
};

std::optional<Between> between_values(const std::vector<double>& values, double value) {
  if (values.empty() || !(value <= values.back())) return std::nullopt;
  if (value <= values.front()) return Between{};
  const auto high = static_cast<std::size_t>(std::lower_bound(values.begin(), values.end(), value) - values.begin());
  return Between{high - 1, high, (value - values[high - 1]) / (values[high] - values[high - 1])};
}

}  // namespace

std::optional<SensorErrors::Sigma> SensorErrors::at(double distance, double bearing, double place) const {
  const auto by_distance = between_values(distances, distance);
  const auto by_bearing = between_values(bearings, std::abs(bearing));
  const auto by_place = between_values(places, std::abs(place));
  if (!by_distance || !by_bearing || !by_place) return std::nullopt;
  Sigma sum;
  for (int corner = 0; corner < 8; ++corner) {
    const auto side = [&](const Between& one, int bit) {
      const bool high = (corner & bit) != 0;
      return std::pair(high ? one.high : one.low, high ? one.share : 1.0 - one.share);
    };
    const auto [k, of_place] = side(*by_place, 1);
    const auto [j, of_bearing] = side(*by_bearing, 2);
    const auto [i, of_distance] = side(*by_distance, 4);
    const double weight = of_place * of_bearing * of_distance;
    if (weight == 0.0) continue;
    const std::optional<Sigma>& cell = cells[(k * bearings.size() + j) * distances.size() + i];
    if (!cell) return std::nullopt;
    sum.along += weight * cell->along;
    sum.across += weight * cell->across;
    sum.heading += weight * cell->heading;
  }
  return sum;
}

std::optional<Eigen::Matrix3d> lens_covariance(const SensorErrors& errors, const Pose2& T_station_camera,
                                               double half_view) {
  const double sight = std::atan2(-T_station_camera.y, -T_station_camera.x);  // direction to the board's centre
  const double off_axis = wrap_angle(sight - T_station_camera.yaw);
  if (!(std::abs(off_axis) < half_view)) return std::nullopt;
  const double place = std::tan(off_axis) / std::tan(half_view);
  const auto sigma = errors.at(std::hypot(T_station_camera.x, T_station_camera.y), sight, place);
  if (!sigma) return std::nullopt;
  Eigen::Matrix2d to_station;
  to_station << std::cos(sight), -std::sin(sight), std::sin(sight), std::cos(sight);
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();
  const Eigen::Vector2d variances(sigma->along * sigma->along, sigma->across * sigma->across);
  covariance.topLeftCorner<2, 2>() = to_station * variances.asDiagonal() * to_station.transpose();
  covariance(2, 2) = sigma->heading * sigma->heading;
  return covariance;
}

}  // namespace tagdock
