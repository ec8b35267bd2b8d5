#pragma once

#include <chrono>
#include <string>

namespace tagdock {

/// "45 s", "12 min 5 s", "3 h 20 min"
std::string duration_words(double seconds);

/// "[#######---] 70 of 100 runs, 12 min 5 s to go"
std::string progress_words(int done, int wanted, double seconds_to_go);

/// How far a campaign is, on stderr: a bar in place on a terminal, otherwise a line now and then.
class Progress {
 public:
  explicit Progress(bool quiet);
  ~Progress();
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// After every run that was made here.
  void operator()(int done, int wanted);

  [[nodiscard]] int here() const { return here_; }  ///< runs made here, not before
  [[nodiscard]] double seconds() const;

 private:
  using Clock = std::chrono::steady_clock;
  bool quiet_;
  bool terminal_;
  bool dirty_ = false;
  int here_ = 0;
  Clock::time_point start_ = Clock::now();
  Clock::time_point told_ = start_;
};

}  // namespace tagdock
