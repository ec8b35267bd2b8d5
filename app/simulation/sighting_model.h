#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <vector>

#include "app/simulation/corner_errors.h"
#include "app/simulation/world.h"
#include "detection/tag_locator.h"

namespace tagdock {

/// Sightings without images: true corners with drawn errors, and from them the pose by the same least squares as from
/// images (board_pose). What it cannot show: dirt, light and false tags.
class SightingModel {
 public:
  /// @param calibrated, surveyed  as the robot has them
  SightingModel(const Rig& calibrated, const Board& surveyed, const TagLocatorConfig& locator,
                const CornerErrors& errors, std::uint64_t seed);

  /// What a frame says that the world exposes at a time.
  /// @param predicted  where the robot expects to see the station, as TagLocator takes it. With two tags or more the
  ///                   pose is sought from there; without, or with one tag alone, from the corners, which takes a
  ///                   hundred times as long but sees the mirrored pose. Never from the truth.
  [[nodiscard]] Sighting look(const World& world, std::uint64_t frame, std::chrono::nanoseconds mid_exposure,
                              const std::optional<Eigen::Isometry3d>& predicted) const;

 private:
  /// Of one tag's corners: the same in every frame of a run.
  struct Biases {
    int tag = 0;
    std::array<double, 8> normal{};  ///< in sigmas
    std::array<double, 16> phase{};  ///< of the error along the pixels, two a coordinate [rad]
  };
  [[nodiscard]] static double on_pixels(const Biases& bias, Eigen::Index place, const Eigen::Vector2d& corner);
  [[nodiscard]] const Biases& bias_of(int tag) const;

  Rig calibrated_;
  Board surveyed_;
  GroundPrior prior_;
  double border_px_;
  CornerErrors errors_;
  std::uint64_t seed_;
  std::vector<Biases> biases_;
};

}  // namespace tagdock
