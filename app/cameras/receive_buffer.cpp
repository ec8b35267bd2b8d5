#include "app/cameras/receive_buffer.h"

#include <algorithm>
#include <array>
#include <sys/socket.h>
#include <unistd.h>

namespace tagdock {

std::size_t needed_receive_buffer(const RegionSize& size) {
  // A sender on the loopback device sends a frame in one burst, so the buffer must hold it, and the kernel's own
  // overhead counts too; in exchange the kernel reserves twice what was asked. The good case measured had
  // 2 x 212992 bytes for 307200 pixels, 1.39 times as much; 1.35 keeps it.
  constexpr double room_for_overhead = 1.35;
  return static_cast<std::size_t>(static_cast<double>(size.width) * size.height * room_for_overhead / 2.0) + 1;
}

RegionSize region_that_fits(const RegionSize& wanted, std::size_t granted) {
  if (needed_receive_buffer(wanted) <= granted) return wanted;
  constexpr std::array<RegionSize, 4> smaller{{{640, 480}, {480, 360}, {320, 240}, {160, 120}}};
  for (const RegionSize& size : smaller)
    if (size.width <= wanted.width && size.height <= wanted.height && needed_receive_buffer(size) <= granted)
      return size;
  return {std::min(wanted.width, smaller.back().width), std::min(wanted.height, smaller.back().height)};
}

SmallerImage image_that_fits(const RegionSize& wanted, std::size_t granted, int most_binning) {
  constexpr int row_step = 16;  // heights of most cameras go in steps of 2 to 16 pixels
  constexpr double least_rows = 0.9;
  for (int binning = 1; binning <= std::min(most_binning, 4); binning *= 2) {
    RegionSize size{wanted.width / binning, wanted.height / binning};
    if (needed_receive_buffer(size) <= granted) return {binning, size};
    const int whole = size.height;
    size.height = whole / row_step * row_step;
    while (size.height >= least_rows * whole && needed_receive_buffer(size) > granted) size.height -= row_step;
    if (size.height >= least_rows * whole) return {binning, size};
  }
  return {1, region_that_fits(wanted, granted)};
}

std::size_t granted_receive_buffer(std::size_t wanted) {
  const int handle = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  if (handle < 0) return 0;
  const int asked = static_cast<int>(wanted);
  int granted = 0;
  socklen_t size = sizeof granted;
  ::setsockopt(handle, SOL_SOCKET, SO_RCVBUF, &asked, sizeof asked);
  ::getsockopt(handle, SOL_SOCKET, SO_RCVBUF, &granted, &size);
  ::close(handle);
  return static_cast<std::size_t>(granted) / 2;  // Linux reports the double
}

}  // namespace tagdock
