#include "app/corner_measurement.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <map>

#include "app/simulation/draws.h"
#include "planning/pose2.h"

namespace tagdock {
namespace {

// Sums over the frames of one corner coordinate.
struct Sums {
  int count = 0;
  double sum = 0.0;
  double squares = 0.0;

  void add(double value) {
    ++count;
    sum += value;
    squares += value * value;
  }
  [[nodiscard]] double mean() const { return sum / count; }
  [[nodiscard]] double variance() const { return (squares - sum * sum / count) / (count - 1); }
};

// Mean squares of one distance.
struct Pool {
  double variance = 0.0, mean_square = 0.0, claimed = 0.0, log_side = 0.0;
  int coordinates = 0, claims = 0, sides = 0, missed = 0, corners = 0;
};

double shortest_side(const Corners& corners) {
  double shortest = std::numeric_limits<double>::infinity();
  for (std::size_t i = 0; i < 4; ++i) shortest = std::min(shortest, (corners[i] - corners[(i + 1) % 4]).norm());
  return shortest;
}

// The lens beside the axis by up to 5 degrees, turned by up to 12 degrees, so that the board comes to many places of
// the image; pitch and roll as a chassis has them.
Eigen::Isometry3d view_at(const CornerMeasurementWish& wish, double distance, Draws& draws) {
  const double bearing = radians(5.0) * draws.even();
  const double turned = radians(12.0) * draws.even() * std::min(1.0, distance / 2.0);
  Eigen::Isometry3d T_station_base = Eigen::Isometry3d::Identity();
  T_station_base.linear() = (Eigen::AngleAxisd(bearing + turned, Eigen::Vector3d::UnitZ()) *
                             Eigen::AngleAxisd(radians(0.3) * draws.even(), Eigen::Vector3d::UnitY()) *
                             Eigen::AngleAxisd(radians(0.3) * draws.even(), Eigen::Vector3d::UnitX()))
                                .toRotationMatrix();
  const Eigen::Vector3d lens = T_station_base.linear() * wish.rig.T_base_camera.translation();
  T_station_base.translation() << -distance * std::cos(bearing) - lens.x(), -distance * std::sin(bearing) - lens.y(),
      0.0;
  return T_station_base * wish.rig.T_base_camera;
}

void pool_pose(const CornerMeasurementWish& wish, const Renderer& renderer, const TagDetector& detector,
               const Exposure& exposure, Draws& draws, Pool& pool) {
  const std::vector<TrueTag> truth = renderer.true_tags(exposure);
  std::map<int, std::array<Sums, 8>> sums;
  for (int frame = 0; frame < wish.frames; ++frame) {
    const cv::Mat1b gray =
        renderer
            .render(exposure, mixed(wish.seed) + static_cast<std::uint64_t>(1e9 * (1.0 + draws.even())),
                    RenderedRows::with_tags)
            .gray;
    const std::vector<TagDetection> found = detector.detect(gray);
    for (const TrueTag& tag : truth) {
      if (!tag.fully_visible) continue;
      const auto seen =
          std::find_if(found.begin(), found.end(), [&](const TagDetection& one) { return one.id == tag.id; });
      if (seen == found.end()) {
        ++pool.missed;
        continue;
      }
      const Refinement refined = refine(gray, wish.board.family, *seen, wish.method, wish.rig.camera);
      const RefinedTag* fine = std::get_if<RefinedTag>(&refined);
      if (fine == nullptr) {
        ++pool.missed;
        continue;
      }
      for (std::size_t i = 0; i < 8; ++i) {
        const auto place = static_cast<Eigen::Index>(i);
        sums[tag.id][i].add(fine->corners_px[i / 2][place % 2] - tag.corners_px[i / 2][place % 2]);
        pool.claimed += fine->covariance_px2(place, place);
        ++pool.claims;
      }
      pool.corners += 8;
    }
  }
  for (const TrueTag& tag : truth)
    if (const auto one = sums.find(tag.id); one != sums.end()) {
      pool.log_side += std::log(shortest_side(tag.corners_px));
      ++pool.sides;
      for (const Sums& coordinate : one->second) {
        if (coordinate.count < 2) continue;
        pool.variance += coordinate.variance();
        // The mean of n frames holds a share 1/n of their noise.
        pool.mean_square += coordinate.mean() * coordinate.mean() - coordinate.variance() / coordinate.count;
        ++pool.coordinates;
      }
    }
}

}  // namespace

std::vector<CornerMeasurement> measure_corners(const CornerMeasurementWish& wish,
                                               const std::function<void(int done, int wanted)>& progress) {
  Scene scene;
  scene.board = wish.board;
  const Renderer renderer(scene, wish.rig.camera, wish.sensor);
  TagDetectorConfig detection;
  detection.family = wish.board.family;
  const TagDetector detector(detection);
  std::vector<CornerMeasurement> measured;
  for (std::size_t i = 0; i < wish.distances.size(); ++i) {
    Draws draws(wish.seed, i);
    Pool still;
    Pool moving;
    for (int pose = 0; pose < wish.poses; ++pose) {
      Exposure exposure;
      const Eigen::Isometry3d T_station_camera = view_at(wish, wish.distances[i], draws);
      exposure.T_station_camera = {T_station_camera};
      pool_pose(wish, renderer, detector, exposure, draws, still);
      // Turning about the vertical moves every corner alike: by blur_px over the exposure.
      if (pose % 2 != 0) continue;
      const double half = 0.5 * wish.blur_px / wish.rig.camera.fx;
      exposure.T_station_camera.clear();
      for (const double share : {-1.0, 0.0, 1.0})
        exposure.T_station_camera.push_back(T_station_camera *
                                            Eigen::AngleAxisd(share * half, Eigen::Vector3d::UnitY()));
      pool_pose(wish, renderer, detector, exposure, draws, moving);
    }
    progress(static_cast<int>(i) + 1, static_cast<int>(wish.distances.size()));
    if (still.coordinates == 0) continue;
    CornerMeasurement one;
    one.side_px = std::exp(still.log_side / still.sides);
    one.noise_px = std::sqrt(still.variance / still.coordinates);
    one.bias_px = std::sqrt(std::max(0.0, still.mean_square / still.coordinates));
    one.claimed_px = std::sqrt(still.claimed / still.claims);
    one.moving_noise_px = moving.coordinates > 0 ? std::sqrt(moving.variance / moving.coordinates) : one.noise_px;
    one.corners = still.corners;
    one.missed = still.missed + moving.missed;
    measured.push_back(one);
  }
  return measured;
}

CornerErrors errors_from(const std::vector<CornerMeasurement>& measured, double blur_px) {
  std::vector<CornerMeasurement> rising = measured;
  std::sort(rising.begin(), rising.end(), [](const auto& a, const auto& b) { return a.side_px < b.side_px; });
  CornerErrors errors;
  double claimed = 0.0;
  double added = 0.0;
  for (const CornerMeasurement& one : rising) {
    errors.side_px.push_back(one.side_px);
    errors.noise_px.push_back(one.noise_px);
    errors.bias_px.push_back(one.bias_px);
    claimed += std::log(one.claimed_px / one.noise_px);
    added += std::max(0.0, one.moving_noise_px * one.moving_noise_px - one.noise_px * one.noise_px);
  }
  const auto count = static_cast<double>(rising.size());
  errors.claimed_share = std::exp(claimed / count);
  errors.noise_per_blur_px = std::sqrt(added / count) / blur_px;
  return errors;
}

}  // namespace tagdock
