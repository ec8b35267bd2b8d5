#pragma once

#include <string>
#include <vector>

namespace tagdock {

/// How wrong refined corners are: sigma of a coordinate by the length of the tag's shortest side, between the points
/// by the logarithm. `tagdock evaluate corner-errors` measures these with the renderer and the real detector.
struct CornerErrors {
  std::vector<double> side_px;     ///< rising
  std::vector<double> noise_px;    ///< new in every frame
  std::vector<double> bias_px;     ///< the same from frame to frame where nothing moves: one draw per corner coordinate
  double noise_per_blur_px = 0.0;  ///< more noise per px that the corner moves during the exposure
  double claimed_share = 1.0;      ///< the sigma that is told with a corner, over `noise_px`
  /// Whether `bias_px` goes with how the corner lies on the pixels, as a real detector's does: it comes back where the
  /// corner lies on the same part of a pixel, and a robot that rests half a pixel beside meets another one. Otherwise
  /// it is the same for a whole run (notes on docking, 4.5).
  bool bias_follows_pixels = true;

  [[nodiscard]] double noise_at(double side) const { return at(noise_px, side); }
  [[nodiscard]] double bias_at(double side) const { return at(bias_px, side); }

 private:
  [[nodiscard]] double at(const std::vector<double>& values, double side) const;
};

/// Words that `corner_errors` knows: the corner methods tanh, apriltag and best, as measured (data/corner_errors);
/// `paper`, the noise that explains the paper's pose errors (0.10 px, and 0.05 px lasting; notes on docking, 4.5);
/// `poor`, 0.3 px and 0.2 px lasting.
const std::vector<std::string>& corner_error_names();

/// By one of those words or from a file as `to_yaml` writes it.
/// Throws Failure(usage) with file, line and key.
CornerErrors corner_errors(const std::string& word);
std::string to_yaml(const CornerErrors& errors);

}  // namespace tagdock
