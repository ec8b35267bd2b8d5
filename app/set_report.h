#pragma once

#include <string>
#include <vector>

#include <nlohmann/json.hpp>

#include "app/campaign_set.h"
#include "app/evaluation_limits.h"

namespace tagdock {

/// A line for each campaign of a set, for people.
std::string set_summary(const std::vector<SetResult>& results);

/// What a reader must know first where a report is not of whole campaigns: one shard, or a join of a part. Empty, null
/// for whole ones.
/// @param never_ran  sentences on campaigns that are not among the results
std::string html_of_part(const std::vector<SetResult>& results, const std::vector<std::string>& never_ran = {});
nlohmann::ordered_json json_of_part(const SetResult& result);

/// A campaign as figures take it.
FigureData figure_data(const SetResult& result, const std::string& name, const std::string& colour);

/// Which of the campaigns give the limits their figures; those of another name or none stay out.
LimitEvidence evidence_of(const std::vector<SetResult>& results);

/// report.html of a set: one file, no scripts.
/// @param never_ran  as html_of_part
std::string set_to_html(const std::vector<SetResult>& results, const std::vector<std::string>& never_ran = {});

}  // namespace tagdock
