#include "tests/app/session_mutation.h"

#include <chrono>
#include <fstream>
#include <sstream>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "app/session_replay.h"

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

TEST_CASE("the largest numbers that a recording can hold are read as they are") {
  const auto folder = std::filesystem::temp_directory_path() / ("tagdock_largest_" + std::to_string(::getpid()));
  std::filesystem::remove_all(folder);
  make_small_session(folder, false);
  // A docking may be given any seed of 64 bits.
  std::string head = contents(folder / "session.yaml");
  REQUIRE(head.find("\nseed: 1\n") != std::string::npos);
  head.replace(head.find("\nseed: 1\n"), 9, "\nseed: 18446744073709551615\n");
  std::ofstream(folder / "session.yaml", std::ios::binary) << head;
  CHECK(try_session(folder));
  CHECK(read_session_head(folder).seed == 18446744073709551615U);
  // More readings than there are: all that are left.
  std::string commands = contents(folder / "commands.csv");
  const std::string one_read = ",4,1,ok,none,linked,";
  REQUIRE(commands.find(one_read) != std::string::npos);
  commands.replace(commands.find(one_read), one_read.size(), ",4,18446744073709551615,ok,none,linked,");
  std::ofstream(folder / "commands.csv", std::ios::binary) << commands;
  CHECK_FALSE(try_session(folder));  // another command line than was recorded, and nothing worse
  std::filesystem::remove_all(folder);
}
