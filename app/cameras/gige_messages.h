#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <variant>
#include <vector>

#include "app/camera.h"
#include "app/cameras/gige.h"
#include "app/cameras/gvcp_probe.h"
#include "app/failure.h"

namespace tagdock {

// What the docking process and the process of the Aravis client say to each other, one message a datagram of a
// socket pair. Numbers as the machine has them: both are the same program on the same machine.

/// -> client, first: open this camera.
struct OpenRequest {
  GigeSettings settings;
  std::chrono::nanoseconds session_start{0};  ///< of the steady clock
};
/// -> client: a frame's memory is free again.
struct FrameReturned {
  std::uint32_t memory = 0;
  std::int32_t slot = 0;
};
/// -> client
struct AdjustRequest {
  double exposure_us = 0.0;
  double gain = 0.0;
};
/// -> client
struct TriggerRequest {};
/// -> client: give the camera back and end. A client whose socket is closed does the same.
struct EndRequest {};
using ClientRequest = std::variant<OpenRequest, FrameReturned, AdjustRequest, TriggerRequest, EndRequest>;

/// <- client: memory for frames; its handle comes with the message.
struct MemoryMade {
  std::uint32_t memory = 0;  ///< counts
  std::int32_t count = 0;
  std::int32_t rows = 0;
  std::int32_t columns = 0;
};
/// <- client, before the stream begins and so before a datagram can end it: its sockets. Whoever knows them can give
/// the camera's control back after the client's death.
struct SocketsMade {
  std::vector<LocalPort> ports;
};
/// <- client: the camera streams.
struct CameraOpened {
  CameraSettings actual;
};
/// <- client: it could not be opened.
struct OpenFailed {
  ExitCode code = ExitCode::camera;
  std::string sentence;
};
/// <- client: how it is, at least every 50 ms.
struct HealthReport {
  CameraHealth health;
};
/// <- client: a frame lies in the shared memory.
struct FrameReady {
  std::uint32_t memory = 0;
  std::int32_t slot = 0;
  std::int32_t rows = 0;
  std::int32_t columns = 0;
  std::uint64_t number = 0;
  std::uint64_t lost_before = 0;
  std::chrono::nanoseconds time{0};
  std::chrono::nanoseconds arrived{0};
  std::chrono::nanoseconds camera_time{0};
  double exposure_us = 0.0;
  double gain = 0.0;
};
using ClientReport = std::variant<MemoryMade, SocketsMade, CameraOpened, OpenFailed, HealthReport, FrameReady>;

constexpr std::size_t longest_message = 16384;

std::vector<std::uint8_t> packed(const ClientRequest& request);
std::vector<std::uint8_t> packed(const ClientReport& report);
/// None for bytes that are no such message: what the other process says is not believed, it is read.
std::optional<ClientRequest> unpacked_request(const std::uint8_t* bytes, std::size_t size);
std::optional<ClientReport> unpacked_report(const std::uint8_t* bytes, std::size_t size);

/// A message with, if not -1, a handle; never waits. @return whether it was sent
bool send_message(int socket, const std::vector<std::uint8_t>& message, int handle = -1);

struct Received {
  std::vector<std::uint8_t> message;
  int handle = -1;      ///< the caller's to close
  bool closed = false;  ///< the other side is gone
};
/// The next message, if there is one; never waits.
std::optional<Received> receive_message(int socket);

}  // namespace tagdock
