#include "app/simulation/renderer.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <stdexcept>
#include <string>

#include <Eigen/LU>
#include <apriltag/apriltag.h>
#include <apriltag/tag16h5.h>
#include <apriltag/tag25h9.h>
#include <apriltag/tag36h11.h>
#include <apriltag/tagStandard41h12.h>
#include <apriltag/tagStandard52h13.h>

#include "app/simulation/draws.h"

namespace tagdock {
namespace {

using Polygon = std::vector<Eigen::Vector2d>;
using Quad = std::array<Eigen::Vector2d, 4>;

constexpr double nearest_depth = 0.05;              // m; plates with a corner nearer than this are left out
constexpr double sag_px = 2e-4;                     // largest departure of a piece from its chord: 0.02 grey level
constexpr double gauss_node = 0.21132486540518713;  // (1 - 1/sqrt 3) / 2, of two points between 0 and 1
constexpr int most_motion_intervals = 32;           // 30 px of path, beyond what a tag survives
constexpr int background_step = 2;                  // background rays are this many pixels apart
constexpr int texture_size = 512;                   // texels, tiled
constexpr int quantile_count = 4096;                // 12 random bits a pixel; reaches +-3.7 sigma

// ---- tags -----------------------------------------------------------------------------------------------------------

/// Reflectance classes of a tag's modules with the one module of white that belongs to it: true is white.
struct Modules {
  int total = 0;      ///< modules along the side of the picture
  int at_border = 0;  ///< modules along the side of the square whose corners are measured
  std::vector<bool> white;
};

struct FamilyDoor {
  const char* name;
  apriltag_family_t* (*create)();
  void (*destroy)(apriltag_family_t*);
};

constexpr FamilyDoor families[] = {
    {"tag36h11", tag36h11_create, tag36h11_destroy},
    {"tag25h9", tag25h9_create, tag25h9_destroy},
    {"tag16h5", tag16h5_create, tag16h5_destroy},
    {"tagStandard41h12", tagStandard41h12_create, tagStandard41h12_destroy},
    {"tagStandard52h13", tagStandard52h13_create, tagStandard52h13_destroy},
};

Modules modules_of(const std::string& family, int id) {
  for (const FamilyDoor& door : families) {
    if (family != door.name) continue;
    const std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)> tags(door.create(), door.destroy);
    if (id < 0 || id >= static_cast<int>(tags->ncodes))
      throw std::invalid_argument("family " + family + " has no tag " + std::to_string(id));
    const std::unique_ptr<image_u8_t, void (*)(image_u8_t*)> picture(apriltag_to_image(tags.get(), id),
                                                                     image_u8_destroy);
    Modules modules{tags->total_width, tags->width_at_border, {}};
    for (int row = 0; row < modules.total; ++row)
      for (int column = 0; column < modules.total; ++column)
        modules.white.push_back(picture->buf[row * picture->stride + column] > 127);
    return modules;
  }
  throw std::invalid_argument("unknown tag family " + family);
}

// ---- plates: what tags and stains have in common --------------------------------------------------------------------

/// A border between two modules, in plate coordinates, with the weight of its line integral.
struct Border {
  Eigen::Vector2d from, to;
  double weight;
};

/// A flat rectangle of modules. Plate frame as a tag's: origin at its centre, x right, y down, z away from the viewer.
struct Plate {
  int id = -1;  ///< of the tag; -1 for a stain
  double tag_size = 0.0;
  Eigen::Isometry3d T_station_plate = Eigen::Isometry3d::Identity();
  std::vector<double> lines_x, lines_y;  ///< borders of columns and rows [m]
  std::vector<double> reflectance;       ///< row by row
  std::vector<Border> borders;

  [[nodiscard]] double at(int row, int column) const {
    const int columns = static_cast<int>(lines_x.size()) - 1;
    const int rows = static_cast<int>(lines_y.size()) - 1;
    if (row < 0 || column < 0 || row >= rows || column >= columns) return 0.0;
    return reflectance[row * columns + column];
  }
  [[nodiscard]] Quad outline() const {
    return {Eigen::Vector2d(lines_x.front(), lines_y.front()), Eigen::Vector2d(lines_x.back(), lines_y.front()),
            Eigen::Vector2d(lines_x.back(), lines_y.back()), Eigen::Vector2d(lines_x.front(), lines_y.back())};
  }
};

/// Borders along which the reflectance jumps; equal jumps in a row are one border. The line integral around a module
/// runs top left, top right, bottom right, bottom left; shared sides are counted once with the difference.
void find_borders(Plate& plate) {
  const int columns = static_cast<int>(plate.lines_x.size()) - 1;
  const int rows = static_cast<int>(plate.lines_y.size()) - 1;
  for (int column = 0; column <= columns; ++column)
    for (int row = 0; row < rows;) {
      const double weight = plate.at(row, column - 1) - plate.at(row, column);
      int end = row + 1;
      while (end < rows && plate.at(end, column - 1) - plate.at(end, column) == weight) ++end;
      if (weight != 0.0)
        plate.borders.push_back(
            {{plate.lines_x[column], plate.lines_y[row]}, {plate.lines_x[column], plate.lines_y[end]}, weight});
      row = end;
    }
  for (int row = 0; row <= rows; ++row)
    for (int column = 0; column < columns;) {
      const double weight = plate.at(row, column) - plate.at(row - 1, column);
      int end = column + 1;
      while (end < columns && plate.at(row, end) - plate.at(row - 1, end) == weight) ++end;
      if (weight != 0.0)
        plate.borders.push_back(
            {{plate.lines_x[column], plate.lines_y[row]}, {plate.lines_x[end], plate.lines_y[row]}, weight});
      column = end;
    }
}

Plate plate_of(const BoardTag& tag, const Scene& scene) {
  const Modules modules = modules_of(scene.board.family, tag.id);
  Plate plate;
  plate.id = tag.id;
  plate.tag_size = tag.size;
  plate.T_station_plate = tag.T_station_tag;
  const double module = tag.size / modules.at_border;
  const double picture_border = 0.5 * (modules.total - modules.at_border);  // modules, already in the picture
  const double extra = (scene.border_modules - picture_border) * module;    // of white around the picture [m]
  const int total = modules.total + (extra > 0.0 ? 2 : 0);
  const int inset = extra > 0.0 ? 1 : 0;
  for (int i = 0; i <= modules.total; ++i) {
    double at = (i - 0.5 * modules.total) * module;
    if (extra < 0.0 && i == 0) at -= extra;  // a border narrower than the picture's
    if (extra < 0.0 && i == modules.total) at += extra;
    plate.lines_x.push_back(at);
  }
  if (inset == 1) {
    plate.lines_x.insert(plate.lines_x.begin(), plate.lines_x.front() - extra);
    plate.lines_x.push_back(plate.lines_x.back() + extra);
  }
  plate.lines_y = plate.lines_x;
  for (int row = 0; row < total; ++row)
    for (int column = 0; column < total; ++column) {
      const int r = row - inset;
      const int c = column - inset;
      const bool outside = r < 0 || c < 0 || r >= modules.total || c >= modules.total;
      plate.reflectance.push_back(outside || modules.white[r * modules.total + c] ? scene.white : scene.black);
    }
  find_borders(plate);
  return plate;
}

Plate plate_of(const Stain& stain) {
  Plate plate;
  plate.T_station_plate = stain.T_station_stain;
  plate.lines_x = {-0.5 * stain.width, 0.5 * stain.width};
  plate.lines_y = {-0.5 * stain.height, 0.5 * stain.height};
  plate.reflectance = {stain.reflectance};
  find_borders(plate);
  return plate;
}

// ---- convex polygons of the ideal image plane (x/z, y/z), in which every border is straight ------------------------

double cross(const Eigen::Vector2d& a, const Eigen::Vector2d& b) { return a.x() * b.y() - a.y() * b.x(); }

double area(const Polygon& polygon) {
  double twice = 0.0;
  for (std::size_t i = 0; i < polygon.size(); ++i) twice += cross(polygon[i], polygon[(i + 1) % polygon.size()]);
  return 0.5 * twice;
}

/// The part of a convex polygon to one side of the line from a to b: the inside of a positively run outline, or the
/// outside.
Polygon half(const Polygon& polygon, const Eigen::Vector2d& a, const Eigen::Vector2d& b, bool inside) {
  Polygon kept;
  const auto distance = [&](const Eigen::Vector2d& p) { return (inside ? 1.0 : -1.0) * cross(b - a, p - a); };
  for (std::size_t i = 0; i < polygon.size(); ++i) {
    const Eigen::Vector2d& p = polygon[i];
    const Eigen::Vector2d& q = polygon[(i + 1) % polygon.size()];
    const double at_p = distance(p);
    const double at_q = distance(q);
    if (at_p >= 0.0) kept.push_back(p);
    if ((at_p > 0.0 && at_q < 0.0) || (at_p < 0.0 && at_q > 0.0)) kept.push_back(p + (q - p) * (at_p / (at_p - at_q)));
  }
  return kept;
}

Polygon intersection(Polygon polygon, const Polygon& with) {
  for (std::size_t i = 0; i < with.size() && polygon.size() >= 3; ++i)
    polygon = half(polygon, with[i], with[(i + 1) % with.size()], true);
  return polygon.size() >= 3 ? polygon : Polygon{};
}

/// What is left of a convex polygon, as convex pieces, when another is cut out of it.
void cut_out(Polygon polygon, const Polygon& hole, std::vector<Polygon>& pieces) {
  for (std::size_t i = 0; i < hole.size() && polygon.size() >= 3; ++i) {
    const Eigen::Vector2d& a = hole[i];
    const Eigen::Vector2d& b = hole[(i + 1) % hole.size()];
    Polygon outside = half(polygon, a, b, false);
    if (outside.size() >= 3) pieces.push_back(std::move(outside));
    polygon = half(polygon, a, b, true);
  }
}

Polygon polygon_of(const Quad& quad) { return {quad.begin(), quad.end()}; }

// ---- the spread of a point ------------------------------------------------------------------------------------------

/// Weights of a Gaussian convolved with the pixel's square, by the sub-pixel place of an edge point.
class Spread {
 public:
  static constexpr int fractions = 256;

  explicit Spread(double sigma) {
    const double reach = 4.0 * sigma + 0.5;  // beyond it lies 6e-5 of a step: 0.01 grey level
    const int needed = 2 * static_cast<int>(std::ceil(reach)) + 2;
    for (const int offered : {8, 12, 16, 24, 32})
      if (width_ == 0 && offered >= needed) width_ = offered;
    if (width_ == 0) throw std::invalid_argument("psf_sigma_px " + std::to_string(sigma) + " is wider than 3.5 px");
    const int before = width_ / 2 - 1;
    const auto cumulative = [&](double t) { return 0.5 * std::erfc(-t / (sigma * std::numbers::sqrt2)); };
    // Integral of the cumulative normal distribution.
    const auto ramp = [&](double t) {
      const double s = t / sigma;
      return t * cumulative(t) + sigma * std::exp(-0.5 * s * s) / std::sqrt(2.0 * std::numbers::pi);
    };
    const auto step = [&](double t) { return ramp(t + 0.5) - ramp(t - 0.5); };
    for (int fraction = 0; fraction <= fractions; ++fraction) {
      double sum_jump = 0.0;
      double sum_density = 0.0;
      std::vector<double> jump(width_), density(width_);
      for (int j = 0; j < width_; ++j) {
        const double t = static_cast<double>(fraction) / fractions + before - j;
        sum_jump += jump[j] = step(t + 1.0) - step(t);
        sum_density += density[j] = cumulative(t + 0.5) - cumulative(t - 0.5);
      }
      for (int j = 0; j < width_; ++j) {
        jump_.push_back(static_cast<float>(jump[j] / sum_jump));
        density_.push_back(static_cast<float>(density[j] / sum_density));
      }
    }
    // Two Gauss points per interval; 0.7 sigma keeps the quadrature error below 0.02 grey level (measured).
    interval_px_ = std::clamp(0.7 * sigma, 0.25, 1.0);
  }

  [[nodiscard]] int width() const { return width_; }
  [[nodiscard]] double interval_px() const { return interval_px_; }
  /// Change of the blurred step from column to column, for columns floor(x) - width/2 + 1 and on.
  [[nodiscard]] const float* jump(int fraction) const { return &jump_[fraction * width_]; }
  /// Share of a point's light in each row, for rows floor(y) - width/2 + 1 and on.
  [[nodiscard]] const float* density(int fraction) const { return &density_[fraction * width_]; }

 private:
  int width_ = 0;
  double interval_px_ = 0.5;
  std::vector<float> jump_, density_;
};

/// A rectangle of the image that collects line integrals: the change of brightness from column to column, until
/// `sum_up` makes values of it.
struct Patch {
  int x0 = 0, y0 = 0, width = 0, height = 0;  ///< px
  std::vector<float> values;

  Patch(int left, int top, int right, int bottom)
      : x0(left),
        y0(top),
        width(std::max(0, right - left)),
        height(std::max(0, bottom - top)),
        values(static_cast<std::size_t>(width) * height, 0.0F) {}
};

/// From changes between columns to values.
void sum_up(Patch& patch) {
  for (int row = 0; row < patch.height; ++row) {
    float* at = &patch.values[static_cast<std::size_t>(row) * patch.width];
    for (int x = 1; x < patch.width; ++x) at[x] += at[x - 1];
  }
}

template <int N>
void add_point(Patch& patch, const Spread& spread, double x, double y, double weight) {
  const double floor_x = std::floor(x);
  const double floor_y = std::floor(y);
  const int column = static_cast<int>(floor_x) - (N / 2 - 1) - patch.x0;
  const int row = static_cast<int>(floor_y) - (N / 2 - 1) - patch.y0;
  if (column >= patch.width || row >= patch.height || row + N <= 0) return;
  using Weights = Eigen::Array<float, N, 1>;
  const auto blend = [](double fraction, const float* (Spread::*table)(int) const, const Spread& of) -> Weights {
    const double scaled = fraction * Spread::fractions;
    const int index = std::min(static_cast<int>(scaled), Spread::fractions - 1);
    const float share = static_cast<float>(scaled - index);
    const Eigen::Map<const Weights> low((of.*table)(index));
    const Eigen::Map<const Weights> high((of.*table)(index + 1));
    return low + share * (high - low);
  };
  const Weights across = blend(x - floor_x, &Spread::jump, spread) * static_cast<float>(weight);
  const Weights down = blend(y - floor_y, &Spread::density, spread);
  const int first = std::max(0, -row);
  const int last = std::min(N, patch.height - row);
  if (column >= 0 && column + N <= patch.width) {
    float* at = &patch.values[static_cast<std::size_t>(row + first) * patch.width + column];
    for (int i = first; i < last; ++i, at += patch.width) Eigen::Map<Weights>(at) += down[i] * across;
    return;
  }
  // Cut by the patch: what starts left of it counts in its first column, what starts right of it not at all.
  for (int i = first; i < last; ++i)
    for (int j = 0; j < N && column + j < patch.width; ++j)
      patch.values[static_cast<std::size_t>(row + i) * patch.width + std::max(0, column + j)] += down[i] * across[j];
}

template <int N>
void add_chord(Patch& patch, const Spread& spread, const Eigen::Vector2d& from, const Eigen::Vector2d& to,
               double weight) {
  const Eigen::Vector2d along = to - from;
  if (along.y() == 0.0) return;  // the integral runs over dy
  const int intervals = std::max(1, static_cast<int>(std::ceil(along.cwiseAbs().maxCoeff() / spread.interval_px())));
  const double point_weight = -weight * along.y() / (2.0 * intervals);
  for (int i = 0; i < intervals; ++i)
    for (const double node : {gauss_node, 1.0 - gauss_node}) {
      const Eigen::Vector2d at = from + along * ((i + node) / intervals);
      add_point<N>(patch, spread, at.x(), at.y(), point_weight);
    }
}

void add_chord(Patch& patch, const Spread& spread, const Eigen::Vector2d& from, const Eigen::Vector2d& to,
               double weight) {
  switch (spread.width()) {
    case 8:
      return add_chord<8>(patch, spread, from, to, weight);
    case 12:
      return add_chord<12>(patch, spread, from, to, weight);
    case 16:
      return add_chord<16>(patch, spread, from, to, weight);
    case 24:
      return add_chord<24>(patch, spread, from, to, weight);
    default:
      return add_chord<32>(patch, spread, from, to, weight);
  }
}

Eigen::Vector2d pixel_of(const CameraModel& camera, const Eigen::Vector2d& ideal) {
  const Eigen::Vector2d bent = distort(camera, ideal);
  return {camera.fx * bent.x() + camera.cx, camera.fy * bent.y() + camera.cy};
}

/// A straight line of the ideal plane, bent by the lens, cut into chords.
void add_line(Patch& patch, const Spread& spread, const CameraModel& camera, const Eigen::Vector2d& from,
              const Eigen::Vector2d& to, double weight) {
  const Eigen::Vector2d start = pixel_of(camera, from);
  const Eigen::Vector2d end = pixel_of(camera, to);
  const double sag = (pixel_of(camera, 0.5 * (from + to)) - 0.5 * (start + end)).norm();
  const int pieces = std::clamp(static_cast<int>(std::ceil(std::sqrt(sag / sag_px))), 1, 256);
  Eigen::Vector2d last = start;
  for (int i = 1; i <= pieces; ++i) {
    const Eigen::Vector2d next = i == pieces ? end : pixel_of(camera, from + (to - from) * i / pieces);
    add_chord(patch, spread, last, next, weight);
    last = next;
  }
}

void add_polygon(Patch& patch, const Spread& spread, const CameraModel& camera, const Polygon& polygon, double weight) {
  for (std::size_t i = 0; i < polygon.size(); ++i)
    add_line(patch, spread, camera, polygon[i], polygon[(i + 1) % polygon.size()], weight);
}

// ---- noise ----------------------------------------------------------------------------------------------------------

/// Quantiles of the normal distribution at equal shares, scaled to variance 1.
std::array<float, quantile_count> normal_quantiles() {
  std::array<float, quantile_count> quantiles{};
  double sum_of_squares = 0.0;
  for (int i = 0; i < quantile_count / 2; ++i) {
    const double share = (i + 0.5) / quantile_count;
    double low = -6.0;
    double high = 0.0;
    for (int step = 0; step < 60; ++step) {
      const double middle = 0.5 * (low + high);
      (0.5 * std::erfc(-middle / std::numbers::sqrt2) < share ? low : high) = middle;
    }
    quantiles[i] = static_cast<float>(low);
    quantiles[quantile_count - 1 - i] = static_cast<float>(-low);
    sum_of_squares += 2.0 * low * low;
  }
  const float scale = static_cast<float>(std::sqrt(quantile_count / sum_of_squares));
  for (float& quantile : quantiles) quantile *= scale;
  return quantiles;
}

// ---- the room -------------------------------------------------------------------------------------------------------

/// Smooth random brightness, tiled, mean 0, about +-1: several octaves of bilinear value noise.
std::vector<float> cloud_texture(std::uint64_t seed, int coarsest, double fall) {
  std::vector<float> texture(static_cast<std::size_t>(texture_size) * texture_size, 0.0F);
  double amplitude = 1.0;
  for (int cells = coarsest; cells <= texture_size; cells *= 2, amplitude *= fall) {
    const int period = texture_size / cells;
    const auto value = [&](int x, int y) {
      const std::uint64_t key = (seed * 131 + cells) * 1048576ULL + (y % cells) * 1024ULL + (x % cells);
      return static_cast<double>(mixed(key) >> 11) * 0x1p-52 - 1.0;
    };
    for (int y = 0; y < texture_size; ++y)
      for (int x = 0; x < texture_size; ++x) {
        const double fx = static_cast<double>(x % period) / period;
        const double fy = static_cast<double>(y % period) / period;
        const int cx = x / period;
        const int cy = y / period;
        const double top = value(cx, cy) * (1 - fx) + value(cx + 1, cy) * fx;
        const double bottom = value(cx, cy + 1) * (1 - fx) + value(cx + 1, cy + 1) * fx;
        texture[y * texture_size + x] += static_cast<float>(amplitude * (top * (1 - fy) + bottom * fy));
      }
  }
  return texture;
}

const std::vector<float>& concrete() {
  static const std::vector<float> texture = cloud_texture(11, 4, 0.72);
  return texture;
}

const std::vector<float>& plaster() {
  static const std::vector<float> texture = cloud_texture(12, 8, 0.62);
  return texture;
}

float texel(const std::vector<float>& texture, float x, float y, float texels_per_metre) {
  const int column = static_cast<int>(x * texels_per_metre + 65536.0F) & (texture_size - 1);
  const int row = static_cast<int>(y * texels_per_metre + 65536.0F) & (texture_size - 1);
  return texture[row * texture_size + column];
}

/// Rows of an image, the end excluded.
struct RowBand {
  int first = 0;
  int end = 0;
};

float illumination(const Lamp& lamp, const Eigen::Vector3f& place, const Eigen::Vector3f& normal) {
  const Eigen::Vector3f way = lamp.position_station.cast<float>() - place;
  const float squared = way.squaredNorm();
  const float facing = std::max(0.0F, normal.dot(way));
  return static_cast<float>(lamp.ambient) + static_cast<float>(lamp.strength) * facing / (squared * std::sqrt(squared));
}

/// How much of a strip of width `soft` around a value lies in [low, high]: a border drawn without stairs.
inline float inside(float value, float low, float high, float soft) {
  const float deep = std::min(value - low, high - value) + 0.5F * soft;
  if (deep <= 0.0F) return 0.0F;
  return deep >= soft ? 1.0F : deep / soft;
}

/// Distance from the middle between two lines of a grid, negative before it.
inline float from_middle(float value, float period) {
  const float periods = value / period + 1000.0F;
  return period * (periods - static_cast<float>(static_cast<int>(periods)) - 0.5F);
}

/// How much of a thin dark line one line of sight takes in.
inline float thin_line(float from_line, float width, float soft) {
  if (std::abs(from_line) > 0.5F * (width + std::max(width, soft))) return 0.0F;
  return inside(from_line, -0.5F * width, 0.5F * width, std::max(width, soft)) * (soft > width ? width / soft : 1.0F);
}

}  // namespace

struct Renderer::Prepared {
  Scene scene;
  CameraModel camera;
  Sensor sensor;
  std::vector<Plate> plates;
  Spread spread;
  Polygon window;  ///< ideal plane: the image and a tenth around it
  int node_columns = 0, node_rows = 0;
  std::vector<Eigen::Vector3f> rays_camera;  ///< of the background's nodes, z = 1
  std::array<float, quantile_count> quantiles = normal_quantiles();
  std::vector<float> vignetting_x, vignetting_y;  ///< light lost, a sum of both
  std::array<std::uint8_t, 256 * 8> tone{};       ///< grey level by eighths of a linear level

  Prepared(Scene s, CameraModel c, Sensor g) : scene(std::move(s)), camera(c), sensor(g), spread(g.psf_sigma_px) {
    check(camera);
    const auto need = [](bool good, const std::string& what) {
      if (!good) throw std::invalid_argument("sensor: " + what);
    };
    need(sensor.psf_sigma_px >= 0.25, "psf_sigma_px must be at least 0.25");
    need(sensor.levels_per_ms > 0.0 && std::isfinite(sensor.levels_per_ms), "levels_per_ms must be positive");
    need(sensor.read_noise >= 0.0 && sensor.electrons_per_level >= 0.0, "noise must not be negative");
    need(sensor.gamma > 0.0 && std::isfinite(sensor.gamma), "gamma must be positive");
    need(sensor.vignetting >= 0.0 && sensor.vignetting < 1.0, "vignetting must be 0 or more and less than 1");
    for (const BoardTag& tag : scene.board.tags) plates.push_back(plate_of(tag, scene));
    for (const Stain& stain : scene.stains) plates.push_back(plate_of(stain));
    prepare_rays();
    for (int i = 0; i < static_cast<int>(tone.size()); ++i) {
      const double level = (i + 0.5) / 8.0;
      const double curved = sensor.gamma == 1.0 ? level : 255.0 * std::pow(level / 255.0, 1.0 / sensor.gamma);
      tone[i] = static_cast<std::uint8_t>(std::clamp(std::lround(curved), 0L, 255L));
    }
  }

  void prepare_rays() {
    const auto ideal_of = [&](double x, double y) -> Eigen::Vector2d {
      const Eigen::Vector2d flat((x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy);
      return undistort(camera, flat).value_or(flat);
    };
    Eigen::AlignedBox2d bounds;
    for (int i = 0; i <= 16; ++i)
      for (int j = 0; j <= 16; ++j)
        bounds.extend(ideal_of(-0.5 + camera.width * i / 16.0, -0.5 + camera.height * j / 16.0));
    const Eigen::Vector2d more = 0.1 * bounds.sizes();
    const Eigen::Vector2d low = bounds.min() - more;
    const Eigen::Vector2d high = bounds.max() + more;
    window = {low, {high.x(), low.y()}, high, {low.x(), high.y()}};
    node_columns = camera.width / background_step + 2;
    node_rows = camera.height / background_step + 2;
    for (int row = 0; row < node_rows; ++row)
      for (int column = 0; column < node_columns; ++column) {
        const Eigen::Vector2d ideal = ideal_of(column * background_step, row * background_step);
        rays_camera.emplace_back(static_cast<float>(ideal.x()), static_cast<float>(ideal.y()), 1.0F);
      }
    const double corner = 0.25 * (camera.width * double(camera.width) + camera.height * double(camera.height));
    for (int x = 0; x < camera.width; ++x)
      vignetting_x.push_back(
          static_cast<float>(sensor.vignetting * std::pow(x - 0.5 * (camera.width - 1), 2) / corner));
    for (int y = 0; y < camera.height; ++y)
      vignetting_y.push_back(
          static_cast<float>(sensor.vignetting * std::pow(y - 0.5 * (camera.height - 1), 2) / corner));
  }

  // -- poses along the exposure

  [[nodiscard]] static Eigen::Isometry3d pose_at(const Exposure& exposure, double share) {
    const auto& poses = exposure.T_station_camera;
    if (poses.size() == 1) return poses.front();
    const double place = share * static_cast<double>(poses.size() - 1);
    const std::size_t index = std::min(static_cast<std::size_t>(place), poses.size() - 2);
    const double part = place - static_cast<double>(index);
    const Eigen::Quaterniond from(poses[index].linear());
    const Eigen::Quaterniond to(poses[index + 1].linear());
    Eigen::Isometry3d pose = Eigen::Isometry3d::Identity();
    pose.linear() = from.slerp(part, to).toRotationMatrix();
    pose.translation() = (1.0 - part) * poses[index].translation() + part * poses[index + 1].translation();
    return pose;
  }

  /// T_camera_plate of each plate that is wholly in front of the camera and faces it.
  struct Seen {
    const Plate* plate;
    Eigen::Isometry3d T_camera_plate;
    Quad outline;  ///< ideal plane
  };

  [[nodiscard]] std::vector<Seen> seen_from(const Eigen::Isometry3d& T_station_camera) const {
    std::vector<Seen> seen;
    const Eigen::Isometry3d T_camera_station = T_station_camera.inverse();
    for (const Plate& plate : plates) {
      Seen one{&plate, T_camera_station * plate.T_station_plate, {}};
      const Eigen::Vector3d normal = one.T_camera_plate.linear().col(2);  // away from who faces the plate
      if (normal.dot(one.T_camera_plate.translation()) <= 0.0) continue;
      const Quad outline = plate.outline();
      bool in_front = true;
      for (int i = 0; i < 4; ++i) {
        const Eigen::Vector3d corner = one.T_camera_plate * Eigen::Vector3d(outline[i].x(), outline[i].y(), 0.0);
        in_front = in_front && corner.z() >= nearest_depth;
        one.outline[i] = corner.head<2>() / corner.z();
      }
      if (in_front && !intersection(polygon_of(one.outline), window).empty()) seen.push_back(one);
    }
    return seen;
  }

  /// Outlines of the plates that stand before this one.
  [[nodiscard]] static std::vector<Polygon> before(const Seen& one, const std::vector<Seen>& all) {
    const auto depth_along = [](const Seen& of, const Eigen::Vector2d& ideal) {
      const Eigen::Vector3d normal = of.T_camera_plate.linear().col(2);
      return normal.dot(of.T_camera_plate.translation()) / normal.dot(ideal.homogeneous());
    };
    std::vector<Polygon> nearer;
    for (const Seen& other : all) {
      if (other.plate == one.plate) continue;
      const Polygon common = intersection(polygon_of(one.outline), polygon_of(other.outline));
      if (common.empty() || std::abs(area(common)) < 1e-12) continue;
      Eigen::Vector2d centre = Eigen::Vector2d::Zero();
      for (const Eigen::Vector2d& corner : common) centre += corner / static_cast<double>(common.size());
      if (depth_along(other, centre) < depth_along(one, centre)) nearer.push_back(polygon_of(other.outline));
    }
    return nearer;
  }

  [[nodiscard]] std::vector<TrueTag> true_tags(const Exposure& exposure) const {
    const std::vector<Seen> seen = seen_from(pose_at(exposure, 0.5));
    std::vector<TrueTag> tags;
    for (const Seen& one : seen) {
      if (one.plate->id < 0) continue;
      TrueTag tag;
      tag.id = one.plate->id;
      tag.T_camera_tag = one.T_camera_plate;
      const auto in_image = [&](const Eigen::Vector2d& p) {
        return p.x() >= -0.5 && p.y() >= -0.5 && p.x() <= camera.width - 0.5 && p.y() <= camera.height - 0.5;
      };
      const TagPoints corners = tag_corners(one.plate->tag_size);
      bool some = in_image(project(camera, one.T_camera_plate.translation()));
      for (int i = 0; i < 4; ++i) {
        tag.corners_px[i] = project(camera, one.T_camera_plate * corners[i]);
        some = some || in_image(tag.corners_px[i]);
      }
      if (!some) continue;
      tag.fully_visible = before(one, seen).empty();
      for (const Eigen::Vector2d& corner : one.outline)
        tag.fully_visible = tag.fully_visible && in_image(pixel_of(camera, corner));
      tags.push_back(tag);
    }
    return tags;
  }

  [[nodiscard]] std::vector<Eigen::Isometry3d> motion_samples(const Exposure& exposure) const {
    const auto& poses = exposure.T_station_camera;
    double path_px = 0.0;
    for (const Plate& plate : plates)
      for (const Eigen::Vector2d& corner : plate.outline()) {
        const Eigen::Vector3d corner_station = plate.T_station_plate * Eigen::Vector3d(corner.x(), corner.y(), 0.0);
        double path = 0.0;
        Eigen::Vector2d last;
        for (std::size_t i = 0; i < poses.size(); ++i) {
          const Eigen::Vector3d corner_camera = poses[i].inverse() * corner_station;
          if (corner_camera.z() < nearest_depth) break;
          const Eigen::Vector2d pixel = project(camera, corner_camera);
          if (i > 0) path += (pixel - last).norm();
          last = pixel;
        }
        path_px = std::max(path_px, path);
      }
    // At rest, or nearly: the mean over 0.06 px departs from its middle by 0.01 grey level.
    if (path_px < 0.06) return {pose_at(exposure, 0.5)};
    const int intervals =
        std::clamp(static_cast<int>(std::ceil(path_px / (1.4 * sensor.psf_sigma_px))), 1, most_motion_intervals);
    std::vector<Eigen::Isometry3d> samples;
    for (int i = 0; i < intervals; ++i)
      for (const double node : {gauss_node, 1.0 - gauss_node})
        samples.push_back(pose_at(exposure, (i + node) / intervals));
    return samples;
  }

  // -- plates into patches

  /// One plate in the image: reflectance, covered share and illumination.
  struct Picture {
    Patch reflected;
    Patch covered;
    int light_step = 16;  ///< px; illumination is bilinear between points this far apart
    int light_columns = 0;
    std::vector<float> light;  ///< at every light_step of the patch
  };

  void add_plate(Picture& picture, const Seen& one, const std::vector<Seen>& all, double share) const {
    const auto ideal = [&](double x, double y) -> Eigen::Vector2d {
      const Eigen::Vector3d point = one.T_camera_plate * Eigen::Vector3d(x, y, 0.0);
      return point.head<2>() / point.z();
    };
    const std::vector<Polygon> nearer = before(one, all);
    bool inside_window = true;
    for (const Eigen::Vector2d& corner : one.outline)
      inside_window = inside_window && corner.x() > window[0].x() && corner.y() > window[0].y() &&
                      corner.x() < window[2].x() && corner.y() < window[2].y();
    if (nearer.empty() && inside_window) {
      for (const Border& border : one.plate->borders)
        add_line(picture.reflected, spread, camera, ideal(border.from.x(), border.from.y()),
                 ideal(border.to.x(), border.to.y()), share * border.weight);
      add_polygon(picture.covered, spread, camera, polygon_of(one.outline), share);
      return;
    }
    const auto visible = [&](const Quad& quad) {
      std::vector<Polygon> pieces{intersection(polygon_of(quad), window)};
      for (const Polygon& hole : nearer) {
        std::vector<Polygon> left;
        for (const Polygon& piece : pieces) cut_out(piece, hole, left);
        pieces = std::move(left);
      }
      return pieces;
    };
    const int columns = static_cast<int>(one.plate->lines_x.size()) - 1;
    const int rows = static_cast<int>(one.plate->lines_y.size()) - 1;
    for (int row = 0; row < rows; ++row)
      for (int column = 0; column < columns; ++column) {
        const double left = one.plate->lines_x[column];
        const double right = one.plate->lines_x[column + 1];
        const double top = one.plate->lines_y[row];
        const double bottom = one.plate->lines_y[row + 1];
        for (const Polygon& piece :
             visible({ideal(left, top), ideal(right, top), ideal(right, bottom), ideal(left, bottom)}))
          add_polygon(picture.reflected, spread, camera, piece, share * one.plate->at(row, column));
      }
    for (const Polygon& piece : visible(one.outline)) add_polygon(picture.covered, spread, camera, piece, share);
  }

  /// Illumination of the plate where the line of sight of each grid point meets it, not far outside the plate.
  void light_plate(Picture& picture, const Seen& one) const {
    const Patch& patch = picture.reflected;
    for (const int smaller : {8, 4, 2})
      if (std::min(patch.width, patch.height) < 16 * smaller) picture.light_step = smaller;
    picture.light_columns = patch.width / picture.light_step + 2;
    const int rows = patch.height / picture.light_step + 2;
    const Eigen::Isometry3d T_plate_camera = one.T_camera_plate.inverse();
    const Eigen::Vector3d lens_plate = T_plate_camera.translation();
    const Eigen::Vector3f normal_station = -one.plate->T_station_plate.linear().col(2).cast<float>();
    const Eigen::Vector2d reach = 3.0 * one.plate->outline()[2];
    for (int row = 0; row < rows; ++row)
      for (int column = 0; column < picture.light_columns; ++column) {
        const Eigen::Vector2d pixel(patch.x0 + column * picture.light_step, patch.y0 + row * picture.light_step);
        const Eigen::Vector2d flat((pixel.x() - camera.cx) / camera.fx, (pixel.y() - camera.cy) / camera.fy);
        const Eigen::Vector3d ray_plate =
            T_plate_camera.linear() * undistort(camera, flat).value_or(flat).homogeneous();
        const double distance = ray_plate.z() > 1e-6 ? -lens_plate.z() / ray_plate.z() : 1e6;
        const Eigen::Vector3d hit = lens_plate + distance * ray_plate;
        const Eigen::Vector3d place(std::clamp(hit.x(), -reach.x(), reach.x()),
                                    std::clamp(hit.y(), -reach.y(), reach.y()), 0.0);
        picture.light.push_back(
            illumination(scene.lamp, (one.plate->T_station_plate * place).cast<float>(), normal_station));
      }
  }

  [[nodiscard]] std::vector<Picture> pictures(const std::vector<Eigen::Isometry3d>& samples) const {
    std::vector<std::vector<Seen>> views;
    for (const Eigen::Isometry3d& T_station_camera : samples) views.push_back(seen_from(T_station_camera));
    std::vector<Picture> result;
    const std::vector<Seen>& middle = views[views.size() / 2];
    for (const Plate& plate : plates) {
      const auto of_plate = [&](const Seen& seen) { return seen.plate == &plate; };
      Eigen::AlignedBox2d box;
      bool always = true;
      for (const std::vector<Seen>& view : views) {
        const auto found = std::find_if(view.begin(), view.end(), of_plate);
        always = always && found != view.end();
        if (found == view.end()) continue;
        // Sides bulge under distortion: points along them, not only the corners.
        const Polygon outline = intersection(polygon_of(found->outline), window);
        for (std::size_t i = 0; i < outline.size(); ++i)
          for (int step = 0; step < 4; ++step)
            box.extend(pixel_of(camera, outline[i] + 0.25 * step * (outline[(i + 1) % outline.size()] - outline[i])));
      }
      if (!always) continue;
      const int margin = spread.width() / 2 + 3;
      const int left = std::max(0, static_cast<int>(std::floor(box.min().x())) - margin);
      const int top = std::max(0, static_cast<int>(std::floor(box.min().y())) - margin);
      const int right = std::min(camera.width, static_cast<int>(std::ceil(box.max().x())) + margin + 1);
      const int bottom = std::min(camera.height, static_cast<int>(std::ceil(box.max().y())) + margin + 1);
      if (right <= left || bottom <= top) continue;
      Picture picture{Patch(left, top, right, bottom), Patch(left, top, right, bottom), 16, 0, {}};
      for (const std::vector<Seen>& view : views)
        add_plate(picture, *std::find_if(view.begin(), view.end(), of_plate), view,
                  1.0 / static_cast<double>(views.size()));
      sum_up(picture.reflected);
      sum_up(picture.covered);
      light_plate(picture, *std::find_if(middle.begin(), middle.end(), of_plate));
      result.push_back(std::move(picture));
    }
    return result;
  }

  // -- background

  [[nodiscard]] float lit(const Eigen::Vector3f& place, const Eigen::Vector3f& normal, float reflectance) const {
    return reflectance * illumination(scene.lamp, place, normal);
  }

  /// The station's housing. @param soft  what one line of sight stands for at that place [m]
  [[nodiscard]] float cabinet_front_light(const Eigen::Vector3f& hit, float soft) const {
    const float half = 0.5F * static_cast<float>(scene.room.cabinet_width);
    const float top = static_cast<float>(scene.room.cabinet_height);
    float reflectance =
        static_cast<float>(scene.room.cabinet) * (1.0F + 0.03F * texel(plaster(), hit.y(), hit.z(), 300.0F));
    constexpr float rim = 0.012F;  // a rolled edge that catches the light
    reflectance *=
        1.35F - 0.35F * inside(hit.y(), -half + rim, half - rim, soft) * inside(hit.z(), 0.0F, top - rim, soft);
    reflectance *= 1.0F - 0.55F * inside(hit.z(), 0.657F, 0.663F, soft);  // gap below the hood
    if (hit.z() > 0.69F && hit.z() < 0.87F) {                             // louvres
      const float nearest = 0.04F * std::round((hit.z() - 0.70F) / 0.04F) + 0.70F;
      reflectance *= 1.0F - 0.6F * inside(hit.z(), nearest - 0.008F, nearest + 0.008F, soft) *
                                inside(hit.y(), -0.34F, 0.34F, soft);
    }
    // The plates keep the lamp off the sheet right behind them.
    const float shade = inside(hit.y(), -0.29F, 0.29F, 0.08F) * inside(hit.z(), 0.20F, 0.45F, 0.08F);
    return lit(hit, -Eigen::Vector3f::UnitX(), reflectance) * (1.0F - 0.35F * shade);
  }

  [[nodiscard]] float floor_light(const Eigen::Vector3f& hit, float soft_across, float soft_along) const {
    const Room& room = scene.room;
    float reflectance = static_cast<float>(room.floor) * (1.0F + 0.09F * texel(concrete(), hit.x(), hit.y(), 190.0F));
    const float lane = inside(std::abs(hit.y()), 0.62F, 0.67F, soft_across) * inside(hit.x(), -4.6F, -0.5F, soft_along);
    reflectance += 0.85F * lane * (static_cast<float>(room.marking) - reflectance);
    constexpr float slab = 3.0F;     // m between joints
    constexpr float joint = 0.008F;  // m
    reflectance *= 1.0F - 0.4F * std::min(1.0F, thin_line(from_middle(hit.x(), slab), joint, soft_along) +
                                                    thin_line(from_middle(hit.y() + 0.3F, slab), joint, soft_across));
    // The shadow under and before the cabinet.
    const float half = 0.5F * static_cast<float>(room.cabinet_width);
    const float shade = inside(hit.x(), static_cast<float>(room.cabinet_x) - 0.15F, 9.0F, 0.30F) *
                        inside(hit.y(), -half - 0.1F, half + 0.1F, 0.25F);
    return lit(hit, Eigen::Vector3f::UnitZ(), reflectance) * (1.0F - 0.6F * shade);
  }

  [[nodiscard]] float wall_light(const Eigen::Vector3f& hit, const Eigen::Vector3f& normal, float soft) const {
    const Room& room = scene.room;
    const bool facing = std::abs(normal.x()) > 0.5F;
    const float across = facing ? hit.y() : hit.x();
    float reflectance = static_cast<float>(room.wall) * (1.0F + 0.025F * texel(plaster(), across, hit.z(), 170.0F));
    reflectance *= 1.0F - 0.55F * inside(hit.z(), -1.0F, 0.10F, soft);  // skirting
    reflectance *= 1.0F - 0.2F * inside(hit.z(), 1.20F, 1.215F, soft);  // trunking along the wall
    constexpr float panel = 1.2F;                                       // m between joints
    constexpr float joint = 0.008F;                                     // m
    reflectance *= 1.0F - 0.18F * thin_line(from_middle(across, panel), joint, soft);
    float light = lit(hit, normal, reflectance);
    if (facing && normal.x() < 0.0F) {  // the cabinet's soft shadow
      const float half = 0.5F * static_cast<float>(room.cabinet_width);
      light *= 1.0F - 0.3F * inside(hit.y(), -half - 0.2F, half + 0.1F, 0.2F) *
                          inside(hit.z(), -1.0F, static_cast<float>(room.cabinet_height) + 0.1F, 0.2F);
    }
    return light;
  }

  /// The room from inside, without the cabinet: walls, floor, ceiling.
  [[nodiscard]] float shell_light(const Eigen::Vector3f& lens, const Eigen::Vector3f& ray, float node_angle) const {
    const Room& room = scene.room;
    const auto until = [](float from, float along, float low, float high) {
      if (along > 0.0F) return (high - from) / along;
      return along < 0.0F ? (low - from) / along : 1e9F;
    };
    const float half_width = static_cast<float>(room.half_width);
    const float at_x = until(lens.x(), ray.x(), static_cast<float>(room.back_x), static_cast<float>(room.wall_x));
    const float at_y = until(lens.y(), ray.y(), -half_width, half_width);
    const float at_z = until(lens.z(), ray.z(), 0.0F, static_cast<float>(room.height));
    const float to_wall = std::min(at_x, at_y);
    const Eigen::Vector3f on_wall = lens + ray * to_wall;
    const float soft_wall = node_angle * to_wall;
    // The share of this line of sight that meets a wall above the floor; the rest meets the floor.
    const float wall_share = ray.z() < 0.0F ? std::clamp(0.5F + on_wall.z() / soft_wall, 0.0F, 1.0F) : 1.0F;
    float light = 0.0F;
    if (wall_share > 0.0F) {
      const bool facing = at_x <= at_y;
      const Eigen::Vector3f normal = facing ? Eigen::Vector3f(ray.x() > 0.0F ? -1.0F : 1.0F, 0.0F, 0.0F)
                                            : Eigen::Vector3f(0.0F, ray.y() > 0.0F ? -1.0F : 1.0F, 0.0F);
      light += wall_share * (ray.z() > 0.0F && at_z < to_wall
                                 ? lit(lens + ray * at_z, -Eigen::Vector3f::UnitZ(), static_cast<float>(room.wall))
                                 : wall_light(on_wall, normal, soft_wall));
    }
    if (wall_share < 1.0F) {
      const float to_floor = std::min(at_z, to_wall);
      const float soft = node_angle * to_floor;
      const float steepness = lens.z() / to_floor;  // sine of the angle to the floor, for rays with z = 1
      light += (1.0F - wall_share) * floor_light(lens + ray * to_floor, soft, soft / std::max(0.02F, steepness));
    }
    return light;
  }

  /// Light that comes from where a line of sight ends in the room.
  [[nodiscard]] float room_light(const Eigen::Vector3f& lens, const Eigen::Vector3f& ray, float node_angle) const {
    const Room& room = scene.room;
    const float front = static_cast<float>(room.cabinet_x);
    const float half = 0.5F * static_cast<float>(room.cabinet_width);
    const float top = static_cast<float>(room.cabinet_height);
    constexpr float bottom = 0.06F;  // m; it stands on feet
    float share = 0.0F;
    float light = 0.0F;
    if (ray.x() > 0.0F && lens.x() < front) {
      const float distance = (front - lens.x()) / ray.x();
      const Eigen::Vector3f hit = lens + ray * distance;
      const float soft = node_angle * distance;
      share = inside(hit.y(), -half, half, soft) * inside(hit.z(), bottom, top, soft);
      if (share > 0.0F) light = share * cabinet_front_light(hit, soft);
    }
    const float side = lens.y() > 0.0F ? half : -half;
    if (share < 1.0F && std::abs(lens.y()) > half && ray.y() * side < 0.0F) {
      const float distance = (side - lens.y()) / ray.y();
      const Eigen::Vector3f hit = lens + ray * distance;
      const float soft = node_angle * distance;
      const float more = (1.0F - share) * inside(hit.z(), bottom, top, soft) *
                         inside(hit.x(), front, static_cast<float>(room.wall_x), 1e-3F);
      if (more > 0.0F)
        light += more * lit(hit, Eigen::Vector3f(0.0F, side > 0.0F ? 1.0F : -1.0F, 0.0F),
                            0.8F * static_cast<float>(room.cabinet));
      share += more;
    }
    return share < 1.0F ? light + (1.0F - share) * shell_light(lens, ray, node_angle) : light;
  }

  /// @param band  rows of the image; nodes elsewhere stay zero
  [[nodiscard]] std::vector<float> background(const Eigen::Isometry3d& T_station_camera, const RowBand& band) const {
    const Eigen::Matrix3f rotation = T_station_camera.linear().cast<float>();
    const Eigen::Vector3f lens = T_station_camera.translation().cast<float>();
    const float node_angle = 1.2F * background_step / static_cast<float>(camera.fx);
    std::vector<float> nodes(rays_camera.size());
    const std::size_t first = static_cast<std::size_t>(band.first / background_step) * node_columns;
    const std::size_t end =
        std::min(nodes.size(), (static_cast<std::size_t>((band.end - 1) / background_step) + 2) * node_columns);
    for (std::size_t i = first; i < end; ++i) nodes[i] = room_light(lens, rotation * rays_camera[i], node_angle);
    return nodes;
  }

  // -- the image

  [[nodiscard]] RowBand all_rows() const { return {0, camera.height}; }

  /// The rows in which tags are, with a tag's height above and below them.
  [[nodiscard]] RowBand rows_with_tags(const std::vector<TrueTag>& tags) const {
    double top = camera.height;
    double bottom = 0.0;
    double tall = 0.0;
    for (const TrueTag& tag : tags) {
      double least = tag.corners_px[0].y();
      double most = least;
      for (const Eigen::Vector2d& corner : tag.corners_px) {
        least = std::min(least, corner.y());
        most = std::max(most, corner.y());
      }
      top = std::min(top, least);
      bottom = std::max(bottom, most);
      tall = std::max(tall, most - least);
    }
    if (!(top < bottom)) return all_rows();
    const auto row = [&](double y) { return static_cast<int>(std::clamp(y, 0.0, static_cast<double>(camera.height))); };
    return {row(top - tall), row(bottom + tall)};
  }

  /// Calls `take(y, levels)` with every row of a band of linear grey levels before noise.
  template <class Take>
  void rows_of(const Exposure& exposure, const RowBand& band, Take take) const {
    const std::vector<Eigen::Isometry3d> samples = motion_samples(exposure);
    const std::vector<Picture> plates_seen = pictures(samples);
    const std::vector<float> nodes = background(pose_at(exposure, 0.5), band);
    const float gain = static_cast<float>(sensor.levels_per_ms * exposure.light *
                                          std::chrono::duration<double, std::milli>(exposure.duration).count());
    const float black = static_cast<float>(sensor.black_level);
    std::vector<float> mixed_nodes(node_columns), behind(camera.width), levels(camera.width);
    for (int y = band.first; y < band.end; ++y) {
      const float* above = &nodes[static_cast<std::size_t>(y / background_step) * node_columns];
      const float down = static_cast<float>(y % background_step) / background_step;
      for (int i = 0; i < node_columns; ++i) mixed_nodes[i] = above[i] + down * (above[i + node_columns] - above[i]);
      for (int x = 0; x + 1 < camera.width; x += 2) {
        behind[x] = mixed_nodes[x / 2];
        behind[x + 1] = 0.5F * (mixed_nodes[x / 2] + mixed_nodes[x / 2 + 1]);
      }
      if (camera.width % 2 == 1) behind[camera.width - 1] = mixed_nodes[camera.width / 2];
      levels = behind;
      for (const Picture& picture : plates_seen) add_row(picture, y, behind, levels);
      for (int x = 0; x < camera.width; ++x)
        levels[x] = black + gain * levels[x] * (1.0F - vignetting_x[x] - vignetting_y[y]);
      take(y, levels);
    }
  }

  /// Reflectance times illumination. The spread of a product is not the product of the spreads: the first order of the
  /// difference is variance * slope of illumination * slope of reflectance, 0.2 grey level 3.5 m away.
  void add_row(const Picture& picture, int y, const std::vector<float>& behind, std::vector<float>& levels) const {
    const Patch& patch = picture.reflected;
    const int row = y - patch.y0;
    if (row < 0 || row >= patch.height) return;
    const float* reflected = &patch.values[static_cast<std::size_t>(row) * patch.width];
    const float* above = row > 0 ? reflected - patch.width : reflected;
    const float* below = row + 1 < patch.height ? reflected + patch.width : reflected;
    const float* covered = &picture.covered.values[static_cast<std::size_t>(row) * patch.width];
    const float* light = &picture.light[static_cast<std::size_t>(row / picture.light_step) * picture.light_columns];
    const float down = static_cast<float>(row % picture.light_step) / picture.light_step;
    const auto light_at = [&](int node) {
      return light[node] + down * (light[node + picture.light_columns] - light[node]);
    };
    const float half_variance = 0.5F * static_cast<float>(sensor.psf_sigma_px * sensor.psf_sigma_px + 1.0 / 12.0);
    for (int start = 0; start < patch.width; start += picture.light_step) {
      const int node = start / picture.light_step;
      const float first = light_at(node);
      const float slope_x = (light_at(node + 1) - first) / picture.light_step;
      const float slope_y = (light[node + picture.light_columns] - light[node]) / picture.light_step;
      const int end = std::min(patch.width, start + picture.light_step);
      for (int x = start; x < end; ++x) {
        const float brightness = first + slope_x * static_cast<float>(x - start);
        const float before_x = x > 0 ? reflected[x - 1] : 0.0F;
        const float after_x = x + 1 < patch.width ? reflected[x + 1] : reflected[x];
        levels[patch.x0 + x] += brightness * reflected[x] - covered[x] * behind[patch.x0 + x] +
                                half_variance * (slope_x * (after_x - before_x) + slope_y * (below[x] - above[x]));
      }
    }
  }

  void add_noise_and_round(std::uint64_t seed, int y, std::vector<float>& levels, std::uint8_t* out) const {
    const float read = static_cast<float>(sensor.read_noise * sensor.read_noise);
    const float photon = sensor.electrons_per_level > 0.0 ? static_cast<float>(1.0 / sensor.electrons_per_level) : 0.0F;
    const float black = static_cast<float>(sensor.black_level);
    const int width = camera.width;
    if (read > 0.0F || photon > 0.0F) {
      std::vector<float> sigma(width);
      for (int x = 0; x < width; ++x) sigma[x] = std::sqrt(read + photon * std::max(0.0F, levels[x] - black));
      const std::uint64_t row_key = mixed(mixed(seed) + static_cast<std::uint64_t>(y));
      for (int x = 0, draw = 0; x < width; x += 5, ++draw) {
        std::uint64_t bits = mixed(row_key + static_cast<std::uint64_t>(draw));
        const int end = std::min(width, x + 5);
        for (int i = x; i < end; ++i, bits >>= 12) levels[i] += sigma[i] * quantiles[bits & (quantile_count - 1)];
      }
    }
    constexpr float highest = 255.999F;
    for (int x = 0; x < width; ++x) out[x] = tone[static_cast<int>(8.0F * std::clamp(levels[x], 0.0F, highest))];
  }
};

namespace {

void require_pose(const Exposure& exposure) {
  if (exposure.T_station_camera.empty()) throw std::invalid_argument("an exposure needs at least one camera pose");
}

}  // namespace

Renderer::Renderer(Scene scene, CameraModel camera, Sensor sensor)
    : prepared_(std::make_unique<const Prepared>(std::move(scene), camera, sensor)) {}
Renderer::~Renderer() = default;
Renderer::Renderer(Renderer&&) noexcept = default;
Renderer& Renderer::operator=(Renderer&&) noexcept = default;

Rendering Renderer::render(const Exposure& exposure, std::uint64_t noise_seed, RenderedRows rows) const {
  require_pose(exposure);
  Rendering rendering;
  rendering.tags = prepared_->true_tags(exposure);
  const RowBand band =
      rows == RenderedRows::with_tags ? prepared_->rows_with_tags(rendering.tags) : prepared_->all_rows();
  rendering.gray = cv::Mat1b::zeros(prepared_->camera.height, prepared_->camera.width);
  prepared_->rows_of(exposure, band, [&](int y, std::vector<float>& levels) {
    prepared_->add_noise_and_round(noise_seed, y, levels, rendering.gray.ptr<std::uint8_t>(y));
  });
  return rendering;
}

cv::Mat1f Renderer::render_exact(const Exposure& exposure) const {
  require_pose(exposure);
  cv::Mat1f image(prepared_->camera.height, prepared_->camera.width);
  prepared_->rows_of(exposure, prepared_->all_rows(), [&](int y, const std::vector<float>& levels) {
    std::copy(levels.begin(), levels.end(), image.ptr<float>(y));
  });
  return image;
}

std::vector<TrueTag> Renderer::true_tags(const Exposure& exposure) const {
  require_pose(exposure);
  return prepared_->true_tags(exposure);
}

const CameraModel& Renderer::camera() const { return prepared_->camera; }
const Sensor& Renderer::sensor() const { return prepared_->sensor; }

}  // namespace tagdock
