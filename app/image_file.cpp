#include "app/image_file.h"

#include <fcntl.h>
#include <fstream>
#include <iterator>
#include <unistd.h>
#include <vector>

#include <opencv2/imgcodecs.hpp>

namespace tagdock {
namespace {

constexpr std::uintmax_t largest_file = std::uintmax_t{1} << 30;

/// While one lives, nothing reaches stderr: libpng and OpenCV's readers print there what our own sentence says better.
class Hush {
 public:
  Hush() : kept_(dup(STDERR_FILENO)) {
    const int nowhere = open("/dev/null", O_WRONLY | O_CLOEXEC);
    if (kept_ >= 0 && nowhere >= 0) dup2(nowhere, STDERR_FILENO);
    if (nowhere >= 0) close(nowhere);
  }
  ~Hush() {
    if (kept_ < 0) return;
    dup2(kept_, STDERR_FILENO);
    close(kept_);
  }
  Hush(const Hush&) = delete;
  Hush& operator=(const Hush&) = delete;

 private:
  int kept_;
};

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
  try {
    const Hush hush;
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
