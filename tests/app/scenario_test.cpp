#include "app/simulation/scenario.h"

#include <filesystem>
#include <fstream>
#include <sstream>

#include <catch2/catch.hpp>

#include "app/failure.h"

using namespace tagdock;

namespace {

const std::filesystem::path shipped = "data/scenarios";

std::string text_of(const std::filesystem::path& file) {
  std::ifstream stream(file);
  std::ostringstream text;
  text << stream.rdbuf();
  return text.str();
}

/// A folder with a copy of the default scenario and one file to be read.
class Folder {
 public:
  Folder() : path_(std::filesystem::temp_directory_path() / "tagdock_scenario_test") {
    std::filesystem::remove_all(path_);
    std::filesystem::create_directories(path_);
    std::filesystem::copy_file(shipped / "default.yaml", path_ / "default.yaml");
  }
  ~Folder() { std::filesystem::remove_all(path_); }

  Scenario read(const std::string& text) const {
    std::ofstream(path_ / "mine.yaml") << text;
    return read_scenario(path_ / "mine.yaml");
  }

  std::string refusal(const std::string& text) const {
    try {
      read(text);
    } catch (const Failure& failure) {
      CHECK(failure.code() == ExitCode::usage);
      return failure.what();
    }
    return "not refused";
  }

 private:
  std::filesystem::path path_;
};

std::string replaced(std::string text, const std::string& what, const std::string& by) {
  const auto at = text.find(what);
  REQUIRE(at != std::string::npos);
  return text.replace(at, what.size(), by);
}

}  // namespace

TEST_CASE("the default scenario file says what the structs say") {
  CHECK(read_scenario(shipped / "default.yaml") == Scenario{});
}

TEST_CASE("every shipped scenario is read, is named as its file, and only the default changes nothing") {
  int count = 0;
  for (const auto& entry : std::filesystem::directory_iterator(shipped)) {
    CAPTURE(entry.path().string());
    Scenario scenario = read_scenario(entry.path());
    CHECK(scenario.name == entry.path().stem().string());
    scenario.name = "default";
    CHECK((scenario == Scenario{}) == (entry.path().stem() == "default"));
    ++count;
  }
  CHECK(count >= 15);
}

TEST_CASE("a scenario based on another changes only what it names") {
  const Folder folder;
  const Scenario scenario = folder.read("name: mine\nbased_on: default.yaml\ncamera:\n  latency_ms: 250.0\n");
  Scenario expected;
  expected.name = "mine";
  expected.camera.latency = 0.250;
  CHECK(scenario == expected);
}

TEST_CASE("a scenario that cannot be is refused with file, line and key") {
  const Folder folder;
  const std::string whole = text_of(shipped / "default.yaml");
  CHECK_THAT(folder.refusal(replaced(whole, "  lag: 0.12", "  lagg: 0.12")), Catch::Contains("drive.lag"));
  CHECK_THAT(folder.refusal(replaced(whole, "  lag: 0.12", "  lag: .nan")),
             Catch::Contains("drive.lag") && Catch::Contains("mine.yaml:"));
  CHECK_THAT(folder.refusal(replaced(whole, "  loss: 0.0", "  loss: 1.5")),
             Catch::Contains("camera.loss") && Catch::Contains("between 0 and 1"));
  CHECK_THAT(folder.refusal(replaced(whole, "  track: 0.6", "  tyres: 4\n  track: 0.6")),
             Catch::Contains("drive.tyres") && Catch::Contains("not known"));
  CHECK_THAT(folder.refusal(replaced(whole, "  mass: 710.0", "  # mass")), Catch::Contains("drive.mass is missing"));
  CHECK_THAT(folder.refusal("name: mine\nbased_on: default.yaml\ncamera:\n  latncy_ms: 250.0\n"),
             Catch::Contains("camera.latncy_ms") && Catch::Contains("latency_ms"));
  CHECK_THAT(folder.refusal("name: mine\nbased_on: ../default.yaml\n"), Catch::Contains("without a folder"));
  CHECK_THAT(folder.refusal("name: mine\nbased_on: mine.yaml\n"), Catch::Contains("based_on"));
  CHECK_THAT(folder.refusal("name: mine\nbased_on: default.yaml\nstation:\n  dirt:\n    - {tag: 1, x: 0.0}\n"),
             Catch::Contains("dirt[0].y"));
}
