#pragma once

#include <cstdint>
#include <optional>

namespace tagdock {

/// Turns frame ids from the wire into numbers that only grow. Short ids have 16 bits and skip 0 (65535 is followed by
/// 1); extended ids have 64 bits and need no unwrapping.
class FrameCounter {
 public:
  /// @param id  as on the wire, > 0
  /// @return    its number, the first one being the id itself; none for a frame that is not newer than the last
  std::optional<std::uint64_t> number(std::uint64_t id) {
    const std::optional<std::uint64_t> number = would_be(id);
    if (!number) return std::nullopt;
    last_id_ = id;
    number_ = *number;
    return number;
  }

  /// The number that it would give, without counting the frame: of one that was not complete.
  [[nodiscard]] std::optional<std::uint64_t> would_be(std::uint64_t id) const {
    constexpr std::uint64_t short_ids = 65535;
    constexpr std::uint64_t farthest_ahead = std::uint64_t{1} << 62;
    std::uint64_t step = 1;
    if (last_id_) {
      const bool extended = id > short_ids || *last_id_ > short_ids;
      step = extended ? id - *last_id_ : (id + short_ids - *last_id_) % short_ids;
      if (step == 0 || step > (extended ? farthest_ahead : short_ids / 2)) return std::nullopt;
    }
    return number_ == 0 ? id : number_ + step;
  }

  /// The camera was opened anew and counts from elsewhere: the next frame follows the last number directly.
  void reopened() { last_id_.reset(); }

 private:
  std::optional<std::uint64_t> last_id_;
  std::uint64_t number_ = 0;  ///< of the last frame; 0 before the first
};

}  // namespace tagdock
