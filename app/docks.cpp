// Verb: docks. Between the dock database of ROS 2's Nav2 and ours.
#include <fstream>
#include <iostream>
#include <memory>

#include "app/dock_database.h"
#include "app/failure.h"
#include "app/verbs.h"

namespace tagdock {
namespace {

struct DocksOptions {
  std::string file;
  std::string output;
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

}  // namespace

void add_docks(CLI::App& program, Action& action) {
  CLI::App* verb = program.add_subcommand("docks", "Docks of this robot, from and to the dock database of Nav2.");
  verb->require_subcommand(1);
  const auto add = [&](const char* name, const char* what, const char* file, auto convert) {
    auto options = std::make_shared<DocksOptions>();
    CLI::App* one = verb->add_subcommand(name, what);
    one->add_option("file", options->file, file)->required();
    one->add_option("--output", options->output, "file to write; stdout without");
    one->callback([options, convert, &action] {
      action = [options, convert] {
        deliver(convert(options->file), options->output);
        return static_cast<int>(ExitCode::done);
      };
    });
  };
  add("import", "Nav2's dock database to ours.", "Nav2's: docks: {NAME: {type, frame, pose: [x, y, yaw], id}}",
      [](const std::string& file) { return docks_yaml(read_nav2_docks(file)); });
  add("export", "Our docks as Nav2's dock database.", "ours, as import writes it",
      [](const std::string& file) { return nav2_docks(read_docks(file)); });
  verb->footer(
      "Examples:\n  tagdock docks import nav2_docks.yaml --output docks.yaml\n"
      "  tagdock docks export docks.yaml --output nav2_docks.yaml\n"
      "  tagdock dock --docks docks.yaml --dock home_dock\nExit codes: 0 done, 2 usage or a file that is refused.");
}

}  // namespace tagdock
