#pragma once

#include <span>
#include <string>

#include "servo/docking.h"

namespace tagdock {

/// The phases of a docking and the ways between them as an SVG picture, after the paper's Fig. 2. Nothing is drawn but
/// the rows of the table, and every row: those that act in a column in the order of the table, the ways onward beside
/// it, back to the first phase on the left, to a back-off or the end on the right.
std::string phase_picture(std::span<const Transition> table);

}  // namespace tagdock
