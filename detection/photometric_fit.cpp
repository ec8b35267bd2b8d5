#include "detection/photometric_fit.h"

#include <algorithm>
#include <cmath>

#include <Eigen/Cholesky>

namespace tagdock {
namespace {

using A = TagAppearance;

/// Least blur variance on an axis [px^2] (the pixel's own box has 1/12) and most.
constexpr double least_blur = 0.05;
constexpr double most_blur = 36.0;

/// Slopes of light across a tag are not known to a factor of ten, but are never thousands of grey levels: this holds
/// them where clipping leaves them undetermined, and is far weaker than any unclipped tag's pixels.
constexpr double slope_sigma = 300.0;

/// Holds the blur where a pixel's box leaves it: without any optics it is 1/12, and edges that fall between pixels tell
/// no blur at all. True if it had to be held.
bool hold_blur(A::Vector& p) {
  constexpr double held = 1.1 * least_blur;
  const double most_xy = p[A::blur_xx] > held && p[A::blur_yy] > held
                             ? std::sqrt((p[A::blur_xx] - least_blur) * (p[A::blur_yy] - least_blur))
                             : 0.0;
  const A::Vector before = p;
  p[A::blur_xx] = std::max(p[A::blur_xx], held);
  p[A::blur_yy] = std::max(p[A::blur_yy], held);
  p[A::blur_xy] = std::clamp(p[A::blur_xy], -most_xy, most_xy);
  return p != before;
}

Eigen::VectorXd reduced(const A::Vector& full, const FreeParameters& free) {
  Eigen::VectorXd result(static_cast<Eigen::Index>(free.size()));
  for (Eigen::Index i = 0; i < result.size(); ++i) result[i] = full[free[static_cast<std::size_t>(i)]];
  return result;
}

}  // namespace

bool plausible(const A::Vector& p) {
  const double xx = p[A::blur_xx];
  const double yy = p[A::blur_yy];
  return p.allFinite() && xx > least_blur && yy > least_blur && xx < most_blur && yy < most_blur &&
         xx * yy - p[A::blur_xy] * p[A::blur_xy] > least_blur * least_blur && std::abs(p[A::bleed]) < 0.35 &&
         p[A::tone] > 0.3 && p[A::tone] < 1.6;
}

Equations held_equations(const TagImageModel& model, std::vector<TagSample>& samples, const PixelNoise* noise) {
  Equations sum = model.equations(samples, noise);
  for (const int i : {A::white + 1, A::white + 2, A::drop + 1, A::drop + 2}) {
    const double value = model.appearance().value[i];
    sum.cost += value * value / (slope_sigma * slope_sigma);
    sum.gradient[i] += value / (slope_sigma * slope_sigma);
    sum.hessian(i, i) += 1.0 / (slope_sigma * slope_sigma);
  }
  return sum;
}

FreeParameters free_parameters(bool bleed, bool tone) {
  FreeParameters free;
  for (int i = 0; i < A::bleed; ++i) free.push_back(i);
  if (bleed) free.push_back(A::bleed);
  if (tone) free.push_back(A::tone);
  return free;
}

Eigen::MatrixXd reduced(const A::Matrix& full, const FreeParameters& free) {
  const auto n = static_cast<Eigen::Index>(free.size());
  Eigen::MatrixXd result(n, n);
  for (Eigen::Index i = 0; i < n; ++i)
    for (Eigen::Index j = 0; j < n; ++j)
      result(i, j) = full(free[static_cast<std::size_t>(i)], free[static_cast<std::size_t>(j)]);
  return result;
}

PhotometricFit fit_appearance(TagImageModel& model, std::vector<TagSample>& samples, const FreeParameters& free,
                              int max_iterations, double enough, const PixelNoise* noise) {
  PhotometricFit fit;
  fit.at = held_equations(model, samples, noise);
  if (!std::isfinite(fit.at.cost)) return fit;
  double lambda = 1e-4;
  int failures = 0;
  bool stale = false;  // the samples hold what a rejected step gave them
  for (int iteration = 0; iteration < max_iterations && failures < 12; ++iteration) {
    Eigen::MatrixXd h = reduced(fit.at.hessian, free);
    const Eigen::VectorXd b = reduced(fit.at.gradient, free);
    h.diagonal() *= 1.0 + lambda;
    const Eigen::LLT<Eigen::MatrixXd> factor(h);
    bool better = false;
    double gain = 0.0;
    double predicted = enough;
    if (factor.info() == Eigen::Success) {
      const Eigen::VectorXd step = factor.solve(b);
      predicted = b.dot(step);
      const TagAppearance last = model.appearance();
      TagAppearance next = last;
      for (Eigen::Index i = 0; i < step.size(); ++i) next.value[free[static_cast<std::size_t>(i)]] -= step[i];
      const bool held = hold_blur(next.value);
      if (predicted < enough) {
        // The last step is so short that what it leaves, by its square, needs no look at the pixels.
        if (plausible(next.value)) model.set(next);
        fit.converged = true;
        break;
      }
      if (plausible(next.value)) {
        model.set(next);
        const Equations at = held_equations(model, samples, nullptr);
        stale = !(at.cost < fit.at.cost);
        if (stale) {
          model.set(last);
        } else {
          gain = fit.at.cost - at.cost;
          fit.at = at;
          better = true;
        }
        // At its bound the blur still pulls, though nothing can be gained.
        if (held && !(gain > enough)) {
          fit.converged = true;
          break;
        }
      }
    }
    if (better && gain < 1e-7 * fit.at.cost) {
      fit.converged = true;
      break;
    }
    if (!better) ++failures;
    lambda *= better ? 0.2 : 8.0;
  }
  if (stale) fit.at = held_equations(model, samples, nullptr);
  return fit;
}

double score(const Equations& at, const FreeParameters& free, int parameter, double inflation) {
  Eigen::VectorXd column(static_cast<Eigen::Index>(free.size()));
  for (Eigen::Index i = 0; i < column.size(); ++i) column[i] = at.hessian(free[static_cast<std::size_t>(i)], parameter);
  const Eigen::VectorXd solved = reduced(at.hessian, free).ldlt().solve(column);
  const double all = at.hessian(parameter, parameter);
  const double information = all - column.dot(solved);
  const double slope = at.gradient[parameter] - reduced(at.gradient, free).dot(solved);
  // Nothing is learnt of a parameter whose effect the others imitate.
  return information > 1e-9 * all ? slope * slope / information / inflation : 0.0;
}

double deviation(const Equations& at, const FreeParameters& free, int parameter) {
  Eigen::VectorXd unit(static_cast<Eigen::Index>(free.size()));
  for (Eigen::Index i = 0; i < unit.size(); ++i) unit[i] = free[static_cast<std::size_t>(i)] == parameter ? 1.0 : 0.0;
  return std::sqrt(std::max(unit.dot(reduced(at.hessian, free).ldlt().solve(unit)), 0.0));
}

}  // namespace tagdock
