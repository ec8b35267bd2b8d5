// Damaged recordings by a seeded generator: each is read and replayed in a child that must end by itself within its
// time; a crash or a hang is printed with the seed that repeats it.
//   session_fuzz COUNT [FIRST_SEED]
// Every seed is one damage of one file of a small recorded docking.
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <fcntl.h>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <sys/wait.h>
#include <unistd.h>

#include "tests/app/session_mutation.h"

namespace {

namespace fs = std::filesystem;

std::string contents(const fs::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::stringstream text;
  text << stream.rdbuf();
  return text.str();
}

/// Seeds first..last-1, one after the other; says where it is, so that the parent knows what it died of.
void attempt(const fs::path& folder, unsigned long first, unsigned long last, int progress) {
  const std::string picture = first % 2000 < 1000 ? "pgm" : "png";
  tagdock::make_small_session(folder, picture == "png");
  const std::string files[] = {"session.yaml",
                               "cam0/data.csv",
                               "odometry.csv",
                               "sightings.csv",
                               "commands.csv",
                               "phases.csv",
                               "cam0/data/I000002." + picture};
  for (unsigned long seed = first; seed < last; ++seed) {
    tagdock::SessionMutation mutation(seed);
    const fs::path file = folder / files[mutation.below(std::size(files))];
    const std::string whole = contents(file);
    std::ofstream(file, std::ios::binary) << mutation.damaged(whole);
    const unsigned long report[2] = {seed, tagdock::try_session(folder) ? 1UL : 0UL};
    (void)!::write(progress, report, sizeof report);
    std::ofstream(file, std::ios::binary) << whole;
  }
}

}  // namespace

int main(int argc, char** argv) {
  const unsigned long count = argc > 1 ? std::strtoul(argv[1], nullptr, 10) : 0;
  const unsigned long begin = argc > 2 ? std::strtoul(argv[2], nullptr, 10) : 0;
  if (count == 0) {
    std::fprintf(stderr, "usage: session_fuzz COUNT [FIRST_SEED]\n");
    return 2;
  }
  const fs::path folder = fs::temp_directory_path() / ("tagdock_session_fuzz_" + std::to_string(::getpid()));
  unsigned long done = 0, good = 0, crashed = 0;
  constexpr unsigned long batch = 1000;
  constexpr unsigned longest_s = 10;  // of one try; one takes 2 ms
  for (unsigned long next = begin; next < begin + count;) {
    fs::remove_all(folder);
    const unsigned long last = std::min((next / batch + 1) * batch, begin + count);
    int ends[2];
    if (::pipe(ends) != 0) return 70;
    const pid_t child = ::fork();
    if (child == 0) {
      ::close(ends[0]);
      // One seed alone is run to be looked at.
      if (const int nowhere = ::open("/dev/null", O_WRONLY); count > 1 && nowhere >= 0) ::dup2(nowhere, STDERR_FILENO);
      attempt(folder, next, last, ends[1]);
      ::_exit(0);
    }
    ::close(ends[1]);
    unsigned long report[2];
    unsigned long reached = next;
    while (true) {
      fd_set wanted;
      FD_ZERO(&wanted);
      FD_SET(ends[0], &wanted);
      timeval patience{longest_s, 0};
      if (::select(ends[0] + 1, &wanted, nullptr, nullptr, &patience) == 0) ::kill(child, SIGKILL);  // it hangs
      if (::read(ends[0], report, sizeof report) != static_cast<ssize_t>(sizeof report)) break;
      reached = report[0] + 1;
      ++done;
      good += report[1];
    }
    ::close(ends[0]);
    int status = 0;
    ::waitpid(child, &status, 0);
    if (!WIFEXITED(status) || WEXITSTATUS(status) != 0) {
      std::printf("seed %lu: %s %d\n", reached, WIFSIGNALED(status) ? "signal" : "exit code",
                  WIFSIGNALED(status) ? WTERMSIG(status) : WEXITSTATUS(status));
      std::fflush(stdout);
      ++crashed;
      reached += 1;
    }
    next = std::max(reached, next + 1);
  }
  fs::remove_all(folder);
  std::printf("%lu damaged recordings: %lu crashed or hung, %lu gave a result, %lu an error\n", done + crashed, crashed,
              good, done - good);
  return crashed == 0 ? 0 : 1;
}
