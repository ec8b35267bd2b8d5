// Verb: docks. Between the dock database of ROS 2's Nav2 and ours.
#include <fstream>
#include <iostream>
#include <memory>

#include <nlohmann/json.hpp>

#include "app/dock_database.h"
#include "app/failure.h"
#include "app/output_file.h"
#include "app/verbs.h"

namespace tagdock {
namespace {

struct DocksOptions {
  std::string file;
  std::string output;
  bool json = false;
};

void deliver(const std::string& text, const std::string& output) {
  if (output.empty()) {
    std::cout << text;
    return;
  }
  std::ofstream stream(output, std::ios::binary);
  stream << text << std::flush;
  if (!stream) throw Failure(ExitCode::usage, "--output " + output + ": cannot be written");
}

// Sigmas in the frame of dock_pose, m and rad.
nlohmann::ordered_json taught_json(const TaughtDock& taught) {
  const Eigen::Vector3d sigma = taught.covariance.diagonal().cwiseSqrt();
  nlohmann::ordered_json json{{"sigma", {{"x", sigma.x()}, {"y", sigma.y()}, {"yaw", sigma.z()}}}, {"hang", nullptr}};
  if (taught.hang)
    json["hang"] = {
        {"camera_height", taught.hang->camera_height}, {"roll", taught.hang->roll}, {"pitch", taught.hang->pitch}};
  return json;
}

std::string json_of(const std::vector<DockEntry>& docks) {
  const auto pose = [](const Pose2& value) {
    return nlohmann::ordered_json{{"x", value.x}, {"y", value.y}, {"yaw", value.yaw}};
  };
  nlohmann::ordered_json json;
  json["schema"] = "tagdock-docks/1";
  json["docks"] = nlohmann::ordered_json::array();
  for (const DockEntry& dock : docks) {
    nlohmann::ordered_json one{{"name", dock.name},       {"type", dock.type}, {"frame", dock.frame},
                               {"pose", pose(dock.pose)}, {"id", dock.id},     {"board", dock.board}};
    one["dock_pose"] = dock.dock_pose ? pose(*dock.dock_pose) : nlohmann::ordered_json();
    one["taught"] = dock.taught ? taught_json(*dock.taught) : nlohmann::ordered_json();
    json["docks"].push_back(one);
  }
  return json.dump(2) + "\n";
}

}  // namespace

void add_docks(CLI::App& program, Action& action) {
  CLI::App* verb = program.add_subcommand("docks", "Docks of this robot, from and to the dock database of Nav2.");
  verb->require_subcommand(1);
  // Ours may hold boards and docking poses that a person added: an import does not write over it.
  const auto add = [&](const char* name, const char* what, const char* file, bool keeps_additions, auto read,
                       auto write) {
    auto options = std::make_shared<DocksOptions>();
    CLI::App* one = verb->add_subcommand(name, what);
    one->add_option("file", options->file, file)->required();
    one->add_option("--output", options->output, "file to write; stdout without");
    one->add_flag("--json", options->json,
                  "the docks as one JSON object on stdout, m and rad; with --output beside it");
    one->callback([=, &action] {
      action = [=] {
        check_not_an_input("--output", options->output, {options->file});
        if (keeps_additions) check_new("--output", options->output);
        const std::vector<DockEntry> docks = read(options->file);
        if (!options->json || !options->output.empty()) deliver(write(docks), options->output);
        if (options->json) std::cout << json_of(docks);
        return static_cast<int>(ExitCode::done);
      };
    });
  };
  add("import", "Nav2's dock database to ours.", "Nav2's: docks: {NAME: {type, frame, pose: [x, y, yaw], id}}", true,
      read_nav2_docks, docks_yaml);
  add("export", "Our docks as Nav2's dock database.", "ours, as import writes it", false, read_docks, nav2_docks);
  verb->footer(
      "Examples:\n  tagdock docks import nav2_docks.yaml --output docks.yaml\n"
      "  tagdock docks export docks.yaml --output nav2_docks.yaml\n"
      "  tagdock dock --docks docks.yaml --dock home_dock\nExit codes: 0 done, 2 usage or a file that is refused.");
}

}  // namespace tagdock
