#pragma once

#include <array>
#include <cstdint>

#include "app/simulation/world.h"
#include "detection/tag_locator.h"

namespace tagdock {

/// How wrong refined corners are: sigma of a coordinate by the length of the tag's shortest side, between the points
/// by the logarithm. `tagdock evaluate corner-errors` measures these with the renderer and the real detector.
struct CornerErrors {
  std::vector<double> side_px;     ///< rising
  std::vector<double> noise_px;    ///< new in every frame
  std::vector<double> bias_px;     ///< the same for a whole run: drawn once per corner coordinate
  double noise_per_blur_px = 0.0;  ///< more noise per px that the corner moves during the exposure
  double claimed_share = 1.0;      ///< the sigma that is told with a corner, over `noise_px`

  [[nodiscard]] double noise_at(double side) const { return at(noise_px, side); }
  [[nodiscard]] double bias_at(double side) const { return at(bias_px, side); }

 private:
  [[nodiscard]] double at(const std::vector<double>& values, double side) const;
};

/// The fit of tanh to each side, as the detector has it (measured: see sighting_model.cpp).
CornerErrors errors_of_tanh();
/// The corner noise that explains the paper's pose errors: 0.10 px and 0.05 px lasting (notes on docking, 4.5).
CornerErrors errors_of_paper();

/// Sightings without images: true corners with drawn errors, and from them the pose by the same least squares as from
/// images (board_pose). What it cannot show: dirt, light, false tags and the mirrored pose of a flat tag.
class SightingModel {
 public:
  /// @param calibrated, surveyed  as the robot has them
  SightingModel(const Rig& calibrated, const Board& surveyed, const TagLocatorConfig& locator,
                const CornerErrors& errors, std::uint64_t seed);

  /// What a frame says that the world exposes at a time.
  [[nodiscard]] Sighting look(const World& world, std::uint64_t frame, std::chrono::nanoseconds mid_exposure) const;

 private:
  Rig calibrated_;
  Board surveyed_;
  GroundPrior prior_;
  double border_px_;
  CornerErrors errors_;
  std::uint64_t seed_;
};

}  // namespace tagdock
