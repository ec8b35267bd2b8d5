#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace tagdock {

/// A numeric address inside 127.0.0.0/8: the only kind that tagdock sends anything to.
class LoopbackAddress {
 public:
  /// @throws Failure (usage) for a name, an address of another network, or anything else that is not a.b.c.d;
  ///         nothing is ever looked up in a name service
  explicit LoopbackAddress(const std::string& text);

  [[nodiscard]] const std::string& text() const { return text_; }
  [[nodiscard]] std::uint32_t number() const { return number_; }  ///< host byte order

  bool operator==(const LoopbackAddress&) const = default;

 private:
  std::string text_;
  std::uint32_t number_ = 0;
};

/// How a GigE Vision camera introduces itself (bootstrap registers of its discovery answer).
struct CameraIdentity {
  std::string address;
  std::string vendor;
  std::string model;
  std::string serial;
  std::string user_name;

  bool operator==(const CameraIdentity&) const = default;
};

/// Asks one address whether a camera is there: a discovery command by unicast, never by broadcast.
/// Answered in 0.03 to 0.2 ms by the simulated camera. Does not disturb whoever controls the camera.
std::optional<CameraIdentity> probe_camera(const LoopbackAddress& address, std::chrono::milliseconds timeout);

/// Asks every address of the loopback device, and 127.0.0.1 to 127.0.0.16, which camera is there; one datagram each.
std::vector<CameraIdentity> probe_loopback(std::chrono::milliseconds timeout);

/// Whether somebody controls the camera; none if it does not answer.
/// Aravis' camera renews the controller's lease (3 s) at every read of this register, whoever reads: ask seldom.
std::optional<bool> is_controlled(const LoopbackAddress& address, std::chrono::milliseconds timeout);

/// Where a UDP socket of this machine is bound.
struct LocalPort {
  std::uint32_t address = 0;  ///< host byte order
  std::uint32_t port = 0;

  bool operator==(const LocalPort&) const = default;
};

/// Gives the control of a camera back in the place of a controller that died: a camera knows its controller by address
/// and port only, and would else wait for its heartbeat for seconds. Of the ports tried, those are passed over that
/// somebody holds; a camera refuses the others, but for the one that has the control.
void give_control_back(const LoopbackAddress& camera, const std::vector<LocalPort>& ports,
                       std::chrono::milliseconds timeout);

/// Whether another program holds the GVCP port 3956 of the address.
bool gvcp_port_is_taken(const LoopbackAddress& address);

}  // namespace tagdock
