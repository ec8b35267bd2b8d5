#pragma once

#include <filesystem>
#include <string>
#include <variant>

#include <opencv2/core.hpp>

namespace tagdock {

/// An image file as grey pixels, or a sentence that says why it could not be read.
/// PNG, JPEG, PGM and whatever else OpenCV reads; colour becomes luminance. Values of 16 bits are divided by the
/// smallest power of two that brings the brightest one below 256, so pictures of 10, 12 and 14 bit cameras keep their
/// contrast. An orientation noted in the file is ignored: pixels stay where the sensor had them.
std::variant<cv::Mat1b, std::string> read_grey(const std::filesystem::path& file);

}  // namespace tagdock
