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

BivariateNormal::BivariateNormal(double correlation)
    : correlation_(correlation), per_rest_(1.0 / std::sqrt(1.0 - correlation * correlation)) {
  const double angle = std::asin(correlation);
  // Fewer points where the path is short: one leaves 1e-5 below 0.05, two leave 1e-5 below 0.4.
  const double size = std::abs(correlation);
  points_ = size < 1e-6 ? 0 : size < 0.05 ? 1 : size < 0.4 ? 2 : 3;
  static constexpr std::array<std::array<double, 3>, 4> places = {
      {{}, {0.5}, {0.21132486540518712, 0.78867513459481288}, {0.11270166537925831, 0.5, 0.88729833462074169}}};
  static constexpr std::array<std::array<double, 3>, 4> weights = {
      {{}, {1.0}, {0.5, 0.5}, {5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0}}};
  for (int i = 0; i < points_; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const auto n = static_cast<std::size_t>(points_);
    sine_[k] = std::sin(angle * places[n][k]);
    scale_[k] = -0.5 / (1.0 - sine_[k] * sine_[k]);
    weight_[k] = weights[n][k] * angle / (2.0 * std::numbers::pi);
  }
}

Normal2 BivariateNormal::at(double p, const Normal& at_p, double q, const Normal& at_q) const {
  Normal2 result;
  result.cumulative = at_p.cumulative * at_q.cumulative;
  if (points_ == 0) {
    result.by_p = at_p.density * at_q.cumulative;
    result.by_q = at_q.density * at_p.cumulative;
    result.density = at_p.density * at_q.density;
    return result;
  }
  const Normal q_given_p = normal((q - correlation_ * p) * per_rest_);
  result.by_p = at_p.density * q_given_p.cumulative;
  result.by_q = at_q.density * normal((p - correlation_ * q) * per_rest_).cumulative;
  result.density = at_p.density * q_given_p.density * per_rest_;
  const double squares = p * p + q * q;
  const double product = 2.0 * p * q;
  for (int i = 0; i < points_; ++i) {
    const auto k = static_cast<std::size_t>(i);
    result.cumulative += weight_[k] * std::exp(scale_[k] * (squares - product * sine_[k]));
  }
  return result;
}

}  // namespace tagdock
