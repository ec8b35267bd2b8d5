#pragma once

#include <filesystem>
#include <functional>
#include <vector>

#include "app/campaign_run.h"

namespace tagdock {

/// Which runs of a campaign are done here.
struct CampaignShare {
  std::uint64_t first_seed = 1;
  int runs = 100;
  int shard = 0;  ///< of `shards`: every shards-th run, from this one
  int shards = 1;
  int jobs = 1;  ///< runs at a time
};

/// The columns of runs.csv (CONTRACTS.md) and those of ours behind them.
std::string runs_header();
std::string line(const RunRecord& record);

/// Reads a runs.csv. A last line that is cut off (the program was killed while it wrote) is left out.
/// Throws Failure(usage) with file and line.
std::vector<RunRecord> read_runs(const std::filesystem::path& file);

/// Everything that decides what a run comes to, as YAML: two campaigns with the same text may be joined.
std::string campaign_text(const RunSettings& settings);

/// What such a text says of a key: strategy, law, scenario_name, start, rig_name, board_name, corners, teach, images,
/// focal_length_px or limits_lifted; empty if it does not.
std::string campaign_value(const std::string& text, const std::string& key);

/// Runs what is missing in `folder` and gives all its records by rising seed. Each record is on disk before the next
/// one of the same job begins; so a campaign that was killed goes on where it was.
/// Throws Failure(usage): the folder holds another campaign, or cannot be written.
/// @param progress  called after every run with the number done and wanted, from any thread, one at a time
std::vector<RunRecord> run_campaign(const RunSettings& settings, const CampaignShare& share,
                                    const std::filesystem::path& folder,
                                    const std::function<void(int done, int wanted)>& progress);

/// The ways of the first runs of a campaign, which its folder keeps for the report's figures.
constexpr std::uint64_t traced_runs = 20;
std::vector<RunTrace> read_traces(const std::filesystem::path& folder);

/// The records of shards of one campaign, by rising seed, written as one runs.csv into `folder`.
/// Throws Failure(usage): folders of different campaigns, or one seed with two outcomes.
std::vector<RunRecord> join_campaigns(const std::vector<std::filesystem::path>& shards,
                                      const std::filesystem::path& folder);

}  // namespace tagdock
