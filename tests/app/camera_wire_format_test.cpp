#include <catch2/catch.hpp>

#include "app/cameras/wire_format.h"

namespace tagdock {
namespace {

cv::Mat1b narrowed(const std::vector<std::uint8_t>& wire, const char* name, int width, int height) {
  cv::Mat1b gray(height, width, std::uint8_t{77});
  narrow(wire.data(), *wire_format(name), gray);
  return gray;
}

// Two pixels by hand, from the standards: 0x2ab and 0x1f3 of 10 bits, 0xabc and 0x123 of 12, 0xabcd and 0x1234 of 16.

TEST_CASE("wide pixels come as their upper 8 bits, by the layout of GigE Vision") {
  const auto pair = [](const std::vector<std::uint8_t>& wire, const char* name) {
    const cv::Mat1b gray = narrowed(wire, name, 2, 1);
    return std::pair<int, int>(gray(0, 0), gray(0, 1));
  };
  CHECK(pair({0xab, 0x02, 0xf3, 0x01}, "Mono10") == std::pair(0xaa, 0x7c));
  CHECK(pair({0xaa, 0x33, 0x7c}, "Mono10Packed") == std::pair(0xaa, 0x7c));
  CHECK(pair({0xbc, 0x0a, 0x23, 0x01}, "Mono12") == std::pair(0xab, 0x12));
  CHECK(pair({0xab, 0x3c, 0x12}, "Mono12Packed") == std::pair(0xab, 0x12));
  CHECK(pair({0xcd, 0xab, 0x34, 0x12}, "Mono16") == std::pair(0xab, 0x12));
}

TEST_CASE("a picture of any size and brightness goes through every format, and no byte beyond it is touched") {
  for (const char* name : {"Mono8", "Mono10", "Mono10Packed", "Mono12", "Mono12Packed", "Mono16"})
    for (const auto& [width, height] : {std::pair(16, 16), std::pair(7, 5), std::pair(1, 1), std::pair(3, 1)}) {
      CAPTURE(name, width, height);
      cv::Mat1b gray(height, width);
      int grey = 0;
      for (std::uint8_t& pixel : gray) pixel = static_cast<std::uint8_t>(255 - 37 * grey++);
      const std::vector<std::uint8_t> wire = widened(gray, *wire_format(name));
      CHECK(wire.size() == wire_format(name)->bytes(width, height));
      CHECK(cv::countNonZero(narrowed(wire, name, width, height) != gray) == 0);
    }
  // White is white: all bits of both pixels.
  CHECK(widened(cv::Mat1b(1, 2, std::uint8_t{255}), *wire_format("Mono10Packed")) ==
        std::vector<std::uint8_t>{0xff, 0x33, 0xff});
  CHECK(widened(cv::Mat1b(1, 2, std::uint8_t{255}), *wire_format("Mono12Packed")) ==
        std::vector<std::uint8_t>{0xff, 0xff, 0xff});
  CHECK(widened(cv::Mat1b(1, 1, std::uint8_t{255}), *wire_format("Mono10")) == std::vector<std::uint8_t>{0xff, 0x03});
  CHECK(wire_format("Mono12p") == nullptr);
  CHECK(wire_format(0x01100005)->name == "Mono12");
}

}  // namespace
}  // namespace tagdock
