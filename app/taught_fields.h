#pragma once

#include <optional>

#include "app/fields.h"
#include "servo/docking.h"

namespace tagdock {

/// The keys of what `tagdock teach` measured beside the docking pose: of docking.taught, and of a dock in a database.
/// @param measured  was it
/// @param hang      how the board hung; none: not looked at
void visit_taught(Fields& fields, bool& measured, Eigen::Matrix3d& covariance, std::optional<BoardHang>& hang);

}  // namespace tagdock
