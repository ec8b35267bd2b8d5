#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "app/campaign_run.h"

namespace tagdock {

/// What a campaign is asked for, in the words of the command line.
struct CampaignWish {
  std::string strategy = "servo";  ///< servo or paper
  std::string scenario;            ///< file; empty: the built-in default (paper: from the paper's start)
  std::string start = "scenario";  ///< scenario; paper: 3.45 m and 26 degrees; straight: 3.45 m and 5 degrees
  std::string config;              ///< file; empty: the defaults
  std::string rig;                 ///< default, five_megapixel or a file; empty: the strategy's own
  std::string board;               ///< one of `board_names` or a file; empty: the strategy's own
  std::string method;              ///< corner method; empty: the configuration's
  std::string corners;             ///< drawn corner errors, one of `corner_error_names`; empty: the strategy's own
  std::string law;                 ///< line or centering; empty: the configuration's
  bool teach = true;
  bool images = false;
  /// One attempt, and no refusal because the pose is uncertain: to compare laws, boards and corners alone.
  bool limits_lifted = false;
};

/// The settings of one campaign.
/// Throws Failure(usage) for files that cannot be read, and for scenarios that only images can show.
RunSettings settings_of(const CampaignWish& wish);

/// Whether a scenario has dirt or other light, which drawn corners do not show.
bool needs_images(const Scenario& scenario);

/// The boards of the notes on docking, 6: one_tag, pair, v_concave, v_convex, v_convex_centre (the default).
const std::vector<std::string>& board_names();
/// A board of those, its tags' centres at `height`; none of another name.
std::optional<Board> board_named(const std::string& name, double height);

/// Scenario files by word: a file, a folder (all of its *.yaml, by name) or `all` (the shipped ones).
/// Throws Failure(usage) where there is none.
std::vector<std::filesystem::path> scenario_files(const std::string& word);

}  // namespace tagdock
