#include "servo/marker_centering.h"

#include <algorithm>
#include <cmath>

#include <visp3/core/vpException.h>
#include <visp3/core/vpHomogeneousMatrix.h>
#include <visp3/core/vpVelocityTwistMatrix.h>
#include <visp3/visual_features/vpFeatureDepth.h>
#include <visp3/visual_features/vpFeaturePoint.h>
#include <visp3/vs/vpServo.h>

namespace tagdock {
namespace {

vpHomogeneousMatrix visp_pose(const Eigen::Isometry3d& pose) {
  vpHomogeneousMatrix result;
  for (unsigned int row = 0; row < 3; ++row) {
    for (unsigned int column = 0; column < 4; ++column) result[row][column] = pose(row, column);
  }
  return result;
}

bool is_usable(const MarkerView& view) {
  return std::isfinite(view.x) && std::isfinite(view.depth) && view.depth > 0.0;
}

}  // namespace

std::optional<MarkerView> marker_view(const Eigen::Isometry3d& T_base_camera,
                                      const Eigen::Isometry3d& T_camera_station) {
  const Eigen::Vector3d middle_station(0.0, 0.0, T_base_camera.translation().z());
  const Eigen::Vector3d middle_camera = T_camera_station * middle_station;
  const MarkerView view{middle_camera.x() / middle_camera.z(), middle_camera.z()};
  if (!is_usable(view)) return std::nullopt;
  return view;
}

std::optional<Twist2> center_marker(const MarkerView& view, double desired_depth,
                                    const Eigen::Isometry3d& T_base_camera, Centering mode,
                                    const MarkerCenteringConfig& config) {
  if (!is_usable(view) || !std::isfinite(desired_depth) || desired_depth <= 0.0) return std::nullopt;
  try {
    vpFeaturePoint point;
    vpFeaturePoint wanted_point;
    point.buildFrom(view.x, 0.0, view.depth);
    wanted_point.buildFrom(0.0, 0.0, desired_depth);
    vpFeatureDepth depth;
    vpFeatureDepth wanted_depth;
    depth.buildFrom(view.x, 0.0, view.depth, std::log(view.depth / desired_depth));
    wanted_depth.buildFrom(0.0, 0.0, desired_depth, 0.0);

    // The end effector is the base (x forward, z up): a differential drive moves along its x and turns about its z.
    vpMatrix eJe(6, 2);
    if (mode == Centering::turn_and_drive) eJe[0][0] = 1.0;
    eJe[5][1] = 1.0;

    vpServo task;
    task.setServo(vpServo::EYEINHAND_L_cVe_eJe);
    task.setInteractionMatrixType(vpServo::CURRENT, vpServo::PSEUDO_INVERSE);
    task.setLambda(mode == Centering::turn_only ? config.turn_gain : config.gain);
    task.set_cVe(vpVelocityTwistMatrix(visp_pose(T_base_camera.inverse())));
    task.set_eJe(eJe);
    task.addFeature(point, wanted_point, vpFeaturePoint::selectX());
    if (mode == Centering::turn_and_drive) task.addFeature(depth, wanted_depth);
    const vpColVector velocity = task.computeControlLaw();
    task.kill();

    const Twist2 command{std::clamp(velocity[0], -config.max_reverse, config.max_speed),
                         std::clamp(velocity[1], -config.max_turn_rate, config.max_turn_rate)};
    if (!is_finite(command)) return std::nullopt;
    return command;
  } catch (const vpException&) {
    return std::nullopt;
  }
}

}  // namespace tagdock
