#include "app/campaign_progress.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <unistd.h>

namespace tagdock {

std::string duration_words(double seconds) {
  const long whole = std::lround(std::max(0.0, seconds));
  if (whole < 60) return std::to_string(whole) + " s";
  if (whole < 3600) return std::to_string(whole / 60) + " min " + std::to_string(whole % 60) + " s";
  return std::to_string(whole / 3600) + " h " + std::to_string(whole / 60 % 60) + " min";
}

std::string progress_words(int done, int wanted, double seconds_to_go) {
  constexpr int width = 30;
  const int filled = wanted > 0 ? std::clamp(width * done / wanted, 0, width) : 0;
  return "[" + std::string(static_cast<std::size_t>(filled), '#') +
         std::string(static_cast<std::size_t>(width - filled), '-') + "] " + std::to_string(done) + " of " +
         std::to_string(wanted) + " runs, " + duration_words(seconds_to_go) + " to go";
}

Progress::Progress(bool quiet) : quiet_(quiet), terminal_(::isatty(STDERR_FILENO) != 0) {}

Progress::~Progress() {
  if (dirty_) std::fprintf(stderr, "\r\033[K");
}

double Progress::seconds() const { return std::chrono::duration<double>(Clock::now() - start_).count(); }

void Progress::operator()(int done, int wanted) {
  ++here_;
  // Often enough to be seen moving; in a log rarely enough to be read.
  const auto between = terminal_ ? std::chrono::milliseconds(100) : std::chrono::milliseconds(30000);
  if (quiet_ || (done < wanted && Clock::now() - told_ < between)) return;
  if (!terminal_ && done == wanted) return;
  told_ = Clock::now();
  const std::string words = progress_words(done, wanted, seconds() / here_ * (wanted - done));
  std::fprintf(stderr, terminal_ ? "\r\033[K%s" : "%s\n", words.c_str());
  std::fflush(stderr);
  dirty_ = terminal_;
}

}  // namespace tagdock
