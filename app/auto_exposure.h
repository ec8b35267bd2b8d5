#pragma once

#include <optional>
#include <vector>

#include <opencv2/core.hpp>

#include "calibration/target.h"

namespace tagdock {

struct AutoExposureConfig {
  double white_low = 0.6;         ///< of full scale: the tags' white shall lie between these two
  double white_high = 0.8;        ///< above, noise and reflections begin to saturate
  double most_saturated = 0.005;  ///< share of the tags' white that may be saturated
  double largest_step = 1.5;      ///< factor: a faster change disturbs the edges that are being measured
  int frames_between = 3;         ///< a change shows after one or two frames
  double largest_blur_px = 1.0;   ///< motion during the exposure
  double shortest_us = 50.0;
  double longest_us = 30000.0;
  double highest_gain_db = 12.0;  ///< beyond, noise costs more than blur

  bool operator==(const AutoExposureConfig&) const = default;
};

/// How bright the white around the tags is.
struct MarkerLight {
  double white = 0.0;      ///< mean, of full scale
  double saturated = 0.0;  ///< share of it that is
};

/// Metered on the white frames of the tags only, half a module outside their black squares; the rest of the picture
/// may be as dark or bright as it likes. None if no tag's frame lies in the picture.
std::optional<MarkerLight> meter(const cv::Mat1b& gray, const std::vector<Corners>& tags);

/// The longest exposure in which the picture moves by no more than `blur_px`. @param speed_px  of the picture, px/s
double longest_exposure_us(double speed_px, double blur_px);

struct ExposureSetting {
  double exposure_us = 0.0;
  double gain_db = 0.0;

  bool operator==(const ExposureSetting&) const = default;
};

/// Holds the tags' white between its limits: exposure first, up to what motion blur allows, then gain.
class AutoExposure {
 public:
  explicit AutoExposure(const AutoExposureConfig& config) : config_(config) {}

  /// @param set      what the frame was taken with
  /// @param speed_px how fast the tags move in the picture [px/s]
  /// @param frozen   the final approach: light that changes then would move edges by a fraction of a pixel
  /// @return         what to set now, if anything
  std::optional<ExposureSetting> next(const MarkerLight& light, const ExposureSetting& set, double speed_px,
                                      bool frozen);

 private:
  AutoExposureConfig config_;
  int waited_ = 0;
};

}  // namespace tagdock
