#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>

#include "detection/frame.h"

namespace tagdock {

/// What a camera has done so far.
struct CameraHealth {
  std::string state;              ///< one word: "streaming", "lost", ...
  std::string reason;             ///< a sentence when the state is not good, with the next step for a person
  std::uint64_t received = 0;     ///< good frames
  std::uint64_t incomplete = 0;   ///< frames with missing packets or of the wrong size
  std::uint64_t lost = 0;         ///< frames that never came, by frame number
  std::uint64_t overwritten = 0;  ///< good frames that nobody took in time
  std::uint64_t reconnects = 0;
};

/// A frame as it left the camera, with what only the recording and the health report need.
struct CameraFrame {
  Frame frame;
  std::chrono::nanoseconds arrived{0};      ///< host time since the session began
  std::chrono::nanoseconds camera_time{0};  ///< the camera's own clock
  double exposure_us = 0.0;
  double gain = 0.0;
  std::uint64_t lost_before = 0;  ///< frames missing right before this one
};

/// A source of frames. `newest` is called from the loop thread and never waits.
class Camera {
 public:
  virtual ~Camera() = default;

  /// The newest frame that has not been taken yet; older ones are dropped and counted. None if there is no new one.
  /// @param now  session time; a simulated or recorded camera gives what has arrived by then
  virtual std::optional<CameraFrame> newest(std::chrono::nanoseconds now) = 0;

  [[nodiscard]] virtual CameraHealth health() const = 0;
};

}  // namespace tagdock
