#pragma once

#include <optional>
#include <variant>
#include <vector>

#include <opencv2/core.hpp>

#include "detection/photometric_fit.h"
#include "detection/photometric_refiner.h"
#include "detection/photometric_samples.h"

namespace tagdock {

/// A tag as its own fit to the grey values left it: what a fit of several tags together goes on from.
struct FittedTag {
  RefinedTag tag;
  TagRegion region;
  TagImageModel model;             ///< at the minimum
  std::vector<TagSample> samples;  ///< with their weights and variances
  FreeParameters free;
  double inflation = 1.0;  ///< of the covariance that the pixels' own scatter makes
};

/// `refine_photometric` with all that it fitted.
std::variant<FittedTag, Unrefined> fit_photometric(const cv::Mat1b& gray, const std::string& family,
                                                   const TagDetection& coarse, const PhotometricConfig& config,
                                                   const std::optional<CameraModel>& camera);

}  // namespace tagdock
