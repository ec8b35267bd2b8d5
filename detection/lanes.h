#pragma once

#include <cstdint>

namespace tagdock {

/// Eight numbers that are computed at once; the compiler makes them the machine's own vectors (of four by default). No
/// result depends on how wide these are.
using Lanes = float __attribute__((vector_size(32)));
using LaneBits = std::int32_t __attribute__((vector_size(32)));
inline constexpr int lane_count = 8;

// Inlined always, so that vectors are never handed over by a calling convention that depends on the machine.
#define TAGDOCK_LANES [[gnu::always_inline]] inline

TAGDOCK_LANES Lanes lanes(float value) { return Lanes{value, value, value, value, value, value, value, value}; }

TAGDOCK_LANES double sum(const Lanes& values) {
  double result = 0.0;
  for (int lane = 0; lane < lane_count; ++lane) result += values[lane];
  return result;
}

/// Within 2e-7 of itself; arguments are held to +-87.
TAGDOCK_LANES Lanes exponential(const Lanes& argument) {
  Lanes x = argument > 87.0F ? lanes(87.0F) : argument;
  x = x < -87.0F ? lanes(-87.0F) : x;
  // x = n ln 2 + rest; adding 1.5 * 2^23 rounds to a whole number.
  const Lanes shifted = x * 1.44269504088896341F + 12582912.0F;
  const LaneBits n = reinterpret_cast<LaneBits>(shifted) - 0x4B400000;
  const Lanes whole = shifted - 12582912.0F;
  const Lanes rest = (x - whole * 0.693359375F) + whole * 2.12194440e-4F;
  Lanes p = rest * 1.9875691500e-4F + 1.3981999507e-3F;  // Cephes' coefficients
  p = p * rest + 8.3334519073e-3F;
  p = p * rest + 4.1665795894e-2F;
  p = p * rest + 1.6666665459e-1F;
  p = p * rest + 5.0000001201e-1F;
  p = p * rest * rest + rest + 1.0F;
  return p * reinterpret_cast<Lanes>((n + 127) << 23);
}

/// Natural logarithm of positive numbers, within 1e-7 (absolute, near one).
TAGDOCK_LANES Lanes logarithm(const Lanes& argument) {
  const LaneBits bits = reinterpret_cast<LaneBits>(argument);
  LaneBits power = ((bits >> 23) & 0xff) - 126;
  Lanes m = reinterpret_cast<Lanes>((bits & 0x007fffff) | 0x3f000000);  // 0.5 to 1
  const LaneBits low = m < 0.70710678F;
  power += low;  // a true lane is -1
  m = low ? m + m - 1.0F : m - 1.0F;
  Lanes p = m * 7.0376836292e-2F - 1.1514610310e-1F;  // Cephes' coefficients
  p = p * m + 1.1676998740e-1F;
  p = p * m - 1.2420140846e-1F;
  p = p * m + 1.4249322787e-1F;
  p = p * m - 1.6668057665e-1F;
  p = p * m + 2.0000714765e-1F;
  p = p * m - 2.4999993993e-1F;
  p = p * m + 3.3333331174e-1F;
  const Lanes squared = m * m;
  const Lanes n = __builtin_convertvector(power, Lanes);
  return (p * m * squared - 0.5F * squared - 2.12194440e-4F * n) + m + 0.693359375F * n;
}

/// The normal distribution: cumulative within 2e-7. Beyond 8 sigma it stays what it is at 8, so that no product becomes
/// a denormal number, which would take a hundred times as long.
struct NormalLanes {
  Lanes cumulative, density;
};
TAGDOCK_LANES NormalLanes normal(const Lanes& z) {
  // Abramowitz and Stegun, 26.2.17.
  Lanes size = z < 0.0F ? -z : z;
  size = size > 8.0F ? lanes(8.0F) : size;
  const Lanes density = exponential(-0.5F * size * size) * 0.398942280401F;
  const Lanes t = 1.0F / (1.0F + 0.2316419F * size);
  Lanes p = t * 1.330274429F - 1.821255978F;
  p = p * t + 1.781477937F;
  p = p * t - 0.356563782F;
  p = p * t + 0.319381530F;
  const Lanes tail = density * p * t;
  return {z > 0.0F ? 1.0F - tail : tail, density};
}

}  // namespace tagdock
