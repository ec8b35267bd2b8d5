// The sums over pixels of the full-tag fit, eight pixels of one kind at a time: its whole time is spent here.
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

#include "detection/lanes.h"
#include "detection/photometric_model.h"

namespace tagdock {
namespace {

using A = TagAppearance;

/// A second copy for machines whose vectors hold eight numbers is chosen when the program starts. It gives the same
/// bits: nothing is contracted or summed in another order.
#ifdef TAGDOCK_TWO_WIDTHS
#define TAGDOCK_WIDE __attribute__((target_clones("default", "avx2")))
#else
#define TAGDOCK_WIDE
#endif

constexpr std::size_t light_count = 7;
constexpr std::array<Eigen::Index, light_count> light_parameters = {8, 9, 10, 11, 12, 13, A::tone};

/// Sums in single precision are moved to double ones after so many blocks: 1e-6 of them at worst is lost until then.
constexpr int blocks_in_single = 64;

/// A border through the blur and the pixel's box, and its derivative by the distance in units of the blur.
struct StepLanes {
  Lanes value, slope;
};
TAGDOCK_LANES StepLanes boxed(const NormalLanes& gauss, const Lanes& z, float fourth) {
  const Lanes z2 = z * z;
  return {gauss.cumulative - fourth * z * (z2 - 3.0F) * gauss.density,
          gauss.density * (1.0F + fourth * (z2 * (z2 - 6.0F) + 3.0F))};
}

/// Lower triangle of a symmetric matrix and a vector, eight partial sums each.
template <std::size_t count>
struct TriangleSum {
  std::array<Lanes, count*(count + 1) / 2> square{};
  std::array<Lanes, count> gradient{};

  TAGDOCK_LANES void add(const std::array<Lanes, count>& by, const Lanes& slope, const Lanes& curvature) {
    std::size_t k = 0;
    for (std::size_t i = 0; i < count; ++i) {
      const Lanes scaled = curvature * by[i];
      for (std::size_t j = 0; j <= i; ++j) square[k++] += scaled * by[j];
      gradient[i] += slope * by[i];
    }
  }
};

/// The samples of one block; lanes beyond `count` repeat the first one without weight.
struct Block {
  std::array<TagSample*, lane_count> sample;
  int count = 0;
  Lanes x, y, grey, weight, variance, beyond;

  TAGDOCK_LANES void load(TagSample* first, std::size_t left) {
    count = static_cast<int>(std::min<std::size_t>(lane_count, left));
    for (int lane = 0; lane < lane_count; ++lane) {
      const int used = lane < count ? lane : 0;
      TagSample* const one = first + used;
      sample[static_cast<std::size_t>(lane)] = one;
      x[lane] = one->x;
      y[lane] = one->y;
      grey[lane] = one->grey;
      weight[lane] = lane < count ? one->weight : 0.0F;
      variance[lane] = one->variance;
      beyond[lane] = one->beyond_px;
    }
  }
};

/// What a block's misfit says, and how its grey values follow the light.
struct Lit {
  Lanes slope, curvature;  ///< of half the cost, weighted
  Lanes by_light, drop;
  std::array<Lanes, light_count> by;  ///< of the light's parameters
};

}  // namespace

/// One pass over samples.
class TagSums {
 public:
  TagSums(const TagImageModel& model, const PixelNoise* noise, Scatter* scatter)
      : model_(model), p_(model.appearance_.value), noise_(noise), scatter_(scatter) {
    for (std::size_t i = 0; i < light_.size(); ++i) light_[i] = static_cast<float>(p_[A::white + static_cast<int>(i)]);
    const double exponent = p_[A::tone];
    const double toe = std::pow(tone_toe, exponent);
    const double whole = std::pow(1.0 + tone_toe, exponent);
    exponent_ = static_cast<float>(exponent);
    toe_ = static_cast<float>(toe);
    toe_ln_ = static_cast<float>(toe * std::log(tone_toe));
    range_ln_ = static_cast<float>(whole * std::log1p(tone_toe) - toe * std::log(tone_toe));
    per_range_ = static_cast<float>(1.0 / (whole - toe));
  }

  /// Samples that see the same lines.
  void add(TagSample* first, std::size_t count) {
    if (first->view.kind == PixelView::general)
      add_general(first, count);
    else
      add_border(first, count);
    if (scatter_ == nullptr) return;
    const A::Vector now = gradient();
    const A::Vector own = now - before_;
    before_ = now;
    scatter_->views.push_back(own);
  }

  /// Samples in any order.
  void add(std::vector<TagSample>& samples) {
    for (std::size_t first = 0; first < samples.size();) {
      std::size_t end = first + 1;
      while (end < samples.size() && alike(samples[end].view, samples[first].view)) ++end;
      add(samples.data() + first, end - first);
      first = end;
    }
  }

  Equations result();

 private:
  using Line = TagImageModel::Line;

  /// The double-precision sums over pixels that see one border only: their derivatives span four directions of the
  /// geometry and seven of the light, so that 77 products a pixel do instead of 190.
  struct BorderSum {
    std::array<double, 10> geometry{};
    std::array<std::array<double, light_count>, 4> cross{};
    std::array<double, 4> gradient{};
    bool used = false;
  };

  TAGDOCK_LANES Lit compare(Block& block, const Lanes& whiteness);
  TAGDOCK_WIDE void add_border(TagSample* first, std::size_t count);
  TAGDOCK_WIDE void add_general(TagSample* first, std::size_t count);
  /// Of everything so far.
  [[nodiscard]] A::Vector gradient() const;
  [[nodiscard]] Eigen::Matrix<double, 9, 4> border_directions(const Line& line, std::size_t side) const;
  [[nodiscard]] static std::array<Eigen::Index, 9> border_parameters(std::size_t direction);
  void move_light(TriangleSum<light_count>& sums);
  void move_general();

  const TagImageModel& model_;
  const A::Vector& p_;
  const PixelNoise* noise_;
  A::Vector before_ = A::Vector::Zero();  ///< the gradient before a group of samples
  Scatter* scatter_;                      ///< if given, squared slopes are summed in the place of information
  std::array<float, 6> light_{};
  float exponent_ = 1.0F;
  float toe_ = 0.0F, toe_ln_ = 0.0F, range_ln_ = 0.0F, per_range_ = 1.0F;  ///< of the tone curve
  Equations result_;
  Lanes cost_{};
  std::array<std::array<std::array<BorderSum, 2>, 13>, 2> borders_;
  TriangleSum<A::count> general_;
  int general_blocks_ = 0;
};

/// Light, tone curve, noise and misfit of a block.
TAGDOCK_LANES Lit TagSums::compare(Block& block, const Lanes& whiteness) {
  Lit lit;
  const Lanes& x = block.x;
  const Lanes& y = block.y;
  lit.drop = light_[3] + light_[4] * x + light_[5] * y;
  const Lanes black = 1.0F - whiteness;
  const Lanes light = light_[0] + light_[1] * x + light_[2] * y - lit.drop * black;
  Lanes modelled;
  Lanes by_exponent;
  Lanes stretched = lanes(1.0F);
  // See `toned` of the model.
  Lanes share_up = light * (1.0F / 255.0F) + static_cast<float>(tone_toe);
  share_up = share_up < 1e-4F ? lanes(1e-4F) : share_up;
  const Lanes ln = logarithm(share_up);
  if (exponent_ == 1.0F) {
    modelled = light;
    lit.by_light = lanes(1.0F);
    const Lanes part = share_up - static_cast<float>(tone_toe);
    by_exponent = 255.0F * (share_up * ln - toe_ln_ - part * range_ln_);
  } else {
    const Lanes power = exponential(exponent_ * ln);
    const Lanes part = (power - toe_) * per_range_;
    modelled = 255.0F * part;
    lit.by_light = exponent_ * per_range_ * power / share_up;
    by_exponent = 255.0F * per_range_ * (power * ln - toe_ln_ - part * range_ln_);
    if (noise_ != nullptr) {
      const Lanes lit_up = share_up < static_cast<float>(tone_toe) ? lanes(static_cast<float>(tone_toe)) : share_up;
      const Lanes steepness = exponent_ * per_range_ * exponential((exponent_ - 1.0F) * logarithm(lit_up));
      stretched = steepness * steepness;
    }
  }
  LaneBits leaks{};
  if (noise_ != nullptr) {
    Lanes share = whiteness < 0.0F ? lanes(0.0F) : whiteness;
    share = share > 1.0F ? lanes(1.0F) : share;
    const auto dark_noise = static_cast<float>(noise_->black);
    const auto more = static_cast<float>(noise_->white - noise_->black);
    const Lanes own = (dark_noise + share * more) * stretched + static_cast<float>(rounding_variance);
    // What lies beyond may differ from the margin by half the contrast, and is alike along a side: as many pixels as a
    // side has err together, so each must count for that many times less.
    const Lanes leak = static_cast<float>(0.5 * noise_->contrast) *
                       normal(-block.beyond * static_cast<float>(1.0 / noise_->blur_px)).cumulative;
    block.variance = own + static_cast<float>(noise_->side_px) * leak * leak * stretched;
    leaks = block.variance > 1.1F * own;
  }
  const Lanes residual = modelled - block.grey;
  const Lanes information = 1.0F / block.variance;
  Lanes slope = residual * information;
  Lanes curvature = information;
  Lanes cost = residual * slope;
  const LaneBits clipped =
      (block.grey >= static_cast<float>(highest_grey)) | (block.grey <= static_cast<float>(lowest_grey));
  for (int lane = 0; lane < block.count; ++lane) {
    TagSample& sample = *block.sample[static_cast<std::size_t>(lane)];
    sample.modelled = modelled[lane];
    sample.whiteness = whiteness[lane];
    if (noise_ != nullptr) {
      sample.variance = block.variance[lane];
      sample.leaks = leaks[lane] != 0;
    }
    if (clipped[lane] == 0) continue;
    const Misfit fit = misfit(modelled[lane], block.grey[lane], block.variance[lane]);
    slope[lane] = static_cast<float>(fit.slope);
    curvature[lane] = static_cast<float>(fit.curvature);
    cost[lane] = static_cast<float>(fit.cost);
  }
  cost_ += block.weight * cost;
  lit.slope = block.weight * slope;
  lit.curvature = scatter_ == nullptr ? block.weight * curvature : lit.slope * lit.slope;
  const Lanes dark = -lit.by_light * black;
  lit.by = {lit.by_light, lit.by_light * x, lit.by_light * y, dark, dark * x, dark * y, by_exponent};
  return lit;
}

void TagSums::move_light(TriangleSum<light_count>& sums) {
  std::size_t k = 0;
  for (std::size_t i = 0; i < light_count; ++i) {
    result_.gradient[light_parameters[i]] += sum(sums.gradient[i]);
    // Ascending parameters: the upper triangle is filled, the lower one follows at the end.
    for (std::size_t j = 0; j <= i; ++j)
      result_.hessian(light_parameters[j], light_parameters[i]) += sum(sums.square[k++]);
  }
  sums = {};
  result_.cost += sum(cost_);
  cost_ = Lanes{};
}

TAGDOCK_WIDE void TagSums::add_border(TagSample* first, std::size_t count) {
  const PixelView& view = first->view;
  const bool border = view.kind == PixelView::line;
  const Line none{};
  const Line& line = border ? model_.lines_[static_cast<std::size_t>(view.direction)]
                                           [static_cast<std::size_t>(view.index)][view.step > 0 ? 1 : 0]
                            : none;
  const auto a = static_cast<float>(line.a);
  const auto b = static_cast<float>(line.b);
  const auto c = static_cast<float>(line.c);
  const auto unit_0 = static_cast<float>(line.unit);
  const auto unit_x = static_cast<float>(line.unit_x);
  const auto unit_y = static_cast<float>(line.unit_y);
  const auto fourth = static_cast<float>(line.fourth);
  const auto step_up = static_cast<float>(view.step);
  TriangleSum<light_count> lights;
  TriangleSum<4> geometry;
  std::array<std::array<Lanes, light_count>, 4> cross{};
  BorderSum* sums = border ? &borders_[static_cast<std::size_t>(view.direction)][static_cast<std::size_t>(view.index)]
                                      [view.step > 0 ? 1 : 0]
                           : nullptr;
  const auto move = [&] {
    move_light(lights);
    if (sums == nullptr) return;
    sums->used = true;
    for (std::size_t k = 0; k < 10; ++k) sums->geometry[k] += sum(geometry.square[k]);
    for (std::size_t i = 0; i < 4; ++i) {
      sums->gradient[i] += sum(geometry.gradient[i]);
      for (std::size_t j = 0; j < light_count; ++j) sums->cross[i][j] += sum(cross[i][j]);
    }
    geometry = {};
    cross = {};
  };
  Block block;
  int blocks = 0;
  for (std::size_t done = 0; done < count; done += lane_count) {
    block.load(first + done, count - done);
    Lanes r = lanes(static_cast<float>(view.white));
    std::array<Lanes, 4> r_by{};
    if (border)
      for (const TagImageModel::Stop& stop : model_.stops_) {
        const Lanes x = block.x + static_cast<float>(stop.x);
        const Lanes y = block.y + static_cast<float>(stop.y);
        const Lanes unit = unit_0 + unit_x * x + unit_y * y;
        const Lanes z = (a * x + b * y + c) * unit;
        const StepLanes step = boxed(normal(z), z, fourth);
        const float up = step_up * static_cast<float>(stop.share);
        r += up * step.value;
        const Lanes by_c = up * step.slope * unit;
        r_by[0] += by_c * x;
        r_by[1] += by_c * y;
        r_by[2] += by_c;
        r_by[3] += by_c * z;
      }
    const Lit lit = compare(block, r);
    lights.add(lit.by, lit.slope, lit.curvature);
    if (border) {
      const Lanes f = lit.by_light * lit.drop;
      const std::array<Lanes, 4> by = {f * r_by[0], f * r_by[1], f * r_by[2], f * r_by[3]};
      geometry.add(by, lit.slope, lit.curvature);
      for (std::size_t i = 0; i < 4; ++i) {
        const Lanes scaled = lit.curvature * by[i];
        for (std::size_t j = 0; j < light_count; ++j) cross[i][j] += scaled * lit.by[j];
      }
    }
    if (++blocks % blocks_in_single == 0) move();
  }
  move();
}

void TagSums::move_general() {
  std::size_t k = 0;
  for (Eigen::Index i = 0; i < A::count; ++i) {
    result_.gradient[i] += sum(general_.gradient[static_cast<std::size_t>(i)]);
    for (Eigen::Index j = 0; j <= i; ++j) result_.hessian(j, i) += sum(general_.square[k++]);
  }
  general_ = {};
  general_blocks_ = 0;
  result_.cost += sum(cost_);
  cost_ = Lanes{};
}

/// Pixels near cell corners: the sum over grid nodes, see TagImageModel::at.
TAGDOCK_WIDE void TagSums::add_general(TagSample* first, std::size_t count) {
  struct Seen {
    const Line* line;
    bool across_v;  ///< its value is that of v
    bool higher;
    Lanes unit, z, by_z;
    NormalLanes gauss;
    StepLanes step;
  };
  struct Corner {
    std::size_t a, b;  ///< seen lines
    float sign;
    const BivariateNormal* integral;
    std::array<float, 11> by_correlation;  ///< u's row (2), v's row (2), w (2), blur (3), of the appearance
  };
  constexpr std::size_t most_seen = 52;
  std::array<Seen, most_seen> seen;
  std::size_t seen_count = 0;
  std::array<std::array<std::array<std::int8_t, 2>, 13>, 2> place;
  for (auto& direction : place)
    for (auto& line : direction) line.fill(-1);
  const auto see = [&](std::size_t direction, int index, int side) {
    std::int8_t& known = place[direction][static_cast<std::size_t>(index)][static_cast<std::size_t>(side)];
    if (known < 0) {
      known = static_cast<std::int8_t>(seen_count);
      Seen& one = seen[seen_count++];
      one.line = &model_.lines_[direction][static_cast<std::size_t>(index)][static_cast<std::size_t>(side)];
      one.across_v = direction == 1;
      one.higher = side == 1;
    }
    return static_cast<std::size_t>(known);
  };
  const PixelView& view = first->view;
  const int column = view.first[0] - 1;
  const int row = view.first[1] - 1;
  struct Crossing {
    std::size_t seen;
    float step;
  };
  std::array<Crossing, most_seen> steps;
  std::size_t step_count = 0;
  const auto add_step = [&](std::size_t direction, int index, int step) {
    if (step != 0) steps[step_count++] = {see(direction, index, step > 0 ? 1 : 0), static_cast<float>(step)};
  };
  for (int i = view.first[0]; i <= view.last[0]; ++i) add_step(0, i, model_.cell(i, row) - model_.cell(i - 1, row));
  for (int j = view.first[1]; j <= view.last[1]; ++j)
    add_step(1, j, model_.cell(column, j) - model_.cell(column, j - 1));
  const auto& vertices = model_.vertices_[p_[A::bleed] >= 0.0 ? 0 : 1];
  std::array<Corner, 2 * 12 * 12> corners;
  std::size_t corner_count = 0;
  for (int j = view.first[1]; j <= view.last[1]; ++j)
    for (int i = view.first[0]; i <= view.last[0]; ++i)
      for (const auto& vertex : vertices[model_.node(i, j)]) {
        if (vertex.sign == 0) break;
        Corner& corner = corners[corner_count++];
        corner.a = see(0, i, vertex.side_u);
        corner.b = see(1, j, vertex.side_v);
        corner.sign = static_cast<float>(vertex.sign);
        corner.integral = &vertex.integral;
        const Line& a = *seen[corner.a].line;
        const Line& b = *seen[corner.b].line;
        const double both = a.unit * b.unit;
        const double ca = vertex.correlation * a.unit * a.unit;
        const double cb = vertex.correlation * b.unit * b.unit;
        const double aa = b.ba * both - ca * a.ba;
        const double ab = b.bb * both - ca * a.bb;
        const double ba = a.ba * both - cb * b.ba;
        const double bb = a.bb * both - cb * b.bb;
        const std::array<double, 9> by = {aa,
                                          ab,
                                          ba,
                                          bb,
                                          -(a.place * aa + b.place * ba),
                                          -(a.place * ab + b.place * bb),
                                          a.nx * b.nx * both - 0.5 * (ca * a.nx * a.nx + cb * b.nx * b.nx),
                                          (a.nx * b.ny + a.ny * b.nx) * both - (ca * a.nx * a.ny + cb * b.nx * b.ny),
                                          a.ny * b.ny * both - 0.5 * (ca * a.ny * a.ny + cb * b.ny * b.ny)};
        for (std::size_t k = 0; k < by.size(); ++k) corner.by_correlation[k] = static_cast<float>(by[k]);
      }

  const auto g6 = static_cast<float>(p_[6]);
  const auto g7 = static_cast<float>(p_[7]);
  Block block;
  for (std::size_t done = 0; done < count; done += lane_count) {
    block.load(first + done, count - done);
    Lanes r = lanes(static_cast<float>(view.white));
    std::array<Lanes, 2> by_u{}, by_v{}, by_w{};
    std::array<Lanes, 3> by_blur{};
    Lanes by_u2{};
    Lanes by_v2{};
    Lanes by_bleed{};
    for (const TagImageModel::Stop& stop : model_.stops_) {
      const Lanes x = block.x + static_cast<float>(stop.x);
      const Lanes y = block.y + static_cast<float>(stop.y);
      const auto share = static_cast<float>(stop.share);
      for (std::size_t s = 0; s < seen_count; ++s) {
        Seen& one = seen[s];
        const Line& line = *one.line;
        one.unit =
            static_cast<float>(line.unit) + static_cast<float>(line.unit_x) * x + static_cast<float>(line.unit_y) * y;
        one.z =
            (static_cast<float>(line.a) * x + static_cast<float>(line.b) * y + static_cast<float>(line.c)) * one.unit;
        one.gauss = normal(one.z);
        one.step = boxed(one.gauss, one.z, static_cast<float>(line.fourth));
        one.by_z = Lanes{};
      }
      for (std::size_t s = 0; s < step_count; ++s) {
        Seen& one = seen[steps[s].seen];
        const float up = share * steps[s].step;
        r += up * one.step.value;
        one.by_z += up * one.step.slope;
      }
      for (std::size_t c = 0; c < corner_count; ++c) {
        const Corner& corner = corners[c];
        const float sign = share * corner.sign;
        Seen& a = seen[corner.a];
        Seen& b = seen[corner.b];
        const BivariateNormal::Points& points = corner.integral->points();
        const auto correlation = static_cast<float>(points.correlation);
        const auto per_rest = static_cast<float>(points.per_rest);
        const NormalLanes b_given_a = normal((b.z - correlation * a.z) * per_rest);
        const NormalLanes a_given_b = normal((a.z - correlation * b.z) * per_rest);
        Lanes both = a.gauss.cumulative * b.gauss.cumulative;
        const Lanes squares = a.z * a.z + b.z * b.z;
        const Lanes product = 2.0F * a.z * b.z;
        for (std::size_t k = 0; k < static_cast<std::size_t>(points.count); ++k)
          both += static_cast<float>(points.weight[k]) *
                  exponential(static_cast<float>(points.scale[k]) *
                              (squares - product * static_cast<float>(points.sine[k])));
        const Lanes more_a = a.step.value - a.gauss.cumulative;
        const Lanes more_b = b.step.value - b.gauss.cumulative;
        r += sign * (both + more_a * b.gauss.cumulative + more_b * a.gauss.cumulative);
        a.by_z += sign * (a.gauss.density * b_given_a.cumulative +
                          (a.step.slope - a.gauss.density) * b.gauss.cumulative + more_b * a.gauss.density);
        b.by_z += sign * (b.gauss.density * a_given_b.cumulative +
                          (b.step.slope - b.gauss.density) * a.gauss.cumulative + more_a * b.gauss.density);
        const Lanes by_correlation = sign * a.gauss.density * b_given_a.density * per_rest;
        const auto& by = corner.by_correlation;
        by_u[0] += by_correlation * by[0];
        by_u[1] += by_correlation * by[1];
        by_v[0] += by_correlation * by[2];
        by_v[1] += by_correlation * by[3];
        by_w[0] += by_correlation * by[4];
        by_w[1] += by_correlation * by[5];
        for (std::size_t k = 0; k < 3; ++k) by_blur[k] += by_correlation * by[6 + k];
      }
      for (std::size_t s = 0; s < seen_count; ++s) {
        const Seen& one = seen[s];
        const Line& line = *one.line;
        const Lanes scale = one.by_z * one.unit;
        const auto unit = static_cast<float>(line.unit);
        const Lanes shrink = one.z * unit;
        const Lanes da = scale * (x - shrink * static_cast<float>(line.ba));
        const Lanes db = scale * (y - shrink * static_cast<float>(line.bb));
        auto& by = one.across_v ? by_v : by_u;
        by[0] += da;
        by[1] += db;
        (one.across_v ? by_v2 : by_u2) += scale;
        const auto at = static_cast<float>(line.place);
        by_w[0] -= at * da;
        by_w[1] -= at * db;
        const Lanes by_place = -(da * g6 + db * g7 + scale);
        by_bleed += one.higher ? by_place : -by_place;
        const Lanes by_variance = -0.5F * scale * shrink;
        const auto nx = static_cast<float>(line.nx);
        const auto ny = static_cast<float>(line.ny);
        by_blur[0] += by_variance * (nx * nx);
        by_blur[1] += by_variance * (2.0F * nx * ny);
        by_blur[2] += by_variance * (ny * ny);
      }
    }
    const Lit lit = compare(block, r);
    const Lanes f = lit.by_light * lit.drop;
    general_.add({f * by_u[0], f * by_u[1], f * by_u2, f * by_v[0], f * by_v[1], f * by_v2, f * by_w[0], f * by_w[1],
                  lit.by[0], lit.by[1], lit.by[2], lit.by[3], lit.by[4], lit.by[5], f * by_blur[0], f * by_blur[1],
                  f * by_blur[2], f * by_bleed, lit.by[6]},
                 lit.slope, lit.curvature);
    if (++general_blocks_ == blocks_in_single) move_general();
  }
}

std::array<Eigen::Index, 9> TagSums::border_parameters(std::size_t direction) {
  const Eigen::Index row = direction == 0 ? 0 : 3;
  return {row, row + 1, row + 2, 6, 7, A::blur_xx, A::blur_xy, A::blur_yy, A::bleed};
}

/// How the four directions of a border's sums follow those parameters.
Eigen::Matrix<double, 9, 4> TagSums::border_directions(const Line& line, std::size_t side) const {
  const Eigen::RowVector4d by_a(1.0, 0.0, 0.0, -line.ba * line.unit);
  const Eigen::RowVector4d by_b(0.0, 1.0, 0.0, -line.bb * line.unit);
  const Eigen::RowVector4d by_c(0.0, 0.0, 1.0, 0.0);
  const Eigen::RowVector4d by_variance(0.0, 0.0, 0.0, -0.5 * line.unit);
  Eigen::Matrix<double, 9, 4> by;
  by << by_a, by_b, by_c, -line.place * by_a, -line.place * by_b, line.nx * line.nx * by_variance,
      2.0 * line.nx * line.ny * by_variance, line.ny * line.ny * by_variance,
      (side == 1 ? -1.0 : 1.0) * (p_[6] * by_a + p_[7] * by_b + by_c);
  return by;
}

A::Vector TagSums::gradient() const {
  A::Vector result = result_.gradient;
  for (std::size_t i = 0; i < A::count; ++i) result[static_cast<Eigen::Index>(i)] += sum(general_.gradient[i]);
  for (std::size_t direction = 0; direction < 2; ++direction)
    for (std::size_t i = 0; i < borders_[direction].size(); ++i)
      for (std::size_t side = 0; side < 2; ++side) {
        const BorderSum& border = borders_[direction][i][side];
        if (!border.used) continue;
        const Eigen::Matrix<double, 9, 1> own = border_directions(model_.lines_[direction][i][side], side) *
                                                Eigen::Map<const Eigen::Vector4d>(border.gradient.data());
        const std::array<Eigen::Index, 9> parameters = border_parameters(direction);
        for (Eigen::Index m = 0; m < 9; ++m) result[parameters[static_cast<std::size_t>(m)]] += own[m];
      }
  return result;
}

Equations TagSums::result() {
  move_general();
  auto& h = result_.hessian;
  h.triangularView<Eigen::StrictlyLower>() = h.transpose();
  // From the borders' own directions to the parameters.
  for (std::size_t direction = 0; direction < 2; ++direction)
    for (std::size_t i = 0; i < borders_[direction].size(); ++i)
      for (std::size_t side = 0; side < 2; ++side) {
        const BorderSum& border = borders_[direction][i][side];
        if (!border.used) continue;
        const Line& line = model_.lines_[direction][i][side];
        const std::array<Eigen::Index, 9> parameters = border_parameters(direction);
        const Eigen::Matrix<double, 9, 4> by = border_directions(line, side);
        Eigen::Matrix4d geometry;
        std::size_t k = 0;
        for (Eigen::Index m = 0; m < 4; ++m)
          for (Eigen::Index n = 0; n <= m; ++n) geometry(m, n) = geometry(n, m) = border.geometry[k++];
        Eigen::Matrix<double, 4, 7> cross;
        for (std::size_t m = 0; m < 4; ++m)
          for (std::size_t n = 0; n < light_count; ++n)
            cross(static_cast<Eigen::Index>(m), static_cast<Eigen::Index>(n)) = border.cross[m][n];
        const Eigen::Matrix<double, 9, 9> own = by * geometry * by.transpose();
        const Eigen::Matrix<double, 9, 7> with_light = by * cross;
        const Eigen::Matrix<double, 9, 1> gradient = by * Eigen::Map<const Eigen::Vector4d>(border.gradient.data());
        for (Eigen::Index m = 0; m < 9; ++m) {
          const Eigen::Index p = parameters[static_cast<std::size_t>(m)];
          result_.gradient[p] += gradient[m];
          for (Eigen::Index n = 0; n < 9; ++n) h(p, parameters[static_cast<std::size_t>(n)]) += own(m, n);
          for (Eigen::Index n = 0; n < 7; ++n) {
            h(p, light_parameters[static_cast<std::size_t>(n)]) += with_light(m, n);
            h(light_parameters[static_cast<std::size_t>(n)], p) += with_light(m, n);
          }
        }
      }
  return result_;
}

Equations TagImageModel::equations(std::vector<TagSample>& samples, const PixelNoise* noise) const {
  TagSums sums(*this, noise, nullptr);
  sums.add(samples);
  return sums.result();
}

Scatter TagImageModel::scatter(std::vector<TagSample>& samples) const {
  Scatter scatter;
  TagSums sums(*this, nullptr, &scatter);
  sums.add(samples);
  scatter.pixels = sums.result().hessian;
  return scatter;
}

}  // namespace tagdock
