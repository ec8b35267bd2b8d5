#pragma once

#include <functional>

#include <CLI/CLI.hpp>

namespace tagdock {

/// What a verb does once its arguments are read; gives the exit code (app/failure.h) or throws Failure.
using Action = std::function<int()>;

/// Each adds its verb with options and help to the program, and sets `action` when the command line chose it.
void add_plan(CLI::App& program, Action& action);
void add_detect(CLI::App& program, Action& action);
void add_dock(CLI::App& program, Action& action);
void add_undock(CLI::App& program, Action& action);
void add_teach(CLI::App& program, Action& action);
void add_replay(CLI::App& program, Action& action);
void add_evaluate(CLI::App& program, Action& action);
void add_docks(CLI::App& program, Action& action);
void add_robot_sim(CLI::App& program, Action& action);
void add_doctor(CLI::App& program, Action& action);
void add_calibrate(CLI::App& program, Action& action);
void add_record(CLI::App& program, Action& action);
void add_export(CLI::App& program, Action& action);
void add_camera_sim(CLI::App& program, Action& action);

}  // namespace tagdock
