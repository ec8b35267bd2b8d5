#include <catch2/catch.hpp>

#include "app/cameras/frame_counter.h"
#include "app/cameras/receive_buffer.h"

namespace tagdock {
namespace {

TEST_CASE("short frame ids are unwrapped over 65535, which 1 follows") {
  FrameCounter counter;
  CHECK(counter.number(65401) == 65401);
  CHECK(counter.number(65535) == 65535);
  CHECK(counter.number(1) == 65536);
  CHECK(counter.number(4) == 65539);  // two frames are missing
  std::uint64_t number = 65539;
  for (std::uint64_t i = 1; i <= 3 * 65535; ++i) {
    const std::uint64_t id = (3 + i) % 65535 + 1;
    REQUIRE(counter.number(id) == number + i);
  }
}

TEST_CASE("a frame that is not newer than the last has no number") {
  FrameCounter counter;
  counter.number(10);
  CHECK_FALSE(counter.number(10));
  CHECK_FALSE(counter.number(9));
  CHECK(counter.number(11) == 11);
}

TEST_CASE("a frame that was not complete has a number, and is not counted") {
  FrameCounter counter;
  counter.number(65534);
  CHECK(counter.would_be(1) == 65536);
  CHECK(counter.would_be(65534) == std::nullopt);
  CHECK(counter.number(65535) == 65535);
}

TEST_CASE("extended frame ids run on beyond 16 bits") {
  FrameCounter counter;
  CHECK(counter.number(65535) == 65535);
  CHECK(counter.number(65536) == 65536);
  CHECK(counter.number(std::uint64_t{1} << 40) == std::uint64_t{1} << 40);
  CHECK_FALSE(counter.number(65536));
}

TEST_CASE("numbers go on over a camera that was opened anew") {
  FrameCounter counter;
  counter.number(500);
  counter.reopened();
  CHECK(counter.number(1) == 501);
  CHECK(counter.number(3) == 503);
}

TEST_CASE("the region shrinks to what a receive buffer holds") {
  const RegionSize whole{1280, 1024};
  CHECK(region_that_fits(whole, std::size_t{4} << 20) == whole);
  CHECK(region_that_fits(whole, needed_receive_buffer(whole)) == whole);
  CHECK(region_that_fits(whole, needed_receive_buffer(whole) - 1) == RegionSize{640, 480});
  CHECK(region_that_fits(whole, 212992) == RegionSize{640, 480});  // a stock kernel
  CHECK(region_that_fits(whole, 200000) == RegionSize{480, 360});
  CHECK(region_that_fits(whole, 0) == RegionSize{160, 120});
  CHECK(region_that_fits({100, 50}, 0) == RegionSize{100, 50});
  // Coarser pixels keep the view; a few rows at the edge may go.
  CHECK(image_that_fits(whole, needed_receive_buffer(whole), 4) == SmallerImage{1, whole});
  CHECK(image_that_fits(whole, 212992, 4) == SmallerImage{2, {640, 480}});
  CHECK(image_that_fits(whole, 100000, 4) == SmallerImage{4, {320, 256}});
  CHECK(image_that_fits(whole, 100000, 2) == SmallerImage{1, {320, 240}});  // this camera cannot bin so far
  CHECK(image_that_fits(whole, 212992, 1) == SmallerImage{1, {640, 480}});
  CHECK(granted_receive_buffer(65536) == 65536);  // every kernel grants this much
}

}  // namespace
}  // namespace tagdock
