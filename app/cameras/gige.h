#pragma once

#include <chrono>
#include <cstddef>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "app/camera.h"

namespace tagdock {

/// Which camera, and how it is asked to work. What is not given stays as the camera has it.
struct GigeSettings {
  std::string address;  ///< numeric, inside 127.0.0.0/8; empty: looked for by serial number
  std::string serial;   ///< empty: whichever camera answers at the address
  int offset_x = 0;     ///< of the sensor's region that is sent [px]
  int offset_y = 0;
  int width = 0;  ///< 0: to the sensor's edge
  int height = 0;
  std::optional<double> frame_rate;  ///< 1/s
  std::optional<double> exposure_us;
  std::optional<double> gain;  ///< dB, as far as the camera keeps to the convention
  /// Bytes of a packet. 16384 on the loopback device: fewer packets than with the usual 1400, and frames four times
  /// smaller than the receive buffer still fit into a stock kernel's limit. A real network takes its MTU at most.
  int packet_size = 16384;
  /// Receive buffer of the stream. The sender sends a frame in one burst, so it must hold most of a frame.
  std::size_t receive_buffer = std::size_t{4} << 20;
  /// From mid-exposure to arrival, as far as the arrivals themselves cannot tell it: the smallest delay.
  std::chrono::nanoseconds declared_latency{0};
  /// How long a camera that somebody else controls is waited for. A controller that died keeps it for 3 s.
  std::chrono::milliseconds take_over_wait{4000};
  /// Told at once when somebody else controls the camera and it is waited for. May be empty.
  std::function<void(const std::string&)> waiting;
  bool triggered = false;  ///< a frame comes only when Camera::trigger asks for it
  /// Mono8, Mono10, Mono10Packed, Mono12, Mono12Packed or Mono16; wider pixels are cut to their upper 8 bits, so that
  /// frames cost one copy.
  std::string pixel_format = "Mono8";
  bool ptp = false;     ///< lets the camera's clock follow the network's (IEEE 1588); not tried with a real camera
  bool chunks = false;  ///< asks for each frame's own exposure and gain; not tried with a real camera
  /// What runs `serve_gige_client` for us: a program and the words before which nothing else is read. Empty: this
  /// program, as `tagdock camera-client`.
  std::vector<std::string> client_program;
};

/// Opens a GigE Vision camera and starts its stream. Aravis runs in a process of its own, since one malformed datagram
/// aborts it: frames come by shared memory without a copy, and when the process dies or hangs, the camera is lost
/// (Camera::health), its control is given back, and another process opens the same camera again.
/// Only numeric loopback addresses are ever spoken to, by unicast.
/// @param session_start  zero of the session's time
/// @throws Failure (camera) with a sentence when nobody is there, another program controls the camera, or the link
///         breaks; Failure (usage) when a setting is refused
std::unique_ptr<Camera> open_gige(const GigeSettings& settings, std::chrono::steady_clock::time_point session_start);

}  // namespace tagdock
