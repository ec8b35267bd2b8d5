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

namespace {

/// Calls work(finder, i) for all i below count, on as many threads as the machine has cores: pictures are the unit of
/// work.
template <typename Work>
void for_all_pictures(const CalibrationTarget& target, std::size_t count, const Work& work) {
  cv::setNumThreads(1);
  std::atomic<std::size_t> next{0};
  std::mutex guard;
  std::string wrong;
  const auto loop = [&] {
    try {
      const TargetFinder finder(target);
      for (std::size_t i = next++; i < count; i = next++) work(finder, i);
    } catch (const std::invalid_argument& error) {
      const std::lock_guard<std::mutex> lock(guard);
      wrong = error.what();
    }
  };
  std::vector<std::thread> workers;
  const unsigned threads = std::clamp(std::thread::hardware_concurrency(), 1U, 8U);
  for (unsigned i = 1; i < threads; ++i) workers.emplace_back(loop);
  loop();
  for (std::thread& worker : workers) worker.join();
  if (!wrong.empty()) throw Failure(ExitCode::usage, "the target: " + wrong);
}

}  // namespace

ImageViews find_in_folder(const std::filesystem::path& folder, const CalibrationTarget& target) {
  const std::vector<std::filesystem::path> files = pictures_in(folder);
  struct Found {
    std::optional<TargetView> view;
    std::string unreadable;
    cv::Size size;
  };
  std::vector<Found> found(files.size());
  for_all_pictures(target, files.size(), [&](const TargetFinder& finder, std::size_t i) {
    const auto image = read_grey(files[i]);
    if (const std::string* sentence = std::get_if<std::string>(&image)) {
      found[i].unreadable = *sentence;
      return;
    }
    const cv::Mat1b& gray = std::get<cv::Mat1b>(image);
    found[i].size = gray.size();
    found[i].view = finder.find_coarsely(gray);
  });

  ImageViews result;
  std::string first;
  for (std::size_t i = 0; i < files.size(); ++i) {
    if (!found[i].view) {
      result.unreadable.push_back(found[i].unreadable);
      continue;
    }
    const std::string name = files[i].filename().string();
    if (first.empty()) {
      first = name;
      result.width = found[i].size.width;
      result.height = found[i].size.height;
    }
    if (found[i].size != cv::Size(result.width, result.height))
      throw Failure(ExitCode::usage, files[i].string() + ": " + std::to_string(found[i].size.width) + "x" +
                                         std::to_string(found[i].size.height) + " pixels, but " + first + " has " +
                                         std::to_string(result.width) + "x" + std::to_string(result.height) +
                                         "; all pictures must be of one camera and size");
    result.views.push_back(view_of(name, *found[i].view));
    result.files.push_back(files[i]);
    result.seen.push_back(std::move(*found[i].view));
  }
  if (result.views.empty())
    throw Failure(ExitCode::usage,
                  "--images " + folder.string() + ": no picture can be read: " + result.unreadable.front());
  return result;
}

ImageViews refine_in_folder(const ImageViews& found, const CalibrationTarget& target, const CameraModel& camera) {
  ImageViews result = found;
  std::vector<std::string> gone(found.files.size());
  for_all_pictures(target, found.files.size(), [&](const TargetFinder& finder, std::size_t i) {
    if (found.seen[i].corners.empty()) return;
    const auto image = read_grey(found.files[i]);
    if (const std::string* sentence = std::get_if<std::string>(&image)) {
      gone[i] = *sentence;
      return;
    }
    result.seen[i] = finder.refine(std::get<cv::Mat1b>(image), found.seen[i], camera);
    result.views[i] = view_of(found.views[i].name, result.seen[i]);
  });
  for (const std::string& sentence : gone)
    if (!sentence.empty()) throw Failure(ExitCode::usage, sentence);
  return result;
}

FolderCalibration calibrate_from_folder(const std::filesystem::path& folder, const CalibrationTarget& target,
                                        const IntrinsicsConfig& config) {
  FolderCalibration made;
  made.views = find_in_folder(folder, target);
  const auto solve = [&](const IntrinsicsConfig& how) {
    made.result = calibrate_intrinsics(made.views.views, made.views.width, made.views.height, how);
  };
  try {
    IntrinsicsConfig quick;  // whatever lens and board are asked for: corners want the lens as it is
    quick.lens_only = true;
    solve(quick);
    constexpr std::size_t enough_corners = 50;  // to know the lens from
    if (made.result.corners.size() >= enough_corners)
      made.views = refine_in_folder(made.views, target, made.result.camera);
    solve(config);
  } catch (const std::invalid_argument& error) {
    throw Failure(ExitCode::calibration_refused, folder.string() + ": " + error.what());
  }
  return made;
}

}  // namespace tagdock
