#include "calibration/rig_check.h"

#include <Eigen/Cholesky>

#include "planning/pose2.h"

namespace tagdock {

RigCheck check_rig(const HandEyeProblem& problem, const Rig& rig) {
  RigCheck check;
  check.now = calibrate_hand_eye(problem);
  const Eigen::Isometry3d& X = check.now.T_base_camera;
  const Eigen::AngleAxisd turn(Eigen::Matrix3d(X.linear() * rig.T_base_camera.linear().transpose()));
  Eigen::Matrix<double, 6, 1> difference;
  difference << X.translation() - rig.T_base_camera.translation(), turn.angle() * turn.axis();
  check.moved_mm = 1000.0 * difference.head<2>().norm();
  check.turned_deg = degrees(turn.angle());
  const Eigen::Matrix<double, 6, 6> covariance = check.now.covariance.topLeftCorner<6, 6>();
  check.surprise = difference.dot(covariance.ldlt().solve(difference));
  check.holds = check.surprise <= check.limit;
  return check;
}

}  // namespace tagdock
