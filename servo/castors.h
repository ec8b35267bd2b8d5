#pragma once

#include "planning/pose2.h"

namespace tagdock {

/// What is known of the castors of a base with a differential drive: pivots before and behind the axle, on its middle
/// line. Their friction is not known well; PoseFilter estimates it while the robot drives.
struct CastorConfig {
  double front = 0.45;  ///< m, pivot before the axle; 0 is none
  double rear = 0.45;   ///< m, pivot behind the axle; 0 is none
  double trail = 0.05;  ///< m, from the pivot to the wheel's contact
  /// Spin of a castor on its contact, per metre of travel, at which its scrub is at tanh(1) of its limit [1/m].
  double creepage = 1.5;
  double scrub = 0.17;         ///< rad/m; how fast castors at the limit of their scrub turn the robot: first guess ...
  double scrub_sigma = 0.10;   ///< ... and how wrong it may be
  double scrub_wander = 0.02;  ///< rad/m per sqrt(m); how fast it changes along the way
};

/// Angle of the castors to the body [rad]; 0 trails in forward travel.
struct CastorAngles {
  double front = 0.0;
  double rear = 0.0;
};

/// What the castors do over a motion of the axle.
struct CastorPush {
  CastorAngles after;
  double around = 0.0;  ///< turn of the robot per scrub [rad per rad/m]
  double aside = 0.0;   ///< shift of the axle to the left per scrub [m per rad/m]
};

/// Castors swivel behind their pivots and scrub while they do; the drive wheels creep under that push.
/// Source: notes on docking, 4.2, with the castors of one side of the axle taken as one.
/// @param motion  of the base by its wheels, in the body frame
/// @param track   of the drive wheels [m]
CastorPush push(const CastorAngles& before, const Pose2& motion, double track, const CastorConfig& config);

/// The turn that castors at an angle give back once the robot drives straight on, per scrub [rad per rad/m]: the
/// integral of `push` over their swivelling back, with tanh(x)/x taken as 1/sqrt(1 + x^2) (within 5.3 %).
double held_back(const CastorAngles& angles, const CastorConfig& config);

/// The same once the castors have settled to a curvature [1/m], forward.
double held_back_in_turn(double curvature, const CastorConfig& config);

/// The distance by which the heading of a robot lags behind its wheels in a gentle change of curvature [m]:
/// psi = theta - lag * kappa.
double heading_lag(double scrub, const CastorConfig& config);

}  // namespace tagdock
