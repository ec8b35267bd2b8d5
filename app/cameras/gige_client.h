#pragma once

#include <chrono>
#include <functional>
#include <memory>
#include <vector>

#include <opencv2/core.hpp>

#include "app/camera.h"
#include "app/cameras/gige.h"

namespace tagdock {

/// What a client of a GigE camera needs from whom it works for. All are called from its threads.
struct GigeClientHooks {
  /// Memory for frames: `count` pictures, each with a reference count of its own. Called whenever the camera is opened;
  /// earlier pictures may still be out. Empty: the client's own memory.
  std::function<std::vector<cv::Mat1b>(int count, int rows, int columns)> pictures;
  /// The state or the counts are new; those of a frame are told before it can be taken.
  std::function<void(const CameraHealth&)> changed;
  /// A frame can be taken.
  std::function<void()> frame_ready;
  /// Aravis does not come to an end with packets that it got and cannot be stopped: only another process helps. Empty:
  /// it is waited for.
  std::function<void()> stuck;
};

/// The client itself, in this process: Aravis, which a malformed datagram aborts. `open_gige` runs it in another one.
/// A thread of its own hands the newest frame over, notices when the camera is lost (no good frame for 250 ms or 5
/// periods, and no answer to two probes), and opens the same camera again when it is back.
/// @throws Failure as open_gige
std::unique_ptr<Camera> open_gige_client(const GigeSettings& settings,
                                         std::chrono::steady_clock::time_point session_start,
                                         const GigeClientHooks& hooks = {});

}  // namespace tagdock
