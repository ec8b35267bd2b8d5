#include "app/cameras/gvcp_probe.h"

#include <algorithm>
#include <arpa/inet.h>
#include <array>
#include <cstring>
#include <ifaddrs.h>
#include <netinet/in.h>
#include <poll.h>
#include <set>
#include <sys/socket.h>
#include <unistd.h>

#include "app/failure.h"

namespace tagdock {

namespace {

using std::chrono::milliseconds;
using std::chrono::steady_clock;

// GigE Vision 1.2, control protocol. All numbers are big-endian.
constexpr std::uint16_t gvcp_port = 3956;
constexpr std::uint8_t gvcp_key = 0x42;
constexpr std::uint8_t answer_wanted = 0x01;
constexpr std::uint16_t discovery_command = 0x0002;
constexpr std::uint16_t discovery_answer = 0x0003;
constexpr std::uint16_t read_register_command = 0x0080;
constexpr std::uint16_t read_register_answer = 0x0081;
constexpr std::uint16_t write_register_command = 0x0082;
constexpr std::uint16_t write_register_answer = 0x0083;
constexpr std::uint32_t control_privilege_register = 0x0a00;
constexpr std::size_t header_size = 8;

struct Text {
  std::size_t offset;
  std::size_t size;
};
constexpr Text vendor_text{0x48, 32};
constexpr Text model_text{0x68, 32};
constexpr Text serial_text{0xd8, 16};
constexpr Text user_name_text{0xe8, 16};

class Socket {
 public:
  Socket() : handle_(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    if (handle_ < 0) throw Failure(ExitCode::camera, std::string("no UDP socket: ") + std::strerror(errno));
  }
  ~Socket() { ::close(handle_); }
  Socket(const Socket&) = delete;
  Socket& operator=(const Socket&) = delete;
  [[nodiscard]] int handle() const { return handle_; }

 private:
  int handle_;
};

sockaddr_in gvcp_address(std::uint32_t number) {
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(gvcp_port);
  address.sin_addr.s_addr = htonl(number);
  return address;
}

void put16(std::uint8_t* bytes, std::uint16_t value) {
  bytes[0] = static_cast<std::uint8_t>(value >> 8);
  bytes[1] = static_cast<std::uint8_t>(value);
}

std::uint16_t get16(const std::uint8_t* bytes) { return static_cast<std::uint16_t>(bytes[0] << 8 | bytes[1]); }

std::array<std::uint8_t, header_size> command_header(std::uint16_t command, std::uint16_t size, std::uint16_t id) {
  std::array<std::uint8_t, header_size> bytes{gvcp_key, answer_wanted};
  put16(&bytes[2], command);
  put16(&bytes[4], size);
  put16(&bytes[6], id);
  return bytes;
}

using Datagram = std::array<std::uint8_t, 1024>;

/// One datagram that answers `id` with `answer`, or none by the deadline. Anything else on the socket is ignored.
std::size_t receive(const Socket& socket, std::uint16_t answer, std::uint16_t id, steady_clock::time_point deadline,
                    Datagram& datagram, sockaddr_in& from) {
  while (true) {
    const auto left = std::chrono::ceil<milliseconds>(deadline - steady_clock::now());
    if (left.count() <= 0) return 0;
    pollfd wanted{socket.handle(), POLLIN, 0};
    if (::poll(&wanted, 1, static_cast<int>(left.count())) <= 0) continue;
    socklen_t from_size = sizeof from;
    const ssize_t size = ::recvfrom(socket.handle(), datagram.data(), datagram.size(), MSG_DONTWAIT,
                                    reinterpret_cast<sockaddr*>(&from), &from_size);
    if (size < 0 && errno == ECONNREFUSED) return 0;  // the kernel knows that nobody listens there
    if (size < static_cast<ssize_t>(header_size)) continue;
    const bool good_status = get16(&datagram[0]) == 0;
    if (good_status && get16(&datagram[2]) == answer && get16(&datagram[6]) == id)
      return static_cast<std::size_t>(size);
  }
}

std::string text_at(const Datagram& datagram, std::size_t size, const Text& text) {
  const std::size_t begin = header_size + text.offset;
  if (begin + text.size > size) return {};
  const auto* characters = reinterpret_cast<const char*>(&datagram[begin]);
  return std::string(characters, ::strnlen(characters, text.size));
}

CameraIdentity identity(const Datagram& datagram, std::size_t size, const sockaddr_in& from) {
  std::array<char, INET_ADDRSTRLEN> address{};
  ::inet_ntop(AF_INET, &from.sin_addr, address.data(), address.size());
  return {address.data(), text_at(datagram, size, vendor_text), text_at(datagram, size, model_text),
          text_at(datagram, size, serial_text), text_at(datagram, size, user_name_text)};
}

/// Addresses in 127.0.0.0/8 that the loopback device carries, and a few more that servers like to use.
std::set<std::uint32_t> loopback_numbers() {
  constexpr std::uint32_t first = 0x7f000001;
  constexpr std::uint32_t tried = 16;
  std::set<std::uint32_t> numbers;
  for (std::uint32_t i = 0; i < tried; ++i) numbers.insert(first + i);
  ifaddrs* all = nullptr;
  if (::getifaddrs(&all) != 0) return numbers;
  for (const ifaddrs* one = all; one != nullptr; one = one->ifa_next) {
    if (one->ifa_addr == nullptr || one->ifa_addr->sa_family != AF_INET) continue;
    sockaddr_in address{};
    std::memcpy(&address, one->ifa_addr, sizeof address);
    const std::uint32_t number = ntohl(address.sin_addr.s_addr);
    if (number >> 24 == 127) numbers.insert(number);
  }
  ::freeifaddrs(all);
  return numbers;
}

}  // namespace

LoopbackAddress::LoopbackAddress(const std::string& text) : text_(text) {
  in_addr address{};
  if (::inet_pton(AF_INET, text.c_str(), &address) != 1)
    throw Failure(ExitCode::usage, "camera address '" + text +
                                       "' is not a numeric address: write it as 127.x.y.z, for example 127.0.0.1");
  number_ = ntohl(address.s_addr);
  if (number_ >> 24 != 127)
    throw Failure(ExitCode::usage, "camera address " + text +
                                       " is outside 127.0.0.0/8: this program speaks to cameras on the loopback "
                                       "device only, for example gige:127.0.0.1");
}

std::optional<CameraIdentity> probe_camera(const LoopbackAddress& address, milliseconds timeout) {
  constexpr std::uint16_t id = 0x7464;
  const auto deadline = steady_clock::now() + timeout;
  const Socket socket;
  sockaddr_in to = gvcp_address(address.number());
  // Connected, so that the kernel tells at once when nobody listens there.
  if (::connect(socket.handle(), reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0) return std::nullopt;
  const auto question = command_header(discovery_command, 0, id);
  if (::send(socket.handle(), question.data(), question.size(), 0) < 0) return std::nullopt;
  Datagram datagram;
  const std::size_t size = receive(socket, discovery_answer, id, deadline, datagram, to);
  if (size == 0) return std::nullopt;
  return identity(datagram, size, gvcp_address(address.number()));
}

std::vector<CameraIdentity> probe_loopback(milliseconds timeout) {
  constexpr std::uint16_t id = 0x7465;
  const auto deadline = steady_clock::now() + timeout;
  const Socket socket;
  const auto question = command_header(discovery_command, 0, id);
  for (const std::uint32_t number : loopback_numbers()) {
    const sockaddr_in to = gvcp_address(number);
    ::sendto(socket.handle(), question.data(), question.size(), 0, reinterpret_cast<const sockaddr*>(&to), sizeof to);
  }
  std::vector<CameraIdentity> found;
  Datagram datagram;
  sockaddr_in from{};
  while (const std::size_t size = receive(socket, discovery_answer, id, deadline, datagram, from))
    found.push_back(identity(datagram, size, from));
  return found;
}

std::optional<bool> is_controlled(const LoopbackAddress& address, milliseconds timeout) {
  constexpr std::uint16_t id = 0x7466;
  const auto deadline = steady_clock::now() + timeout;
  const Socket socket;
  sockaddr_in to = gvcp_address(address.number());
  if (::connect(socket.handle(), reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0) return std::nullopt;
  std::array<std::uint8_t, header_size + 4> question{};
  const auto header = command_header(read_register_command, 4, id);
  std::copy(header.begin(), header.end(), question.begin());
  put16(&question[header_size], control_privilege_register >> 16);
  put16(&question[header_size + 2], control_privilege_register & 0xffff);
  if (::send(socket.handle(), question.data(), question.size(), 0) < 0) return std::nullopt;
  Datagram datagram;
  const std::size_t size = receive(socket, read_register_answer, id, deadline, datagram, to);
  if (size < header_size + 4) return std::nullopt;
  constexpr unsigned exclusive_or_controlled = 0b11;
  return (datagram[header_size + 3] & exclusive_or_controlled) != 0;
}

void give_control_back(const LoopbackAddress& camera, const std::vector<LocalPort>& ports, milliseconds timeout) {
  constexpr std::uint16_t id = 0x7467;
  for (const LocalPort& port : ports) {
    const Socket socket;
    sockaddr_in here{};
    here.sin_family = AF_INET;
    here.sin_port = htons(static_cast<std::uint16_t>(port.port));
    here.sin_addr.s_addr = htonl(port.address);
    sockaddr_in to = gvcp_address(camera.number());
    if (::bind(socket.handle(), reinterpret_cast<const sockaddr*>(&here), sizeof here) != 0 ||
        ::connect(socket.handle(), reinterpret_cast<const sockaddr*>(&to), sizeof to) != 0)
      continue;
    std::array<std::uint8_t, header_size + 8> command{};
    const auto header = command_header(write_register_command, 8, id);
    std::copy(header.begin(), header.end(), command.begin());
    put16(&command[header_size], control_privilege_register >> 16);
    put16(&command[header_size + 2], control_privilege_register & 0xffff);
    if (::send(socket.handle(), command.data(), command.size(), 0) < 0) continue;
    Datagram datagram;
    receive(socket, write_register_answer, id, steady_clock::now() + timeout, datagram, to);
  }
}

bool gvcp_port_is_taken(const LoopbackAddress& address) {
  const Socket socket;
  const sockaddr_in here = gvcp_address(address.number());
  return ::bind(socket.handle(), reinterpret_cast<const sockaddr*>(&here), sizeof here) != 0 && errno == EADDRINUSE;
}

}  // namespace tagdock
