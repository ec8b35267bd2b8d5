#include "servo/slip_watch.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

namespace tagdock {

void SlipWatch::reset() {
  moments_.clear();
  corrected_ = {};
  in_a_row_ = 0;
}

std::optional<std::string> SlipWatch::take(const FilterUpdate& update, double travelled) {
  const bool fused = update.use == SightingUse::fused;
  if (!fused && update.use != SightingUse::rejected) {
    // Without an estimate, or with one of unsure yaw, there is nothing to hold against the encoders.
    if (update.use != SightingUse::fused_without_yaw && update.use != SightingUse::too_old) reset();
    return std::nullopt;
  }
  if (travelled < config_.castor_way) {
    reset();
    return std::nullopt;
  }
  const double longest = std::max(config_.yaw_way, config_.place_way);
  if (moments_.empty()) moments_.push_back({travelled, corrected_, update.castor_turn});
  while (moments_.size() > 1 && moments_[1].travelled < travelled - longest) moments_.pop_front();
  // What the camera says now against where the filter, its corrections left out, would have come since `way` ago.
  const auto since = [&](double way) {
    const auto begin = std::find_if(moments_.begin(), moments_.end(),
                                    [&](const Moment& moment) { return moment.travelled >= travelled - way; });
    const Moment before = begin == moments_.end() ? Moment{travelled, corrected_, update.castor_turn} : *begin;
    return Moment{way,
                  {corrected_.x - before.corrected.x + update.innovation.x,
                   corrected_.y - before.corrected.y + update.innovation.y,
                   corrected_.yaw - before.corrected.yaw + update.innovation.yaw},
                  update.castor_turn - before.castor_turn};
  };
  const Moment turned = since(config_.yaw_way);
  const Pose2 place = since(config_.place_way).corrected;
  const double yaw = turned.corrected.yaw;
  const double distance = std::hypot(place.x, place.y);
  // Nor does the camera know better than it says: a flat tag seen head-on tells its yaw by degrees only.
  constexpr double sigmas = 3.0;
  const PlanarSighting unsaid;
  const PlanarSighting& seen = update.sighting ? *update.sighting : unsaid;
  const double unsure = sigmas * std::sqrt(seen.covariance(2, 2) + seen.bias_covariance(2, 2));
  const bool turned_apart = std::abs(yaw) > config_.yaw + config_.castor_times * turned.castor_turn + unsure;
  const bool apart = turned_apart || distance > config_.place;
  in_a_row_ = apart ? in_a_row_ + 1 : 0;
  if (fused) {
    corrected_.x += update.correction.x;
    corrected_.y += update.correction.y;
    corrected_.yaw += update.correction.yaw;
    moments_.push_back({travelled, corrected_, update.castor_turn});
  }
  if (in_a_row_ < config_.sightings) return std::nullopt;
  std::array<char, 200> text{};
  if (turned_apart)
    std::snprintf(text.data(), text.size(),
                  "encoders and camera are %.1f degrees apart over %.1f m: the wheels slip; clean the floor, look at "
                  "the wheels",
                  degrees(std::abs(yaw)), config_.yaw_way);
  else
    std::snprintf(text.data(), text.size(),
                  "encoders and camera are %.0f mm apart over %.1f m: the wheels slip; clean the floor, look at the "
                  "wheels",
                  1e3 * distance, config_.place_way);
  return std::string(text.data());
}

}  // namespace tagdock
