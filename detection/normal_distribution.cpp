#include "detection/normal_distribution.h"

#include <cmath>
#include <numbers>

namespace tagdock {
namespace {

NormalTable make_table() {
  NormalTable table;
  for (std::size_t i = 0; i < table.size(); ++i) {
    const double z = static_cast<double>(i) * (2.0 * normal_reach / normal_steps) - normal_reach;
    table[i] = {0.5 * std::erfc(-z / std::numbers::sqrt2), std::exp(-0.5 * z * z) / std::sqrt(2.0 * std::numbers::pi)};
  }
  return table;
}

}  // namespace

const NormalTable normal_table = make_table();

BivariateNormal::BivariateNormal(double correlation) {
  points_.correlation = correlation;
  points_.per_rest = 1.0 / std::sqrt(1.0 - correlation * correlation);
  const double angle = std::asin(correlation);
  // Fewer points where the path is short: one leaves 1e-5 below 0.05, two leave 1e-5 below 0.4.
  const double size = std::abs(correlation);
  points_.count = size < 1e-6 ? 0 : size < 0.05 ? 1 : size < 0.4 ? 2 : 3;
  static constexpr std::array<std::array<double, 3>, 4> places = {
      {{}, {0.5}, {0.21132486540518712, 0.78867513459481288}, {0.11270166537925831, 0.5, 0.88729833462074169}}};
  static constexpr std::array<std::array<double, 3>, 4> weights = {
      {{}, {1.0}, {0.5, 0.5}, {5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0}}};
  for (int i = 0; i < points_.count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const auto n = static_cast<std::size_t>(points_.count);
    points_.sine[k] = std::sin(angle * places[n][k]);
    points_.scale[k] = -0.5 / (1.0 - points_.sine[k] * points_.sine[k]);
    points_.weight[k] = weights[n][k] * angle / (2.0 * std::numbers::pi);
  }
}

Normal2 BivariateNormal::at(double p, const Normal& at_p, double q, const Normal& at_q) const {
  Normal2 result;
  result.cumulative = at_p.cumulative * at_q.cumulative;
  if (points_.count == 0) {
    result.by_p = at_p.density * at_q.cumulative;
    result.by_q = at_q.density * at_p.cumulative;
    result.density = at_p.density * at_q.density;
    return result;
  }
  const Normal q_given_p = normal((q - points_.correlation * p) * points_.per_rest);
  result.by_p = at_p.density * q_given_p.cumulative;
  result.by_q = at_q.density * normal((p - points_.correlation * q) * points_.per_rest).cumulative;
  result.density = at_p.density * q_given_p.density * points_.per_rest;
  const double squares = p * p + q * q;
  const double product = 2.0 * p * q;
  for (int i = 0; i < points_.count; ++i) {
    const auto k = static_cast<std::size_t>(i);
    result.cumulative += points_.weight[k] * std::exp(points_.scale[k] * (squares - product * points_.sine[k]));
  }
  return result;
}

}  // namespace tagdock
