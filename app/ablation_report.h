#pragma once

#include <string>
#include <vector>

#include "app/campaign_set.h"

namespace tagdock {

/// Whether these are the campaigns of an ablation (`ablation_set`).
bool is_ablation(const std::vector<SetResult>& results);

/// Path x law x board x corners for people: what each choice is worth, the best combinations, and every combination
/// with its number of runs and intervals. HTML; empty if it is no ablation.
std::string ablation_html(const std::vector<SetResult>& results);

}  // namespace tagdock
