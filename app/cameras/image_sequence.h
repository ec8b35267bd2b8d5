#pragma once

#include <chrono>
#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

#include "app/camera.h"

namespace tagdock {

/// The pictures that `where` names, in order: a folder (its pictures by name, numbers inside names by value), or a
/// numbered pattern as ViSP writes it ("I%04d.pgm"; consecutive, from the smallest number that exists).
/// @throws Failure (usage) when there is none
std::vector<std::filesystem::path> list_images(const std::string& where);

struct ImageSequenceSettings {
  std::string where;   ///< folder or numbered pattern, see list_images
  double rate = 25.0;  ///< pictures a second, > 0
};

/// Pictures from files as a camera: picture k is taken at k / rate after the session begins and has the number k.
class ImageSequence : public Camera {
 public:
  /// @throws Failure (usage) when there are no pictures, or the rate is not positive
  explicit ImageSequence(const ImageSequenceSettings& settings);

  /// The last picture taken by `now`; those before it that nobody asked for are dropped and counted.
  /// @throws Failure (usage) with the file's name when a picture cannot be read
  std::optional<CameraFrame> newest(std::chrono::nanoseconds now) override;

  /// The next picture whatever the time, so that none is left out; none after the last.
  std::optional<CameraFrame> next();

  /// `streaming`, or `ended` after the last picture.
  [[nodiscard]] CameraHealth health() const override;
  [[nodiscard]] CameraSettings actual() const override;

  [[nodiscard]] const std::vector<std::filesystem::path>& files() const { return files_; }

 private:
  [[nodiscard]] std::chrono::nanoseconds time_of(std::size_t index) const;

  ImageSequenceSettings settings_;
  std::vector<std::filesystem::path> files_;
  std::size_t next_ = 0;
  CameraHealth health_;
  cv::Size size_;  ///< of the pictures read so far
};

}  // namespace tagdock
