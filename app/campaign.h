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
  int jobs = 1;  ///< runs at a time; says nothing of what is done
};

/// The seeds of its own, by rising value.
std::vector<std::uint64_t> seeds_of(const CampaignShare& share);

/// What a folder has of its campaign (share.yaml): the share that was run there, or those that were joined there.
/// Read gives none where the file is missing, as in folders of earlier versions. Throws Failure(usage) with file and
/// line.
void write_shares(const std::filesystem::path& folder, const std::vector<CampaignShare>& shares);
std::vector<CampaignShare> read_shares(const std::filesystem::path& folder);

/// The columns of runs.csv (CONTRACTS.md) and those of ours behind them.
std::string runs_header();
std::string line(const RunRecord& record);

/// Reads a runs.csv. A last line that is cut off (the program was killed while it wrote) is left out.
/// Throws Failure(usage) with file and line.
std::vector<RunRecord> read_runs(const std::filesystem::path& file);
/// Writes the runs.csv of a folder; a reader never sees half of it.
void write_runs(const std::filesystem::path& folder, const std::vector<RunRecord>& records);

/// Everything that decides what a run comes to, as YAML: two campaigns with the same text may be joined.
std::string campaign_text(const RunSettings& settings);

/// What such a text says of a key: strategy, law, scenario_name, start, rig_name, board_name, corners, teach, images,
/// focal_length_px or limits_lifted; empty if it does not.
std::string campaign_value(const std::string& text, const std::string& key);

/// Runs what is missing in `folder` and gives all its records by rising seed. Each record is on disk before the next
/// one of the same job begins; so a campaign that was killed goes on where it was.
/// Throws Failure(usage): the folder holds another campaign or runs that are not asked for, another process is at work
/// in it, or it cannot be written.
/// @param progress  called after every run with the number done and wanted, from any thread, one at a time
std::vector<RunRecord> run_campaign(const RunSettings& settings, const CampaignShare& share,
                                    const std::filesystem::path& folder,
                                    const std::function<void(int done, int wanted)>& progress);

/// In a campaign's folder: what single frames say over distance (read_looks), for the report's figures.
constexpr const char* looks_file = "looks.csv";

/// The ways of the first runs of a campaign, which its folder keeps for the report's figures.
constexpr std::uint64_t traced_runs = 20;
std::vector<RunTrace> read_traces(const std::filesystem::path& folder);

}  // namespace tagdock
