#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "app/campaign.h"

namespace tagdock {

/// What a join takes for whole.
struct JoinWish {
  /// The campaign as told by a person, for folders that do not say themselves what it has (of earlier versions).
  std::optional<CampaignShare> told;
  int image_runs = 20;   ///< of the same, in a set: of campaigns that only images show
  bool partial = false;  ///< join also what is not whole, and say what is missing
};

/// What the shards of a campaign come to, and what they lack.
struct JoinedCampaign {
  std::string campaign;            ///< campaign.yaml
  std::vector<RunRecord> records;  ///< by rising seed
  int wanted = 0;                  ///< runs; 0 where nobody knows
  /// Which runs are missing and which folder should have them, a sentence each; empty where all are there.
  std::vector<std::string> missing;
  std::vector<CampaignShare> shares;
  std::vector<std::filesystem::path> traces;  ///< files
  std::filesystem::path looks;                ///< file; empty where no shard has it
};

/// Seeds for people: "1, 4, 7" or, where there are more, the first, the last and how many.
std::string seeds_in_words(const std::vector<std::uint64_t>& seeds);

/// Reads shards of one campaign. Throws Failure(usage): folders of different campaigns, or one seed with two outcomes.
/// @param shards  one at least
JoinedCampaign gather(const std::vector<std::filesystem::path>& shards, const std::optional<CampaignShare>& told);

/// Writes what was gathered as one campaign: campaign.yaml, share.yaml, runs.csv and traces.
void write_joined(const JoinedCampaign& joined, const std::filesystem::path& folder);

/// Throws Failure(usage) that names what is missing.
[[noreturn]] void refuse_part(const std::vector<std::string>& missing);

/// Shards of one campaign as one. Throws as `gather`, and without writing anything if runs are missing (or nobody
/// knows) and no part is wished.
JoinedCampaign join_campaigns(const std::vector<std::filesystem::path>& shards, const std::filesystem::path& folder,
                              const JoinWish& wish = {});

}  // namespace tagdock
