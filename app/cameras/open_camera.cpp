#include "app/cameras/open_camera.h"

#include <algorithm>

#include "app/cameras/gvcp_probe.h"
#include "app/failure.h"

namespace tagdock {

namespace {

/// Written like an address: digits, dots and colons only, with at least one dot or colon. A serial number made of
/// digits alone is a serial number.
bool looks_like_address(const std::string& text) {
  return text.find_first_not_of("0123456789.:") == std::string::npos && text.find_first_of(".:") != std::string::npos;
}

}  // namespace

CameraArgument parse_camera_argument(const std::string& argument) {
  const auto after = [&](const std::string& prefix) { return argument.substr(prefix.size()); };
  if (argument == "sim") return SimulatedCamera{};
  if (argument.starts_with("gige:") && argument.size() > std::string("gige:").size()) {
    const std::string which = after("gige:");
    if (looks_like_address(which)) return GigeAddress{LoopbackAddress(which).text()};
    return GigeSerial{which};
  }
  if (argument.starts_with("images:") && argument.size() > std::string("images:").size())
    return Images{after("images:")};
  throw Failure(ExitCode::usage,
                "camera '" + argument + "' is not known: write sim, gige:127.x.y.z, gige:SERIAL or images:DIR");
}

std::unique_ptr<Camera> open_camera(const CameraArgument& argument, const GigeSettings& gige, double image_rate,
                                    std::chrono::steady_clock::time_point session_start) {
  if (const auto* images = std::get_if<Images>(&argument))
    return std::make_unique<ImageSequence>(ImageSequenceSettings{images->where, image_rate});
  GigeSettings settings = gige;
  settings.address.clear();
  settings.serial.clear();
  if (const auto* address = std::get_if<GigeAddress>(&argument)) {
    settings.address = address->address;
  } else if (const auto* serial = std::get_if<GigeSerial>(&argument)) {
    settings.serial = serial->serial;
  } else {
    throw Failure(ExitCode::internal, "a simulated camera is made by who simulates the world");
  }
  return open_gige(settings, session_start);
}

}  // namespace tagdock
