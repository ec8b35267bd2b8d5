#pragma once

#include <cstddef>
#include <cstdint>
#include <string_view>
#include <vector>

#include <opencv2/core.hpp>

namespace tagdock {

/// How grey pixels lie on the wire: name and value of GenICam's Pixel Format Naming Convention.
struct WireFormat {
  std::string_view name;
  std::uint32_t value = 0;
  int bits = 8;          ///< that tell the brightness
  int bits_on_wire = 8;  ///< 16: one number, the low byte first; 12: two pixels in three bytes (GigE Vision's "Packed")

  [[nodiscard]] std::size_t bytes(int width, int height) const {
    return (static_cast<std::size_t>(width) * static_cast<std::size_t>(height) *
                static_cast<std::size_t>(bits_on_wire) +
            7) /
           8;
  }
};

/// Null for a name or value that is none of ours.
const WireFormat* wire_format(std::string_view name);
const WireFormat* wire_format(std::uint32_t value);

/// The upper 8 bits of each pixel.
/// @param wire  `format.bytes(gray.cols, gray.rows)` bytes
/// @param gray  written; its size says how many pixels there are
void narrow(const std::uint8_t* wire, const WireFormat& format, cv::Mat1b& gray);

/// What a camera sends for a picture: white is white in every format.
std::vector<std::uint8_t> widened(const cv::Mat1b& gray, const WireFormat& format);

}  // namespace tagdock
