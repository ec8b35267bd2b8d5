#pragma once

#include <filesystem>
#include <optional>
#include <string>
#include <vector>

#include "planning/pose2.h"
#include "servo/docking.h"

namespace tagdock {

/// What teaching a dock measured beside the pose, as docking.taught of a configuration.
struct TaughtDock {
  Eigen::Matrix3d covariance = Eigen::Matrix3d::Zero();  ///< of the docking pose [x y yaw], m and rad
  std::optional<BoardHang> hang;                         ///< how the board hung

  bool operator==(const TaughtDock&) const = default;
};

/// A dock that this robot knows.
struct DockEntry {
  std::string name;
  std::string type;                ///< Nav2's plugin for it; empty: Nav2's only one
  std::string frame = "map";       ///< of `pose`
  Pose2 pose;                      ///< of the robot's base when docked, in `frame`
  std::string id;                  ///< what Nav2 hands to the plugin; may be empty
  std::string board;               ///< ours: file of its board, relative to the database; empty: the configuration's
  std::optional<Pose2> dock_pose;  ///< ours: of the camera point in the station frame
  std::optional<TaughtDock> taught = std::nullopt;  ///< ours: `dock_pose` was measured there; none: it is nominal

  bool operator==(const DockEntry&) const = default;
};

/// Nav2's dock database: `docks: {NAME: {type, frame, pose: [x, y, yaw], id}}`, m and rad.
/// Throws Failure(usage) with file, line and key for what Nav2 would not take or would take for something else.
std::vector<DockEntry> read_nav2_docks(const std::filesystem::path& file);
std::string nav2_docks(const std::vector<DockEntry>& docks);

/// Ours: a list with units in its keys, and where each dock's board and taught pose are.
/// Throws as the other.
std::vector<DockEntry> read_docks(const std::filesystem::path& file);
std::string docks_yaml(const std::vector<DockEntry>& docks);

/// The dock of a name. Throws Failure(usage) with the names that there are.
DockEntry find_dock(const std::vector<DockEntry>& docks, const std::string& name);

/// The dock of --dock NAME in --docks FILE; none where neither was given.
/// Throws Failure(usage): only one of them, or as read_docks and find_dock.
std::optional<DockEntry> chosen_dock(const std::string& file, const std::string& name);

}  // namespace tagdock
