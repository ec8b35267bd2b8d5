#pragma once

#include <cstdint>
#include <random>
#include <vector>

namespace tagdock {

/// Datagrams that no camera should send to the stream port of a client: too short, too long, of random bytes, leaders
/// of absurd pictures, packets of frames that do not exist, trailers that claim four thousand million packets. Among
/// them are those that abort Aravis 0.8.26 (it allocates what a trailer claims). The same seed gives the same bytes.
class MalformedDatagrams {
 public:
  explicit MalformedDatagrams(std::uint64_t seed) : random_(seed) {}

  std::vector<std::uint8_t> next();

 private:
  std::uint32_t below(std::uint32_t bound);

  std::mt19937_64 random_;
};

}  // namespace tagdock
