#pragma once

#include <array>

namespace tagdock {

/// The normal distribution at one place.
struct Normal {
  double cumulative = 0.0;  ///< Phi(z)
  double density = 0.0;     ///< phi(z)
};

inline constexpr double normal_reach = 4.3;
inline constexpr int normal_steps = 4096;  ///< of the table over +-normal_reach

using NormalTable = std::array<Normal, normal_steps + 2>;
extern const NormalTable normal_table;

/// From a table, linearly between its entries: within 2e-7. Beyond +-`normal_reach` it is 0 or 1, off by 1e-5 at most.
inline Normal normal(double z) {
  constexpr double scale = normal_steps / (2.0 * normal_reach);
  if (z >= normal_reach) return {1.0, 0.0};
  if (!(z > -normal_reach)) return {0.0, 0.0};
  const double place = (z + normal_reach) * scale;
  const int index = static_cast<int>(place);
  const double part = place - index;
  const Normal& low = normal_table[static_cast<std::size_t>(index)];
  const Normal& high = normal_table[static_cast<std::size_t>(index) + 1];
  return {low.cumulative + part * (high.cumulative - low.cumulative),
          low.density + part * (high.density - low.density)};
}

/// The probability that both of two correlated standard normal values lie below p and q, with its derivatives.
struct Normal2 {
  double cumulative = 0.0;
  double by_p = 0.0, by_q = 0.0;
  double density = 0.0;  ///< also the derivative by the correlation (the heat equation)
};

/// Two standard normal values of one correlation.
/// Source: Plackett's identity; up to three Gauss-Legendre points over the arc sine of the correlation, which leaves
/// 1e-4 at a correlation of 0.87.
class BivariateNormal {
 public:
  BivariateNormal() = default;

  /// @param correlation  within +-0.999
  explicit BivariateNormal(double correlation);

  /// @param at_p, at_q  normal(p), normal(q)
  [[nodiscard]] Normal2 at(double p, const Normal& at_p, double q, const Normal& at_q) const;

  /// cumulative(p, q) = Phi(p) Phi(q) + sum of weight exp(scale (p^2 + q^2 - 2 p q sine)).
  struct Points {
    double correlation = 0.0;
    double per_rest = 1.0;  ///< 1 / sqrt(1 - correlation^2)
    int count = 0;
    std::array<double, 3> sine{};  ///< of the angles of the integral
    std::array<double, 3> scale{};
    std::array<double, 3> weight{};
  };
  [[nodiscard]] const Points& points() const { return points_; }

 private:
  Points points_;
};

}  // namespace tagdock
