#include "detection/normal_distribution.h"

#include <array>
#include <cmath>
#include <numbers>

namespace tagdock {
namespace {

constexpr int table_steps = 4096;
constexpr double table_scale = table_steps / (2.0 * normal_reach);

using Table = std::array<Normal, table_steps + 2>;

Table make_table() {
  Table table;
  for (int i = 0; i < static_cast<int>(table.size()); ++i) {
    const double z = i / table_scale - normal_reach;
    table[static_cast<std::size_t>(i)] = {0.5 * std::erfc(-z / std::numbers::sqrt2),
                                          std::exp(-0.5 * z * z) / std::sqrt(2.0 * std::numbers::pi)};
  }
  return table;
}

const Table table = make_table();

}  // namespace

Normal normal(double z) {
  if (z >= normal_reach) return {1.0, 0.0};
  if (!(z > -normal_reach)) return {0.0, 0.0};
  const double place = (z + normal_reach) * table_scale;
  const int index = static_cast<int>(place);
  const double part = place - index;
  const Normal& low = table[static_cast<std::size_t>(index)];
  const Normal& high = table[static_cast<std::size_t>(index) + 1];
  return {low.cumulative + part * (high.cumulative - low.cumulative),
          low.density + part * (high.density - low.density)};
}

Normal2 normal2(double p, double q, double correlation) {
  const double rest = std::sqrt(1.0 - correlation * correlation);
  const Normal at_p = normal(p);
  const Normal at_q = normal(q);
  Normal2 result;
  result.by_p = at_p.density * normal((q - correlation * p) / rest).cumulative;
  result.by_q = at_q.density * normal((p - correlation * q) / rest).cumulative;
  const double squares = p * p + q * q;
  const double product = 2.0 * p * q;
  result.density = std::exp(-0.5 * (squares - product * correlation) / (rest * rest)) / (2.0 * std::numbers::pi * rest);
  double integral = 0.0;
  if (std::abs(correlation) > 1e-4) {
    static const std::array<double, 3> place = {0.5 - std::sqrt(0.15), 0.5, 0.5 + std::sqrt(0.15)};
    static constexpr std::array<double, 3> weight = {5.0 / 18.0, 8.0 / 18.0, 5.0 / 18.0};
    const double angle = std::asin(correlation);
    for (std::size_t i = 0; i < 3; ++i) {
      const double sine = std::sin(angle * place[i]);
      integral += weight[i] * std::exp(-0.5 * (squares - product * sine) / (1.0 - sine * sine));
    }
    integral *= angle / (2.0 * std::numbers::pi);
  }
  result.cumulative = at_p.cumulative * at_q.cumulative + integral;
  return result;
}

}  // namespace tagdock
