#include "app/campaign_set.h"

#include <algorithm>
#include <fstream>
#include <sstream>

#include "app/failure.h"

namespace tagdock {
namespace {

constexpr const char* campaign_file = "campaign.yaml";
constexpr const char* set_file = "set.yaml";  // which campaigns a set has, also those not begun

std::string contents(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  return text.str();
}

// As set.yaml says, in its order; of earlier versions those that were begun, by name.
std::vector<std::string> member_names(const std::filesystem::path& folder) {
  std::vector<std::string> names;
  std::istringstream lines(contents(folder / set_file));
  for (std::string line; std::getline(lines, line);)
    if (line.starts_with("- ")) names.push_back(line.substr(2));
  if (!names.empty()) return names;
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    if (std::filesystem::exists(entry.path() / campaign_file)) names.push_back(entry.path().filename().string());
  std::sort(names.begin(), names.end());
  return names;
}

// A set may get further members, but no other set goes into its folder.
void begin_set(const std::vector<std::string>& names, const std::filesystem::path& folder) {
  if (std::filesystem::exists(folder / campaign_file))
    throw Failure(ExitCode::usage,
                  folder.string() + ": holds one campaign, not a set of them; give --output another folder");
  if (std::filesystem::exists(folder / set_file))
    for (const std::string& before : member_names(folder))
      if (std::find(names.begin(), names.end(), before) == names.end())
        throw Failure(ExitCode::usage, folder.string() + ": holds a set with the campaign " + before +
                                           ", which is not asked for now; give --output another folder");
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  std::ofstream stream(folder / set_file, std::ios::binary);
  stream << "# The campaigns of this set, each in a folder of its name.\n";
  for (const std::string& name : names) stream << "- " << name << "\n";
  stream << std::flush;
  if (!stream) throw Failure(ExitCode::usage, folder.string() + ": cannot be written");
}

bool begun(const std::filesystem::path& folder) {
  return std::filesystem::exists(folder / campaign_file) && std::filesystem::exists(folder / "runs.csv");
}

// Dirt on a tag that a board does not have is nowhere: the paper's board has the middle tag alone.
RunSettings without_dirt_elsewhere(RunSettings settings) {
  std::erase_if(settings.scenario.station.dirt,
                [&](const Dirt& dirt) { return find_tag(settings.config.board, dirt.tag) == nullptr; });
  return settings;
}

std::string stem(const std::string& file) { return std::filesystem::path(file).stem().string(); }

}  // namespace

std::vector<SetMember> scenario_set(const SetWish& wish) {
  const StartScenario usual;
  std::vector<SetMember> members;
  for (const std::string& file : wish.scenarios) {
    const Scenario scenario = read_scenario(file);
    const bool usual_start = scenario.start.range == usual.range && scenario.start.bearing == usual.bearing;
    for (const std::string& strategy : wish.strategies) {
      CampaignWish one = wish.common;
      one.strategy = strategy;
      one.scenario = file;
      one.images = one.images || needs_images(scenario);
      const bool paper = strategy == "paper";
      if (paper && usual_start) one.start = "paper";
      std::vector<std::string> rigs = wish.rigs;
      if (rigs.empty() || (paper && rigs.size() > 1)) rigs = {wish.common.rig};
      for (const std::string& rig : rigs) {
        one.rig = rig;
        std::string name = scenario.name + "-" + strategy;
        if (rigs.size() > 1) name += "-" + stem(rig);
        const bool only_images = !wish.common.images && one.images;
        members.push_back({name, without_dirt_elsewhere(settings_of(one)),
                           only_images ? std::min(wish.runs, wish.image_runs) : wish.runs});
      }
      // The straight way, open loop, once more with the servo's board: tells apart what path, board and loop give.
      if (paper && scenario.name == "straight_start" && one.board.empty()) {
        one.board = "v_convex_centre";
        members.push_back({"straight_start-paper-v_convex_centre", settings_of(one), wish.runs});
      }
    }
  }
  return members;
}

std::vector<SetMember> ablation_set(const SetWish& wish) {
  std::vector<SetMember> members;
  for (const std::string& path : {std::string("paper"), std::string("straight")})
    for (const std::string& law : {std::string("open"), std::string("centering"), std::string("line")})
      for (const std::string& board : board_names())
        for (const std::string& corners : corner_error_names()) {
          CampaignWish one = wish.common;
          if (!wish.scenarios.empty()) one.scenario = wish.scenarios.front();
          one.strategy = law == "open" ? "paper" : "servo";
          one.law = law == "open" ? "" : law;
          one.rig = wish.common.rig.empty() ? "default" : wish.common.rig;
          one.board = board;
          one.corners = corners;
          one.start = path;
          one.limits_lifted = true;
          members.push_back({path + "_start-" + law + "-" + board + "-" + corners, settings_of(one), wish.runs});
        }
  return members;
}

std::vector<SetResult> run_set(const std::vector<SetMember>& members, const CampaignShare& share,
                               const std::filesystem::path& folder,
                               const std::function<void(int done, int wanted)>& progress) {
  const auto wanted_here = [&](const SetMember& member) {
    return (member.runs - share.shard + share.shards - 1) / share.shards;
  };
  int wanted = 0;
  std::vector<std::string> names;
  for (const SetMember& member : members) {
    wanted += wanted_here(member);
    names.push_back(member.name);
  }
  const bool alone = names == std::vector<std::string>{""};
  if (!alone) begin_set(names, folder);
  if (alone && std::filesystem::exists(folder / set_file))
    throw Failure(ExitCode::usage, folder.string() + ": holds a set of campaigns; give --output another folder");
  int before = 0;
  std::vector<SetResult> results;
  for (const SetMember& member : members) {
    CampaignShare own = share;
    own.runs = member.runs;
    std::vector<RunRecord> records = run_campaign(member.settings, own, folder / member.name,
                                                  [&](int done, int) { progress(before + done, wanted); });
    before += wanted_here(member);
    Evaluation evaluation = evaluate(records);
    results.push_back({.name = member.name,
                       .campaign = campaign_text(member.settings),
                       .records = std::move(records),
                       .evaluation = std::move(evaluation),
                       .traces = read_traces(folder / member.name),
                       .looks = read_looks(folder / member.name / looks_file),
                       .share = own,
                       .missing = {},
                       .wanted = member.runs});
  }
  return results;
}

bool is_set(const std::filesystem::path& folder) {
  return std::filesystem::is_directory(folder) && !std::filesystem::exists(folder / campaign_file) &&
         !member_names(folder).empty();
}

std::vector<SetResult> join_sets(const std::vector<std::filesystem::path>& shards, const std::filesystem::path& folder,
                                 const JoinWish& wish) {
  const std::vector<std::string> names = member_names(shards.front());
  const auto check = [](const std::filesystem::path& with, const std::filesystem::path& lacking) {
    const std::vector<std::string> all = member_names(lacking);
    for (const std::string& name : member_names(with))
      if (std::find(all.begin(), all.end(), name) == all.end())
        throw Failure(ExitCode::usage, lacking.string() + ": has no campaign " + name + ", which " + with.string() +
                                           " has; join equal sets");
  };
  for (const std::filesystem::path& shard : shards) {
    check(shard, shards.front());
    check(shards.front(), shard);
  }
  std::vector<std::pair<std::string, JoinedCampaign>> all;
  std::vector<std::string> missing;
  for (const std::string& name : names) {
    std::vector<std::filesystem::path> parts;
    JoinedCampaign joined;
    std::vector<std::string> lacking;
    for (const std::filesystem::path& shard : shards)
      if (begun(shard / name))
        parts.push_back(shard / name);
      else
        lacking.push_back((shard / name).string() + " was not begun; give the command that made " + shard.string() +
                          " again, and it goes on");
    if (!parts.empty()) {
      std::optional<CampaignShare> told = wish.told;
      if (told && campaign_value(contents(parts.front() / campaign_file), "images") == "on")
        told->runs = std::min(told->runs, wish.image_runs);
      joined = gather(parts, told);
      for (std::string& sentence : joined.missing) sentence.insert(0, name + ": ");
    }
    joined.missing.insert(joined.missing.begin(), lacking.begin(), lacking.end());
    missing.insert(missing.end(), joined.missing.begin(), joined.missing.end());
    all.emplace_back(name, std::move(joined));
  }
  if (!missing.empty() && !wish.partial) refuse_part(missing);
  if (std::all_of(all.begin(), all.end(), [](const auto& one) { return one.second.records.empty(); }))
    throw Failure(ExitCode::usage, shards.front().string() + ": has no runs");
  begin_set(names, folder);
  std::vector<SetResult> results;
  for (auto& [name, joined] : all) {
    if (joined.records.empty()) {  // never ran: it has no figures, but is told of
      results.push_back({.name = name,
                         .campaign = {},
                         .records = {},
                         .evaluation = {},
                         .traces = {},
                         .looks = {},
                         .share = {},
                         .missing = std::move(joined.missing),
                         .wanted = joined.wanted});
      continue;
    }
    write_joined(joined, folder / name);
    Evaluation evaluation = evaluate(joined.records);
    results.push_back({.name = name,
                       .campaign = std::move(joined.campaign),
                       .records = std::move(joined.records),
                       .evaluation = std::move(evaluation),
                       .traces = read_traces(folder / name),
                       .looks = read_looks(folder / name / looks_file),
                       .share = {},
                       .missing = std::move(joined.missing),
                       .wanted = joined.wanted});
  }
  return results;
}

}  // namespace tagdock
