#include "app/cameras/gige_messages.h"

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <sys/socket.h>
#include <sys/uio.h>
#include <type_traits>
#include <unistd.h>

namespace tagdock {
namespace {

class Writer {
 public:
  template <class Value>
  void operator()(const Value& value) {
    if constexpr (std::is_same_v<Value, std::string>) {
      (*this)(static_cast<std::uint32_t>(value.size()));
      bytes.insert(bytes.end(), value.begin(), value.end());
    } else {
      static_assert(std::is_trivially_copyable_v<Value>);
      const auto* begin = reinterpret_cast<const std::uint8_t*>(&value);
      bytes.insert(bytes.end(), begin, begin + sizeof value);
    }
  }
  template <class Value>
  void operator()(const std::vector<Value>& values) {
    (*this)(static_cast<std::uint32_t>(values.size()));
    for (const Value& value : values) (*this)(value);
  }
  void operator()(const std::vector<CameraStateChange>& values) {
    (*this)(static_cast<std::uint32_t>(values.size()));
    for (const CameraStateChange& value : values) {
      (*this)(value.state);
      (*this)(value.time);
    }
  }
  std::vector<std::uint8_t> bytes;
};

class Reader {
 public:
  Reader(const std::uint8_t* bytes, std::size_t size) : at_(bytes), left_(size) {}
  template <class Value>
  void operator()(Value& value) {
    if constexpr (std::is_same_v<Value, std::string>) {
      const std::size_t size = count();
      value.assign(reinterpret_cast<const char*>(at_), size);
      skip(size);
    } else if constexpr (std::is_same_v<Value, bool>) {
      // A byte that is neither 0 nor 1 is no bool.
      std::uint8_t byte = 0;
      (*this)(byte);
      value = byte != 0;
    } else {
      static_assert(std::is_trivially_copyable_v<Value>);
      if (left_ < sizeof value) return fail();
      std::memcpy(&value, at_, sizeof value);
      skip(sizeof value);
    }
  }
  template <class Value>
  void operator()(std::vector<Value>& values) {
    const std::size_t size = count();
    values.clear();
    for (std::size_t i = 0; good_ && i < size; ++i) (*this)(values.emplace_back());
  }
  void operator()(std::vector<CameraStateChange>& values) {
    const std::size_t size = count();
    values.clear();
    for (std::size_t i = 0; good_ && i < size; ++i) {
      CameraStateChange& value = values.emplace_back();
      (*this)(value.state);
      (*this)(value.time);
    }
  }
  [[nodiscard]] bool whole() const { return good_ && left_ == 0; }

 private:
  /// Of what follows; at least a byte each, so no count is believed that the message cannot hold.
  std::size_t count() {
    std::uint32_t size = 0;
    (*this)(size);
    if (size > left_) fail();
    return good_ ? size : 0;
  }
  void skip(std::size_t size) {
    at_ += size;
    left_ -= size;
  }
  void fail() {
    good_ = false;
    left_ = 0;
  }
  const std::uint8_t* at_;
  std::size_t left_;
  bool good_ = true;
};

// The fields of each message, told once.
template <class Visitor, class Message>
void fields(Visitor& visit, Message& message) {
  using Plain = std::remove_const_t<Message>;
  if constexpr (std::is_same_v<Plain, OpenRequest>) {
    auto& settings = message.settings;
    visit(settings.address);
    visit(settings.serial);
    visit(settings.offset_x);
    visit(settings.offset_y);
    visit(settings.width);
    visit(settings.height);
    visit(settings.frame_rate);
    visit(settings.exposure_us);
    visit(settings.gain);
    visit(settings.packet_size);
    visit(settings.receive_buffer);
    visit(settings.declared_latency);
    visit(settings.take_over_wait);
    visit(settings.triggered);
    visit(settings.pixel_format);
    visit(settings.ptp);
    visit(settings.chunks);
    visit(message.session_start);
  } else if constexpr (std::is_same_v<Plain, CameraOpened>) {
    auto& actual = message.actual;
    visit(actual.identity);
    visit(actual.address);
    visit(actual.sensor_width);
    visit(actual.sensor_height);
    visit(actual.binning);
    visit(actual.offset_x);
    visit(actual.offset_y);
    visit(actual.width);
    visit(actual.height);
    visit(actual.frame_rate);
    visit(actual.exposure_us);
    visit(actual.gain);
    visit(actual.notes);
  } else if constexpr (std::is_same_v<Plain, SocketsMade>) {
    visit(message.ports);
  } else if constexpr (std::is_same_v<Plain, OpenFailed>) {
    visit(message.code);
    visit(message.sentence);
  } else if constexpr (std::is_same_v<Plain, HealthReport>) {
    auto& health = message.health;
    visit(health.state);
    visit(health.reason);
    visit(health.received);
    visit(health.incomplete);
    visit(health.lost);
    visit(health.overwritten);
    visit(health.reconnects);
    visit(health.stale);
    visit(health.resent);
    visit(health.restarts);
    visit(health.history);
  } else if constexpr (!std::is_empty_v<Plain>) {
    visit(message);
  }
}

template <class Messages>
std::vector<std::uint8_t> pack(const Messages& message) {
  Writer writer;
  writer(static_cast<std::uint32_t>(message.index()));
  std::visit([&](const auto& one) { fields(writer, one); }, message);
  return std::move(writer.bytes);
}

template <class Messages, std::size_t index = 0>
std::optional<Messages> unpack(std::uint32_t wanted, Reader& reader) {
  if constexpr (index < std::variant_size_v<Messages>) {
    if (wanted != index) return unpack<Messages, index + 1>(wanted, reader);
    std::optional<Messages> message(std::in_place, std::in_place_index<index>);
    fields(reader, std::get<index>(*message));
    if (!reader.whole()) message.reset();
    return message;
  } else {
    return std::nullopt;
  }
}

template <class Messages>
std::optional<Messages> unpack(const std::uint8_t* bytes, std::size_t size) {
  Reader reader(bytes, size);
  std::uint32_t index = 0xffffffff;
  reader(index);
  return unpack<Messages>(index, reader);
}

}  // namespace

std::vector<std::uint8_t> packed(const ClientRequest& request) { return pack(request); }
std::vector<std::uint8_t> packed(const ClientReport& report) { return pack(report); }
std::optional<ClientRequest> unpacked_request(const std::uint8_t* bytes, std::size_t size) {
  return unpack<ClientRequest>(bytes, size);
}
std::optional<ClientReport> unpacked_report(const std::uint8_t* bytes, std::size_t size) {
  return unpack<ClientReport>(bytes, size);
}

bool send_message(int socket, const std::vector<std::uint8_t>& message, int handle) {
  iovec part{const_cast<std::uint8_t*>(message.data()), message.size()};
  msghdr header{};
  header.msg_iov = &part;
  header.msg_iovlen = 1;
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof handle)> control{};
  if (handle >= 0) {
    header.msg_control = control.data();
    header.msg_controllen = control.size();
    cmsghdr* attached = CMSG_FIRSTHDR(&header);
    attached->cmsg_level = SOL_SOCKET;
    attached->cmsg_type = SCM_RIGHTS;
    attached->cmsg_len = CMSG_LEN(sizeof handle);
    std::memcpy(CMSG_DATA(attached), &handle, sizeof handle);
  }
  return ::sendmsg(socket, &header, MSG_DONTWAIT | MSG_NOSIGNAL) >= 0;
}

std::optional<Received> receive_message(int socket) {
  Received received;
  received.message.resize(longest_message);
  iovec part{received.message.data(), received.message.size()};
  msghdr header{};
  header.msg_iov = &part;
  header.msg_iovlen = 1;
  alignas(cmsghdr) std::array<char, CMSG_SPACE(sizeof(int))> control{};
  header.msg_control = control.data();
  header.msg_controllen = control.size();
  const ssize_t size = ::recvmsg(socket, &header, MSG_DONTWAIT | MSG_CMSG_CLOEXEC);
  if (size < 0 && (errno == EAGAIN || errno == EINTR)) return std::nullopt;
  received.closed = size <= 0;
  received.message.resize(static_cast<std::size_t>(std::max<ssize_t>(size, 0)));
  if (size > 0)
    for (cmsghdr* attached = CMSG_FIRSTHDR(&header); attached != nullptr; attached = CMSG_NXTHDR(&header, attached))
      if (attached->cmsg_level == SOL_SOCKET && attached->cmsg_type == SCM_RIGHTS)
        std::memcpy(&received.handle, CMSG_DATA(attached), sizeof received.handle);
  return received;
}

}  // namespace tagdock
