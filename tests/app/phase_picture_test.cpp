#include "app/phase_picture.h"

#include <array>
#include <set>

#include <catch2/catch.hpp>

using namespace tagdock;

namespace {

int count(const std::string& text, const std::string& words) {
  int found = 0;
  for (std::size_t at = text.find(words); at != std::string::npos; at = text.find(words, at + 1)) ++found;
  return found;
}

}  // namespace

TEST_CASE("the picture of phases shows every row of the table, and follows the table when it changes") {
  const std::string picture = phase_picture(transitions());
  std::set<std::string> words;
  for (const Transition& row : transitions()) words.insert(std::string(row.word));
  for (const std::string& word : words) {
    int rows = 0;
    for (const Transition& row : transitions()) rows += row.word == word ? 1 : 0;
    CAPTURE(word);
    CHECK(count(picture, ">" + word + "<") == rows);
  }
  for (const Transition& row : transitions())
    if (row.from != "any") CHECK(count(picture, ">" + std::string(row.from) + "<") == 1);

  const std::array<Transition, 3> other = {
      {{"waking", "walking", "rested"}, {"walking", "sleeping", "tired"}, {"walking", "waking", "stumbled"}}};
  const std::string small = phase_picture(other);
  for (const char* word : {"waking", "walking", "sleeping", "rested", "tired", "stumbled"})
    CHECK(count(small, std::string(">") + word + "<") == 1);
}
