#include "app/simulation/gige_server.h"

#include <algorithm>
#include <arpa/inet.h>
#include <array>
#include <bit>
#include <cerrno>
#include <condition_variable>
#include <cstring>
#include <deque>
#include <mutex>
#include <netinet/in.h>
#include <optional>
#include <poll.h>
#include <random>
#include <sys/socket.h>
#include <thread>
#include <unistd.h>
#include <vector>

#include <opencv2/imgproc.hpp>

#include "app/cameras/gvcp_probe.h"
#include "app/cameras/wire_format.h"
#include "app/failure.h"
#include "app/simulation/genicam_description.h"

namespace tagdock {

namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using std::chrono::steady_clock;

// GigE Vision 1.2. All numbers on the wire are big-endian.
constexpr std::uint16_t gvcp_port = 3956;
constexpr std::uint8_t gvcp_key = 0x42;
constexpr std::uint8_t answer_wanted = 0x01;
constexpr std::size_t header_size = 8;  // of both protocols
enum Command : std::uint16_t {
  discovery = 0x0002,
  packet_resend = 0x0040,
  read_register = 0x0080,
  write_register = 0x0082,
  read_memory = 0x0084,
  write_memory = 0x0086
};
enum Status : std::uint16_t {
  success = 0x0000,
  not_implemented = 0x8001,
  invalid_parameter = 0x8002,
  invalid_address = 0x8003,
  write_protected = 0x8004,
  bad_alignment = 0x8005,
  access_denied = 0x8006
};

// The bootstrap registers that are more than a constant.
namespace bootstrap {
constexpr std::uint32_t size = 0xf8;  // what a discovery answer shows
constexpr std::uint32_t vendor = 0x48;
constexpr std::uint32_t model = 0x68;
constexpr std::uint32_t version = 0x88;
constexpr std::uint32_t serial = 0xd8;
constexpr std::uint32_t user_name = 0xe8;
constexpr std::uint32_t first_url = 0x200;
constexpr std::uint32_t capabilities = 0x934;
constexpr std::uint32_t heartbeat_ms = 0x938;
constexpr std::uint32_t tick_frequency_low = 0x940;
constexpr std::uint32_t privilege = 0xa00;
constexpr std::uint32_t stream_port = 0xd00;
constexpr std::uint32_t stream_packet_size = 0xd04;
constexpr std::uint32_t stream_packet_delay = 0xd08;
constexpr std::uint32_t stream_address = 0xd18;
constexpr std::uint32_t stream_source_port = 0xd1c;
}  // namespace bootstrap

constexpr std::uint32_t can_concatenate = 1U << 0;
constexpr std::uint32_t can_write_memory = 1U << 1;
constexpr std::uint32_t can_resend = 1U << 2;
constexpr std::uint32_t has_serial_number = 1U << 30;
constexpr std::uint32_t has_user_name = 1U << 31;

constexpr std::uint32_t image = 1;  // kinds of payload
constexpr std::uint32_t image_with_chunks = 0x4001;
constexpr std::uint64_t tick_frequency = 1'000'000'000;
constexpr std::uint64_t largest_id = 65535;                    // 0 is no frame id, so they run from 1 to this
constexpr std::size_t packet_overhead = 20 + 8 + header_size;  // IP, UDP and GVSP headers count in the packet size
constexpr std::size_t frames_for_resend = 4;
constexpr std::size_t longest_command = 600;

void put16(std::uint8_t* bytes, std::uint32_t value) {
  bytes[0] = static_cast<std::uint8_t>(value >> 8);
  bytes[1] = static_cast<std::uint8_t>(value);
}
void put32(std::uint8_t* bytes, std::uint32_t value) {
  put16(bytes, value >> 16);
  put16(bytes + 2, value & 0xffff);
}
void put64(std::uint8_t* bytes, std::uint64_t value) {
  put32(bytes, static_cast<std::uint32_t>(value >> 32));
  put32(bytes + 4, static_cast<std::uint32_t>(value));
}
std::uint32_t get16(const std::uint8_t* bytes) { return static_cast<std::uint32_t>(bytes[0] << 8 | bytes[1]); }
std::uint32_t get32(const std::uint8_t* bytes) { return get16(bytes) << 16 | get16(bytes + 2); }

/// A UDP socket bound to an address.
class Socket {
 public:
  Socket(std::uint32_t address, std::uint16_t port) : handle_(::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in here{};
    here.sin_family = AF_INET;
    here.sin_port = htons(port);
    here.sin_addr.s_addr = htonl(address);
    if (handle_ >= 0 && ::bind(handle_, reinterpret_cast<sockaddr*>(&here), sizeof here) == 0) return;
    error_ = errno;
  }
  ~Socket() {
    if (handle_ >= 0) ::close(handle_);
  }
  Socket(const Socket&) = delete;
  Socket& operator=(const Socket&) = delete;
  [[nodiscard]] int handle() const { return handle_; }
  [[nodiscard]] int error() const { return error_; }
  [[nodiscard]] std::uint16_t port() const {
    sockaddr_in here{};
    socklen_t size = sizeof here;
    ::getsockname(handle_, reinterpret_cast<sockaddr*>(&here), &size);
    return ntohs(here.sin_port);
  }

 private:
  int handle_;
  int error_ = 0;
};

bool same(const sockaddr_in& a, const sockaddr_in& b) {
  return a.sin_addr.s_addr == b.sin_addr.s_addr && a.sin_port == b.sin_port;
}

/// The camera's memory: bootstrap block, our registers, the description. What a client may change is said here.
class Memory {
 public:
  explicit Memory(const GigeServerSettings& settings, std::uint32_t address)
      : bytes_(camera_register::description + camera_description.size()) {
    write(0x0, 0x00010002);  // GigE Vision 1.2
    write(0x4, 0x80000001);  // big-endian, a transmitter, UTF-8
    write(0x8, 0x0000dead);  // MAC address; the loopback device has none
    write(0xc, 0xbeef0000 | (address & 0xffff));
    write(0x10, 0x7);
    write(0x14, 0x5);
    write(0x24, address);
    write(0x34, 0xff000000);
    text(bootstrap::vendor, 32, "tagdock");
    text(bootstrap::model, 32, settings.model);
    text(bootstrap::version, 32, "1");
    text(bootstrap::serial, 16, settings.serial);
    text(bootstrap::user_name, 16, settings.user_name);
    std::array<char, 64> url{};
    std::snprintf(url.data(), url.size(), "Local:tagdock.xml;%x;%zx", camera_register::description,
                  camera_description.size());
    text(bootstrap::first_url, 512, url.data());
    write(0x600, 1);  // one interface
    write(0x900, 0);  // no message channel
    write(0x904, 1);  // one stream channel
    write(bootstrap::capabilities,
          can_concatenate | can_write_memory | has_serial_number | has_user_name | (settings.resend ? can_resend : 0));
    write(bootstrap::heartbeat_ms, 3000);
    write(bootstrap::tick_frequency_low, tick_frequency);
    write(bootstrap::stream_packet_size, 1400);
    using namespace camera_register;
    write(sensor_width, static_cast<std::uint32_t>(settings.width));
    write(sensor_height, static_cast<std::uint32_t>(settings.height));
    write(width, static_cast<std::uint32_t>(settings.width));
    write(height, static_cast<std::uint32_t>(settings.height));
    write(binning_horizontal, 1);
    write(binning_vertical, 1);
    write(pixel_format, wire_format("Mono8")->value);
    write(acquisition_mode, 1);
    real(exposure, settings.exposure_us);
    real(gain, settings.gain);
    real(frame_rate, settings.frame_rate);
    std::copy(camera_description.begin(), camera_description.end(),
              bytes_.begin() + static_cast<std::ptrdiff_t>(description));
  }

  [[nodiscard]] bool holds(std::uint64_t address, std::uint64_t size) const { return address + size <= bytes_.size(); }
  [[nodiscard]] const std::uint8_t* at(std::uint32_t address) const { return &bytes_[address]; }
  [[nodiscard]] std::uint32_t read(std::uint32_t address) const { return get32(&bytes_[address]); }
  [[nodiscard]] double real(std::uint32_t address) const {
    return std::bit_cast<double>(std::uint64_t{read(address)} << 32 | read(address + 4));
  }
  void write(std::uint32_t address, std::uint32_t value) { put32(&bytes_[address], value); }
  void write(std::uint32_t address, const std::uint8_t* from, std::size_t size) {
    std::copy_n(from, size, bytes_.begin() + static_cast<std::ptrdiff_t>(address));
  }

  [[nodiscard]] static bool writable(std::uint64_t address, std::uint64_t size) {
    const auto inside = [&](std::uint32_t begin, std::uint32_t end) {
      return address >= begin && address + size <= end;
    };
    return inside(bootstrap::user_name, bootstrap::user_name + 16) ||
           inside(bootstrap::heartbeat_ms, bootstrap::heartbeat_ms + 4) ||
           inside(bootstrap::privilege, bootstrap::privilege + 4) ||
           inside(bootstrap::stream_port, bootstrap::stream_packet_delay + 4) ||
           inside(bootstrap::stream_address, bootstrap::stream_address + 4) ||
           inside(camera_register::first_writable, camera_register::end);
  }

 private:
  void text(std::uint32_t address, std::size_t size, const std::string& words) {
    std::copy_n(words.begin(), std::min(words.size(), size - 1), bytes_.begin() + static_cast<std::ptrdiff_t>(address));
  }
  void real(std::uint32_t address, double value) { put64(&bytes_[address], std::bit_cast<std::uint64_t>(value)); }

  std::vector<std::uint8_t> bytes_;
};

/// A frame cut into packets, kept while the client may ask for some of them again.
struct Packets {
  std::uint32_t id = 0;
  nanoseconds time{0};
  const WireFormat* format = nullptr;
  std::vector<std::uint8_t> payload;  ///< pixels, and the chunks behind them
  bool has_chunks = false;
  std::vector<std::pair<std::uint32_t, double>> chunks;  ///< id and number
  cv::Point offset;                                      ///< of the region, in binned pixels
  cv::Size agreed;                                       ///< what the leader says
  std::size_t block = 0;                                 ///< bytes of payload in a packet
  std::size_t blocks = 0;  ///< payload packets; the leader is packet 0, the trailer packet blocks + 1
};

}  // namespace

class GigeServer::Implementation {
 public:
  explicit Implementation(const GigeServerSettings& settings)
      : settings_(settings),
        address_(settings.address),
        control_(address_.number(), gvcp_port),
        stream_(address_.number(), 0),
        memory_(settings, address_.number()) {
    if (settings.serial.empty() || settings.serial.size() > 15)
      throw Failure(ExitCode::usage,
                    "the serial number of a simulated camera has 1 to 15 characters, not '" + settings.serial + "'");
    if (control_.error() != 0)
      throw Failure(ExitCode::camera,
                    control_.error() == EADDRINUSE
                        ? "another camera simulator holds port 3956 on " + settings.address +
                              ": stop it, or wait for it to end; no two can share an address"
                        : "port 3956 on " + settings.address + " cannot be had: " + std::strerror(control_.error()));
    if (stream_.error() != 0)
      throw Failure(ExitCode::camera, std::string("no socket for the stream: ") + std::strerror(stream_.error()));
    memory_.write(bootstrap::stream_source_port, stream_.port());
    controlling_ = std::thread([this] { control(); });
    sending_ = std::thread([this] { send_frames(); });
  }

  ~Implementation() { stop(); }
  Implementation(const Implementation&) = delete;
  Implementation& operator=(const Implementation&) = delete;

  void publish(const ServedFrame& frame) {
    if (frame.gray.cols != settings_.width || frame.gray.rows != settings_.height)
      throw Failure(ExitCode::internal, "a frame of the wrong size was given to the simulated camera");
    const std::lock_guard<std::mutex> lock(mutex_);
    newest_ = frame;
    fresh_ = true;
    changed_.notify_all();
  }

  ServedSettings client() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    ServedSettings client;
    client.exposure_us = memory_.real(camera_register::exposure);
    client.gain = memory_.real(camera_register::gain);
    client.frame_rate = memory_.real(camera_register::frame_rate);
    client.region = region();
    client.streaming = streaming();
    return client;
  }

  std::uint64_t sent() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return sent_;
  }
  std::uint64_t sent_again() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return sent_again_;
  }

  GigeFaults faults() const {
    const std::lock_guard<std::mutex> lock(mutex_);
    return faults_;
  }
  void faults(const GigeFaults& faults) {
    const std::lock_guard<std::mutex> lock(mutex_);
    faults_ = faults;
    faults_.lost_packets = std::clamp(faults_.lost_packets, 0.0, 1.0);
  }

  bool send_to_stream(const void* bytes, std::size_t size) {
    sockaddr_in to{};
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (!streaming() || stopped_) return false;
      to = destination();
    }
    return ::sendto(stream_.handle(), bytes, size, MSG_DONTWAIT, reinterpret_cast<const sockaddr*>(&to), sizeof to) >=
           0;
  }

  void stop() {
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      if (stopped_) return;
      stopped_ = true;
      changed_.notify_all();
    }
    controlling_.join();
    sending_.join();
    // Nobody else uses the sockets now; what is asked from here on must find nobody.
    const int nowhere = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
    ::dup2(nowhere, control_.handle());
    ::close(nowhere);
  }

 private:
  // ---- control -------------------------------------------------------------------------------------------------

  void control() {
    std::array<std::uint8_t, longest_command> command{};
    while (true) {
      pollfd wanted{control_.handle(), POLLIN, 0};
      constexpr int heartbeat_check_ms = 50;
      ::poll(&wanted, 1, heartbeat_check_ms);
      const std::lock_guard<std::mutex> lock(mutex_);
      if (stopped_) return;
      const auto heartbeat = milliseconds(std::max(500U, memory_.read(bootstrap::heartbeat_ms)));
      if (controller_ && steady_clock::now() - controller_seen_ > heartbeat) release();
      sockaddr_in from{};
      socklen_t from_size = sizeof from;
      const ssize_t size = ::recvfrom(control_.handle(), command.data(), command.size(), MSG_DONTWAIT,
                                      reinterpret_cast<sockaddr*>(&from), &from_size);
      if (size >= static_cast<ssize_t>(header_size) && command[0] == gvcp_key)
        answer(command.data(), static_cast<std::size_t>(size), from);
    }
  }

  void release() {
    controller_.reset();
    memory_.write(bootstrap::privilege, 0);
    memory_.write(bootstrap::stream_port, 0);
    memory_.write(camera_register::acquisition, 0);
  }

  void answer(const std::uint8_t* command, std::size_t size, const sockaddr_in& from) {
    const std::uint32_t what = get16(command + 2);
    const std::uint32_t length = get16(command + 4);
    const std::uint8_t* content = command + header_size;
    const bool whole = size >= header_size + length;
    if (controller_ && same(*controller_, from)) controller_seen_ = steady_clock::now();
    if (what == packet_resend) {
      if (whole && length >= 12) resend(content);
      return;  // has no answer
    }
    std::vector<std::uint8_t> reply(header_size);
    Status status = success;
    if (!whole)
      status = invalid_parameter;
    else if (what == discovery)
      reply.insert(reply.end(), memory_.at(0), memory_.at(0) + bootstrap::size);
    else if (what == read_register)
      status = read_registers(content, length, reply);
    else if (what == write_register)
      status = write_registers(content, length, from, reply);
    else if (what == read_memory)
      status = read_block(content, length, reply);
    else if (what == write_memory)
      status = write_block(content, length, from, reply);
    else
      status = not_implemented;
    if ((command[1] & answer_wanted) == 0) return;
    put16(&reply[0], status);
    put16(&reply[2], what + 1);
    put16(&reply[4], static_cast<std::uint32_t>(reply.size() - header_size));
    put16(&reply[6], get16(command + 6));
    ::sendto(control_.handle(), reply.data(), reply.size(), MSG_DONTWAIT, reinterpret_cast<const sockaddr*>(&from),
             sizeof from);
  }

  Status read_registers(const std::uint8_t* content, std::size_t length, std::vector<std::uint8_t>& reply) const {
    if (length % 4 != 0) return invalid_parameter;
    for (std::size_t i = 0; i < length; i += 4) {
      const std::uint32_t address = get32(content + i);
      if (address % 4 != 0) return bad_alignment;
      if (!memory_.holds(address, 4)) return invalid_address;
      reply.insert(reply.end(), memory_.at(address), memory_.at(address) + 4);
    }
    return success;
  }

  Status read_block(const std::uint8_t* content, std::size_t length, std::vector<std::uint8_t>& reply) const {
    if (length < 8) return invalid_parameter;
    const std::uint32_t address = get32(content);
    const std::uint32_t size = get16(content + 6);
    constexpr std::uint32_t largest_block = 536;
    if (size > largest_block) return invalid_parameter;
    // The last block of the description may reach beyond it: Aravis reads whole blocks.
    reply.insert(reply.end(), content, content + 4);
    if (!memory_.holds(address, 1)) return invalid_address;
    for (std::uint32_t i = 0; i < size; ++i)
      reply.push_back(memory_.holds(std::uint64_t{address} + i, 1) ? *memory_.at(address + i) : std::uint8_t{0});
    return success;
  }

  Status write_registers(const std::uint8_t* content, std::size_t length, const sockaddr_in& from,
                         std::vector<std::uint8_t>& reply) {
    if (length % 8 != 0) return invalid_parameter;
    for (std::size_t i = 0; i < length; i += 8)
      if (const Status status = write(get32(content + i), content + i + 4, 4, from); status != success) return status;
    reply.resize(header_size + 4);
    put16(&reply[header_size + 2], static_cast<std::uint32_t>(length / 8));
    return success;
  }

  Status write_block(const std::uint8_t* content, std::size_t length, const sockaddr_in& from,
                     std::vector<std::uint8_t>& reply) {
    if (length < 4) return invalid_parameter;
    if (const Status status = write(get32(content), content + 4, length - 4, from); status != success) return status;
    reply.resize(header_size + 4);
    put16(&reply[header_size + 2], static_cast<std::uint32_t>(length - 4));
    return success;
  }

  Status write(std::uint32_t address, const std::uint8_t* bytes, std::size_t size, const sockaddr_in& from) {
    if (!memory_.holds(address, size)) return invalid_address;
    if (!Memory::writable(address, size)) return write_protected;
    const bool is_controller = controller_ && same(*controller_, from);
    if (address == bootstrap::privilege) {
      if (controller_ && !is_controller) return access_denied;
      if (get32(bytes) == 0) {
        release();
        return success;
      }
      controller_ = from;
      controller_seen_ = steady_clock::now();
    } else if (!is_controller) {
      return access_denied;
    }
    memory_.write(address, bytes, size);
    if (address == camera_register::trigger_software) trigger_ = true;
    if (address == camera_register::acquisition) {
      due_ = {};
      trigger_ = false;
    }
    changed_.notify_all();
    return success;
  }

  // ---- stream --------------------------------------------------------------------------------------------------

  [[nodiscard]] bool streaming() const {
    return controller_ && memory_.read(camera_register::acquisition) != 0 &&
           memory_.read(bootstrap::stream_port) % 65536 != 0;
  }

  [[nodiscard]] sockaddr_in destination() const {
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(static_cast<std::uint16_t>(memory_.read(bootstrap::stream_port) % 65536));
    to.sin_addr.s_addr = htonl(memory_.read(bootstrap::stream_address));
    return to;
  }

  [[nodiscard]] cv::Size binning() const {
    return {std::clamp(static_cast<int>(memory_.read(camera_register::binning_horizontal)), 1, 4),
            std::clamp(static_cast<int>(memory_.read(camera_register::binning_vertical)), 1, 4)};
  }

  /// What of the sensor is sent, in sensor pixels; empty when the client asks for what there is not.
  [[nodiscard]] cv::Rect region() const {
    const cv::Size bin = binning();
    const auto number = [&](std::uint32_t address) { return std::int64_t{memory_.read(address)}; };
    const std::int64_t x = number(camera_register::offset_x) * bin.width;
    const std::int64_t y = number(camera_register::offset_y) * bin.height;
    const std::int64_t width = number(camera_register::width) * bin.width;
    const std::int64_t height = number(camera_register::height) * bin.height;
    if (width <= 0 || height <= 0 || x + width > settings_.width || y + height > settings_.height) return {};
    return {static_cast<int>(x), static_cast<int>(y), static_cast<int>(width), static_cast<int>(height)};
  }

  void send_frames() {
    std::unique_lock<std::mutex> lock(mutex_);
    while (true) {
      changed_.wait(lock, [this] { return stopped_ || fresh_; });
      if (stopped_) return;
      const bool triggered = memory_.read(camera_register::trigger_mode) != 0;
      const cv::Rect part = region();
      if (!streaming() || part.empty() || (triggered && !trigger_)) {
        fresh_ = false;
        continue;
      }
      const auto now = steady_clock::now();
      if (!triggered && now < due_) {
        changed_.wait_until(lock, due_);
        continue;
      }
      fresh_ = false;
      trigger_ = false;
      // Frames that come a little late do not slow the rhythm, but a pause is not made up for.
      const double rate = std::clamp(memory_.real(camera_register::frame_rate), 0.5, 1000.0);
      const nanoseconds period(static_cast<std::int64_t>(1e9 / rate));
      due_ = std::max(due_, now - period) + period;
      if (faults_.silent) continue;
      ++sent_;
      const ServedFrame frame = newest_;
      Packets packets = describe(frame, part);
      const std::uint32_t delay = memory_.read(bootstrap::stream_packet_delay);
      const double lost = faults_.lost_packets;
      const sockaddr_in to = destination();
      lock.unlock();
      packets.payload = payload_of(frame, part, packets);
      send(packets, 0, packets.blocks + 1, lost, delay, to, random_);
      lock.lock();
      if (settings_.resend) {
        recent_.push_back(std::move(packets));
        if (recent_.size() > frames_for_resend) recent_.pop_front();
      }
    }
  }

  /// Everything about a frame but its pixels, with the faults that the camera has. The lock is held.
  Packets describe(const ServedFrame& frame, const cv::Rect& part) {
    Packets packets;
    if (!faults_.stale_times || !last_time_) last_time_ = frame.camera_time + faults_.time_jump;
    packets.time = *last_time_;
    if (!faults_.frozen || frozen_.empty()) frozen_ = frame.gray;
    packets.id = static_cast<std::uint32_t>(frame.number % largest_id + 1);
    packets.format = wire_format(memory_.read(camera_register::pixel_format));
    if (packets.format == nullptr) packets.format = wire_format("Mono8");
    packets.has_chunks = memory_.read(camera_register::chunk_mode) != 0;
    const auto offer = [&](std::uint32_t enable, std::uint32_t id, double number) {
      if (packets.has_chunks && memory_.read(enable) != 0) packets.chunks.emplace_back(id, number);
    };
    offer(camera_register::chunk_enable, camera_chunk::exposure_id,
          frame.exposure_us.value_or(memory_.real(camera_register::exposure)));
    offer(camera_register::chunk_enable + 4, camera_chunk::gain_id,
          frame.gain.value_or(memory_.real(camera_register::gain)));
    const cv::Size bin = binning();
    packets.offset = {part.x / bin.width, part.y / bin.height};
    packets.agreed = {part.width / bin.width, part.height / bin.height};
    if (faults_.wrong_size) packets.agreed.height = std::max(1, packets.agreed.height / 2);
    const std::size_t wanted = memory_.read(bootstrap::stream_packet_size) % 65536;
    constexpr std::size_t smallest_packet = 576, largest_packet = 65000;
    packets.block = std::clamp(wanted, smallest_packet, largest_packet) - packet_overhead;
    std::size_t bytes = packets.format->bytes(packets.agreed.width, packets.agreed.height);
    if (packets.has_chunks)
      bytes += camera_chunk::tag_size + packets.chunks.size() * (sizeof(double) + camera_chunk::tag_size);
    packets.blocks = (bytes + packets.block - 1) / packets.block;
    return packets;
  }

  std::vector<std::uint8_t> payload_of(const ServedFrame& frame, const cv::Rect& part, const Packets& packets) {
    // Of the thread that sends alone: nobody else touches the frozen picture.
    const cv::Mat1b& gray = frozen_.empty() ? frame.gray : frozen_;
    cv::Mat shown = gray(part);
    const cv::Size whole(packets.agreed.width, static_cast<int>(part.height * packets.agreed.width / part.width));
    if (whole.width != part.width) {
      cv::Mat averaged;
      // Whole factors: the mean of each block.
      cv::resize(shown, averaged, {whole.width, std::max(packets.agreed.height, whole.height)}, 0.0, 0.0,
                 cv::INTER_AREA);
      shown = averaged;
    }
    shown = shown.rowRange(0, packets.agreed.height);
    std::vector<std::uint8_t> payload = widened(shown, *packets.format);
    if (!packets.has_chunks) return payload;
    const auto end_chunk = [&payload](std::uint32_t id, std::size_t size) {
      payload.resize(payload.size() + camera_chunk::tag_size);
      put32(&payload[payload.size() - 8], id);
      put32(&payload[payload.size() - 4], static_cast<std::uint32_t>(size));
    };
    end_chunk(camera_chunk::image_id, payload.size());
    for (const auto& [id, number] : packets.chunks) {
      payload.resize(payload.size() + sizeof number);
      put64(&payload[payload.size() - sizeof number], std::bit_cast<std::uint64_t>(number));
      end_chunk(id, sizeof number);
    }
    return payload;
  }

  /// Sends packets first..last of a frame, each lost with a probability.
  void send(const Packets& packets, std::size_t first, std::size_t last, double lost, std::uint32_t delay_ns,
            const sockaddr_in& to, std::mt19937& random) const {
    constexpr std::size_t batch = 64;
    std::array<mmsghdr, batch> messages{};
    std::array<std::array<iovec, 2>, batch> parts{};
    std::array<std::array<std::uint8_t, header_size + 36>, batch> headers{};
    sockaddr_in address = to;
    std::bernoulli_distribution loses(lost);
    const std::size_t bytes = packets.payload.size();
    const std::uint32_t kind = packets.has_chunks ? image_with_chunks : image;
    std::size_t filled = 0;
    const auto flush = [&] {
      for (std::size_t done = 0; done < filled;) {
        const int count = ::sendmmsg(stream_.handle(), &messages[done], static_cast<unsigned>(filled - done), 0);
        if (count <= 0) break;  // nobody listens there any more: the packets are lost, as on a wire
        done += static_cast<std::size_t>(count);
      }
      filled = 0;
    };
    for (std::size_t index = first; index <= last; ++index) {
      if (loses(random)) continue;
      auto& header = headers[filled];
      header.fill(0);
      put16(&header[2], packets.id);
      put32(&header[4], static_cast<std::uint32_t>(index));
      std::size_t header_bytes = header_size;
      parts[filled][1] = {nullptr, 0};
      if (index == 0) {
        header[4] = 1;  // leader
        put16(&header[10], kind);
        put64(&header[12], static_cast<std::uint64_t>(packets.time.count()));
        put32(&header[20], packets.format->value);
        put32(&header[24], static_cast<std::uint32_t>(packets.agreed.width));
        put32(&header[28], static_cast<std::uint32_t>(packets.agreed.height));
        put32(&header[32], static_cast<std::uint32_t>(packets.offset.x));
        put32(&header[36], static_cast<std::uint32_t>(packets.offset.y));
        header_bytes += 36;
      } else if (index == packets.blocks + 1) {
        header[4] = 2;  // trailer
        put16(&header[10], kind);
        put32(&header[12], static_cast<std::uint32_t>(packets.agreed.height));
        header_bytes += 8;
      } else {
        header[4] = 3;  // payload
        const std::size_t begin = (index - 1) * packets.block;
        parts[filled][1] = {const_cast<std::uint8_t*>(packets.payload.data()) + begin,
                            std::min(packets.block, bytes - begin)};
      }
      parts[filled][0] = {header.data(), header_bytes};
      messages[filled].msg_hdr = {};
      messages[filled].msg_hdr.msg_name = &address;
      messages[filled].msg_hdr.msg_namelen = sizeof address;
      messages[filled].msg_hdr.msg_iov = parts[filled].data();
      messages[filled].msg_hdr.msg_iovlen = parts[filled][1].iov_len > 0 ? 2 : 1;
      ++filled;
      if (filled == batch || delay_ns > 0) flush();
      if (delay_ns > 0) std::this_thread::sleep_for(nanoseconds(delay_ns));
    }
    flush();
  }

  /// The client misses packets. The lock is held; what is sent again may be lost again.
  void resend(const std::uint8_t* content) {
    const std::uint32_t id = get16(content + 2);
    const std::size_t first = get32(content + 4) & 0xffffff;
    const std::size_t last = get32(content + 8) & 0xffffff;
    if (!streaming()) return;
    for (const Packets& packets : recent_) {
      if (packets.id != id || first > last || first > packets.blocks + 1) continue;
      const std::size_t end = std::min(last, packets.blocks + 1);
      sent_again_ += end - first + 1;
      send(packets, first, end, faults_.lost_packets, 0, destination(), random_again_);
    }
  }

  const GigeServerSettings settings_;
  const LoopbackAddress address_;
  const Socket control_;
  const Socket stream_;

  mutable std::mutex mutex_;  ///< guards what follows
  std::condition_variable changed_;
  Memory memory_;
  std::optional<sockaddr_in> controller_;
  steady_clock::time_point controller_seen_{};
  ServedFrame newest_;
  bool fresh_ = false;    ///< newest_ was not sent yet
  bool trigger_ = false;  ///< a client asked for the next frame
  steady_clock::time_point due_{};
  std::uint64_t sent_ = 0;
  std::uint64_t sent_again_ = 0;
  GigeFaults faults_;
  std::optional<nanoseconds> last_time_;
  cv::Mat1b frozen_;
  std::deque<Packets> recent_;
  bool stopped_ = false;
  std::mt19937 random_again_{2};  ///< of the thread that controls

  std::mt19937 random_{1};  ///< of the thread that sends

  std::thread controlling_;
  std::thread sending_;
};

GigeServer::GigeServer(const GigeServerSettings& settings)
    : implementation_(std::make_unique<Implementation>(settings)) {}
GigeServer::~GigeServer() = default;
void GigeServer::publish(const ServedFrame& frame) { implementation_->publish(frame); }
ServedSettings GigeServer::client() const { return implementation_->client(); }
std::uint64_t GigeServer::sent() const { return implementation_->sent(); }
std::uint64_t GigeServer::sent_again() const { return implementation_->sent_again(); }
void GigeServer::faults(const GigeFaults& faults) { implementation_->faults(faults); }
GigeFaults GigeServer::faults() const { return implementation_->faults(); }
void GigeServer::lose_packets(double ratio) {
  GigeFaults changed = faults();
  changed.lost_packets = ratio;
  faults(changed);
}
void GigeServer::silence(bool on) {
  GigeFaults changed = faults();
  changed.silent = on;
  faults(changed);
}
bool GigeServer::send_to_stream(const void* bytes, std::size_t size) {
  return implementation_->send_to_stream(bytes, size);
}
void GigeServer::stop() { implementation_->stop(); }

}  // namespace tagdock
