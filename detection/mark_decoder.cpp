#include "detection/mark_decoder.h"

#include <algorithm>
#include <cctype>
#include <stdexcept>
#include <utility>

#include <opencv2/aruco.hpp>

namespace tagdock {
namespace {

constexpr std::pair<const char*, cv::aruco::PREDEFINED_DICTIONARY_NAME> dictionaries[] = {
    {"4X4_50", cv::aruco::DICT_4X4_50},
    {"4X4_100", cv::aruco::DICT_4X4_100},
    {"4X4_250", cv::aruco::DICT_4X4_250},
    {"4X4_1000", cv::aruco::DICT_4X4_1000},
    {"5X5_50", cv::aruco::DICT_5X5_50},
    {"5X5_100", cv::aruco::DICT_5X5_100},
    {"5X5_250", cv::aruco::DICT_5X5_250},
    {"5X5_1000", cv::aruco::DICT_5X5_1000},
    {"6X6_50", cv::aruco::DICT_6X6_50},
    {"6X6_100", cv::aruco::DICT_6X6_100},
    {"6X6_250", cv::aruco::DICT_6X6_250},
    {"6X6_1000", cv::aruco::DICT_6X6_1000},
    {"7X7_50", cv::aruco::DICT_7X7_50},
    {"7X7_100", cv::aruco::DICT_7X7_100},
    {"7X7_250", cv::aruco::DICT_7X7_250},
    {"7X7_1000", cv::aruco::DICT_7X7_1000},
    {"ARUCO_ORIGINAL", cv::aruco::DICT_ARUCO_ORIGINAL},
    {"APRILTAG_16H5", cv::aruco::DICT_APRILTAG_16h5},
    {"APRILTAG_25H9", cv::aruco::DICT_APRILTAG_25h9},
    {"APRILTAG_36H10", cv::aruco::DICT_APRILTAG_36h10},
    {"APRILTAG_36H11", cv::aruco::DICT_APRILTAG_36h11},
    {"TAG16H5", cv::aruco::DICT_APRILTAG_16h5},
    {"TAG25H9", cv::aruco::DICT_APRILTAG_25h9},
    {"TAG36H11", cv::aruco::DICT_APRILTAG_36h11},
};

cv::Ptr<cv::aruco::Dictionary> dictionary_of(const std::string& word) {
  std::string name = word;
  std::transform(name.begin(), name.end(), name.begin(), [](unsigned char c) { return std::toupper(c); });
  if (name.starts_with("DICT_")) name.erase(0, 5);
  for (const auto& [known, value] : dictionaries)
    if (name == known) return cv::aruco::getPredefinedDictionary(value);
  throw std::invalid_argument("\"" + word +
                              "\" is no dictionary; known are DICT_4X4_50 .. DICT_7X7_1000, DICT_ARUCO_ORIGINAL, "
                              "DICT_APRILTAG_16h5, 25h9, 36h10, 36h11, and the families tag16h5, tag25h9, tag36h11");
}

}  // namespace

struct MarkDecoder::Library {
  cv::Ptr<cv::aruco::Dictionary> dictionary;
  cv::Ptr<cv::aruco::DetectorParameters> parameters = cv::aruco::DetectorParameters::create();
};

MarkDecoder::MarkDecoder(const std::string& dictionary) : library_(std::make_unique<Library>()) {
  library_->dictionary = dictionary_of(dictionary);
}

MarkDecoder::~MarkDecoder() = default;

std::vector<DecodedMark> MarkDecoder::decode(const cv::Mat1b& gray) const {
  constexpr int least_side = 32;  // px; below that no mark can be read
  if (gray.cols < least_side || gray.rows < least_side) return {};
  std::vector<std::vector<cv::Point2f>> corners;
  std::vector<int> ids;
  cv::aruco::detectMarkers(gray, library_->dictionary, corners, ids, library_->parameters);
  std::vector<DecodedMark> marks;
  for (std::size_t i = 0; i < ids.size(); ++i) {
    DecodedMark mark{ids[i], {}};
    for (std::size_t k = 0; k < 4; ++k) mark.corners_px[k] = {corners[i][k].x, corners[i][k].y};
    marks.push_back(mark);
  }
  std::stable_sort(marks.begin(), marks.end(), [](const DecodedMark& a, const DecodedMark& b) { return a.id < b.id; });
  return marks;
}

TagPattern mark_pattern(const std::string& dictionary, int id) {
  const cv::Ptr<cv::aruco::Dictionary> codes = dictionary_of(dictionary);
  if (id < 0 || id >= codes->bytesList.rows)
    throw std::invalid_argument(dictionary + " has no mark " + std::to_string(id) + "; it has " +
                                std::to_string(codes->bytesList.rows));
  TagPattern pattern;
  pattern.cells = pattern.border_cells = codes->markerSize + 2;
  cv::Mat bits;
  codes->drawMarker(id, pattern.cells, bits, 1);
  for (int row = 0; row < pattern.cells; ++row)
    for (int column = 0; column < pattern.cells; ++column)
      pattern.cell.push_back(bits.at<unsigned char>(row, column) > 127 ? TagPattern::white : TagPattern::black);
  return pattern;
}

}  // namespace tagdock
