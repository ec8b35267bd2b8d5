#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "app/campaign_run.h"
#include "app/evaluation_figures.h"

namespace tagdock {

/// A share of successes with the bounds of its 95 % confidence interval (Clopper and Pearson).
struct Share {
  int count = 0;
  int of = 0;
  double low = 0.0;
  double high = 1.0;
  [[nodiscard]] double value() const { return of > 0 ? static_cast<double>(count) / of : 0.0; }
};

/// @param confidence  two-sided
Share share_of(int count, int of, double confidence = 0.95);

/// The reliability that so many failures in so many runs show with a confidence, one-sided (ASTM F3499-21 states
/// docking this way; without a failure it is (1 - confidence)^(1 / runs)).
double shown_reliability(int failures, int runs, double confidence = 0.95);

/// The interval of a standard deviation at 95 %, as factors on it, from the values: Bonett (2006), which does not take
/// the errors for normally distributed.
struct SigmaBounds {
  double low = 0.0;
  double high = 0.0;  ///< infinite below 5 values
};
SigmaBounds sigma_bounds(const std::vector<double>& values);

/// Errors of a set of runs.
struct Spread {
  int runs = 0;
  Pose2 mean, sigma;
  Pose2 sigma_low, sigma_high;  ///< 95 %
};

/// Whether a robot came to the dock and measured there: it docked, arrived, or found itself outside and said so.
bool came_to_end(const RunRecord& record);

/// What a campaign came to. Every run counts in every figure; refused and failed ones stay in the denominators.
struct Evaluation {
  int runs = 0;
  Pose2 mean;                    ///< true error: m, m, rad
  Pose2 sigma;                   ///< of the same
  Pose2 sigma_low, sigma_high;   ///< 95 %
  Pose2 p95;                     ///< of the absolute values
  Spread ended;                  ///< of the runs that came to their end (came_to_end), right or wrong
  Share first_3mm;               ///< docked at the first attempt, inside 3 mm, 3 mm, 0.5 degrees (true)
  Share all_3mm;                 ///< docked, with retries, inside the same
  Share all_10mm;                ///< docked (or arrived) inside 10 mm, 10 mm, 1 degree
  int failed = 0;                ///< said so
  int wrong_claims = 0;          ///< claimed success, and were outside of 3 mm, 3 mm, 0.5 degrees
  int outside_without_word = 0;  ///< claimed success, and were outside of 10 mm, 10 mm, 1 degree
  double mean_duration_s = 0.0;
  double p99_duration_s = 0.0;
  double mean_attempts = 0.0;
  Pose2 normalised;  ///< mean square of (estimated - true) / sigma of the runs that gave sigmas; 1 is honest
  int with_sigma = 0;
  int faults = 0;                  ///< runs in which something broke on the way
  double fault_to_zero_ms = 0.0;   ///< longest of those; infinite: never
  double fault_to_stand_ms = 0.0;  ///< longest of those
  /// Of those that failed, the most frequent first; figures are left out (#), so that equal reasons count together.
  std::vector<std::pair<std::string, int>> reasons;
};

Evaluation evaluate(const std::vector<RunRecord>& records);

/// summary.json
nlohmann::ordered_json to_json(const Evaluation& evaluation, const RunSettings& settings);
/// A few lines for people.
std::string summary(const Evaluation& evaluation);
/// The robot's own word on its accuracy against the truth, in sentences; empty without.
std::string fix_words(const Evaluation& evaluation);
/// "0.32 mm (0.27 to 0.38)"
std::string sigma_words(double sigma, double low, double high, double scale, const char* unit, int decimals);
/// How fast the robot stopped where something broke.
std::string fault_words(const Evaluation& evaluation);

/// A table of campaigns beside the paper and MiR; its rows come from `html_row`.
std::string html_against_others(const std::string& rows);
std::string html_row(const Evaluation& evaluation, const std::string& name);

/// report.html: figures as the paper's 8, 9 and 10, tables against the paper and MiR, limits. One file, no scripts.
struct CampaignPage {
  std::string title;
  std::string campaign;                               ///< campaign.yaml, or what stands for it
  std::string first;                                  ///< before everything else, as HTML
  std::string limits;                                 ///< html_limits
  std::string truth = "as the simulator knows them";  ///< where the true errors come from
};
std::string to_html(const Evaluation& evaluation, const FigureData& data, const CampaignPage& page);

}  // namespace tagdock
