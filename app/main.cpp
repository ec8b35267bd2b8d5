// Dispatches to a verb, catches once, sets the exit code; nothing else.
#include <algorithm>
#include <exception>
#include <iostream>
#include <string>
#include <vector>

#include "app/cameras/gige_process.h"
#include "app/failure.h"
#include "app/nearest_word.h"
#include "app/verbs.h"

namespace tagdock {
namespace {

int run_verb(int argc, char** argv) {
  CLI::App program("Docks a mobile robot at its station with one camera and AprilTags.", "tagdock");
  program.require_subcommand(1);
  program.set_version_flag("--version", std::string("tagdock " TAGDOCK_VERSION));
  Action action;
  add_dock(program, action);
  add_undock(program, action);
  add_teach(program, action);
  add_replay(program, action);
  add_detect(program, action);
  add_plan(program, action);
  add_evaluate(program, action);
  add_calibrate(program, action);
  add_docks(program, action);
  add_robot_sim(program, action);
  add_doctor(program, action);
  add_record(program, action);
  add_export(program, action);
  add_camera_sim(program, action);
  program.failure_message([](const CLI::App* app, const CLI::Error& error) {
    return "tagdock: " + CLI::FailureMessage::simple(app, error);
  });
  std::vector<std::string> verbs;
  for (const CLI::App* verb : program.get_subcommands({})) verbs.push_back(verb->get_name());
  if (argc > 1 && argv[1][0] != '-' && std::find(verbs.begin(), verbs.end(), argv[1]) == verbs.end()) {
    const std::string nearest = nearest_word(argv[1], verbs);
    std::cerr << "tagdock: there is no verb " << argv[1] << (nearest.empty() ? "" : "; did you mean " + nearest + "?")
              << "\nRun with --help for the verbs.\n";
    return static_cast<int>(ExitCode::usage);
  }
  try {
    program.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return program.exit(error) == 0 ? 0 : static_cast<int>(ExitCode::usage);
  }
  return action();
}

}  // namespace
}  // namespace tagdock

int main(int argc, char** argv) {
  using namespace tagdock;
  try {
    // The process of the Aravis client (app/cameras/gige.h): not a verb, only tagdock itself starts it.
    if (argc == 2 && std::string(argv[1]) == gige_client_word) return serve_gige_client(gige_client_socket);
    return run_verb(argc, argv);
  } catch (const Failure& failure) {
    std::cerr << "tagdock: " << failure.what() << "\n";
    return static_cast<int>(failure.code());
  } catch (const std::exception& error) {
    std::cerr << "tagdock: internal error: " << error.what() << "\n";
    return static_cast<int>(ExitCode::internal);
  }
}
