#pragma once

#include <vector>

#include "detection/photometric_model.h"

namespace tagdock {

/// The parameters that are free, by index.
using FreeParameters = std::vector<int>;

/// Geometry, light and blur always; ink spread and tone curve if asked for.
FreeParameters free_parameters(bool bleed, bool tone);

/// Are these values ones that an image of a tag can have?
bool plausible(const TagAppearance::Vector& value);

/// The model's equations, and what weakly holds the slopes of light.
Equations held_equations(const TagImageModel& model, std::vector<TagSample>& samples,
                         const PixelNoise* noise = nullptr);

struct PhotometricFit {
  bool converged = false;
  Equations at;  ///< at the minimum, over all parameters
};

/// Levenberg-Marquardt over the free parameters. The model is left at the best appearance, the samples with what it
/// gives them there, or one short step before.
/// @param enough  a step that should lower the cost by less than this is the last one; it is taken, and the sums and
/// the
///                samples stay as they were before it
/// @param noise   if given, sets the samples' variances at the start
PhotometricFit fit_appearance(TagImageModel& model, std::vector<TagSample>& samples, const FreeParameters& free,
                              int max_iterations, double enough, const PixelNoise* noise = nullptr);

/// Statistic of the score test of one parameter that is not free: about 1 when it has no part in the image, the square
/// of its value in sigmas when it has.
/// @param inflation  of the residuals' variance against what was assumed
double score(const Equations& at, const FreeParameters& free, int parameter, double inflation);

/// Standard deviation of a free parameter by the normal equations.
double deviation(const Equations& at, const FreeParameters& free, int parameter);

/// Rows and columns of the free parameters.
Eigen::MatrixXd reduced(const TagAppearance::Matrix& full, const FreeParameters& free);

}  // namespace tagdock
