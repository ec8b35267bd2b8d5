#include "app/yaml_file.h"

#include <catch2/catch.hpp>

#include "app/failure.h"

using namespace tagdock;
using Catch::Matchers::Contains;
using Catch::Matchers::Message;

namespace {

std::string refusal(const std::string& text, const std::function<void(YamlMap&)>& read) {
  try {
    YamlMap map = YamlMap::parse(text, "dock.yaml");
    read(map);
    map.finish();
  } catch (const Failure& failure) {
    CHECK(failure.code() == ExitCode::usage);
    return failure.what();
  }
  return "";
}

void read_speed(YamlMap& map) {
  double speed = 0.15;
  if (auto servo = map.optional_map("servo")) servo->read("max_speed", speed, 0.05, 0.8);
}

}  // namespace

TEST_CASE("a good file is read, and a key that is missing keeps its default") {
  CHECK(refusal("servo: {max_speed: 0.2}", read_speed).empty());
  CHECK(refusal("servo: {}", read_speed).empty());
  CHECK(refusal("", read_speed).empty());
}

TEST_CASE("a bad value is refused with file, line, column, key, value and what would be right") {
  CHECK(refusal("servo:\n  max_speed: 12\n", read_speed) ==
        "dock.yaml:2:14: servo.max_speed is 12; it must be between 0.05 and 0.8");
  for (const std::string word : {"fast", ".nan", ".inf", "1e999", "0,2", "0.2 m/s", "\"\""}) {
    CAPTURE(word);
    CHECK_THAT(refusal("servo: {max_speed: " + (word == "0,2" ? std::string("\"0,2\"") : word) + "}", read_speed),
               Contains("dock.yaml:1:") && Contains("servo.max_speed") && Contains("not a finite number"));
  }
}

TEST_CASE("an unknown key is refused with the nearest known one") {
  CHECK_THAT(refusal("servo: {max_sped: 0.2}", read_speed),
             Contains("dock.yaml:1:9: the key servo.max_sped is not known; did you mean max_speed?"));
  CHECK_THAT(refusal("colour: red", read_speed), Contains("the key colour is not known"));
}

TEST_CASE("a missing key is named") {
  CHECK_THAT(refusal("{}", [](YamlMap& map) { (void)map.number("tag_size", 0.01, 1.0); }),
             Contains("the key tag_size is missing"));
}

TEST_CASE("keys given twice, aliases and deep nesting are refused before a tree is built") {
  CHECK_THAT(refusal("servo: {max_speed: 0.2}\nservo: {}", read_speed), Contains("given twice"));
  CHECK_THAT(refusal("a: &x [*x]", read_speed), Contains("aliases") || Contains("anchors"));
  CHECK_THAT(refusal("a: &x {}\nb: *x\n", read_speed), Contains("alias") || Contains("anchor"));
  CHECK_THAT(refusal(std::string(20000, '['), read_speed), Contains("nested deeper"));
  CHECK_THAT(refusal("a: [1, 2", read_speed), Contains("not YAML"));
}
