#include "calibration/rig.h"

namespace tagdock {

Eigen::Isometry3d level_camera(double ahead, double height) {
  Eigen::Isometry3d T_base_camera = Eigen::Isometry3d::Identity();
  T_base_camera.linear() << 0.0, 0.0, 1.0,  // camera z is base x
      -1.0, 0.0, 0.0,                       // camera x is base -y
      0.0, -1.0, 0.0;                       // camera y is base -z
  T_base_camera.translation() << ahead, 0.0, height;
  return T_base_camera;
}

Rig default_rig() {
  Rig rig;
  constexpr double focal_px = 5.9e-3 / 4.8e-6;
  rig.camera = {.width = 1280,
                .height = 1024,
                .fx = focal_px,
                .fy = focal_px,
                .cx = 642.3,
                .cy = 509.6,
                .k1 = -0.11,
                .k2 = 0.07,
                .p1 = 0.0003,
                .p2 = -0.0002,
                .k3 = 0.0};
  rig.T_base_camera = level_camera(0.35, 0.35);
  rig.odometry = {.r_left = 0.10, .r_right = 0.10, .track = 0.60};
  return rig;
}

}  // namespace tagdock
