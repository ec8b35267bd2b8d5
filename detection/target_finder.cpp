#include "detection/target_finder.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <stdexcept>

#include <Eigen/Cholesky>
#include <Eigen/Eigenvalues>
#include <Eigen/LU>
#include <opencv2/calib3d.hpp>

#include "detection/mark_decoder.h"
#include "detection/saddle_refiner.h"
#include "detection/tag_detector.h"
#include "detection/tag_locator.h"

namespace tagdock {
namespace {

using Eigen::Matrix2d;
using Eigen::Matrix3d;
using Eigen::Vector2d;

/// A place of the drawing and where the picture shows it.
struct Pair {
  Vector2d drawn;
  Vector2d pixel;
};

Vector2d mapped(const Matrix3d& H, const Vector2d& drawn) {
  return (H * Eigen::Vector3d(drawn.homogeneous())).hnormalized();
}

/// The picture of the drawing: one homography, and near each place what its neighbours leave.
class Warp {
 public:
  Warp(const Matrix3d& H, const std::vector<Pair>& pairs, double near) : H_(H), near_(near), pairs_(pairs) {
    for (const Pair& pair : pairs) left_.push_back(pair.pixel - mapped(H, pair.drawn));
  }

  [[nodiscard]] Vector2d operator()(const Vector2d& drawn) const {
    // What the homography leaves, as a plane fitted to the neighbours.
    Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
    Eigen::Matrix<double, 3, 2> right = Eigen::Matrix<double, 3, 2>::Zero();
    for (std::size_t i = 0; i < pairs_.size(); ++i) {
      const Vector2d d = (pairs_[i].drawn - drawn) / near_;
      const double weight = std::exp(-0.5 * d.squaredNorm());
      if (weight < 1e-4) continue;
      const Eigen::Vector3d row(1.0, d.x(), d.y());
      information += weight * row * row.transpose();
      right += weight * row * left_[i].transpose();
    }
    information.diagonal() += Eigen::Vector3d(0.02, 0.3, 0.3);  // few neighbours: towards no correction
    const Eigen::Matrix<double, 3, 2> plane = information.ldlt().solve(right);
    return mapped(H_, drawn) + plane.row(0).transpose();
  }

  [[nodiscard]] Matrix2d derivative(const Vector2d& drawn) const {
    const double step = 0.05 * near_;
    Matrix2d J;
    J.col(0) = (mapped(H_, drawn + Vector2d(step, 0.0)) - mapped(H_, drawn - Vector2d(step, 0.0))) / (2.0 * step);
    J.col(1) = (mapped(H_, drawn + Vector2d(0.0, step)) - mapped(H_, drawn - Vector2d(0.0, step))) / (2.0 * step);
    return J;
  }

 private:
  Matrix3d H_;
  double near_;
  std::vector<Pair> pairs_;
  std::vector<Vector2d> left_;
};

std::optional<Matrix3d> homography(const std::vector<Pair>& pairs, double tolerance_px, std::vector<bool>& inliers) {
  if (pairs.size() < 4) return std::nullopt;
  std::vector<cv::Point2d> from;
  std::vector<cv::Point2d> to;
  for (const Pair& pair : pairs) {
    from.emplace_back(pair.drawn.x(), pair.drawn.y());
    to.emplace_back(pair.pixel.x(), pair.pixel.y());
  }
  cv::Mat mask;
  cv::setRNGSeed(1);  // the same picture gives the same corners
  const cv::Mat H = cv::findHomography(from, to, cv::RANSAC, tolerance_px, mask, 500, 0.995);
  if (H.empty()) return std::nullopt;
  inliers.assign(pairs.size(), false);
  for (std::size_t i = 0; i < pairs.size(); ++i) inliers[i] = mask.at<unsigned char>(static_cast<int>(i)) != 0;
  Matrix3d result;
  for (int row = 0; row < 3; ++row)
    for (int column = 0; column < 3; ++column) result(row, column) = H.at<double>(row, column);
  return result;
}

/// Marks of a picture laid onto one layout.
struct Fit {
  Matrix3d H = Matrix3d::Identity();
  std::vector<Pair> pairs;  ///< of the marks that agree
  int agreeing = 0;         ///< marks
  int others = 0;
};

/// @param turn  the decoder's first corner is this many corners after the drawing's
Fit fit_layout(const std::vector<DecodedMark>& marks, const TargetLayout& layout, std::size_t turn,
               double tolerance_px) {
  std::vector<Pair> pairs;
  std::size_t known = 0;
  for (const DecodedMark& mark : marks) {
    const auto drawn = layout.marks.find(mark.id);
    if (drawn == layout.marks.end()) continue;
    ++known;
    for (std::size_t k = 0; k < 4; ++k) pairs.push_back({drawn->second[(k + turn) % 4], mark.corners_px[k]});
  }
  Fit fit;
  fit.others = static_cast<int>(marks.size());
  std::vector<bool> inliers;
  const std::optional<Matrix3d> H = homography(pairs, tolerance_px, inliers);
  if (!H || known == 0) return fit;
  // A picture shows a board from its front: not mirrored.
  const Vector2d centre = pairs.front().drawn;
  const double step = 1e-3;
  const Vector2d right = mapped(*H, centre + Vector2d(step, 0)) - mapped(*H, centre);
  const Vector2d down = mapped(*H, centre + Vector2d(0, step)) - mapped(*H, centre);
  if (right.x() * down.y() - right.y() * down.x() <= 0.0) return fit;
  fit.H = *H;
  for (std::size_t mark = 0; mark < known; ++mark) {
    if (!(inliers[4 * mark] && inliers[4 * mark + 1] && inliers[4 * mark + 2] && inliers[4 * mark + 3])) continue;
    ++fit.agreeing;
    fit.pairs.insert(fit.pairs.end(), pairs.begin() + static_cast<std::ptrdiff_t>(4 * mark),
                     pairs.begin() + static_cast<std::ptrdiff_t>(4 * mark + 4));
  }
  fit.others -= fit.agreeing;
  return fit;
}

/// How many of the layout's marks lie in the picture, far enough from its rim to be decoded.
int marks_inside(const cv::Mat1b& gray, const TargetLayout& layout, const Matrix3d& H) {
  constexpr double rim_px = 10.0;
  int count = 0;
  for (const auto& [id, corners] : layout.marks) {
    bool inside = true;
    for (const Vector2d& corner : corners) {
      const Vector2d pixel = mapped(H, corner);
      inside = inside && pixel.x() > rim_px && pixel.y() > rim_px && pixel.x() < gray.cols - 1 - rim_px &&
               pixel.y() < gray.rows - 1 - rim_px;
    }
    count += inside ? 1 : 0;
  }
  return count;
}

double median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2), values.end());
  return values[values.size() / 2];
}

/// Blur as an ellipse from the blur across edges of many directions: variance along n is n' B n.
void judge_blur(const std::vector<Saddle>& saddles, TargetView& view) {
  Matrix3d information = Matrix3d::Identity() * 1e-9;
  Eigen::Vector3d right = Eigen::Vector3d::Zero();
  for (const Saddle& saddle : saddles)
    for (int edge = 0; edge < 2; ++edge) {
      const Vector2d& n = saddle.normal[edge];
      const Eigen::Vector3d row(n.x() * n.x(), 2.0 * n.x() * n.y(), n.y() * n.y());
      const double variance = std::min(64.0, saddle.blur_px[edge] * saddle.blur_px[edge]);
      information += row * row.transpose();
      right += row * variance;
    }
  // Where all edges run along the picture's axes nothing tells of the oblique directions: then none is preferred.
  information(1, 1) += 0.2 * static_cast<double>(saddles.size());
  const Eigen::Vector3d b = information.ldlt().solve(right);
  Matrix2d B;
  B << b[0], b[1], b[1], b[2];
  const Vector2d axes = Eigen::SelfAdjointEigenSolver<Matrix2d>(B).eigenvalues().cwiseMax(0.0).cwiseSqrt();
  view.blur_px = axes[1];
  view.sharpest_px = axes[0];
}

}  // namespace

struct TargetFinder::Parts {
  CalibrationTarget target;
  std::vector<TargetLayout> layouts;
  std::unique_ptr<MarkDecoder> decoder;   ///< where squares touch
  std::unique_ptr<TagDetector> detector;  ///< where tags stand free: on a picture of half the size ...
  std::unique_ptr<TagDetector> thorough;  ///< ... or, where that misses some of the board's, on the whole one
};

TargetFinder::TargetFinder(const CalibrationTarget& target) : parts_(std::make_unique<Parts>()) {
  parts_->target = target;
  parts_->layouts = layouts_of(target);
  switch (target.type) {
    case CalibrationTarget::Type::charuco:
      parts_->decoder = std::make_unique<MarkDecoder>(target.dictionary);
      break;
    case CalibrationTarget::Type::aprilgrid:
      parts_->decoder = std::make_unique<MarkDecoder>(target.family);
      break;
    case CalibrationTarget::Type::taggrid:
    case CalibrationTarget::Type::tag: {
      TagDetectorConfig config;
      config.family = target.family;
      parts_->detector = std::make_unique<TagDetector>(config);
      config.decimate = 1;
      parts_->thorough = std::make_unique<TagDetector>(config);
      break;
    }
  }
}

TargetFinder::~TargetFinder() = default;
TargetFinder::TargetFinder(TargetFinder&&) noexcept = default;
TargetFinder& TargetFinder::operator=(TargetFinder&&) noexcept = default;

namespace {

/// @param passes  each predicts from the corners of the one before
TargetView find_saddles(const cv::Mat1b& gray, const TargetLayout& layout, const Fit& fit, int passes,
                        const std::optional<CameraModel>& camera) {
  TargetView view;
  const double near = 2.0 * layout.reach / 0.45;
  std::vector<Pair> known = fit.pairs;
  std::map<std::size_t, Saddle> found;
  for (int pass = 0; pass < passes; ++pass) {
    const Warp warp(fit.H, known, near);
    view.corners_expected = 0;
    for (std::size_t i = 0; i < layout.corners.size(); ++i) {
      const TargetLayout::Corner& corner = layout.corners[i];
      SaddleGuess guess;
      guess.pixel = warp(corner.drawn);
      if (!(guess.pixel.x() > 4 && guess.pixel.y() > 4 && guess.pixel.x() < gray.cols - 5 &&
            guess.pixel.y() < gray.rows - 5))
        continue;
      ++view.corners_expected;
      if (found.contains(i)) continue;
      guess.pixel_by_drawn = warp.derivative(corner.drawn);
      guess.reach = layout.reach;
      guess.clearance = layout.clearance;
      const std::optional<Saddle> saddle = refine_saddle(gray, guess, camera);
      if (!saddle) continue;
      // Near marks the prediction is good to some pixels; a corner of the next square is not this one.
      const double cell_px = std::sqrt(std::abs(guess.pixel_by_drawn.determinant())) * layout.reach;
      if ((saddle->pixel - guess.pixel).norm() > std::max(1.5, 0.35 * cell_px)) continue;
      found[i] = *saddle;
    }
    // The sign of the contrast alternates as the squares do; weak ones are shadows and letters.
    double balance = 0.0;
    std::vector<double> amplitudes;
    for (const auto& [i, saddle] : found) {
      balance += layout.corners[i].parity == 0 ? saddle.amplitude : -saddle.amplitude;
      amplitudes.push_back(std::abs(saddle.amplitude));
    }
    const double usual = median(amplitudes);
    std::erase_if(found, [&](const auto& item) {
      const double signed_amplitude = (layout.corners[item.first].parity == 0 ? 1.0 : -1.0) * item.second.amplitude;
      return signed_amplitude * balance <= 0.0 || std::abs(signed_amplitude) < 0.3 * usual;
    });
    known.clear();
    for (const auto& [i, saddle] : found) known.push_back({layout.corners[i].drawn, saddle.pixel});
    if (known.size() < 6) known.insert(known.end(), fit.pairs.begin(), fit.pairs.end());
  }
  // A corner that does not lie where its neighbours say is none of the board's.
  std::vector<double> residuals;
  std::vector<Saddle> saddles;
  std::vector<double> clipped;
  std::vector<double> contrast;
  for (const auto& [i, saddle] : found) {
    const TargetLayout::Corner& corner = layout.corners[i];
    const double sigma = std::sqrt(0.5 * saddle.covariance_px2.trace());
    if (sigma > 0.5) continue;
    view.corners.push_back({corner.id, corner.point, saddle.pixel, sigma});
    saddles.push_back(saddle);
    residuals.push_back(saddle.residual_rms);
    clipped.push_back(saddle.clipped);
    contrast.push_back(2.0 * std::abs(saddle.amplitude));
  }
  for (const double share : clipped) view.clipped += share / static_cast<double>(clipped.size());
  view.contrast = median(contrast);
  view.residual_rms = median(residuals);
  judge_blur(saddles, view);
  return view;
}

/// Where a quadrilateral's corners go when its sides move outward by a pixel each.
Corners grown_by_a_pixel(const Corners& corners) {
  Corners moved;
  for (std::size_t k = 0; k < 4; ++k) {
    // Clockwise as seen, y down: outward is to the left of the way along a side.
    const Vector2d before = (corners[k] - corners[(k + 3) % 4]).normalized();
    const Vector2d after = (corners[(k + 1) % 4] - corners[k]).normalized();
    Matrix2d normals;
    normals << before.y(), -before.x(), after.y(), -after.x();
    moved[k] = normals.fullPivLu().solve(Vector2d::Ones());
  }
  return moved;
}

TargetView find_tags(const cv::Mat1b& gray, const std::string& family, const std::vector<TagDetection>& tags,
                     const TargetLayout& layout, CornerMethod method, const std::optional<CameraModel>& camera) {
  TargetView view;
  view.tags = tags;
  std::map<int, const TargetLayout::Corner*> by_id;
  for (const TargetLayout::Corner& corner : layout.corners) by_id[corner.id] = &corner;
  std::vector<double> blur;
  std::vector<double> residuals;
  std::vector<double> contrast;
  double clipped = 0.0;
  double counted = 0.0;
  for (const TagDetection& tag : tags) {
    if (!layout.marks.contains(tag.id)) continue;
    const Refinement refinement = refine(gray, family, tag, method, camera);
    const RefinedTag* refined = std::get_if<RefinedTag>(&refinement);
    if (refined == nullptr) continue;
    blur.push_back(refined->blur_px);
    residuals.push_back(refined->residual_rms);
    contrast.push_back(tag.margin);
    Eigen::AlignedBox2d box;
    for (const Vector2d& corner : refined->corners_px) box.extend(corner);
    const cv::Rect part = cv::Rect(static_cast<int>(box.min().x()), static_cast<int>(box.min().y()),
                                   static_cast<int>(box.sizes().x()) + 1, static_cast<int>(box.sizes().y()) + 1) &
                          cv::Rect(0, 0, gray.cols, gray.rows);
    for (int y = part.y; y < part.y + part.height; ++y)
      for (int x = part.x; x < part.x + part.width; ++x) {
        clipped += gray(y, x) >= 254 ? 1.0 : 0.0;
        counted += 1.0;
      }
    const Corners outward = grown_by_a_pixel(refined->corners_px);
    for (int k = 0; k < 4; ++k) {
      const auto corner = by_id.find(4 * tag.id + k);
      if (corner == by_id.end()) continue;
      constexpr std::size_t from_below[] = {3, 2, 1, 0};  // bottom left, bottom right, top right, top left
      const auto at = static_cast<Eigen::Index>(2 * from_below[k]);
      const double sigma = std::sqrt(0.5 * refined->covariance_px2.block<2, 2>(at, at).trace());
      view.corners.push_back(
          {corner->first, corner->second->point, refined->corners_px[from_below[k]], sigma, outward[from_below[k]]});
    }
  }
  view.corners_expected = static_cast<int>(view.corners.size());
  view.clipped = counted > 0.0 ? clipped / counted : 0.0;
  view.blur_px = view.sharpest_px = median(blur);
  view.residual_rms = median(residuals);
  view.contrast = median(contrast);
  return view;
}

}  // namespace

TargetView TargetFinder::find(const cv::Mat1b& gray) const { return find(gray, false); }

TargetView TargetFinder::find_coarsely(const cv::Mat1b& gray) const { return find(gray, true); }

TargetView TargetFinder::find(const cv::Mat1b& gray, bool coarsely) const {
  const Parts& parts = *parts_;
  // Lenses bend boards by some hundredths of the picture against any homography.
  const double tolerance_px = std::max(4.0, 0.012 * std::max(gray.cols, gray.rows));
  const auto best_fit = [&](const std::vector<DecodedMark>& marks, std::size_t& layout) {
    Fit best;
    for (std::size_t i = 0; i < parts.layouts.size(); ++i)
      for (std::size_t turn = 0; turn < (parts.decoder ? 4U : 1U); ++turn) {
        Fit fit = fit_layout(marks, parts.layouts[i], turn, tolerance_px);
        if (fit.agreeing > best.agreeing) {
          best = std::move(fit);
          layout = i;
        }
      }
    return best;
  };
  std::vector<DecodedMark> marks;
  std::vector<TagDetection> tags;
  Fit best;
  std::size_t layout = 0;
  if (parts.decoder) {
    marks = parts.decoder->decode(gray);
    best = best_fit(marks, layout);
  } else {
    for (const TagDetector* detector : {parts.detector.get(), parts.thorough.get()}) {
      tags = detector->detect(gray);
      marks.clear();
      for (const TagDetection& tag : tags) marks.push_back({tag.id, tag.corners_px});
      best = best_fit(marks, layout);
      if (best.agreeing > 0 && best.agreeing >= marks_inside(gray, parts.layouts[layout], best.H)) break;
    }
  }
  TargetView view;
  const int least_marks = parts.target.type == CalibrationTarget::Type::tag ? 1 : 2;
  constexpr int passes = 3;  // the third adds what is left
  if (best.agreeing >= least_marks)
    view = parts.decoder ? find_saddles(gray, parts.layouts[layout], best, passes, std::nullopt)
                         : find_tags(gray, parts.target.family, tags, parts.layouts[layout],
                                     coarsely ? CornerMethod::apriltag : CornerMethod::best, std::nullopt);
  view.layout = layout;
  view.marks_found = best.agreeing;
  view.marks_elsewhere = static_cast<int>(marks.size()) - best.agreeing;
  return view;
}

TargetView TargetFinder::refine(const cv::Mat1b& gray, const TargetView& seen, const CameraModel& camera) const {
  const Parts& parts = *parts_;
  const TargetLayout& layout = parts.layouts[seen.layout];
  TargetView view = seen;
  if (parts.detector) {
    if (seen.tags.empty()) return seen;
    view = find_tags(gray, parts.target.family, seen.tags, layout, CornerMethod::best, camera);
  } else {
    std::map<int, Vector2d> drawn;
    for (const TargetLayout::Corner& corner : layout.corners) drawn[corner.id] = corner.drawn;
    Fit fit;
    for (const SeenPoint& corner : seen.corners) fit.pairs.push_back({drawn.at(corner.id), corner.pixel});
    std::vector<bool> inliers;
    const double all = 1e6;  // px: what was found is the board's
    const std::optional<Matrix3d> H = homography(fit.pairs, all, inliers);
    if (!H) return seen;
    fit.H = *H;
    view = find_saddles(gray, layout, fit, 1, camera);
  }
  view.layout = seen.layout;
  view.marks_found = seen.marks_found;
  view.marks_elsewhere = seen.marks_elsewhere;
  return view;
}

}  // namespace tagdock
