#include "tests/app/session_mutation.h"

#include <chrono>
#include <fstream>
#include <sstream>
#include <unistd.h>

#include <catch2/catch.hpp>

using namespace tagdock;

namespace {

std::string contents(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::stringstream text;
  text << stream.rdbuf();
  return text.str();
}

}  // namespace

TEST_CASE("damaged recordings give an error or a result, never a crash") {
  const auto folder = std::filesystem::temp_directory_path() / ("tagdock_mutation_" + std::to_string(::getpid()));
  std::filesystem::remove_all(folder);
  const bool compress = GENERATE(false, true);
  make_small_session(folder, compress);
  CHECK(try_session(folder));  // whole, it repeats itself
  const std::string picture = compress ? "cam0/data/I000002.png" : "cam0/data/I000002.pgm";
  const std::string files[] = {"session.yaml", "cam0/data.csv", "odometry.csv", "sightings.csv",
                               "commands.csv", "phases.csv",    picture};
  SessionMutation mutation(compress ? 2 : 1);
  int still_good = 0;
  // The 100000 of them are tests/fuzz/session_fuzz.cpp.
  constexpr int tries = 150;
  for (int i = 0; i < tries; ++i) {
    const std::filesystem::path file = folder / files[mutation.below(std::size(files))];
    const std::string whole = contents(file);
    std::ofstream(file, std::ios::binary) << mutation.damaged(whole);
    still_good += try_session(folder) ? 1 : 0;
    std::ofstream(file, std::ios::binary) << whole;
  }
  // Some damage is harmless (a line of events, a comment); most is not.
  CHECK(still_good < tries / 2);
  CHECK(try_session(folder));
  std::filesystem::remove_all(folder);
}
