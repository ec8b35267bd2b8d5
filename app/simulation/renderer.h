#pragma once

#include <chrono>
#include <cstdint>
#include <memory>
#include <vector>

#include <Eigen/Geometry>
#include <opencv2/core.hpp>

#include "calibration/camera_model.h"
#include "calibration/target.h"

namespace tagdock {

/// A lamp without a size, and light from everywhere. "Illumination" is without a unit: 1 is what the sensor's
/// sensitivity is given for.
struct Lamp {
  Eigen::Vector3d position_station{-2.2, 0.9, 2.6};  ///< m
  double strength = 8.0;                             ///< illumination of a surface that faces the lamp from 1 m
  double ambient = 0.5;                              ///< illumination from everywhere

  bool operator==(const Lamp&) const = default;
};

/// What stands around the board. It is only seen, never measured, so it is drawn coarsely.
struct Room {
  double wall_x = 0.45;          ///< the wall behind the station [m, station frame]
  double back_x = -8.0;          ///< the wall opposite [m, station frame]
  double half_width = 3.5;       ///< m
  double height = 3.2;           ///< m
  double wall = 0.55;            ///< reflectance, 0..1, as all that follow
  double floor = 0.34;           ///< concrete
  double marking = 0.70;         ///< lane lines beside the way into the dock
  double cabinet = 0.24;         ///< the station's housing
  double cabinet_x = 0.07;       ///< its front [m, station frame]
  double cabinet_width = 0.90;   ///< m
  double cabinet_height = 0.95;  ///< m

  bool operator==(const Room&) const = default;
};

/// A plain rectangle in front of the board: dirt on a tag, a cable, a label.
struct Stain {
  Eigen::Isometry3d T_station_stain = Eigen::Isometry3d::Identity();  ///< axes as a tag's: x right, y down, z away
  double width = 0.03;                                                ///< m
  double height = 0.03;                                               ///< m
  double reflectance = 0.3;
};

/// Everything that can be seen.
struct Scene {
  Board board;
  double white = 0.85;          ///< reflectance of the tags' white
  double black = 0.06;          ///< reflectance of the tags' black
  double border_modules = 1.0;  ///< white around the black square, in the tag's modules; 1 makes 0.20 m of 0.16 m
  std::vector<Stain> stains;
  Lamp lamp;
  Room room;
};

/// From light to grey levels.
struct Sensor {
  double psf_sigma_px = 0.7;          ///< Gaussian spread before the pixel's square; 0.25 to 3.5
  double levels_per_ms = 40.0;        ///< grey levels of reflectance 1 under illumination 1, per ms of exposure
  double black_level = 8.0;           ///< grey levels without light
  double read_noise = 1.0;            ///< sigma [grey levels], everywhere
  double electrons_per_level = 40.0;  ///< photon noise: variance = level / this [grey levels^2]; 0 switches it off
  double gamma = 1.0;                 ///< tone curve: 255 (level / 255)^(1 / gamma)
  double vignetting = 0.06;           ///< share of light lost at the image's corners, growing with the square of radius

  bool operator==(const Sensor&) const = default;
};

/// The open shutter.
struct Exposure {
  /// Equally spaced in time from opening to closing; one pose for a camera at rest. Between them the camera moves
  /// evenly.
  std::vector<Eigen::Isometry3d> T_station_camera{Eigen::Isometry3d::Identity()};
  std::chrono::nanoseconds duration = std::chrono::milliseconds(5);
  double light = 1.0;  ///< factor on all illumination: somebody switched lamps on or off
};

/// What a tag truly looks like at mid-exposure. For tests and evaluation only; nothing that docks may see it.
struct TrueTag {
  int id = 0;
  Corners corners_px;
  Eigen::Isometry3d T_camera_tag = Eigen::Isometry3d::Identity();
  bool fully_visible = false;  ///< with its white border: inside the image, and nothing in front of it
};

struct Rendering {
  cv::Mat1b gray;
  std::vector<TrueTag> tags;  ///< those that face the camera and are at least partly inside the image
};

/// Which rows of an image are made. Those with tags (and a tag's height above and below) are the same bytes either way;
/// they take a quarter of the time, for campaigns that only look at the board.
enum class RenderedRows { all, with_tags };

/// Makes the image that a camera takes of the board in its room.
///
/// Tags are exact: every border between two modules is projected through the lens (curved sides are cut until a piece
/// departs less than 2e-4 px from its chord) and its contribution to each pixel is integrated in closed form across
/// and by Gauss quadrature along the piece, for a Gaussian spread convolved with the pixel's square (Green's theorem:
/// the blurred picture of an area is a line integral around it). Nearer plates cut holes into those behind them.
/// Motion blur is the mean over the exposure, by two-point Gauss quadrature over intervals of 1.4 spreads of path. The
/// illumination is taken as linear over the width of the spread. Against brute-force quadrature the worst pixel is off
/// by less than 0.1 grey level, up to 75 degrees from a plate's normal (tests/app/renderer_test.cpp). Everything else
/// is a coarse background that only looks like a room.
///
/// Values in, values out: the same arguments give the same bytes.
class Renderer {
 public:
  /// Throws std::invalid_argument for an unknown family or id, and for values that no sensor can have.
  Renderer(Scene scene, CameraModel camera, Sensor sensor);
  ~Renderer();
  Renderer(Renderer&&) noexcept;
  Renderer& operator=(Renderer&&) noexcept;

  /// @param noise_seed  one number a frame
  /// @param rows        those that are made; the others are black
  [[nodiscard]] Rendering render(const Exposure& exposure, std::uint64_t noise_seed,
                                 RenderedRows rows = RenderedRows::all) const;

  /// The same before noise, tone curve and rounding: grey levels, unclipped. For self-tests.
  [[nodiscard]] cv::Mat1f render_exact(const Exposure& exposure) const;

  /// The truth alone, without making an image.
  [[nodiscard]] std::vector<TrueTag> true_tags(const Exposure& exposure) const;

  [[nodiscard]] const CameraModel& camera() const;
  [[nodiscard]] const Sensor& sensor() const;

 private:
  struct Prepared;
  std::unique_ptr<const Prepared> prepared_;
};

}  // namespace tagdock
