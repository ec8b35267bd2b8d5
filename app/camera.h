#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "detection/frame.h"

namespace tagdock {

/// A camera went over to another state.
struct CameraStateChange {
  std::string state;
  std::chrono::nanoseconds time{0};  ///< since the session began
};

/// What a camera has done so far.
struct CameraHealth {
  /// One word: probing, absent, opening, claiming, configuring, streaming, silent, lost, ended.
  std::string state;
  std::string reason;             ///< a sentence when the state is not good, with the next step for a person
  std::uint64_t received = 0;     ///< good frames
  std::uint64_t incomplete = 0;   ///< frames with missing packets or of the wrong size
  std::uint64_t lost = 0;         ///< frames that never came, by frame number
  std::uint64_t overwritten = 0;  ///< good frames that nobody took in time
  std::uint64_t reconnects = 0;
  std::uint64_t stale = 0;                 ///< frames that repeated an old number or time stamp, and were not used
  std::uint64_t resent = 0;                ///< packets that the camera sent again because they were missed
  std::uint64_t restarts = 0;              ///< how often the process that talks to the camera had to be started again
  std::vector<CameraStateChange> history;  ///< the last states, oldest first
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

/// What a camera is and what it made of the settings that it was asked for. Zero or empty: it does not say.
struct CameraSettings {
  std::string identity;  ///< vendor, model and serial number, or the folder of a recorded camera
  std::string address;   ///< numeric, of a network camera
  int sensor_width = 0;  ///< [px]
  int sensor_height = 0;
  /// How many pixels of the sensor, in each direction, were averaged into one of the frame.
  int binning = 1;
  /// What of the (binned) sensor the frames show: pixel (0, 0) of a frame is the binned sensor's (offset_x, offset_y).
  int offset_x = 0;
  int offset_y = 0;
  int width = 0;
  int height = 0;
  double frame_rate = 0.0;  ///< 1/s
  double exposure_us = 0.0;
  double gain = 0.0;               ///< dB, as far as the camera keeps to the convention
  std::vector<std::string> notes;  ///< sentences for a person: what differs from what was asked, and its cure
};

/// A source of frames. `newest` is called from the loop thread and never waits.
class Camera {
 public:
  virtual ~Camera() = default;

  /// The newest frame that has not been taken yet; older ones are dropped and counted. None if there is no new one.
  /// @param now  session time; a simulated or recorded camera gives what has arrived by then
  virtual std::optional<CameraFrame> newest(std::chrono::nanoseconds now) = 0;

  [[nodiscard]] virtual CameraHealth health() const = 0;

  /// As read back from the camera when it was last opened.
  [[nodiscard]] virtual CameraSettings actual() const { return {}; }

  /// Asks for another exposure and gain from the next frame on; the frames tell what they were taken with, with one
  /// frame of doubt after a change. Does not wait; a camera that cannot ignores it.
  virtual void adjust(double /*exposure_us*/, double /*gain*/) {}

  /// Asks a camera that waits for triggers (GigeSettings::triggered) for one frame. Does not wait.
  virtual void trigger() {}
};

}  // namespace tagdock
