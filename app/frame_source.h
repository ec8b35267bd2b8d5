#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <string>
#include <vector>

#include <opencv2/core.hpp>

namespace tagdock {

/// A picture that can be loaded when it is wanted.
struct SourceFrame {
  std::string name;  ///< the file, or the video and the number in it
  std::string file;  ///< with its path; empty for a picture of a video
  std::chrono::nanoseconds time{0};
  std::uint64_t number = 0;
  /// @throws Failure (usage) with the name when it cannot be read
  std::function<cv::Mat1b()> load;
};

/// Recorded pictures of any kind that we read, in order of time.
struct FrameSource {
  std::string kind;  ///< session, euroc, tum, video, or images
  std::vector<SourceFrame> frames;
  std::vector<std::string> remarks;  ///< what was left out
};

/// By content: a session folder; a EuRoC folder (`mav0/cam0/data.csv` or `cam0/data.csv`: #timestamp [ns],filename); a
/// TUM RGB-D folder (`rgb.txt`: seconds filename); a video file that OpenCV reads; a folder of images or a numbered
/// pattern as ViSP has it (one picture a 1/rate).
/// @throws Failure (usage) when there are no pictures
FrameSource open_frames(const std::string& where, double rate);

/// The frames with from <= time <= to, in seconds after the first.
void keep_between(FrameSource& source, double from_s, double to_s);

}  // namespace tagdock
