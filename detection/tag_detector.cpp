#include "detection/tag_detector.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <stdexcept>
#include <string_view>
#include <tuple>

#include <apriltag/apriltag.h>
#include <apriltag/tag16h5.h>
#include <apriltag/tag25h9.h>
#include <apriltag/tag36h11.h>
#include <apriltag/tagCircle21h7.h>
#include <apriltag/tagCircle49h12.h>
#include <apriltag/tagStandard41h12.h>
#include <apriltag/tagStandard52h13.h>

namespace tagdock {
namespace {

/// AprilTag 3.3.0 crashes when a side of the decimated image is below 4 px; with decimation up to 4 this keeps clear.
constexpr int smallest_side_px = 32;

/// AprilTag counts from the edge of the first pixel, we from its centre. Measured: the same at every decimation.
constexpr double half_pixel = 0.5;

struct FamilyMaker {
  std::string_view name;
  apriltag_family_t* (*create)();
  void (*destroy)(apriltag_family_t*);
  /// The library's table of all correctable codes takes over a gigabyte beyond this.
  int most_hamming;
};

constexpr std::array<FamilyMaker, 7> family_makers{
    {{"tag36h11", tag36h11_create, tag36h11_destroy, 2},
     {"tag25h9", tag25h9_create, tag25h9_destroy, 2},
     {"tag16h5", tag16h5_create, tag16h5_destroy, 2},
     {"tagStandard41h12", tagStandard41h12_create, tagStandard41h12_destroy, 2},
     {"tagStandard52h13", tagStandard52h13_create, tagStandard52h13_destroy, 1},
     {"tagCircle21h7", tagCircle21h7_create, tagCircle21h7_destroy, 2},
     {"tagCircle49h12", tagCircle49h12_create, tagCircle49h12_destroy, 1}}};

const FamilyMaker& family_maker(const std::string& name) {
  for (const FamilyMaker& maker : family_makers)
    if (maker.name == name) return maker;
  std::string known;
  for (const FamilyMaker& maker : family_makers) known.append(known.empty() ? "" : ", ").append(maker.name);
  throw std::invalid_argument("tag family '" + name + "' is unknown; known are " + known);
}

TagDetectorConfig checked(const TagDetectorConfig& config) {
  const FamilyMaker& maker = family_maker(config.family);
  if (config.decimate < 1 || config.decimate > 4)
    throw std::invalid_argument("decimate is " + std::to_string(config.decimate) + "; 1 to 4 are possible");
  if (config.max_hamming < 0 || config.max_hamming > maker.most_hamming)
    throw std::invalid_argument("max_hamming is " + std::to_string(config.max_hamming) + "; 0 to " +
                                std::to_string(maker.most_hamming) + " are possible with " + config.family);
  if (!(config.border_px >= 0.0 && config.border_px <= 1000.0))
    throw std::invalid_argument("border_px must be between 0 and 1000");
  return config;
}

TagDetection in_our_convention(const apriltag_detection_t& found, const cv::Point& region_corner) {
  TagDetection detection;
  detection.id = found.id;
  detection.hamming = found.hamming;
  detection.margin = found.decision_margin;
  detection.modules = found.family->width_at_border;
  // The library starts at the bottom left of the tag and runs counter-clockwise; we start at the top left and run
  // clockwise.
  for (int ours = 0; ours < 4; ++ours)
    detection.corners_px[ours] = {found.p[3 - ours][0] - half_pixel + region_corner.x,
                                  found.p[3 - ours][1] - half_pixel + region_corner.y};
  return detection;
}

bool inside(const Corners& corners, const cv::Rect& region, double border) {
  return std::all_of(corners.begin(), corners.end(), [&](const Eigen::Vector2d& corner) {
    return corner.allFinite() && corner.x() >= region.x + border && corner.y() >= region.y + border &&
           corner.x() <= region.x + region.width - 1 - border && corner.y() <= region.y + region.height - 1 - border;
  });
}

/// The region, cut to the image and enlarged within it to the size that the library can bear.
cv::Rect bearable(const cv::Rect& region, const cv::Size& image) {
  const auto axis = [](int start, int length, int whole) {
    // In 64 bits, since a caller's rectangle may end anywhere.
    std::int64_t first = std::clamp<std::int64_t>(start, 0, whole);
    std::int64_t last = std::clamp<std::int64_t>(std::int64_t{start} + std::max(length, 0), first, whole);
    const std::int64_t missing = smallest_side_px - (last - first);
    if (missing > 0) {
      first = std::clamp<std::int64_t>(first - missing / 2, 0, std::max(0, whole - smallest_side_px));
      last = std::min<std::int64_t>(first + smallest_side_px, whole);
    }
    return std::pair<int, int>(static_cast<int>(first), static_cast<int>(last - first));
  };
  const auto [x, width] = axis(region.x, region.width, image.width);
  const auto [y, height] = axis(region.y, region.height, image.height);
  return {x, y, width, height};
}

}  // namespace

struct TagDetector::Library {
  explicit Library(const TagDetectorConfig& wanted)
      : config(checked(wanted)),
        family(family_maker(config.family).create(), family_maker(config.family).destroy),
        detector(apriltag_detector_create(), apriltag_detector_destroy) {
    apriltag_detector_add_family_bits(detector.get(), family.get(), config.max_hamming);
    detector->nthreads = 1;  // the library's thread pool races
    detector->quad_decimate = static_cast<float>(config.decimate);
    detector->refine_edges = true;
  }

  TagDetectorConfig config;
  std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)> family;  // outlives the detector that refers to it
  std::unique_ptr<apriltag_detector_t, void (*)(apriltag_detector_t*)> detector;
};

TagDetector::TagDetector(const TagDetectorConfig& config) : library_(std::make_unique<Library>(config)) {}
TagDetector::~TagDetector() = default;
TagDetector::TagDetector(TagDetector&&) noexcept = default;
TagDetector& TagDetector::operator=(TagDetector&&) noexcept = default;

const TagDetectorConfig& TagDetector::config() const { return library_->config; }

std::vector<TagDetection> TagDetector::detect(const cv::Mat1b& gray) const {
  return detect(gray, {0, 0, gray.cols, gray.rows});
}

std::vector<TagDetection> TagDetector::detect(const cv::Mat1b& gray, const cv::Rect& region) const {
  if (gray.cols < smallest_side_px || gray.rows < smallest_side_px) return {};
  const cv::Rect searched = bearable(region, gray.size());
  const cv::Mat1b part = gray(searched);
  // The library does not write into the image it is given; its interface only lacks the word const.
  image_u8_t image{part.cols, part.rows, static_cast<std::int32_t>(part.step[0]), const_cast<std::uint8_t*>(part.data)};
  const std::unique_ptr<zarray_t, void (*)(zarray_t*)> found(apriltag_detector_detect(library_->detector.get(), &image),
                                                             apriltag_detections_destroy);
  std::vector<TagDetection> detections;
  for (int i = 0; i < zarray_size(found.get()); ++i) {
    apriltag_detection_t* one = nullptr;
    zarray_get(found.get(), i, &one);
    const TagDetection detection = in_our_convention(*one, searched.tl());
    if (detection.hamming <= library_->config.max_hamming &&
        inside(detection.corners_px, searched, library_->config.border_px))
      detections.push_back(detection);
  }
  std::sort(detections.begin(), detections.end(), [](const TagDetection& a, const TagDetection& b) {
    return std::tuple(a.id, a.corners_px[0].y(), a.corners_px[0].x()) <
           std::tuple(b.id, b.corners_px[0].y(), b.corners_px[0].x());
  });
  return detections;
}

}  // namespace tagdock
