#include "app/campaign_join.h"

#include <algorithm>
#include <fstream>
#include <map>
#include <set>
#include <sstream>

#include "app/failure.h"

namespace tagdock {
namespace {

constexpr const char* runs_file = "runs.csv";
constexpr const char* campaign_file = "campaign.yaml";
constexpr const char* traces_folder = "traces";

std::string contents(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  return text.str();
}

void make_folder(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) throw Failure(ExitCode::usage, folder.string() + ": cannot be made: " + error.message());
}

bool same_outcome(const RunRecord& a, const RunRecord& b) { return line(a) == line(b); }

// One folder's part.
struct Part {
  std::filesystem::path folder;
  std::vector<CampaignShare> shares;  ///< empty: it does not say
};

std::string shard_words(const CampaignShare& share) {
  return "shard " + std::to_string(share.shard) + "/" + std::to_string(share.shards);
}

std::vector<std::uint64_t> without(const std::vector<std::uint64_t>& seeds,
                                   const std::map<std::uint64_t, RunRecord>& there) {
  std::vector<std::uint64_t> rest;
  for (const std::uint64_t seed : seeds)
    if (!there.contains(seed)) rest.push_back(seed);
  return rest;
}

// Every run of the campaigns that the parts are of.
std::vector<CampaignShare> whole_of(const std::vector<Part>& parts, const std::optional<CampaignShare>& told) {
  std::vector<CampaignShare> all;
  const auto note = [&](const CampaignShare& share) {
    const auto same = [&](const CampaignShare& one) {
      return one.first_seed == share.first_seed && one.runs == share.runs && one.shards == share.shards;
    };
    if (std::none_of(all.begin(), all.end(), same)) all.push_back(share);
  };
  for (const Part& part : parts)
    for (const CampaignShare& share : part.shares) note(share);
  if (told) note(*told);
  return all;
}

// A sentence for each folder that lacks runs of its own, and for each shard that no folder has.
std::vector<std::string> missing_words(const std::vector<Part>& parts, const std::vector<CampaignShare>& whole,
                                       const std::map<std::uint64_t, RunRecord>& joined) {
  std::vector<std::string> words;
  std::set<std::uint64_t> told;
  const auto tell = [&](const std::vector<std::uint64_t>& missing, const std::string& begin, const std::string& end) {
    std::vector<std::uint64_t> fresh;
    for (const std::uint64_t seed : missing)
      if (told.insert(seed).second) fresh.push_back(seed);
    if (!fresh.empty())
      words.push_back(begin + std::to_string(fresh.size()) + (fresh.size() == 1 ? " run: seed " : " runs: seeds ") +
                      seeds_in_words(fresh) + end);
  };
  for (const Part& part : parts)
    for (const CampaignShare& share : part.shares)
      tell(without(seeds_of(share), joined),
           part.folder.string() + (share.shards > 1 ? " (" + shard_words(share) + ")" : "") + " lacks ",
           "; give the command that made it again, and it goes on");
  for (const CampaignShare& one : whole)
    for (int shard = 0; shard < one.shards; ++shard) {
      CampaignShare share = one;
      share.shard = shard;
      tell(without(seeds_of(share), joined),
           one.shards > 1 ? shard_words(share) + " is in none of the folders: " : "none of the folders has ", "");
    }
  return words;
}

}  // namespace

std::string seeds_in_words(const std::vector<std::uint64_t>& seeds) {
  constexpr std::size_t most = 8;
  std::string text;
  for (std::size_t i = 0; i < std::min(seeds.size(), most); ++i) text += (i ? ", " : "") + std::to_string(seeds[i]);
  if (seeds.size() > most) text += " and so on to " + std::to_string(seeds.back());
  return text;
}

JoinedCampaign gather(const std::vector<std::filesystem::path>& shards, const std::optional<CampaignShare>& told) {
  JoinedCampaign result;
  std::map<std::uint64_t, RunRecord> joined;
  std::vector<Part> parts;
  std::vector<std::string> silent;
  for (const std::filesystem::path& shard : shards) {
    for (const char* needed : {campaign_file, runs_file})
      if (!std::filesystem::exists(shard / needed))
        throw Failure(ExitCode::usage, (shard / needed).string() + ": is missing; --join takes folders of `evaluate`");
    const std::string of_shard = contents(shard / campaign_file);
    if (result.campaign.empty()) result.campaign = of_shard;
    if (of_shard != result.campaign)
      throw Failure(ExitCode::usage, (shard / campaign_file).string() + ": is of another campaign than that in " +
                                         shards.front().string());
    const Part& part = parts.emplace_back(Part{shard, read_shares(shard)});
    result.shares.insert(result.shares.end(), part.shares.begin(), part.shares.end());
    if (part.shares.empty() && !told)
      silent.push_back(shard.string() +
                       " does not say how many runs its campaign has (share.yaml is missing: an earlier version made "
                       "it); say it by --runs N and --seed S");
    for (RunRecord& record : read_runs(shard / runs_file)) {
      const auto [place, fresh] = joined.emplace(record.seed, record);
      if (!fresh && !same_outcome(place->second, record))
        throw Failure(ExitCode::usage, (shard / runs_file).string() + ": seed " + std::to_string(record.seed) +
                                           " has another outcome than in an earlier folder");
    }
    if (result.looks.empty() && std::filesystem::exists(shard / looks_file)) result.looks = shard / looks_file;
    if (std::filesystem::is_directory(shard / traces_folder))
      for (const auto& trace : std::filesystem::directory_iterator(shard / traces_folder))
        result.traces.push_back(trace.path());
  }
  const std::vector<CampaignShare> whole = whole_of(parts, told);
  result.missing = missing_words(parts, whole, joined);
  if (silent.empty()) {
    std::set<std::uint64_t> wanted;
    for (CampaignShare one : whole) {
      one.shard = 0;
      one.shards = 1;
      for (const std::uint64_t seed : seeds_of(one)) wanted.insert(seed);
    }
    result.wanted = static_cast<int>(wanted.size());
  }
  result.missing.insert(result.missing.end(), silent.begin(), silent.end());
  if (result.shares.empty() && told) result.shares = {*told};
  for (auto& [seed, record] : joined) result.records.push_back(std::move(record));
  return result;
}

void write_joined(const JoinedCampaign& joined, const std::filesystem::path& folder) {
  make_folder(folder / traces_folder);
  std::ofstream stream(folder / campaign_file, std::ios::binary);
  stream << joined.campaign << std::flush;
  if (!stream) throw Failure(ExitCode::usage, (folder / campaign_file).string() + ": cannot be written");
  const auto copy = [](const std::filesystem::path& from, const std::filesystem::path& to) {
    std::error_code none;
    if (!std::filesystem::equivalent(from, to, none))
      std::filesystem::copy_file(from, to, std::filesystem::copy_options::overwrite_existing);
  };
  for (const std::filesystem::path& trace : joined.traces) copy(trace, folder / traces_folder / trace.filename());
  if (!joined.looks.empty()) copy(joined.looks, folder / looks_file);
  write_runs(folder, joined.records);
  if (!joined.shares.empty()) write_shares(folder, joined.shares);
}

void refuse_part(const std::vector<std::string>& missing) {
  constexpr std::size_t most = 12;
  std::string sentence = "--join: runs are missing, so nothing was written";
  for (std::size_t i = 0; i < std::min(most, missing.size()); ++i) sentence += "\n  " + missing[i];
  if (missing.size() > most) sentence += "\n  and " + std::to_string(missing.size() - most) + " more";
  throw Failure(ExitCode::usage, sentence + "\nAdd what is missing, or join what there is by --partial.");
}

JoinedCampaign join_campaigns(const std::vector<std::filesystem::path>& shards, const std::filesystem::path& folder,
                              const JoinWish& wish) {
  JoinedCampaign joined = gather(shards, wish.told);
  if (!joined.missing.empty() && !wish.partial) refuse_part(joined.missing);
  write_joined(joined, folder);
  return joined;
}

}  // namespace tagdock
