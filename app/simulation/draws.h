#pragma once

#include <cmath>
#include <cstdint>
#include <numbers>

namespace tagdock {

/// A well-mixed number of a counter (splitmix64). Random numbers of the simulation depend on nothing but their counter:
/// the same on every machine, and whatever else was drawn before.
inline std::uint64_t mixed(std::uint64_t counter) {
  std::uint64_t z = counter * 0x9E3779B97F4A7C15ULL + 0x9E3779B97F4A7C15ULL;
  z = (z ^ (z >> 30)) * 0xBF58476D1CE4E5B9ULL;
  z = (z ^ (z >> 27)) * 0x94D049BB133111EBULL;
  return z ^ (z >> 31);
}

/// Between 0 and 1, ends excluded.
inline double even_number(std::uint64_t key) { return (static_cast<double>(mixed(key) >> 11) + 0.5) * 0x1p-53; }

/// Normal with mean 0 and sigma 1, after Box and Muller.
inline double normal_number(std::uint64_t key) {
  const double radius = std::sqrt(-2.0 * std::log(even_number(key)));
  return radius * std::cos(2.0 * std::numbers::pi * even_number(mixed(key) ^ 0x5851F42D4C957F2DULL));
}

/// Numbers one after the other, for one purpose of one run.
class Draws {
 public:
  Draws(std::uint64_t seed, std::uint64_t purpose) : key_(mixed(mixed(seed) + purpose)) {}

  double normal() { return normal_number(key_ + count_++); }
  /// Leaves out numbers: the next one is what `count` calls would have come to.
  void skip(std::uint64_t count) { count_ += count; }
  /// Between -1 and 1.
  double even() { return 2.0 * even_number(key_ + count_++) - 1.0; }

 private:
  std::uint64_t key_;
  std::uint64_t count_ = 0;
};

}  // namespace tagdock
