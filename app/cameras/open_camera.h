#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <variant>

#include "app/camera.h"
#include "app/cameras/gige.h"
#include "app/cameras/image_sequence.h"

namespace tagdock {

/// What `--camera` names.
struct SimulatedCamera {  ///< sim: the simulated world; the caller makes it
  bool operator==(const SimulatedCamera&) const = default;
};
struct GigeAddress {  ///< gige:127.x.y.z
  std::string address;
  bool operator==(const GigeAddress&) const = default;
};
struct GigeSerial {  ///< gige:SERIAL
  std::string serial;
  bool operator==(const GigeSerial&) const = default;
};
struct Images {  ///< images:DIR or images:PATTERN
  std::string where;
  bool operator==(const Images&) const = default;
};
using CameraArgument = std::variant<SimulatedCamera, GigeAddress, GigeSerial, Images>;

/// Reads `sim`, `gige:127.x.y.z`, `gige:SERIAL` or `images:DIR`.
/// @throws Failure (usage) for anything else, and for an address outside 127.0.0.0/8
CameraArgument parse_camera_argument(const std::string& argument);

/// Opens a camera that is not simulated.
/// @param gige           how a GigE camera is asked to work; which one is taken from the argument
/// @param image_rate     pictures a second of a folder
/// @param session_start  zero of the session's time
/// @throws Failure as open_gige and ImageSequence do; (internal) for a SimulatedCamera, which the caller makes itself
std::unique_ptr<Camera> open_camera(const CameraArgument& argument, const GigeSettings& gige, double image_rate,
                                    std::chrono::steady_clock::time_point session_start);

}  // namespace tagdock
