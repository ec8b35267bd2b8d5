#include <array>
#include <cmath>
#include <string>
#include <utility>

#include "detection/edge_refiner.h"
#include "detection/photometric_refiner.h"
#include "detection/tag_locator.h"

namespace tagdock {
namespace {

constexpr std::array<std::pair<CornerMethod, std::string_view>, 5> method_words{{{CornerMethod::apriltag, "apriltag"},
                                                                                 {CornerMethod::tanh, "tanh"},
                                                                                 {CornerMethod::filter, "filter"},
                                                                                 {CornerMethod::erf, "erf"},
                                                                                 {CornerMethod::best, "best"}}};

/// AprilTag's corners under benign conditions are good to 0.04..0.12 px, mostly by a shift that no image noise explains
/// (notes on detection, section 4).
constexpr double library_corner_sigma_px = 0.1;

/// Ink, tone curves, clipping and what stands before a side shift sides by 0.2 to 0.6 px (the same section).
constexpr double unmodelled_sigma_px = 0.2;

RefinedTag as_detected(const TagDetection& coarse) {
  RefinedTag tag;
  tag.id = coarse.id;
  tag.hamming = coarse.hamming;
  tag.margin = coarse.margin;
  tag.corners_px = coarse.corners_px;
  tag.covariance_px2.diagonal().setConstant(library_corner_sigma_px * library_corner_sigma_px);
  tag.terms = "apriltag";
  return tag;
}

double largest_sigma_px(const RefinedTag& tag) { return std::sqrt(tag.covariance_px2.diagonal().maxCoeff()); }

/// The whole tag; or its sides, where the whole does not fit the model (a point-sampled picture, too few pixels) or is,
/// by its own covariance, no finer than the library's corners and the sides are. The result's terms say which it was.
/// Where an edge was left, or the shape or the pattern is wrong, the sides are no more to be trusted than the whole.
Refinement refine_best(const cv::Mat1b& gray, const std::string& family, const TagDetection& coarse,
                       const std::optional<CameraModel>& camera) {
  Refinement whole = refine_photometric(gray, family, coarse, PhotometricConfig{}, camera);
  const RefinedTag* fitted = std::get_if<RefinedTag>(&whole);
  if (fitted != nullptr && fine_enough(*fitted)) return whole;
  if (const Unrefined* reason = std::get_if<Unrefined>(&whole))
    if (*reason == Unrefined::left_the_edge || *reason == Unrefined::not_a_quadrilateral ||
        *reason == Unrefined::other_pattern)
      return whole;
  EdgeRefinerConfig edges;
  edges.profile = EdgeProfile::erf;
  Refinement sides = refine_edges(gray, coarse, edges, camera);
  RefinedTag* by_sides = std::get_if<RefinedTag>(&sides);
  // What the whole could not be fitted to may be light, ink or a tone curve that shift all sides alike, by more than
  // their own residuals tell.
  if (by_sides != nullptr) by_sides->covariance_px2.diagonal().array() += unmodelled_sigma_px * unmodelled_sigma_px;
  if (fitted != nullptr && (by_sides == nullptr || largest_sigma_px(*by_sides) > largest_sigma_px(*fitted)))
    return whole;
  return sides;
}

}  // namespace

bool fine_enough(const RefinedTag& whole) { return largest_sigma_px(whole) <= library_corner_sigma_px; }

std::optional<CornerMethod> corner_method(const std::string& word) {
  for (const auto& [method, name] : method_words)
    if (name == word) return method;
  return std::nullopt;
}

std::string_view word(CornerMethod method) {
  for (const auto& [known, name] : method_words)
    if (known == method) return name;
  return "unknown";
}

Refinement refine(const cv::Mat1b& gray, const std::string& family, const TagDetection& coarse, CornerMethod method,
                  const std::optional<CameraModel>& camera) {
  EdgeRefinerConfig edges;
  switch (method) {
    case CornerMethod::apriltag:
      return as_detected(coarse);
    case CornerMethod::tanh:
      break;
    case CornerMethod::filter:
      edges.pre_blur = true;
      break;
    case CornerMethod::erf:
      edges.profile = EdgeProfile::erf;
      break;
    case CornerMethod::best:
      return refine_best(gray, family, coarse, camera);
  }
  return refine_edges(gray, coarse, edges, camera);
}

}  // namespace tagdock
