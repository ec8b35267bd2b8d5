// The photograph of Debian's package visp-images-data: twelve tags in one picture.
#include <filesystem>
#include <set>

#include <catch2/catch.hpp>
#include <opencv2/imgcodecs.hpp>

#include "detection/tag_locator.h"

namespace tagdock {

TEST_CASE("all twelve tags of the photograph are found and refined, no corner by more than a pixel") {
  const std::filesystem::path file = "/usr/share/visp-images-data/ViSP-images/AprilTag/AprilTag.pgm";
  INFO("the test needs " << file << ": apt install visp-images-data");
  REQUIRE(std::filesystem::exists(file));
  const cv::Mat1b gray = cv::imread(file.string(), cv::IMREAD_GRAYSCALE);
  REQUIRE(!gray.empty());
  for (const int decimate : {1, 2}) {
    TagDetectorConfig config;
    config.decimate = decimate;
    const auto found = TagDetector(config).detect(gray);
    std::set<int> ids;
    for (const TagDetection& detection : found) ids.insert(detection.id);
    CAPTURE(decimate);
    CHECK(found.size() == 12);
    CHECK(ids.size() == 12);
    for (const TagDetection& detection : found)
      for (const CornerMethod method :
           {CornerMethod::tanh, CornerMethod::filter, CornerMethod::erf, CornerMethod::best}) {
        CAPTURE(detection.id, word(method));
        const Refinement refined = refine(gray, config.family, detection, method, std::nullopt);
        REQUIRE(std::holds_alternative<RefinedTag>(refined));
        const RefinedTag& tag = std::get<RefinedTag>(refined);
        CAPTURE(tag.terms);
        for (int i = 0; i < 4; ++i) {
          CHECK((tag.corners_px[i] - detection.corners_px[i]).norm() < 1.0);
          CHECK(tag.covariance_px2(2 * i, 2 * i) > 0.0);
        }
      }
  }
}

}  // namespace tagdock
