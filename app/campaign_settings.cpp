#include "app/campaign_settings.h"

#include <algorithm>
#include <fstream>
#include <numbers>
#include <sstream>

#include "app/failure.h"
#include "app/rig_file.h"

namespace tagdock {
namespace {

std::string contents(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  return text.str();
}

// The paper's marker-centring position (notes on docking, 4.1).
void start_as_the_paper(StartScenario& start) {
  start.range = 3.45;
  start.bearing = radians(26.0);
  start.heading = 0.0;
  start.bearing_spread = start.heading_spread = 0.0;
}

// As near, and almost on the axis (notes on docking, 0): what the paper's start leaves of a path's length, straight.
void start_straight(StartScenario& start) {
  start_as_the_paper(start);
  start.bearing = radians(5.0);
}

// A word that is none of those known must be a file.
void check_file(const std::string& option, const std::string& word, const std::vector<std::string>& known) {
  if (std::filesystem::exists(word)) return;
  std::string sentence = option + " " + word + ": is no file, nor ";
  for (std::size_t i = 0; i < known.size(); ++i)
    sentence += (i == 0 ? "one of " : i + 1 == known.size() ? " and " : ", ") + known[i];
  throw Failure(ExitCode::usage, sentence);
}

Rig rig_of(const std::string& word) {
  if (word == "default") return default_rig();
  if (word == "five_megapixel") return five_megapixel_rig();
  check_file("--rig", word, {"default", "five_megapixel"});
  return read_rig(word);
}

Board board_of(const std::string& word, double height) {
  if (const std::optional<Board> board = board_named(word, height)) return *board;
  check_file("--board", word, board_names());
  return read_board(word);
}

// The folder of the shipped scenarios: under the working directory, in the source tree of this program, or installed.
std::filesystem::path shipped_scenarios() {
  std::error_code error;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", error).parent_path();
  const std::filesystem::path places[] = {"data/scenarios", program / "../../data/scenarios",
                                          program / "../share/tagdock/scenarios"};
  for (const std::filesystem::path& place : places)
    if (std::filesystem::exists(place / "default.yaml")) return place.lexically_normal();
  throw Failure(
      ExitCode::usage,
      "the shipped scenarios (data/scenarios) are not found from here; give --scenario FILE, or their folder");
}

}  // namespace

bool needs_images(const Scenario& scenario) {
  const StationScenario plain;
  return !scenario.station.dirt.empty() || scenario.station.light_change_range > 0.0 ||
         scenario.station.lamp_strength != plain.lamp_strength || scenario.station.ambient != plain.ambient;
}

const std::vector<std::string>& board_names() {
  static const std::vector<std::string> names = {"one_tag", "pair", "v_concave", "v_convex", "v_convex_centre"};
  return names;
}

std::optional<Board> board_named(const std::string& name, double height) {
  constexpr double edge = 0.16;
  constexpr double tilt = std::numbers::pi / 6.0;
  if (name == "one_tag") return single_tag_board(height);
  if (name == "v_convex_centre") return default_board(height);
  Board board;
  // A wing at y > 0 that faces outwards is turned clockwise, seen from above: the V is convex (default_board).
  if (name == "pair")
    board.tags = {{0, edge, upright_tag(0.0, 0.22, height, 0.0)}, {2, edge, upright_tag(0.0, -0.22, height, 0.0)}};
  else if (name == "v_convex")
    board.tags = {{0, edge, upright_tag(0.0, 0.12, height, -tilt)}, {2, edge, upright_tag(0.0, -0.12, height, tilt)}};
  else if (name == "v_concave")
    board.tags = {{0, edge, upright_tag(0.0, 0.12, height, tilt)}, {2, edge, upright_tag(0.0, -0.12, height, -tilt)}};
  else
    return std::nullopt;
  return board;
}

std::vector<std::filesystem::path> scenario_files(const std::string& word) {
  const std::filesystem::path place = word == "all" ? shipped_scenarios() : std::filesystem::path(word);
  if (!std::filesystem::is_directory(place)) return {place};
  std::vector<std::filesystem::path> files;
  for (const auto& entry : std::filesystem::directory_iterator(place))
    if (entry.path().extension() == ".yaml") files.push_back(entry.path());
  if (files.empty()) throw Failure(ExitCode::usage, "--scenario " + place.string() + ": has no *.yaml");
  std::sort(files.begin(), files.end());
  return files;
}

RunSettings settings_of(const CampaignWish& wish) {
  RunSettings settings;
  const bool paper = wish.strategy == "paper";
  settings.strategy = paper ? Strategy::paper : Strategy::servo;
  settings.teach = wish.teach;
  settings.images = wish.images;
  settings.limits_lifted = wish.limits_lifted;
  Config config;
  settings.rig_name = paper ? "five_megapixel" : "default";
  settings.board_name = paper ? "one_tag" : "v_convex_centre";
  if (!wish.config.empty()) {
    config = read_config(wish.config);
    settings.rig_name = settings.board_name = "of " + wish.config;
  }
  if (!wish.rig.empty()) settings.rig_name = wish.rig;
  if (!wish.board.empty()) settings.board_name = wish.board;
  if (wish.config.empty() || !wish.rig.empty()) config.rig = rig_of(settings.rig_name);
  if (wish.config.empty() || !wish.board.empty())
    config.board = board_of(settings.board_name, config.rig.T_base_camera.translation().z());
  if (!wish.method.empty()) config.locator.method = *corner_method(wish.method);
  if (!wish.law.empty()) config.docking.servo.law = wish.law == "line" ? ServoLaw::line : ServoLaw::centering;
  settings.corners_name = !wish.corners.empty() ? wish.corners
                          : paper               ? "paper"
                                                : std::string(word(config.locator.method));
  const std::vector<std::string>& measured = corner_error_names();
  if (wish.corners.empty() && !wish.images &&
      std::find(measured.begin(), measured.end(), settings.corners_name) == measured.end())
    throw Failure(ExitCode::usage, "--method " + settings.corners_name +
                                       ": its corner errors were not measured; give --images on, or --corners FILE of "
                                       "`tagdock evaluate corner-errors --method " +
                                       settings.corners_name + "`");
  if (!wish.corners.empty() && std::find(measured.begin(), measured.end(), wish.corners) == measured.end())
    check_file("--corners", wish.corners, measured);
  settings.corner_errors = corner_errors(wish.images && wish.corners.empty() ? "tanh" : settings.corners_name);
  if (!wish.scenario.empty()) config.simulation.scenario = wish.scenario;
  const std::string& scenario = config.simulation.scenario;
  if (!scenario.empty()) {
    settings.scenario = read_scenario(scenario);
    settings.scenario_text = contents(scenario);
  } else if (wish.start != "scenario") {
    settings.scenario.name = wish.start + "_start";
  } else if (paper) {
    settings.scenario.name = "paper_start";
    start_as_the_paper(settings.scenario.start);
  }
  settings.start_name = wish.start;
  if (wish.start == "paper") start_as_the_paper(settings.scenario.start);
  if (wish.start == "straight") start_straight(settings.scenario.start);
  if (!settings.images && needs_images(settings.scenario))
    throw Failure(ExitCode::usage, "scenario " + settings.scenario.name +
                                       " has dirt or other light, which only images show: give --images on");
  settings.config = parse_config(to_yaml(config), "(configuration of this campaign)");
  if (settings.limits_lifted) {
    DockingConfig& docking = settings.config.docking;
    docking.acquire.max_sigma_y = docking.servo.max_sigma_y = 10.0;  // m: never
    docking.acquire.max_sigma_yaw = std::numbers::pi;
    docking.back_off.retries = 0;
  }
  return settings;
}

}  // namespace tagdock
