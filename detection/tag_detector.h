#pragma once

#include <memory>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "calibration/target.h"

namespace tagdock {

/// A tag as the detector found it: decoded, with coarse corners.
struct TagDetection {
  int id = 0;
  int hamming = 0;      ///< corrected bits
  double margin = 0.0;  ///< AprilTag's decision margin [grey levels]
  int modules = 8;      ///< cells along a side of the square whose corners these are
  Corners corners_px;   ///< our pixel convention and our order (STYLE.md)
};

struct TagDetectorConfig {
  std::string family = "tag36h11";
  int decimate = 2;     ///< find on an image this much smaller, 1 to 4; the refiner works on the whole one
  int max_hamming = 1;  ///< more corrected bits are refused; at most 2
  double border_px =
      5;  ///< tags with a corner nearer to the image border are refused: cut tags decode with wrong corners
};

/// Finds and decodes tags: the one door to the AprilTag library.
/// One object may be used by one thread at a time.
class TagDetector {
 public:
  /// Throws std::invalid_argument when the family is unknown or a value is out of range.
  explicit TagDetector(const TagDetectorConfig& config);
  ~TagDetector();
  TagDetector(TagDetector&&) noexcept;
  TagDetector& operator=(TagDetector&&) noexcept;

  /// All tags in an image, by id and then by place. Any size and stride is accepted; an image below 32 px on a side
  /// has none (AprilTag 3.3.0 crashes on tiny images).
  [[nodiscard]] std::vector<TagDetection> detect(const cv::Mat1b& gray) const;

  /// The same in a part of the image only; corners are in pixels of the whole image.
  [[nodiscard]] std::vector<TagDetection> detect(const cv::Mat1b& gray, const cv::Rect& region) const;

  [[nodiscard]] const TagDetectorConfig& config() const;

 private:
  struct Library;
  std::unique_ptr<Library> library_;
};

}  // namespace tagdock
