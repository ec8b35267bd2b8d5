#include "app/cameras/image_sequence.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstdint>
#include <utility>

#include <opencv2/imgcodecs.hpp>
#include <opencv2/imgproc.hpp>

#include "app/failure.h"
#include "app/image_file.h"

namespace tagdock {

namespace {

using std::chrono::nanoseconds;

std::string lower(std::string text) {
  std::transform(text.begin(), text.end(), text.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return text;
}

bool is_picture(const std::filesystem::path& file) {
  constexpr std::array<const char*, 9> endings{".pgm",  ".ppm", ".pnm",  ".png", ".jpg",
                                               ".jpeg", ".tif", ".tiff", ".bmp"};
  const std::string ending = lower(file.extension().string());
  return std::find(endings.begin(), endings.end(), ending) != endings.end();
}

bool digit(char c) { return c >= '0' && c <= '9'; }

/// Names as people count: I2 before I10. Runs of digits compare by value, the rest by character.
bool counts_before(const std::string& a, const std::string& b) {
  std::size_t i = 0, j = 0;
  while (i < a.size() && j < b.size()) {
    if (digit(a[i]) && digit(b[j])) {
      const auto run = [](const std::string& text, std::size_t& at) {
        while (at < text.size() && text[at] == '0') ++at;
        const std::size_t begin = at;
        while (at < text.size() && digit(text[at])) ++at;
        return text.substr(begin, at - begin);
      };
      const std::string number_a = run(a, i);
      const std::string number_b = run(b, j);
      if (number_a.size() != number_b.size()) return number_a.size() < number_b.size();
      if (number_a != number_b) return number_a < number_b;
    } else {
      if (a[i] != b[j]) return a[i] < b[j];
      ++i;
      ++j;
    }
  }
  if (a.size() - i != b.size() - j) return a.size() - i < b.size() - j;
  return a < b;  // the same but for leading zeros
}

std::vector<std::filesystem::path> sorted_pictures(const std::filesystem::path& folder, const std::string& where) {
  std::vector<std::filesystem::path> files;
  std::error_code error;
  for (std::filesystem::directory_iterator at(folder, error), end; !error && at != end; at.increment(error))
    if (at->is_regular_file() && is_picture(at->path())) files.push_back(at->path());
  if (error) throw Failure(ExitCode::usage, "cannot list the pictures of " + where + ": " + error.message());
  std::sort(files.begin(), files.end(),
            [](const auto& a, const auto& b) { return counts_before(a.filename().string(), b.filename().string()); });
  return files;
}

/// Files of a pattern with one %d or %0Nd in the file's name.
std::vector<std::filesystem::path> numbered_pictures(const std::string& pattern) {
  const std::filesystem::path path(pattern);
  const std::string name = path.filename().string();
  const std::size_t percent = name.find('%');
  std::size_t letter = percent == std::string::npos ? name.size() : percent + 1;
  std::size_t digits = 1;
  if (letter + 1 < name.size() && name[letter] == '0' && digit(name[letter + 1])) {
    digits = static_cast<std::size_t>(name[letter + 1] - '0');
    letter += 2;
  }
  if (letter >= name.size() || name[letter] != 'd')
    throw Failure(ExitCode::usage, "the picture pattern " + pattern + " holds no number of the form %d or %04d");
  const std::string before = name.substr(0, percent);
  const std::string after = name.substr(letter + 1);

  std::vector<std::pair<unsigned long, std::filesystem::path>> found;
  std::error_code error;
  const std::filesystem::path folder = path.has_parent_path() ? path.parent_path() : std::filesystem::path(".");
  for (std::filesystem::directory_iterator at(folder, error), end; !error && at != end; at.increment(error)) {
    const std::string file = at->path().filename().string();
    if (file.size() <= before.size() + after.size() || !file.starts_with(before) || !file.ends_with(after)) continue;
    const std::string number = file.substr(before.size(), file.size() - before.size() - after.size());
    constexpr std::size_t longest = 18;  // fits 64 bits
    const bool written_so = number.size() == digits || (number.size() > digits && number.front() != '0');
    if (!std::all_of(number.begin(), number.end(), digit) || number.size() > longest || !written_so) continue;
    found.emplace_back(std::stoul(number), at->path());
  }
  if (error) throw Failure(ExitCode::usage, "cannot list the pictures of " + pattern + ": " + error.message());
  std::sort(found.begin(), found.end());
  std::vector<std::filesystem::path> files;
  for (const auto& [number, file] : found) {
    if (number != found.front().first + files.size()) break;
    files.push_back(file);
  }
  return files;
}

cv::Mat1b readable(const std::filesystem::path& file) {
  const auto image = read_grey(file);
  if (const std::string* sentence = std::get_if<std::string>(&image)) throw Failure(ExitCode::usage, *sentence);
  return std::get<cv::Mat1b>(image);
}

}  // namespace

std::vector<std::filesystem::path> list_images(const std::string& where) {
  const bool folder = std::filesystem::is_directory(where);
  const bool pattern = !folder && where.find('%') != std::string::npos;
  if (!folder && !pattern)
    throw Failure(ExitCode::usage, where + " is neither a folder of pictures nor a numbered pattern such as I%04d.pgm");
  std::vector<std::filesystem::path> files = folder ? sorted_pictures(where, where) : numbered_pictures(where);
  if (files.empty())
    throw Failure(ExitCode::usage, "there is no picture in " + where + ": PGM, PNG, JPEG, TIFF and BMP are looked for");
  return files;
}

ImageSequence::ImageSequence(const ImageSequenceSettings& settings)
    : settings_(settings), files_(list_images(settings.where)) {
  if (!(settings.rate > 0.0) || !std::isfinite(settings.rate))
    throw Failure(ExitCode::usage, "the rate of the pictures must be positive, not " + std::to_string(settings.rate));
  health_.state = "streaming";
}

nanoseconds ImageSequence::time_of(std::size_t index) const {
  return nanoseconds(std::llround(static_cast<double>(index) * 1e9 / settings_.rate));
}

std::optional<CameraFrame> ImageSequence::newest(nanoseconds now) {
  std::size_t last = next_;
  if (last >= files_.size() || time_of(last) > now) return std::nullopt;
  while (last + 1 < files_.size() && time_of(last + 1) <= now) ++last;
  health_.overwritten += last - next_;
  health_.received += last - next_;
  next_ = last;
  return next();
}

std::optional<CameraFrame> ImageSequence::next() {
  if (next_ >= files_.size()) return std::nullopt;
  CameraFrame frame;
  frame.frame = Frame{readable(files_[next_]), time_of(next_), next_};
  frame.arrived = frame.camera_time = frame.frame.time;
  size_ = frame.frame.gray.size();
  ++next_;
  ++health_.received;
  if (next_ == files_.size()) {
    health_.state = "ended";
    health_.reason = "the last of " + std::to_string(files_.size()) + " pictures was taken";
  }
  return frame;
}

CameraHealth ImageSequence::health() const { return health_; }

CameraSettings ImageSequence::actual() const {
  CameraSettings settings;
  settings.identity = "pictures of " + settings_.where;
  settings.sensor_width = settings.width = size_.width;
  settings.sensor_height = settings.height = size_.height;
  settings.frame_rate = settings_.rate;
  return settings;
}

}  // namespace tagdock
