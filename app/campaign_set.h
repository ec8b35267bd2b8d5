#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "app/campaign.h"
#include "app/campaign_join.h"
#include "app/campaign_settings.h"
#include "app/distance_looks.h"
#include "app/evaluation_report.h"

namespace tagdock {

/// A campaign of a set; its results are in a folder of its name.
struct SetMember {
  std::string name;
  RunSettings settings;
  int runs = 0;
};

/// What one became.
struct SetResult {
  std::string name;
  std::string campaign;  ///< its campaign.yaml
  std::vector<RunRecord> records;
  Evaluation evaluation;
  std::vector<RunTrace> traces;
  std::vector<DistanceLook> looks;
  CampaignShare share;               ///< that was run; of joined ones the default, which is all
  std::vector<std::string> missing;  ///< of a join of a part, as JoinedCampaign has it
  int wanted = 0;                    ///< runs of the whole campaign; 0 where nobody knows

  /// As `campaign_value`.
  [[nodiscard]] std::string value(const std::string& key) const { return campaign_value(campaign, key); }
};

struct SetWish {
  CampaignWish common;
  std::vector<std::string> strategies;  ///< servo, paper
  std::vector<std::string> scenarios;   ///< files
  std::vector<std::string> rigs;        ///< for servo; paper keeps its own unless only one is given
  int runs = 100;
  int image_runs = 20;  ///< of scenarios that only images show
};

/// Scenario x strategy x rig, in this order, and the straight start open loop with the servo's board, too. The paper's
/// strategy starts where the paper did, except in scenarios whose start is their point (not the default's range and
/// bearing).
std::vector<SetMember> scenario_set(const SetWish& wish);

/// Path x law x board x corners on the same seeds: the paper's start and the straight one; open loop, ViSP's centering,
/// the line law; the boards of `board_names`; the corner errors of `corner_error_names`. One attempt each, no refusal
/// for an uncertain pose; the default rig. The world is the built-in one, or the first of the scenarios with its start
/// replaced.
std::vector<SetMember> ablation_set(const SetWish& wish);

/// Runs a set: each member into `folder`/name, as run_campaign does, resumable and in the same shards.
/// @param progress  called with runs done and wanted over all
std::vector<SetResult> run_set(const std::vector<SetMember>& members, const CampaignShare& share,
                               const std::filesystem::path& folder,
                               const std::function<void(int done, int wanted)>& progress);

/// Whether a folder holds a set.
bool is_set(const std::filesystem::path& folder);

/// Joins shards of a set, member by member; of a part, a member that never ran has no records and says so in `missing`.
/// Throws Failure(usage) as join_campaigns, or where members differ.
std::vector<SetResult> join_sets(const std::vector<std::filesystem::path>& shards, const std::filesystem::path& folder,
                                 const JoinWish& wish = {});

}  // namespace tagdock
