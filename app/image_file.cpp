#include "app/image_file.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <fstream>
#include <iterator>
#include <libdeflate.h>
#include <string_view>
#include <vector>

#include <opencv2/imgcodecs.hpp>

namespace tagdock {
namespace {

constexpr std::uintmax_t largest_file = std::uintmax_t{1} << 30;

std::uint32_t big_endian(const char* bytes) {
  std::uint32_t value = 0;
  for (int i = 0; i < 4; ++i) value = value << 8 | static_cast<std::uint8_t>(bytes[i]);
  return value;
}

/// Whether the chunks of a PNG file are all there and as they were written. libpng says otherwise on stderr, in no
/// sentence of ours, and stderr cannot be hushed for one thread alone. Other formats' libraries are left to talk.
bool whole_if_png(const std::vector<char>& bytes) {
  constexpr std::array<char, 8> signature{'\x89', 'P', 'N', 'G', '\r', '\n', '\x1a', '\n'};
  if (bytes.size() < signature.size() || !std::equal(signature.begin(), signature.end(), bytes.begin())) return true;
  std::size_t at = signature.size();
  constexpr std::size_t around = 12;  // length, name and checksum
  while (at + around <= bytes.size()) {
    const std::size_t length = big_endian(&bytes[at]);
    if (length > bytes.size() - at - around) return false;
    if (libdeflate_crc32(0, &bytes[at + 4], length + 4) != big_endian(&bytes[at + 8 + length])) return false;
    if (std::string_view(&bytes[at + 4], 4) == "IEND") return true;
    at += around + length;
  }
  return false;
}

cv::Mat1b eight_bits(const cv::Mat1w& wide) {
  double brightest = 0.0;
  cv::minMaxLoc(wide, nullptr, &brightest);
  int shift = 0;
  while (static_cast<int>(brightest) >> shift > 255) ++shift;
  cv::Mat1b narrow;
  wide.convertTo(narrow, CV_8U, 1.0 / (1 << shift));
  return narrow;
}

}  // namespace

std::variant<cv::Mat1b, std::string> read_grey(const std::filesystem::path& file) {
  const std::string name = file.string();
  std::error_code error;
  if (!std::filesystem::exists(file, error)) return name + ": there is no such file";
  if (!std::filesystem::is_regular_file(file, error)) return name + ": not a file";
  if (std::filesystem::file_size(file, error) > largest_file || error) return name + ": larger than 1 GiB";
  std::ifstream stream(file, std::ios::binary);
  const std::vector<char> bytes{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  if (!stream.good() && !stream.eof()) return name + ": cannot be read";
  if (bytes.empty()) return name + (stream.is_open() ? ": the file is empty" : ": cannot be opened");
  cv::Mat image;
  if (!whole_if_png(bytes)) return name + ": not an image that can be read; the file is damaged or cut off";
  try {
    image = cv::imdecode(bytes, cv::IMREAD_GRAYSCALE | cv::IMREAD_ANYDEPTH | cv::IMREAD_IGNORE_ORIENTATION);
  } catch (const cv::Exception&) {
    return name + ": not an image that can be read";
  }
  if (image.empty()) return name + ": not an image that can be read";
  if (image.type() == CV_8UC1) return cv::Mat1b(image);
  if (image.type() == CV_16UC1) return eight_bits(image);
  return name + ": its pixels are neither of 8 nor of 16 bits";
}

}  // namespace tagdock
