#pragma once

#include "calibration/hand_eye.h"
#include "calibration/rig.h"

namespace tagdock {

/// Whether a rig still holds, from some stops (the two-minute check).
struct RigCheck {
  HandEyeResult now;        ///< what the stops say by themselves
  double moved_mm = 0.0;    ///< the camera's place in the floor plane against the rig
  double turned_deg = 0.0;  ///< its direction
  double surprise = 0.0;    ///< d' C^-1 d over the six values; above `limit` chance does not explain it
  double limit = 22.5;      ///< one in a thousand of a chi square with six degrees of freedom
  bool holds = false;
};

/// Solves the stops anew and compares with the rig, direction by direction as well as the stops know it: what they
/// leave open does not count. Throws as `calibrate_hand_eye`.
RigCheck check_rig(const HandEyeProblem& problem, const Rig& rig);

}  // namespace tagdock
