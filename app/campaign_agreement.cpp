#include "app/campaign_agreement.h"

#include <cmath>
#include <cstdio>
#include <map>

namespace tagdock {
namespace {

// Student's t at 97.5 %, from the normal's by Cornish and Fisher; within 0.5 % from 5 degrees of freedom on.
double t_quantile(double freedom) {
  constexpr double z = 1.959964;
  return z + (z * z * z + z) / (4.0 * freedom) +
         (5.0 * std::pow(z, 5) + 16.0 * z * z * z + 3.0 * z) / (96.0 * freedom * freedom);
}

SigmaRatio ratio_of(const std::vector<double>& a, const std::vector<double>& b) {
  SigmaRatio result;
  result.pairs = static_cast<int>(a.size());
  constexpr int least = 4;
  if (result.pairs < least) return result;
  const auto count = static_cast<double>(a.size());
  double mean_a = 0.0;
  double mean_b = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    mean_a += a[i] / count;
    mean_b += b[i] / count;
  }
  double aa = 0.0;
  double bb = 0.0;
  double ab = 0.0;
  for (std::size_t i = 0; i < a.size(); ++i) {
    aa += (a[i] - mean_a) * (a[i] - mean_a);
    bb += (b[i] - mean_b) * (b[i] - mean_b);
    ab += (a[i] - mean_a) * (b[i] - mean_b);
  }
  if (!(aa > 0.0 && bb > 0.0)) return result;
  const double t = t_quantile(count - 2.0);
  const double k = 1.0 + 2.0 * (1.0 - ab * ab / (aa * bb)) * t * t / (count - 2.0);
  const double spread = std::sqrt(k + std::sqrt(k * k - 1.0));
  result.ratio = std::sqrt(aa / bb);
  result.low = result.ratio / spread;
  result.high = result.ratio * spread;
  return result;
}

}  // namespace

std::array<SigmaRatio, 3> sigma_ratios(const std::vector<RunRecord>& first, const std::vector<RunRecord>& second) {
  std::map<std::uint64_t, Pose2> by_seed;
  for (const RunRecord& record : second) by_seed[record.seed] = record.true_error;
  std::array<std::vector<double>, 3> a;
  std::array<std::vector<double>, 3> b;
  for (const RunRecord& record : first) {
    const auto other = by_seed.find(record.seed);
    if (other == by_seed.end()) continue;
    const std::array<double Pose2::*, 3> parts = {&Pose2::x, &Pose2::y, &Pose2::yaw};
    for (std::size_t i = 0; i < 3; ++i) {
      a[i].push_back(record.true_error.*parts[i]);
      b[i].push_back(other->second.*parts[i]);
    }
  }
  return {ratio_of(a[0], b[0]), ratio_of(a[1], b[1]), ratio_of(a[2], b[2])};
}

std::string agreement_words(const std::array<SigmaRatio, 3>& ratios) {
  std::string text;
  const std::array<const char*, 3> names = {"x", "y", "yaw"};
  for (std::size_t i = 0; i < 3; ++i) {
    char line[160];
    std::snprintf(line, sizeof line, "sigma %s with images over drawn corners: %.2f (95 %%: %.2f to %.2f; %d pairs)\n",
                  names[i], ratios[i].ratio, ratios[i].low, ratios[i].high, ratios[i].pairs);
    text += line;
  }
  return text;
}

}  // namespace tagdock
