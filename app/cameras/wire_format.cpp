#include "app/cameras/wire_format.h"

#include <algorithm>

namespace tagdock {
namespace {

constexpr WireFormat formats[] = {{"Mono8", 0x01080001, 8, 8},          {"Mono10", 0x01100003, 10, 16},
                                  {"Mono10Packed", 0x010c0004, 10, 12}, {"Mono12", 0x01100005, 12, 16},
                                  {"Mono12Packed", 0x010c0006, 12, 12}, {"Mono16", 0x01100007, 16, 16}};

template <class Condition>
const WireFormat* first(const Condition& condition) {
  const auto* found = std::find_if(std::begin(formats), std::end(formats), condition);
  return found == std::end(formats) ? nullptr : found;
}

}  // namespace

const WireFormat* wire_format(std::string_view name) {
  return first([&](const WireFormat& one) { return one.name == name; });
}
const WireFormat* wire_format(std::uint32_t value) {
  return first([&](const WireFormat& one) { return one.value == value; });
}

void narrow(const std::uint8_t* wire, const WireFormat& format, cv::Mat1b& gray) {
  std::size_t pixel = 0;
  for (int row = 0; row < gray.rows; ++row)
    for (std::uint8_t& value : gray.row(row)) {
      if (format.bits_on_wire == 8)
        value = wire[pixel];
      else if (format.bits_on_wire == 16)
        value = static_cast<std::uint8_t>((wire[2 * pixel] | wire[2 * pixel + 1] << 8) >> (format.bits - 8));
      else  // first pixel's upper 8 bits, both pixels' lower ones, second pixel's upper 8 bits
        value = wire[3 * (pixel / 2) + 2 * (pixel % 2)];
      ++pixel;
    }
}

std::vector<std::uint8_t> widened(const cv::Mat1b& gray, const WireFormat& format) {
  std::vector<std::uint8_t> wire(format.bytes(gray.cols, gray.rows));
  if (format.bits_on_wire == 8) {
    for (int row = 0; row < gray.rows; ++row)
      std::copy_n(gray[row], gray.cols, wire.begin() + std::ptrdiff_t{row} * gray.cols);
    return wire;
  }
  const int more = format.bits - 8;
  std::size_t pixel = 0;
  for (int row = 0; row < gray.rows; ++row)
    for (int column = 0; column < gray.cols; ++column, ++pixel) {
      const unsigned grey = gray(row, column);
      // The bits again below themselves: 255 becomes the largest number.
      const unsigned value = grey << more | grey >> (8 - more);
      if (format.bits_on_wire == 16) {
        wire[2 * pixel] = static_cast<std::uint8_t>(value);
        wire[2 * pixel + 1] = static_cast<std::uint8_t>(value >> 8);
      } else {
        const std::size_t triple = 3 * (pixel / 2);
        const unsigned low = value & ((1U << more) - 1U);
        wire[triple + 2 * (pixel % 2)] = static_cast<std::uint8_t>(value >> more);
        wire[triple + 1] |= static_cast<std::uint8_t>(pixel % 2 == 0 ? low : low << 4);
      }
    }
  return wire;
}

}  // namespace tagdock
