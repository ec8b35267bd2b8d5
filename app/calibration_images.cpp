#include "app/calibration_images.h"

#include <algorithm>
#include <atomic>
#include <mutex>
#include <set>
#include <stdexcept>
#include <thread>

#include <opencv2/core/utility.hpp>

#include "app/failure.h"
#include "app/image_file.h"

namespace tagdock {
namespace {

std::vector<std::filesystem::path> pictures_in(const std::filesystem::path& folder) {
  std::error_code error;
  if (!std::filesystem::is_directory(folder, error))
    throw Failure(ExitCode::usage, "--images " + folder.string() + ": there is no such folder");
  const std::set<std::string> known{".png", ".jpg", ".jpeg", ".pgm", ".tif", ".tiff", ".bmp"};
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(folder)) {
    std::string extension = entry.path().extension().string();
    std::transform(extension.begin(), extension.end(), extension.begin(),
                   [](unsigned char c) { return std::tolower(c); });
    if (entry.is_regular_file() && known.contains(extension)) files.push_back(entry.path());
  }
  if (files.empty())
    throw Failure(ExitCode::usage, "--images " + folder.string() + ": no picture in it (PNG, JPEG, PGM, TIFF, BMP)");
  std::sort(files.begin(), files.end());
  return files;
}

}  // namespace

CalibrationView view_of(const std::string& name, const TargetView& seen) {
  CalibrationView view;
  view.name = name;
  view.corners = seen.corners;
  view.corners_expected = seen.corners_expected;
  view.marks_found = seen.marks_found;
  view.marks_elsewhere = seen.marks_elsewhere;
  view.blur_px = seen.blur_px;
  view.sharpest_px = seen.sharpest_px;
  view.clipped = seen.clipped;
  view.contrast = seen.contrast;
  return view;
}

ImageViews find_in_folder(const std::filesystem::path& folder, const CalibrationTarget& target,
                          const std::optional<CameraModel>& camera) {
  const std::vector<std::filesystem::path> files = pictures_in(folder);
  struct Found {
    std::optional<CalibrationView> view;
    std::string unreadable;
    cv::Size size;
  };
  std::vector<Found> found(files.size());
  std::atomic<std::size_t> next{0};
  std::mutex guard;
  std::string wrong;
  cv::setNumThreads(1);  // pictures are the unit of work
  const auto work = [&] {
    try {
      const TargetFinder finder(target);
      for (std::size_t i = next++; i < files.size(); i = next++) {
        const auto image = [&] {
          const std::lock_guard<std::mutex> lock(guard);  // reading hushes stderr, which all threads share
          return read_grey(files[i]);
        }();
        if (const std::string* sentence = std::get_if<std::string>(&image)) {
          found[i].unreadable = *sentence;
          continue;
        }
        const cv::Mat1b& gray = std::get<cv::Mat1b>(image);
        found[i].size = gray.size();
        found[i].view = view_of(files[i].filename().string(), finder.find(gray, camera));
      }
    } catch (const std::invalid_argument& error) {
      const std::lock_guard<std::mutex> lock(guard);
      wrong = error.what();
    }
  };
  std::vector<std::thread> workers;
  const unsigned count = std::clamp(std::thread::hardware_concurrency(), 1U, 8U);
  for (unsigned i = 1; i < count; ++i) workers.emplace_back(work);
  work();
  for (std::thread& worker : workers) worker.join();
  if (!wrong.empty()) throw Failure(ExitCode::usage, "the target: " + wrong);

  ImageViews result;
  std::string first;
  for (std::size_t i = 0; i < files.size(); ++i) {
    if (!found[i].view) {
      result.unreadable.push_back(found[i].unreadable);
      continue;
    }
    if (first.empty()) {
      first = files[i].filename().string();
      result.width = found[i].size.width;
      result.height = found[i].size.height;
    }
    if (found[i].size != cv::Size(result.width, result.height))
      throw Failure(ExitCode::usage, files[i].string() + ": " + std::to_string(found[i].size.width) + "x" +
                                         std::to_string(found[i].size.height) + " pixels, but " + first + " has " +
                                         std::to_string(result.width) + "x" + std::to_string(result.height) +
                                         "; all pictures must be of one camera and size");
    result.views.push_back(std::move(*found[i].view));
    result.files.push_back(files[i]);
  }
  if (result.views.empty())
    throw Failure(ExitCode::usage,
                  "--images " + folder.string() + ": no picture can be read: " + result.unreadable.front());
  return result;
}

}  // namespace tagdock
