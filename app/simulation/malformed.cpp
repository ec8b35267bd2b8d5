#include "app/simulation/malformed.h"

#include <algorithm>

namespace tagdock {
namespace {

void put(std::vector<std::uint8_t>& bytes, std::size_t at, std::size_t size, std::uint64_t value) {
  for (std::size_t i = 0; i < size && at + i < bytes.size(); ++i)
    bytes[at + i] = static_cast<std::uint8_t>(value >> 8 * (size - 1 - i));
}

// Values at which arithmetic goes wrong.
constexpr std::uint32_t odd_values[] = {0,      1,          2,          0x7f,       0xff,      0x7fff,
                                        0xffff, 0x7fffffff, 0x80000000, 0xfffffffe, 0xffffffff};

}  // namespace

std::uint32_t MalformedDatagrams::below(std::uint32_t bound) { return static_cast<std::uint32_t>(random_() % bound); }

std::vector<std::uint8_t> MalformedDatagrams::next() {
  const auto odd = [&] {
    return below(2) == 0 ? odd_values[below(std::size(odd_values))] : static_cast<std::uint32_t>(random_());
  };
  const auto random_bytes = [&](std::size_t size) {
    std::vector<std::uint8_t> bytes(size);
    for (std::uint8_t& byte : bytes) byte = static_cast<std::uint8_t>(random_());
    return bytes;
  };
  enum { leader = 1, trailer = 2, payload = 3, extended = 0x80 };
  switch (below(7)) {
    case 0:  // not even a header
      return random_bytes(below(16));
    case 1:  // noise, up to a jumbo packet
      return random_bytes(below(9000));
    case 2: {  // short ids: any format, any frame, any packet
      std::vector<std::uint8_t> bytes = random_bytes(8 + below(64));
      put(bytes, 0, 2, below(4) == 0 ? odd() : 0);
      put(bytes, 2, 2, odd());
      put(bytes, 4, 1, below(16));
      put(bytes, 5, 3, odd());
      return bytes;
    }
    case 3: {  // a leader of an absurd picture
      std::vector<std::uint8_t> bytes(44, 0);
      put(bytes, 2, 2, 1 + below(65535));
      put(bytes, 4, 1, leader);
      put(bytes, 10, 2, below(2) == 0 ? 1 : odd());
      put(bytes, 12, 8, random_());
      put(bytes, 20, 4, below(2) == 0 ? 0x01080001 : odd());
      for (const std::size_t at : {24U, 28U, 32U, 36U}) put(bytes, at, 4, odd());
      put(bytes, 40, 4, odd());
      bytes.resize(below(45));
      return bytes;
    }
    case 4: {  // a trailer with extended ids that claims any number of packets
      std::vector<std::uint8_t> bytes(20 + below(12), 0);
      put(bytes, 4, 1, extended | trailer);
      put(bytes, 8, 8, below(2) == 0 ? 1 + below(65535) : random_());
      put(bytes, 16, 4, odd());
      return bytes;
    }
    case 5: {  // payload of a frame that was never begun
      std::vector<std::uint8_t> bytes = random_bytes(8 + below(20000));
      put(bytes, 0, 2, 0);
      put(bytes, 2, 2, 1 + below(65535));
      put(bytes, 4, 1, payload);
      put(bytes, 5, 3, below(200));
      return bytes;
    }
    default: {  // extended ids: any format
      std::vector<std::uint8_t> bytes = random_bytes(20 + below(64));
      put(bytes, 0, 2, 0);
      put(bytes, 4, 1, extended | below(16));
      put(bytes, 8, 8, below(2) == 0 ? odd() : random_());
      put(bytes, 16, 4, odd());
      return bytes;
    }
  }
}

}  // namespace tagdock
