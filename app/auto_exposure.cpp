#include "app/auto_exposure.h"

#include <algorithm>
#include <cmath>

namespace tagdock {

std::optional<MarkerLight> meter(const cv::Mat1b& gray, const std::vector<Corners>& tags) {
  constexpr int per_side = 32;
  constexpr double half_module = 1.0 / 16.0;  // a tag of the usual families has 8 modules a side
  constexpr unsigned char saturated_level = 253;
  double sum = 0.0;
  int count = 0, saturated = 0;
  for (const Corners& corners : tags) {
    Eigen::Vector2d centre = Eigen::Vector2d::Zero();
    for (const auto& corner : corners) centre += 0.25 * corner;
    for (std::size_t side = 0; side < 4; ++side) {
      const Eigen::Vector2d from = centre + (1.0 + 2.0 * half_module) * (corners[side] - centre);
      const Eigen::Vector2d to = centre + (1.0 + 2.0 * half_module) * (corners[(side + 1) % 4] - centre);
      for (int i = 0; i < per_side; ++i) {
        const Eigen::Vector2d at = from + (to - from) * (i + 0.5) / per_side;
        const auto x = static_cast<int>(std::lround(at.x()));
        const auto y = static_cast<int>(std::lround(at.y()));
        if (!at.allFinite() || x < 0 || y < 0 || x >= gray.cols || y >= gray.rows) continue;
        sum += gray(y, x);
        saturated += gray(y, x) >= saturated_level ? 1 : 0;
        ++count;
      }
    }
  }
  if (count == 0) return std::nullopt;
  return MarkerLight{sum / count / 255.0, static_cast<double>(saturated) / count};
}

double longest_exposure_us(double speed_px, double blur_px) {
  return speed_px > 0.0 ? 1e6 * blur_px / speed_px : HUGE_VAL;
}

std::optional<ExposureSetting> AutoExposure::next(const MarkerLight& light, const ExposureSetting& set, double speed_px,
                                                  bool frozen) {
  if (frozen || ++waited_ < config_.frames_between || !(set.exposure_us > 0.0)) return std::nullopt;
  const double cap =
      std::clamp(longest_exposure_us(speed_px, config_.largest_blur_px), config_.shortest_us, config_.longest_us);
  const bool too_bright = light.white > config_.white_high || light.saturated > config_.most_saturated;
  const bool too_dark = light.white < config_.white_low;
  const bool too_long = set.exposure_us > 1.05 * cap;
  if (!too_bright && !too_dark && !too_long) return std::nullopt;
  // Where much is saturated, the mean says too little about how far down it must go.
  double factor = 0.5 * (config_.white_low + config_.white_high) / std::max(light.white, 1e-3);
  if (light.saturated > config_.most_saturated) factor = std::min(factor, 1.0 / config_.largest_step);
  if (!too_bright && !too_dark) factor = 1.0;
  factor = std::clamp(factor, 1.0 / config_.largest_step, config_.largest_step);
  // What the sensor gathers, as exposure without gain; divided again into as much exposure as blur allows.
  const double wanted_us = factor * set.exposure_us * std::pow(10.0, set.gain_db / 20.0);
  ExposureSetting made;
  made.exposure_us = std::clamp(wanted_us, config_.shortest_us, cap);
  made.gain_db = std::clamp(20.0 * std::log10(wanted_us / made.exposure_us), 0.0, config_.highest_gain_db);
  if (std::abs(made.exposure_us - set.exposure_us) < 0.01 * set.exposure_us &&
      std::abs(made.gain_db - set.gain_db) < 0.1)
    return std::nullopt;
  waited_ = 0;
  return made;
}

}  // namespace tagdock
