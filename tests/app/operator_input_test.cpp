#include "app/operator_input.h"

#include <string>
#include <unistd.h>
#include <vector>

#include <catch2/catch.hpp>

using namespace tagdock;

namespace {

// Standard input is a pipe with this in it, and ends there, for as long as one of these lives.
class StandardInput {
 public:
  explicit StandardInput(const std::string& text) : before_(::dup(STDIN_FILENO)) {
    int ends[2];
    REQUIRE(::pipe(ends) == 0);
    REQUIRE(::write(ends[1], text.data(), text.size()) == static_cast<ssize_t>(text.size()));
    ::close(ends[1]);
    ::dup2(ends[0], STDIN_FILENO);
    ::close(ends[0]);
  }
  ~StandardInput() {
    ::dup2(before_, STDIN_FILENO);
    ::close(before_);
  }
  StandardInput(const StandardInput&) = delete;
  StandardInput& operator=(const StandardInput&) = delete;

 private:
  int before_;
};

std::vector<Request> asked(const std::string& text) {
  const StandardInput input(text);
  OperatorInput person(true);
  std::vector<Request> requests;
  for (int call = 0; call < 6; ++call)
    if (const Request request = person.next(); request != Request::none) requests.push_back(request);
  return requests;
}

}  // namespace

TEST_CASE("words of the operator stay words when standard input ends") {
  CHECK(asked("status\n").empty());  // as keys, its s would stop the robot
  CHECK(asked("pause\nresume\n") == std::vector{Request::pause, Request::resume});
  CHECK(asked("pause\nhello\nresume\ncancel") == std::vector{Request::pause, Request::resume, Request::cancel});
  CHECK(asked("stop\r\n") == std::vector{Request::stop});
  CHECK(asked("").empty());
}
