#pragma once

#include <array>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Core>
#include <Eigen/Geometry>

#include "calibration/board_pose.h"
#include "calibration/camera_model.h"
#include "calibration/projection_difference.h"

namespace tagdock {

/// What one picture of the board gave.
struct CalibrationView {
  std::string name;
  std::vector<SeenPoint> corners;
  int corners_expected = 0;
  int marks_found = 0;
  int marks_elsewhere = 0;
  double blur_px = 0.0;      ///< in the worst direction; 0: not known
  double sharpest_px = 0.0;  ///< in the best direction
  double clipped = 0.0;      ///< share of pixels at the sensor's end
  double contrast = 0.0;     ///< grey levels
};

/// Lens models, each with everything of the one before.
enum class LensModel { k1, k1_k2, brown4, brown5, rational };
std::string_view word(LensModel model);

struct IntrinsicsConfig {
  std::optional<LensModel> lens;  ///< none: chosen by the error on views set aside
  bool flat_board = false;        ///< do not let the board bend: to see what that does
  /// Only enough to see corners through the lens: no ladder, no halves, no verdict on the model.
  bool lens_only = false;
  double most_sigma_px = 1.0;  ///< a larger uncertainty anywhere in the image is refused
};

/// The board as it is: how far it bends out of its plane, and how much longer its x than its y lengths were printed.
/// z is added as sum of w_i times a power of u and v, which run from -1 to 1 over the board.
struct BoardShape {
  static constexpr int values = 13;
  static constexpr int stretch = 10;   ///< relative
  static constexpr int ink = 11;       ///< how far free-standing squares reach beyond what was drawn, to each side [m]
  static constexpr int growth = 12;    ///< and what corner fits take their sides to be off [px]
  std::array<double, values> value{};  ///< m for u2 v2 uv u2v2 u3 v3 u2v uv2 u4 v4; then as above
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  Eigen::Vector2d half = Eigen::Vector2d::Ones();  ///< m
  [[nodiscard]] Eigen::Vector3d bent(const Eigen::Vector3d& point) const;
  /// Between the highest and the lowest place, after the best plane was taken out [m].
  [[nodiscard]] double bow() const;
};

struct ViewResidual {
  std::string name;
  bool used = false;
  std::string reason;  ///< why it was not used
  int corners = 0;
  int corners_set_aside = 0;
  double rms_px = 0.0;
  double blur_px = 0.0;
  double tilt_deg = 0.0;      ///< between the board's normal and the optical axis
  double tilt_way_deg = 0.0;  ///< in the image, 0 right, 90 down
  double distance = 0.0;      ///< m
  Eigen::Isometry3d T_camera_board = Eigen::Isometry3d::Identity();
};

/// What a corner left.
struct CornerLeft {
  std::size_t view = 0;
  Eigen::Vector2d pixel = Eigen::Vector2d::Zero();
  Eigen::Vector2d residual = Eigen::Vector2d::Zero();  ///< px
  Eigen::Vector2d board = Eigen::Vector2d::Zero();     ///< m
  int tag = -1;                                        ///< that stands free and has this corner; -1: none
};

struct IntrinsicsResult {
  CameraModel camera;
  LensModel lens = LensModel::brown5;
  BoardShape board;
  /// Of fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6; zero where the lens model has no such term.
  Eigen::Matrix<double, 12, 12> covariance = Eigen::Matrix<double, 12, 12>::Zero();
  ImageMap sigma;             ///< x: root of the mean square length of the projection's error [px]; y: 0
  double sigma_max_px = 0.0;  ///< largest over the image
  double sigma_center_px = 0.0;
  double rms_px = 0.0;       ///< of all coordinates used
  double noise_scale = 1.0;  ///< corner noise over what the corner fits claimed
  std::vector<ViewResidual> views;
  std::vector<CornerLeft> corners;
  struct Step {
    LensModel lens;
    double held_out;  ///< rms over views that the solution had not seen, in sigmas of their corners
  };
  std::vector<Step> ladder;
  /// Mean product of the residuals of neighbouring corners of a view over their mean square: near 0 when noise is all
  /// that is left, towards 1 when the model of lens or board is wrong.
  double neighbours_agree = 0.0;
  double systematic_px = 0.0;  ///< the part of rms_px that neighbours share
  // Two halves of the views, solved apart.
  double halves_px = 0.0;           ///< rms of their difference over the image
  double halves_expected_px = 0.0;  ///< what their uncertainties promise
  ImageMap halves;
  std::vector<std::string> missing;     ///< views that would help most, for a person
  std::vector<std::string> complaints;  ///< why it is refused; empty if good
};

/// Camera, board shape and all views' poses at once from corner pixels, with a robust loss (Ceres). Views are first
/// judged (blur, motion, saturation, duplicates, another board, too few corners), lens models are chosen by the error
/// on views set aside, and two halves of the views are compared with what their uncertainties promise: notes on
/// calibration, sections 2 and 4.
/// Throws std::invalid_argument if no view shows the board.
IntrinsicsResult calibrate_intrinsics(const std::vector<CalibrationView>& views, int width, int height,
                                      const IntrinsicsConfig& config = {});

/// A view that one might take.
struct ViewWish {
  std::string sentence;  ///< for a person
  Eigen::Isometry3d T_camera_board = Eigen::Isometry3d::Identity();
  double sigma_after_px = 0.0;  ///< mean projection uncertainty when it is added
};

/// The views that would lower the uncertainty most, best first.
/// @param points  of the board
std::vector<ViewWish> next_best_views(const IntrinsicsResult& result, const std::vector<Eigen::Vector3d>& points,
                                      std::size_t count);

/// Root of the mean square length of the projection's error over the image, at infinity, after the best turn: x of each
/// value [px]. `covariance` as in IntrinsicsResult.
ImageMap projection_sigma(const CameraModel& camera, const Eigen::Matrix<double, 12, 12>& covariance, int columns = 24,
                          int rows = 18);

/// d(pixel) / d(fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6) for a line of sight (x/z, y/z).
Eigen::Matrix<double, 2, 12> pixel_by_lens(const CameraModel& camera, const Eigen::Vector2d& ideal);

/// Judges views before anything is solved. Sets `used` and `reason`.
/// Limits are relative to the sharpest quarter of the views, so that they hold for any lens.
std::vector<ViewResidual> judge_views(const std::vector<CalibrationView>& views);

}  // namespace tagdock
