#include <atomic>
#include <memory>
#include <thread>
#include <vector>

#include <catch2/catch.hpp>

#include "app/cameras/mailbox.h"

namespace tagdock {
namespace {

TEST_CASE("a mailbox gives the latest value once") {
  Mailbox<int> mailbox;
  CHECK_FALSE(mailbox.take());
  CHECK_FALSE(mailbox.put(1));
  CHECK(mailbox.put(2));
  CHECK(mailbox.take() == 2);
  CHECK_FALSE(mailbox.take());
  CHECK_FALSE(mailbox.put(3));
}

TEST_CASE("between threads values come whole and in order, each taken or counted as replaced") {
  constexpr int values = 20000;
  Mailbox<std::unique_ptr<std::vector<int>>> mailbox;
  std::atomic<bool> ended{false};
  int replaced = 0;
  std::thread producer([&] {
    for (int i = 1; i <= values; ++i) replaced += mailbox.put(std::make_unique<std::vector<int>>(8, i)) ? 1 : 0;
    ended = true;
  });
  int taken = 0;
  int last = 0;
  bool in_order = true;
  bool whole = true;
  while (true) {
    const bool was_ended = ended;
    const auto value = mailbox.take();
    if (!value) {
      if (was_ended) break;
      continue;
    }
    ++taken;
    in_order = in_order && (*value)->front() > last;
    last = (*value)->front();
    whole = whole && **value == std::vector<int>(8, last);
  }
  producer.join();
  CHECK(in_order);
  CHECK(whole);
  CHECK(last == values);
  CHECK(taken + replaced == values);
}

}  // namespace
}  // namespace tagdock
