// Pictures of Debian's package visp-images-data: one with twelve tags, and one with five tags for each family.
#include <filesystem>
#include <set>

#include <catch2/catch.hpp>
#include <opencv2/imgcodecs.hpp>

#include "detection/tag_locator.h"

namespace tagdock {
namespace {

const std::filesystem::path folder = "/usr/share/visp-images-data/ViSP-images/AprilTag";

cv::Mat1b picture(const std::string& name) {
  INFO("the test needs " << (folder / name) << ": apt install visp-images-data");
  REQUIRE(std::filesystem::exists(folder / name));
  cv::Mat1b gray = cv::imread((folder / name).string(), cv::IMREAD_GRAYSCALE);
  REQUIRE(!gray.empty());
  return gray;
}

}  // namespace

TEST_CASE("all twelve tags of the photograph are found and refined, no corner by more than a pixel") {
  const cv::Mat1b gray = picture("AprilTag.pgm");
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

TEST_CASE("all five tags of each family's picture are found and refined") {
  const std::pair<std::string, std::string> families[] = {{"tag36h11", "36_11"},         {"tag25h9", "25_09"},
                                                          {"tag16h5", "16_05"},          {"tagStandard41h12", "41_12"},
                                                          {"tagStandard52h13", "52_13"}, {"tagCircle21h7", "21_07"},
                                                          {"tagCircle49h12", "49_12"}};
  for (const auto& [family, word_in_name] : families) {
    CAPTURE(family);
    const cv::Mat1b gray = picture("benchmark/640x480/tag" + word_in_name + "_640x480.png");
    TagDetectorConfig config;
    config.family = family;
    config.decimate = 1;
    config.max_hamming = 0;
    const auto found = TagDetector(config).detect(gray);
    REQUIRE(found.size() == 5);
    for (int id = 0; id < 5; ++id) {
      CHECK(found[id].id == id);
      for (const CornerMethod method : {CornerMethod::tanh, CornerMethod::best}) {
        CAPTURE(id, word(method));
        const Refinement refined = refine(gray, family, found[id], method, std::nullopt);
        REQUIRE(std::holds_alternative<RefinedTag>(refined));
        for (int i = 0; i < 4; ++i)
          CHECK((std::get<RefinedTag>(refined).corners_px[i] - found[id].corners_px[i]).norm() < 1.0);
      }
    }
  }
}

}  // namespace tagdock
