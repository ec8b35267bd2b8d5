#include "app/simulation/renderer.h"

#include <cmath>
#include <numbers>
#include <random>

#include <apriltag/apriltag.h>
#include <apriltag/tag36h11.h>
#include <catch2/catch.hpp>

#include "calibration/rig.h"
#include "planning/pose2.h"

using namespace tagdock;

namespace {

constexpr double board_height = 0.35;

/// T_station_camera of a level camera at a distance and bearing from the board, turned away from looking at it.
Eigen::Isometry3d looking_at_board(double distance, double bearing_deg, double turned_deg, double height = 0.35) {
  const double bearing = radians(bearing_deg);
  Eigen::Isometry3d T_station_base = Eigen::Isometry3d::Identity();
  T_station_base.linear() =
      Eigen::AngleAxisd(bearing + radians(turned_deg), Eigen::Vector3d::UnitZ()).toRotationMatrix();
  T_station_base.translation() << -distance * std::cos(bearing), -distance * std::sin(bearing), 0.0;
  return T_station_base * level_camera(0.0, height);
}

Eigen::Isometry3d rolled(const Eigen::Isometry3d& T_station_camera, double roll_deg, double pitch_deg) {
  return T_station_camera * Eigen::AngleAxisd(radians(roll_deg), Eigen::Vector3d::UnitZ()) *
         Eigen::AngleAxisd(radians(pitch_deg), Eigen::Vector3d::UnitX());
}

/// A scene in which nothing but the plates sends light, so that the truth behind them is known.
Scene dark_room() {
  Scene scene;
  scene.board = default_board(board_height);
  scene.room.wall = scene.room.floor = scene.room.marking = scene.room.cabinet = 0.0;
  return scene;
}

Sensor sensor_with(double psf_sigma_px) {
  Sensor sensor;
  sensor.psf_sigma_px = psf_sigma_px;
  sensor.vignetting = 0.0;
  return sensor;
}

CameraModel small_camera() {
  CameraModel camera = default_rig().camera;
  camera.width = 640;
  camera.height = 512;
  camera.cx = 321.3;
  camera.cy = 254.6;
  camera.fx = camera.fy = 614.0;
  return camera;
}

/// The modules of tag36h11 from the library's code table: black outside the code, white around that.
bool is_white(int id, double column, double row) {
  static apriltag_family_t* const family = tag36h11_create();
  const int c = static_cast<int>(std::floor(column));
  const int r = static_cast<int>(std::floor(row));
  if (c < 0 || r < 0 || c > 7 || r > 7) return true;
  for (unsigned bit = 0; bit < family->nbits; ++bit)
    if (static_cast<int>(family->bit_x[bit]) == c && static_cast<int>(family->bit_y[bit]) == r)
      return (family->codes[id] >> (family->nbits - 1 - bit)) & 1U;
  return false;
}

/// What light comes to the lens along one line of sight, traced without anything of the renderer.
class Tracer {
 public:
  Tracer(const Scene& scene, const Eigen::Isometry3d& T_station_camera) : scene_(scene) {
    for (const BoardTag& tag : scene.board.tags)
      add(tag.T_station_tag, tag.id, tag.size, 1.25 * tag.size, 1.25 * tag.size, T_station_camera);
    for (const Stain& stain : scene.stains)
      add(stain.T_station_stain, -1, stain.reflectance, stain.width, stain.height, T_station_camera);
  }

  [[nodiscard]] double light(const Eigen::Vector2d& ideal) const {
    double nearest = 1e9;
    double result = 0.0;
    for (const Plane& plane : planes_) {
      const Eigen::Vector3d ray = plane.T_plate_camera.linear() * ideal.homogeneous();
      if (ray.z() <= 0.0) continue;
      const double distance = -plane.T_plate_camera.translation().z() / ray.z();
      const Eigen::Vector3d hit = plane.T_plate_camera.translation() + distance * ray;
      if (distance <= 0.0 || distance >= nearest) continue;
      if (std::abs(hit.x()) > 0.5 * plane.width || std::abs(hit.y()) > 0.5 * plane.height) continue;
      nearest = distance;
      double reflectance = plane.size_or_reflectance;
      if (plane.id >= 0) {
        const double module = plane.size_or_reflectance / 8.0;
        reflectance = is_white(plane.id, hit.x() / module + 4.0, hit.y() / module + 4.0) ? scene_.white : scene_.black;
      }
      const Eigen::Vector3d way = scene_.lamp.position_station - plane.T_station_plate * hit;
      const double facing = -plane.T_station_plate.linear().col(2).dot(way);
      result = reflectance * (scene_.lamp.ambient + scene_.lamp.strength * facing / std::pow(way.norm(), 3));
    }
    return result;
  }

 private:
  struct Plane {
    Eigen::Isometry3d T_station_plate, T_plate_camera;
    int id;
    double size_or_reflectance, width, height;
  };

  void add(const Eigen::Isometry3d& T_station_plate, int id, double size_or_reflectance, double width, double height,
           const Eigen::Isometry3d& T_station_camera) {
    planes_.push_back(
        {T_station_plate, T_station_plate.inverse() * T_station_camera, id, size_or_reflectance, width, height});
  }

  Scene scene_;
  std::vector<Plane> planes_;
};

/// One pixel by brute force: a Fibonacci lattice of lines of sight, spread as a Gaussian plus the pixel's square.
class Quadrature {
 public:
  explicit Quadrature(double sigma) {
    // The distribution of (Gaussian + uniform), inverted from its density summed in steps of 1e-3 px.
    constexpr double step = 1e-3;
    const double reach = 6.0 * sigma + 0.5;
    std::vector<double> places{-reach}, cumulative{0.0};
    for (double x = -reach; x < reach; x += step) {
      double density = 0.0;
      for (int i = 0; i < 50; ++i) {
        const double offset = (x + 0.5 * step - ((i + 0.5) / 50.0 - 0.5)) / sigma;
        density += std::exp(-0.5 * offset * offset) / 50.0;
      }
      places.push_back(x + step);
      cumulative.push_back(cumulative.back() + density);
    }
    std::vector<double> quantiles;
    std::size_t at = 0;
    for (int i = 0; i < count; ++i) {
      const double wanted = cumulative.back() * (i + 0.5) / count;
      while (cumulative[at + 1] < wanted) ++at;
      quantiles.push_back(places[at] + (places[at + 1] - places[at]) * (wanted - cumulative[at]) /
                                           (cumulative[at + 1] - cumulative[at]));
    }
    for (std::int64_t i = 0; i < count; ++i) offsets_.emplace_back(quantiles[i], quantiles[(i * previous) % count]);
    reach_ = static_cast<int>(std::ceil(reach));
  }

  [[nodiscard]] double pixel(const CameraModel& camera, const Tracer& tracer, int x, int y) const {
    // Lines of sight by bilinear interpolation between those of whole pixels: off by 1e-5 px at most.
    const int side = 2 * reach_ + 2;
    std::vector<Eigen::Vector2d> grid;
    for (int j = 0; j < side; ++j)
      for (int i = 0; i < side; ++i)
        grid.push_back(unproject(camera, {double(x - reach_ + i), double(y - reach_ + j)}).value());
    double sum = 0.0;
    for (const Eigen::Vector2d& offset : offsets_) {
      const double px = offset.x() + reach_;
      const double py = offset.y() + reach_;
      const int i = static_cast<int>(px);
      const int j = static_cast<int>(py);
      const double fx = px - i;
      const double fy = py - j;
      const Eigen::Vector2d* row = &grid[j * side + i];
      sum +=
          tracer.light((1 - fy) * ((1 - fx) * row[0] + fx * row[1]) + fy * ((1 - fx) * row[side] + fx * row[side + 1]));
    }
    return sum / count;
  }

 private:
  // Neighbouring Fibonacci numbers. Against a straight edge the lattice is off by about count^(-3/4) of the step:
  // 0.03 grey level of 160.
  static constexpr int count = 121393;
  static constexpr std::int64_t previous = 75025;
  std::vector<Eigen::Vector2d> offsets_;
  int reach_ = 0;
};

/// Largest difference between the renderer and brute force over pixels drawn where the image changes.
double worst_pixel(const Scene& scene, const Eigen::Isometry3d& T_station_camera, double psf_sigma_px, int pixels,
                   unsigned seed) {
  const CameraModel camera = small_camera();
  const Sensor sensor = sensor_with(psf_sigma_px);
  const Renderer renderer(scene, camera, sensor);
  Exposure exposure;
  exposure.T_station_camera = {T_station_camera};
  const cv::Mat1f image = renderer.render_exact(exposure);
  const Tracer tracer(scene, T_station_camera);
  const Quadrature quadrature(psf_sigma_px);
  std::mt19937 random(seed);
  double worst = 0.0;
  for (int taken = 0, tries = 0; taken < pixels && tries < 2000000; ++tries) {
    const int x = static_cast<int>(random() % (camera.width - 40)) + 20;
    const int y = static_cast<int>(random() % (camera.height - 40)) + 20;
    const float slope = std::abs(image(y, x + 1) - image(y, x - 1)) + std::abs(image(y + 1, x) - image(y - 1, x));
    if (slope < 10.0F) continue;
    ++taken;
    const double truth = sensor.black_level + sensor.levels_per_ms * 5.0 * quadrature.pixel(camera, tracer, x, y);
    worst = std::max(worst, std::abs(image(y, x) - truth));
  }
  return worst;
}

}  // namespace

TEST_CASE("a rendered pixel is off by less than 0.1 grey level from brute-force quadrature") {
  // 0.1 grey level of a 160-level step moves an edge by 0.001 px, a tenth of what the corners are asked for.
  const Scene scene = dark_room();
  unsigned seed = 100;
  SECTION("upright and turned by 1, 3, 20 and 45 degrees in the image") {
    for (const double roll_deg : {0.0, 1.0, 3.0, 20.0, 45.0}) {
      CAPTURE(roll_deg);
      CHECK(worst_pixel(scene, rolled(looking_at_board(1.2, 7.0, 1.0), roll_deg, 0.5), 0.7, 40, ++seed) < 0.1);
    }
  }
  SECTION("spread from 0.3 to 2.5 px") {
    for (const double psf_sigma_px : {0.3, 0.45, 1.0, 1.6, 2.5}) {
      CAPTURE(psf_sigma_px);
      CHECK(worst_pixel(scene, rolled(looking_at_board(1.6, -12.0, 2.0), 3.0, 1.0), psf_sigma_px, 40, ++seed) < 0.1);
    }
  }
  SECTION("up to 75 degrees from a plate's normal, and far away") {
    CHECK(worst_pixel(scene, looking_at_board(1.5, 45.0, 9.0), 0.7, 40, ++seed) < 0.1);
    CHECK(worst_pixel(scene, rolled(looking_at_board(3.5, 26.0, 18.0), 0.0, 10.0), 0.7, 40, ++seed) < 0.1);
  }
}

TEST_CASE("what stands in front hides what stands behind, exactly") {
  Scene scene = dark_room();
  SECTION("a stain on the centre tag") {
    Stain stain;
    stain.T_station_stain =
        upright_tag(-0.053, 0.031, board_height + 0.02, 0.0) * Eigen::AngleAxisd(0.4, Eigen::Vector3d::UnitZ());
    stain.width = 0.05;
    scene.stains.push_back(stain);
    CHECK(worst_pixel(scene, looking_at_board(1.0, 5.0, 0.0), 0.7, 60, 7) < 0.1);
  }
  SECTION("a plate half a metre before the board, over the edges of two") {
    scene.board.tags.push_back({7, 0.08, upright_tag(-0.5, 0.06, board_height - 0.05, 0.3)});
    CHECK(worst_pixel(scene, looking_at_board(1.6, 0.0, 0.0), 0.7, 60, 8) < 0.1);
  }
  SECTION("a board that leaves the image") {
    CHECK(worst_pixel(scene, looking_at_board(0.9, 0.0, 22.0), 0.7, 40, 9) < 0.1);
  }
}

TEST_CASE("true corners are projections, say what is hidden, and leave out what cannot be seen") {
  Scene scene = dark_room();
  const CameraModel camera = default_rig().camera;
  Exposure exposure;
  exposure.T_station_camera = {looking_at_board(2.0, 10.0, 3.0)};
  const Renderer renderer(scene, camera, Sensor{});
  const std::vector<TrueTag> tags = renderer.true_tags(exposure);
  REQUIRE(tags.size() == 3);
  for (const TrueTag& tag : tags) {
    CHECK(tag.fully_visible);
    const TagPoints corners = corners_station(*find_tag(scene.board, tag.id));
    for (int i = 0; i < 4; ++i) {
      const Eigen::Vector2d expected = project(camera, exposure.T_station_camera[0].inverse() * corners[i]);
      CHECK((tag.corners_px[i] - expected).norm() < 1e-9);  // px; rounding
    }
    CHECK(tag.corners_px[0].x() < tag.corners_px[1].x());  // read from the left
    CHECK(tag.corners_px[0].y() < tag.corners_px[3].y());  // read from the top
  }

  scene.board.tags.push_back({9, 0.10, upright_tag(-0.6, 0.1, board_height, 0.0)});
  const std::vector<TrueTag> hidden = Renderer(scene, camera, Sensor{}).true_tags(exposure);
  REQUIRE(hidden.size() == 4);
  CHECK(std::count_if(hidden.begin(), hidden.end(), [](const TrueTag& tag) { return tag.fully_visible; }) < 4);

  exposure.T_station_camera = {looking_at_board(2.0, 10.0, 180.0)};
  CHECK(renderer.true_tags(exposure).empty());
  exposure.T_station_camera = {looking_at_board(2.0, 180.0, 0.0)};  // behind the board
  CHECK(renderer.true_tags(exposure).empty());
}

TEST_CASE("motion blur is the mean over the exposure") {
  const Scene scene = dark_room();
  const double psf_sigma_px = GENERATE(0.4, 0.7, 1.5);
  const Renderer renderer(scene, small_camera(), sensor_with(psf_sigma_px));
  // Turned by 0.0015 rad and driven by 1 mm: 0.9 px sideways at 614 px focal length, as at 0.3 rad/s and 0.2 m/s in
  // 5 ms; and four times as much.
  const double factor = GENERATE(0.05, 1.0, 4.0);
  const auto pose = [&](double share) {
    return looking_at_board(1.5 - 0.001 * factor * share, 3.0, degrees(0.0015) * factor * share);
  };
  Exposure moving;
  moving.T_station_camera = {pose(0.0), pose(1.0)};
  const cv::Mat1f blurred = renderer.render_exact(moving);
  cv::Mat1f mean(blurred.size(), 0.0F);
  constexpr int count = 60;
  for (int i = 0; i < count; ++i) {
    Exposure still;
    still.T_station_camera = {pose((i + 0.5) / count)};
    mean += renderer.render_exact(still) / count;
  }
  double worst = 0.0;
  for (int y = 0; y < mean.rows; ++y)
    for (int x = 0; x < mean.cols; ++x) worst = std::max(worst, double(std::abs(mean(y, x) - blurred(y, x))));
  CAPTURE(psf_sigma_px, factor);
  CHECK(worst < 0.1);  // grey levels, as for a still image
  // The truth is that of mid-exposure.
  Exposure middle;
  middle.T_station_camera = {pose(0.5)};
  const auto tags = renderer.true_tags(moving);
  const auto tags_middle = renderer.true_tags(middle);
  REQUIRE(tags.size() == tags_middle.size());
  for (std::size_t i = 0; i < tags.size(); ++i)
    CHECK((tags[i].corners_px[0] - tags_middle[i].corners_px[0]).norm() < 1e-5);  // px; the turn is cut into slerps
}

TEST_CASE("the same exposure and seed give the same bytes, another seed gives the stated noise") {
  Scene scene;
  scene.board = default_board(board_height);
  Sensor sensor;
  const Renderer renderer(scene, small_camera(), sensor);
  Exposure exposure;
  exposure.T_station_camera = {looking_at_board(1.5, 3.0, 0.0)};
  const cv::Mat1b first = renderer.render(exposure, 5).gray;
  const cv::Mat1b again = Renderer(scene, small_camera(), sensor).render(exposure, 5).gray;
  const cv::Mat1b other = renderer.render(exposure, 6).gray;
  CHECK(cv::norm(first, again, cv::NORM_INF) == 0.0);
  CHECK(cv::norm(first, other, cv::NORM_INF) > 0.0);

  // Residuals against the noise-free image, divided by the stated sigma; rounding adds 1/12.
  const cv::Mat1f exact = renderer.render_exact(exposure);
  double sum = 0.0;
  double squares = 0.0;
  double neighbours = 0.0;
  double last = 0.0;
  for (int y = 0; y < exact.rows; ++y)
    for (int x = 0; x < exact.cols; ++x) {
      const double variance = sensor.read_noise * sensor.read_noise + 1.0 / 12.0 +
                              (exact(y, x) - sensor.black_level) / sensor.electrons_per_level;
      const double residual = (first(y, x) - exact(y, x)) / std::sqrt(variance);
      sum += residual;
      squares += residual * residual;
      neighbours += residual * last;
      last = residual;
    }
  const double count = static_cast<double>(exact.total());
  CHECK(std::abs(sum / count) < 4.0 / std::sqrt(count));         // 4 sigma of a mean
  CHECK(squares / count == Approx(1.0).margin(0.01));            // 4 sigma of a variance is 0.010
  CHECK(std::abs(neighbours / count) < 4.0 / std::sqrt(count));  // no correlation along the rows
}

TEST_CASE("more light, a longer exposure and a steeper tone curve brighten the image as they should") {
  const Scene scene = dark_room();
  const Sensor sensor = sensor_with(0.7);
  const Renderer renderer(scene, small_camera(), sensor);
  Exposure exposure;
  exposure.T_station_camera = {looking_at_board(1.5, 3.0, 0.0)};
  const cv::Mat1f normal = renderer.render_exact(exposure);
  exposure.duration *= 2;
  const cv::Mat1f longer = renderer.render_exact(exposure);
  exposure.duration /= 2;
  exposure.light = 0.25;
  const cv::Mat1f darker = renderer.render_exact(exposure);
  const float black = static_cast<float>(sensor.black_level);
  double worst = 0.0;
  for (int y = 0; y < normal.rows; ++y)
    for (int x = 0; x < normal.cols; ++x) {
      worst = std::max(worst, double(std::abs(longer(y, x) - black - 2.0F * (normal(y, x) - black))));
      worst = std::max(worst, double(std::abs(darker(y, x) - black - 0.25F * (normal(y, x) - black))));
    }
  CHECK(worst < 1e-3);  // grey levels; single precision

  Sensor curved = sensor;
  curved.gamma = 2.2;
  curved.read_noise = 0.0;
  curved.electrons_per_level = 0.0;
  exposure.light = 1.0;
  const cv::Mat1b bytes = Renderer(scene, small_camera(), curved).render(exposure, 1).gray;
  double worst_curved = 0.0;
  for (int y = 0; y < normal.rows; ++y)
    for (int x = 0; x < normal.cols; ++x)
      worst_curved = std::max(
          worst_curved, std::abs(bytes(y, x) - std::min(255.0, 255.0 * std::pow(normal(y, x) / 255.0, 1.0 / 2.2))));
  CHECK(worst_curved < 0.8);  // half a grey level of rounding and a sixteenth of a linear level before the curve
}

TEST_CASE("a renderer refuses what cannot be") {
  Scene scene = dark_room();
  Sensor sensor;
  sensor.psf_sigma_px = 0.1;
  CHECK_THROWS_WITH(Renderer(scene, small_camera(), sensor), Catch::Contains("psf_sigma_px"));
  sensor.psf_sigma_px = 9.0;
  CHECK_THROWS_WITH(Renderer(scene, small_camera(), sensor), Catch::Contains("psf_sigma_px"));
  scene.board.family = "tag99";
  CHECK_THROWS_WITH(Renderer(scene, small_camera(), Sensor{}), Catch::Contains("tag99"));
  scene = dark_room();
  scene.board.tags[0].id = 587;
  CHECK_THROWS_WITH(Renderer(scene, small_camera(), Sensor{}), Catch::Contains("587"));
  const Renderer renderer(dark_room(), small_camera(), Sensor{});
  Exposure never;
  never.T_station_camera.clear();
  CHECK_THROWS_WITH(renderer.render(never, 1), Catch::Contains("camera pose"));
  CHECK_THROWS_WITH(renderer.render_exact(never), Catch::Contains("camera pose"));
  CHECK_THROWS_WITH(renderer.true_tags(never), Catch::Contains("camera pose"));
}
