#pragma once

#include <string>

#include "planning/plan_search.h"

/// Why there is no plan: which limit, by how much, and the smallest changes that would help. Sentences are written into
/// strings that keep their memory; cures are looked for only if the configuration asks for them.
namespace tagdock {

inline constexpr std::size_t longest_sentence = 600;

/// Write a sentence, as printf.
void write_sentence(std::string& into, const char* pattern, ...) __attribute__((format(printf, 2, 3)));

/// Four digits.
std::string four_digits(double value);

/// No path without a loop.
void refuse_no_room(const PlanQuestion& question, const TurnShape& full, PlanRefusal& refusal);

/// What no path can mend: the board is not seen well from the start or the goal. True if that is so, and said.
bool refuse_hopeless(const PlanQuestion& question, PlanRefusal& refusal);

/// Every path loses the board.
void refuse_out_of_view(const PlanQuestion& question, PlanRefusal& refusal);

/// No tag is seen well on the part of the way where yaw is measured.
void refuse_bad_incidence(const PlanQuestion& question, PlanRefusal& refusal);

/// Every path comes too near to what must not be touched.
void refuse_too_near(const PlanQuestion& question, PlanRefusal& refusal);

/// No path can be cut into whole periods.
void refuse_no_whole_periods(const PlanQuestion& question, PlanRefusal& refusal);

/// Poses and limits checked; true if they are fine.
bool input_fine(const Pose2& start, const Pose2& goal, const TurnLimits& limits, PlanRefusal& refusal);

/// Wishes checked; true if they make sense.
bool wishes_fine(const DockingPlanConfig& config, PlanRefusal& refusal);

}  // namespace tagdock
