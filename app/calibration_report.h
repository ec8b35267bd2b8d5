#pragma once

#include "app/figure.h"
#include "calibration/hand_eye.h"
#include "calibration/intrinsics.h"

namespace tagdock {

/// What a calibration of the camera is worth: verdict, residual map, uncertainty map, coverage, halves, error against
/// distance (as the paper's Fig. 8), views.
/// @param working_distance  where px are told in mm [m]
Report intrinsics_report(const IntrinsicsResult& result, double working_distance);

/// What a hand-eye calibration is worth: verdict, top view of the stops with the cone in which a single tag is not
/// trusted (as the paper's Fig. 7), error against distance (Fig. 8), residuals by stop, what the drive determines.
Report hand_eye_report(const HandEyeProblem& problem, const HandEyeResult& result);

}  // namespace tagdock
