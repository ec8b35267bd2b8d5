#pragma once

#include <array>
#include <string>
#include <vector>

#include "app/campaign_run.h"

namespace tagdock {

/// How a standard deviation differs between two campaigns that drove the same seeds.
struct SigmaRatio {
  double ratio = 0.0;  ///< of the first over the second
  double low = 0.0;    ///< 95 % confidence, for normal errors
  double high = 0.0;
  int pairs = 0;  ///< seeds that both drove
};

/// Ratios of the standard deviations of the true errors x, y, yaw. The same seeds meet the same floor, so the errors go
/// together and the interval is narrower than that of two independent campaigns (Morgan 1939, Pitman 1939).
/// @return  ratio 0 where fewer than four seeds are common
std::array<SigmaRatio, 3> sigma_ratios(const std::vector<RunRecord>& first, const std::vector<RunRecord>& second);

/// A line for each quantity.
std::string agreement_words(const std::array<SigmaRatio, 3>& ratios);

}  // namespace tagdock
