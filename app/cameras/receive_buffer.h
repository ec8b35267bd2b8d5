#pragma once

#include <cstddef>

namespace tagdock {

struct RegionSize {
  int width = 0;
  int height = 0;
  bool operator==(const RegionSize&) const = default;
};

/// Bytes of receive buffer (as asked from the kernel) that frames of this size need, one byte a pixel.
/// Measured with 16384-byte packets and 212992 bytes: 640x480 came through in 91 of 92 frames, 1280x1024 in none.
std::size_t needed_receive_buffer(const RegionSize& size);

/// The wanted size, or the largest of 640x480, 480x360, 320x240 and 160x120 whose frames survive in `granted` bytes.
RegionSize region_that_fits(const RegionSize& wanted, std::size_t granted);

/// A picture that is made smaller: `binning` x `binning` pixels of the sensor become one, then `size` of those is sent.
struct SmallerImage {
  int binning = 1;
  RegionSize size;
  bool operator==(const SmallerImage&) const = default;
};

/// The wanted picture, or the finest that keeps its view and whose frames survive in `granted` bytes: whole columns,
/// and at least nine tenths of the rows. A camera that cannot bin so far sends a part of the view (region_that_fits).
/// @param most_binning  what the camera can do, 1 if it cannot bin
SmallerImage image_that_fits(const RegionSize& wanted, std::size_t granted, int most_binning);

/// What the kernel grants a UDP socket that asks for `wanted` bytes of receive buffer (its limit: net.core.rmem_max).
std::size_t granted_receive_buffer(std::size_t wanted);

}  // namespace tagdock
