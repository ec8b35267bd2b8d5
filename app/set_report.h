#pragma once

#include <string>
#include <vector>

#include "app/campaign_set.h"

namespace tagdock {

/// A line for each campaign of a set, for people.
std::string set_summary(const std::vector<SetResult>& results);

/// report.html of a set: one file, no scripts.
std::string set_to_html(const std::vector<SetResult>& results);

}  // namespace tagdock
