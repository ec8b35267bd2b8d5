#include "app/recording.h"

#include <algorithm>
#include <cstdio>
#include <sstream>

namespace tagdock {
namespace {

std::string quoted(std::string text) {
  text.erase(std::remove_if(text.begin(), text.end(), [](char c) { return c == '"' || c == '\\' || c == '\n'; }),
             text.end());
  return "\"" + text + "\"";
}

}  // namespace

std::string session_yaml(const std::string& config_text, const std::string& camera_name, const CameraSettings& actual,
                         std::uint64_t seed) {
  char numbers[400];
  std::snprintf(numbers, sizeof numbers,
                "sensor_width: %d, sensor_height: %d, binning: %d, offset_x: %d, offset_y: %d, width: %d, height: %d, "
                "frame_rate: %.17g, exposure_us: %.17g, gain: %.17g",
                actual.sensor_width, actual.sensor_height, actual.binning, actual.offset_x, actual.offset_y,
                actual.width, actual.height, actual.frame_rate, actual.exposure_us, actual.gain);
  std::string text = "format: 1\nprogram: \"tagdock " TAGDOCK_VERSION "\"\nseed: " + std::to_string(seed) +
                     "\ncamera_name: " + quoted(camera_name) + "\ncamera: {identity: " + quoted(actual.identity) +
                     ", address: " + quoted(actual.address) + ", " + numbers + "}\nconfig:\n";
  std::istringstream lines(config_text);
  for (std::string line; std::getline(lines, line);) text += "  " + line + "\n";
  return text;
}

std::string sensor_yaml(const CameraModel& camera, double frame_rate) {
  char text[512];
  std::snprintf(text, sizeof text,
                "sensor_type: camera\nrate_hz: %.17g\nresolution: [%d, %d]\ncamera_model: pinhole\n"
                "intrinsics: [%.17g, %.17g, %.17g, %.17g]\ndistortion_model: radial-tangential\n"
                "distortion_coefficients: [%.17g, %.17g, %.17g, %.17g]\n",
                frame_rate, camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy, camera.k1,
                camera.k2, camera.p1, camera.p2);
  return text;
}

}  // namespace tagdock
