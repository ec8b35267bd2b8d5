#pragma once

#include <string>

#include <opencv2/core.hpp>

#include "detection/photometric_refiner.h"

namespace tagdock {

/// One self-contained HTML page on the fit of one tag: patch, model, residual, profiles across the sides with the
/// fitted S-function, parameters.
/// @param image  its name, as shown
std::string explanation_page(const cv::Mat1b& gray, const std::string& image, const std::string& family,
                             const PhotometricExplanation& explained);

}  // namespace tagdock
