#pragma once

#include <chrono>
#include <cstdint>

#include <opencv2/core.hpp>

namespace tagdock {

/// One image. Its pixels are never written after capture, so copies share them.
struct Frame {
  cv::Mat1b gray;
  std::chrono::nanoseconds time{0};  ///< mid-exposure, since the session began
  std::uint64_t number = 0;          ///< counts the camera's frames, gaps included
};

}  // namespace tagdock
