#pragma once

namespace tagdock {

/// The normal distribution at one place.
struct Normal {
  double cumulative;  ///< Phi(z)
  double density;     ///< phi(z)
};

/// From a table, linearly between its entries: within 2e-7. Beyond +-`normal_reach` it is 0 or 1, off by 1e-5 at most.
Normal normal(double z);
inline constexpr double normal_reach = 4.3;

/// The probability that both of two correlated standard normal values lie below p and q, with its derivatives.
struct Normal2 {
  double cumulative;
  double by_p, by_q;
  double density;  ///< also the derivative by the correlation (the heat equation)
};

/// @param correlation  within +-0.999
/// Source: Plackett's identity; three Gauss-Legendre points over the arc sine of the correlation.
Normal2 normal2(double p, double q, double correlation);

}  // namespace tagdock
