#include "app/campaign_set.h"

#include <algorithm>
#include <fstream>
#include <sstream>

#include "app/failure.h"

namespace tagdock {
namespace {

constexpr const char* campaign_file = "campaign.yaml";

std::string contents(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  return text.str();
}

std::vector<std::string> member_names(const std::filesystem::path& folder) {
  std::vector<std::string> names;
  for (const auto& entry : std::filesystem::directory_iterator(folder))
    if (std::filesystem::exists(entry.path() / campaign_file)) names.push_back(entry.path().filename().string());
  std::sort(names.begin(), names.end());
  return names;
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
  for (const SetMember& member : members) wanted += wanted_here(member);
  int before = 0;
  std::vector<SetResult> results;
  for (const SetMember& member : members) {
    CampaignShare own = share;
    own.runs = member.runs;
    std::vector<RunRecord> records = run_campaign(member.settings, own, folder / member.name,
                                                  [&](int done, int) { progress(before + done, wanted); });
    before += wanted_here(member);
    Evaluation evaluation = evaluate(records);
    results.push_back({member.name, campaign_text(member.settings), std::move(records), std::move(evaluation),
                       read_traces(folder / member.name)});
  }
  return results;
}

bool is_set(const std::filesystem::path& folder) {
  return std::filesystem::is_directory(folder) && !std::filesystem::exists(folder / campaign_file) &&
         !member_names(folder).empty();
}

std::vector<SetResult> join_sets(const std::vector<std::filesystem::path>& shards,
                                 const std::filesystem::path& folder) {
  const std::vector<std::string> names = member_names(shards.front());
  for (const std::filesystem::path& shard : shards)
    if (member_names(shard) != names)
      throw Failure(ExitCode::usage,
                    shard.string() + ": holds other campaigns than " + shards.front().string() + "; join equal sets");
  std::vector<SetResult> results;
  for (const std::string& name : names) {
    std::vector<std::filesystem::path> parts;
    for (const std::filesystem::path& shard : shards) parts.push_back(shard / name);
    std::vector<RunRecord> records = join_campaigns(parts, folder / name);
    Evaluation evaluation = evaluate(records);
    results.push_back({name, contents(folder / name / campaign_file), std::move(records), std::move(evaluation),
                       read_traces(folder / name)});
  }
  return results;
}

}  // namespace tagdock
