#include "app/dock_database.h"

#include <algorithm>
#include <cctype>
#include <cmath>
#include <cstdio>

#include "app/failure.h"
#include "app/taught_fields.h"
#include "app/yaml_file.h"

namespace tagdock {
namespace {

constexpr double farthest = 1e5;  // m, a site

std::string digits(double value) {
  char text[32];
  // Short where that is exact: 1.5 and not 1.50000000000000000.
  for (const int precision : {6, 15, 17}) {
    std::snprintf(text, sizeof text, "%.*g", precision, value);
    if (std::strtod(text, nullptr) == value) break;
  }
  return text;
}

std::string quoted(const std::string& text) {
  std::string result = "\"";
  for (const char letter : text) {
    if (letter == '"' || letter == '\\') result += '\\';
    result += letter;
  }
  return result + "\"";
}

bool plain(const std::string& text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](unsigned char letter) {
    return std::isalnum(letter) != 0 || letter == '_' || letter == '-' || letter == '.' || letter == '/';
  });
}

void check_names(YamlMap& map, const DockEntry& dock) {
  for (const auto& [key, value] :
       {std::pair<const char*, const std::string*>{"type", &dock.type}, {"frame", &dock.frame}, {"id", &dock.id}})
    if (!value->empty() && !plain(*value))
      map.refuse(key, "is \"" + *value + "\"; letters, digits, _ - . and / are what a name is made of");
  if (dock.frame.empty()) map.refuse("frame", "is empty; it must name a frame, for example map");
}

Pose2 read_pose(YamlMap map) {
  Pose2 pose;
  pose.x = map.number("x_m", -farthest, farthest);
  pose.y = map.number("y_m", -farthest, farthest);
  pose.yaw = radians(map.number("yaw_deg", -360.0, 360.0));
  return pose;
}

std::string pose_yaml(const Pose2& pose) {
  return "{x_m: " + digits(pose.x) + ", y_m: " + digits(pose.y) + ", yaw_deg: " + digits(degrees(pose.yaw)) + "}";
}

}  // namespace

std::vector<DockEntry> read_nav2_docks(const std::filesystem::path& file) {
  YamlMap top = YamlMap::load(file);
  YamlMap all = top.map("docks");
  std::vector<DockEntry> docks;
  for (const std::string& name : all.keys()) {
    YamlMap map = all.map(name);
    DockEntry dock;
    dock.name = name;
    map.read("type", dock.type);
    map.read("frame", dock.frame);
    map.read("id", dock.id);
    if (!plain(name)) map.refuse("pose", "belongs to a dock called \"" + name + "\", which is no name");
    check_names(map, dock);
    const std::vector<double> pose = map.numbers("pose", 3, 3);
    for (const double value : pose)
      if (!(std::abs(value) <= farthest)) map.refuse("pose", "must be [x, y, yaw], m and rad");
    constexpr double turn = 6.2832;
    if (std::abs(pose[2]) > turn)
      map.refuse("pose", "has the yaw " + digits(pose[2]) + " rad, more than a turn; Nav2 has [x, y, yaw], m and rad");
    dock.pose = {pose[0], pose[1], pose[2]};
    docks.push_back(dock);
  }
  top.finish();
  if (docks.empty()) top.refuse("docks", "names no dock");
  return docks;
}

std::string nav2_docks(const std::vector<DockEntry>& docks) {
  std::string text = "docks:\n";
  for (const DockEntry& dock : docks) {
    text += "  " + dock.name + ":\n";
    if (!dock.type.empty()) text += "    type: " + quoted(dock.type) + "\n";
    text += "    frame: " + quoted(dock.frame) + "\n";
    // Nav2 reads doubles: a whole number needs its point.
    const auto decimal = [](double value) {
      const std::string number = digits(value);
      return number.find_first_of(".e") == std::string::npos ? number + ".0" : number;
    };
    text += "    pose: [" + decimal(dock.pose.x) + ", " + decimal(dock.pose.y) + ", " + decimal(dock.pose.yaw) + "]\n";
    if (!dock.id.empty()) text += "    id: " + quoted(dock.id) + "\n";
  }
  return text;
}

std::vector<DockEntry> read_docks(const std::filesystem::path& file) {
  YamlMap top = YamlMap::load(file);
  int version = 1;
  top.read("version", version, 1, 1);
  std::vector<DockEntry> docks;
  for (YamlMap map : top.maps("docks")) {
    DockEntry dock;
    dock.name = map.text("name");
    map.read("type", dock.type);
    map.read("frame", dock.frame);
    map.read("id", dock.id);
    map.read("board", dock.board);
    dock.pose = read_pose(map.map("pose"));
    if (auto taught = map.optional_map("dock_pose")) {
      dock.dock_pose = read_pose(*taught);
      if (!(dock.dock_pose->x < 0.0))
        map.refuse("dock_pose",
                   "has x_m = " + digits(dock.dock_pose->x) + "; the camera stands before the wall, below 0");
    }
    if (auto taught = map.optional_map("taught")) {
      FieldReader fields(*taught);
      bool measured = false;
      TaughtDock read;
      visit_taught(fields, measured, read.covariance, read.hang);
      if (measured && !dock.dock_pose) map.refuse("taught", "needs dock_pose: it says how well that was measured");
      if (measured) dock.taught = read;
    }
    if (!plain(dock.name)) map.refuse("name", "is \"" + dock.name + "\"; letters, digits, _ - . and / make a name");
    check_names(map, dock);
    for (const DockEntry& other : docks)
      if (other.name == dock.name) map.refuse("name", "is " + dock.name + ", as another dock's");
    docks.push_back(dock);
  }
  top.finish();
  if (docks.empty()) top.refuse("docks", "names no dock");
  return docks;
}

std::string docks_yaml(const std::vector<DockEntry>& docks) {
  std::string text =
      "# Docks of this robot. pose: of the base when docked, in `frame`. A dock may also have `board` (file) and\n"
      "# `dock_pose` {x_m, y_m, yaw_deg} (of the camera point in the station frame); without, the configuration's\n"
      "# count. `taught` has how well dock_pose was measured there, and how the board hung (tagdock teach --docks).\n"
      "version: 1\ndocks:\n";
  for (const DockEntry& dock : docks) {
    text += "  - name: " + quoted(dock.name) + "\n";
    if (!dock.type.empty()) text += "    type: " + quoted(dock.type) + "\n";
    text += "    frame: " + quoted(dock.frame) + "\n    pose: " + pose_yaml(dock.pose) + "\n";
    if (!dock.id.empty()) text += "    id: " + quoted(dock.id) + "\n";
    if (!dock.board.empty()) text += "    board: " + quoted(dock.board) + "\n";
    if (dock.dock_pose) text += "    dock_pose: " + pose_yaml(*dock.dock_pose) + "\n";
    if (dock.taught) {
      FieldWriter fields(6);
      bool measured = true;
      TaughtDock taught = *dock.taught;
      visit_taught(fields, measured, taught.covariance, taught.hang);
      text += "    taught:\n" + fields.text();
    }
  }
  return text;
}

DockEntry find_dock(const std::vector<DockEntry>& docks, const std::string& name) {
  std::string names;
  for (const DockEntry& dock : docks) {
    if (dock.name == name) return dock;
    names += " " + dock.name;
  }
  throw Failure(ExitCode::usage, "there is no dock " + name + "; the docks are:" + names);
}

std::optional<DockEntry> chosen_dock(const std::string& file, const std::string& name) {
  if (file.empty() != name.empty()) throw Failure(ExitCode::usage, "--dock NAME and --docks FILE belong together");
  if (file.empty()) return std::nullopt;
  return find_dock(read_docks(file), name);
}

}  // namespace tagdock
