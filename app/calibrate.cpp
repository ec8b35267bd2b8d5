// Verb: what our instruments are. Each step of the wizard as a command of its own.
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <iostream>
#include <memory>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "app/calibrate_station.h"
#include "app/calibration_images.h"
#include "app/calibration_report.h"
#include "app/calibration_result.h"
#include "app/camera_file.h"
#include "app/camera_writer.h"
#include "app/failure.h"
#include "app/hand_eye_dataset.h"
#include "app/output_file.h"
#include "app/printed_target.h"
#include "app/rig_file.h"
#include "app/target_file.h"
#include "app/verbs.h"
#include "planning/pose2.h"

namespace tagdock {
namespace {

using Json = nlohmann::ordered_json;

struct HandEyeOptions {
  std::string dataset;
  std::string output;
  std::string camera;
  double camera_height = 0.0;
  double camera_height_sigma = 0.005;
  bool has_height = false;
  bool leave_out_frontal = false;
  std::string report;
  bool json = false;
};

void say_hand_eye(const HandEyeProblem& problem, const HandEyeResult& result) {
  std::ostream& out = std::cerr;
  int used = 0;
  for (const StopResidual& stop : result.stops) used += stop.used ? 1 : 0;
  char line[256];
  const auto print = [&](const char* format, auto... values) {
    std::snprintf(line, sizeof line, format, values...);
    out << line << "\n";
  };
  print("%d stops used of %zu, headings over %.0f deg, places over %.2f m", used, result.stops.size(),
        degrees(result.heading_spread), result.travel);
  for (const StopResidual& stop : result.stops)
    if (!stop.used) out << "  stop " << stop.id << " not used: " << stop.reason << "\n";
  const Eigen::Vector3d t = result.T_base_camera.translation();
  print("camera on the base: x %.4f m, y %.4f m (each +- %.2f mm), direction +- %.3f deg", t.x(), t.y(),
        1000.0 * result.xy_sigma, degrees(result.rotation_sigma));
  if (problem.by_wheels)
    print("wheels: left %.5f m, right %.5f m, track %.5f m (+- %.2f, %.2f, %.2f per mille)", result.odometry.r_left,
          result.odometry.r_right, result.odometry.track,
          1000.0 * std::sqrt(result.covariance(6, 6)) / result.odometry.r_left,
          1000.0 * std::sqrt(result.covariance(7, 7)) / result.odometry.r_right,
          1000.0 * std::sqrt(result.covariance(8, 8)) / result.odometry.track);
  print("noise against what was stated: corners %.2f, %s %.2f", result.corner_scale,
        problem.by_wheels ? "wheels" : "tracker", result.motion_scale);
  if (problem.camera_covariance.isZero(0.0))
    out << "the camera is taken as exact; give --camera with the file of `calibrate intrinsics` to count what it is "
           "unsure of\n";
  else
    print("of this the camera's own uncertainty makes %.3f mm and %.4f deg", 1000.0 * result.camera_xy_sigma,
          degrees(result.camera_rotation_sigma));
  if (result.visp.solved)
    print("ViSP's hand-eye solution differs by %.2f mm in the plane",
          1000.0 * (result.visp.T_base_camera.translation() - t).head<2>().norm());
  else
    out << "ViSP's hand-eye solution does not converge on these stops\n";
  for (const Unobservable& open : result.unobservable)
    out << "not determined: " << open.word << " - " << open.cure << "\n";
  if (result.complaints.empty()) {
    // Docked where it was taught, heading a from there, an error D of the camera's place moves the dock by (R(a) - 1)
    // D.
    const double heading = radians(10.0);
    print(
        "GOOD: at the dock this is %.2f mm when it is reached 10 deg beside the heading that was taught, %.2f mm "
        "where the place comes from a drawing",
        2000.0 * std::sin(0.5 * heading) * std::sqrt(2.0) * result.xy_sigma, 1000.0 * std::sqrt(2.0) * result.xy_sigma);
  } else {
    for (const std::string& complaint : result.complaints) out << "REFUSED: " << complaint << "\n";
  }
}

struct IntrinsicsOptions {
  std::string images;
  std::string target;
  std::string output;
  std::string lens = "auto";
  double working_distance = 2.0;
  bool flat_board = false;
  std::string report;
  std::vector<std::string> formats;
  bool json = false;
};

/// Writes a report as HTML, or as PDF if the file is called so.
void write_report(const Report& report, const std::string& file) {
  if (file.empty()) return;
  if (file.ends_with(".pdf"))
    to_pdf(report, file);
  else
    write_whole(file, to_html(report), "--report");
}

/// Writes a camera in another format and says what that format loses.
/// @return  the same as JSON
Json write_format(const CameraModel& camera, const std::string& format, const std::filesystem::path& file) {
  const CameraText text = camera_text(camera, format);
  write_whole(file, text.text);
  char line[256];
  std::snprintf(line, sizeof line, "%s: the format %s loses %.4f px at worst, %.4f px rms", file.string().c_str(),
                format.c_str(), text.loss.largest_px, text.loss.rms_px);
  std::cerr << line << "\n";
  return {{"format", format},
          {"output", file.string()},
          {"camera", camera_block(text.held)},
          {"loss_px", {{"max", text.loss.largest_px}, {"rms", text.loss.rms_px}}}};
}

struct ConvertOptions {
  std::string camera;
  std::string format;
  std::string output;
  bool json = false;
};

int convert(const ConvertOptions& options) {
  (void)camera_extension(options.format);
  check_outputs({{"--output", options.output}}, {options.camera});
  const Json block = write_format(CameraFile::load(options.camera).camera(), options.format, options.output);
  if (options.json) std::cout << block.dump(1) << "\n";
  return 0;
}

IntrinsicsConfig config_of(const IntrinsicsOptions& options) {
  IntrinsicsConfig config;
  config.flat_board = options.flat_board;
  if (options.lens == "auto") return config;
  std::string known;
  for (const LensModel model :
       {LensModel::k1, LensModel::k1_k2, LensModel::brown4, LensModel::brown5, LensModel::rational}) {
    if (options.lens == word(model)) config.lens = model;
    known += " " + std::string(word(model));
  }
  if (!config.lens) throw Failure(ExitCode::usage, "--lens " + options.lens + " is unknown; known are auto" + known);
  return config;
}

void say_intrinsics(const IntrinsicsOptions& options, const IntrinsicsResult& result,
                    const std::vector<std::string>& unreadable) {
  std::ostream& out = std::cerr;
  char line[256];
  const auto print = [&](const char* format, auto... values) {
    std::snprintf(line, sizeof line, format, values...);
    out << line << "\n";
  };
  for (const std::string& sentence : unreadable) out << "  " << sentence << "\n";
  int used = 0;
  for (const ViewResidual& view : result.views) {
    used += view.used ? 1 : 0;
    if (!view.used) out << "  " << view.name << " not used: " << view.reason << "\n";
  }
  print("%d of %zu views used, %zu corners, left %.3f px rms, lens %s", used, result.views.size(),
        result.corners.size(), result.rms_px, std::string(word(result.lens)).c_str());
  print("fx %.3f fy %.3f cx %.3f cy %.3f; board bowed by %.2f mm", result.camera.fx, result.camera.fy, result.camera.cx,
        result.camera.cy, 1000.0 * result.board.bow());
  print("projection known to %.3f px in the middle, %.3f px at worst; at %.1f m that is %.2f and %.2f mm",
        result.sigma_center_px, result.sigma_max_px, options.working_distance,
        1000.0 * options.working_distance * result.sigma_center_px / result.camera.fx,
        1000.0 * options.working_distance * result.sigma_max_px / result.camera.fx);
  if (result.halves_expected_px > 0.0)
    print("two halves of the views differ by %.3f px, their noise explains %.3f px", result.halves_px,
          result.halves_expected_px);
  if (result.complaints.empty()) {
    out << "GOOD\n";
    return;
  }
  for (const std::string& complaint : result.complaints) out << "REFUSED: " << complaint << "\n";
  for (const std::string& sentence : result.missing) out << "add: " << sentence << "\n";
}

int intrinsics(const IntrinsicsOptions& options) {
  if (!(options.working_distance > 0.0 && options.working_distance <= 100.0))
    throw Failure(ExitCode::usage, "--working-distance " + std::to_string(options.working_distance) +
                                       ": must be a distance in m, above 0 and at most 100");
  const IntrinsicsConfig config = config_of(options);
  std::vector<std::pair<std::string, std::filesystem::path>> outputs{{"--output", options.output},
                                                                     {"--report", options.report}};
  for (const std::string& format : options.formats)  // wrong words are told at once
    outputs.emplace_back("--format " + format,
                         std::filesystem::path(options.output).replace_extension(camera_extension(format)));
  std::vector<std::string> inputs = files_in(options.images);
  inputs.push_back(options.target);
  check_outputs(outputs, inputs);
  const CalibrationTarget target = read_target(options.target);
  FolderCalibration made = calibrate_from_folder(options.images, target, config);
  const ImageViews& found = made.views;
  IntrinsicsResult& result = made.result;
  if (!result.complaints.empty()) {
    std::vector<Eigen::Vector3d> points;
    const TargetLayout layout = layouts_of(target).front();
    for (const TargetLayout::Corner& corner : layout.corners) points.push_back(corner.point);
    for (const ViewWish& wish : next_best_views(result, points, 3)) result.missing.push_back(wish.sentence);
  }
  Json block = intrinsics_block(result, found.unreadable);
  block["quality"]["measured_over_drawn"] = {{"x", target.scale_x}, {"y", target.scale_y}};
  write_result(options.output, block);
  write_report(intrinsics_report(result, options.working_distance), options.report);
  if (result.complaints.empty())
    for (const std::string& format : options.formats)
      write_format(result.camera, format,
                   std::filesystem::path(options.output).replace_extension(camera_extension(format)));
  if (options.json) std::cout << block.dump(1) << "\n";
  say_intrinsics(options, result, found.unreadable);
  return static_cast<int>(result.complaints.empty() ? ExitCode::done : ExitCode::calibration_refused);
}

int hand_eye(const HandEyeOptions& options) {
  if (options.has_height && !(options.camera_height > 0.02 && options.camera_height < 5.0))
    throw Failure(ExitCode::usage, "--camera-height " + std::to_string(options.camera_height) +
                                       ": is the height of the lens above the floor in m, between 0.02 and 5");
  if (!(options.camera_height_sigma > 0.0 && options.camera_height_sigma <= 1.0))
    throw Failure(ExitCode::usage, "--camera-height-sigma " + std::to_string(options.camera_height_sigma) +
                                       ": must be above 0 and at most 1 m");
  std::vector<std::string> inputs = files_in(options.dataset);
  inputs.push_back(options.camera);
  check_outputs({{"--output", options.output}, {"--report", options.report}}, inputs);
  HandEyeProblem problem = read_hand_eye_dataset(options.dataset);
  problem.leave_out_frontal = options.leave_out_frontal;
  if (!options.camera.empty()) {
    const CameraFile camera = CameraFile::load(options.camera);
    problem.camera = camera.camera();
    problem.camera_covariance = camera.covariance();
  }
  if (options.has_height) problem.camera_height = Measured{options.camera_height, options.camera_height_sigma};
  HandEyeResult result;
  try {
    result = calibrate_hand_eye(problem);
  } catch (const std::invalid_argument& error) {
    throw Failure(ExitCode::calibration_refused, options.dataset + ": " + error.what());
  }
  const Json block = hand_eye_block(problem, result);
  write_result(options.output, block);
  write_report(hand_eye_report(problem, result), options.report);
  if (options.json) std::cout << block.dump(1) << "\n";
  say_hand_eye(problem, result);
  return static_cast<int>(result.complaints.empty() ? ExitCode::done : ExitCode::calibration_refused);
}

struct TargetOptions {
  std::string kind = "charuco";
  std::string paper;  ///< empty: what the kind needs
  std::string output;
  std::string description;
  std::string family = "tag36h11";
  std::string dictionary = "DICT_5X5_100";
  std::optional<int> columns;
  std::optional<int> rows;
  int id = 0;
  double square = 0.0;
  double marker = 0.0;
  double tag_size = 0.0;
  double spacing = 0.3;
  double height = 0.35;
  bool json = false;
};

void check(const TargetOptions& options) {
  const auto length = [](const char* option, double value) {
    if (!(value >= 0.0 && value <= 2.0))
      throw Failure(ExitCode::usage,
                    std::string(option) + " " + std::to_string(value) + ": must be a length in m, up to 2");
  };
  length("--square", options.square);
  length("--marker", options.marker);
  length("--tag-size", options.tag_size);
  length("--height", options.height);
  if (!(options.spacing > 0.0 && options.spacing <= 2.0))
    throw Failure(ExitCode::usage, "--spacing " + std::to_string(options.spacing) +
                                       ": is the gap between tags over their size, above 0 and at most 2");
  for (const auto& [option, count] : {std::pair("--cols", options.columns), std::pair("--rows", options.rows)})
    if (count && !(*count >= 1 && *count <= 100))
      throw Failure(ExitCode::usage, std::string(option) + " " + std::to_string(*count) + ": must be from 1 to 100");
}

/// A target as its description has it.
Json target_block(const CalibrationTarget& target) {
  Json block;
  if (target.type == CalibrationTarget::Type::charuco)
    block = {{"type", "charuco"},       {"squares_x", target.squares_x}, {"squares_y", target.squares_y},
             {"square", target.square}, {"marker", target.marker},       {"dictionary", target.dictionary}};
  else if (target.type == CalibrationTarget::Type::tag)
    block = {{"type", "tag"}, {"family", target.family}, {"id", target.first_id}, {"tag_size", target.tag_size}};
  else
    block = {{"type", target.type == CalibrationTarget::Type::taggrid ? "taggrid" : "aprilgrid"},
             {"tag_cols", target.tag_cols},
             {"tag_rows", target.tag_rows},
             {"tag_size", target.tag_size},
             {"tag_spacing", target.tag_spacing},
             {"family", target.family},
             {"first_id", target.first_id}};
  return block;
}

void say_target(const TargetOptions& options, const Paper& paper, const Json& drawn) {
  if (!options.json) return;
  const Json block{{"kind", options.kind},
                   {"paper", {{"name", paper.name}, {"width_mm", paper.width}, {"height_mm", paper.height}}},
                   {"output", options.output},
                   {"description", options.description.empty() ? Json(nullptr) : Json(options.description)},
                   {options.kind == "vboard" ? "board" : "target", drawn}};
  std::cout << block.dump(1) << "\n";
}

int target(TargetOptions options) {
  check(options);
  check_outputs({{"--output", options.output}, {"--description", options.description}}, {});
  if (options.paper.empty()) options.paper = options.kind == "vboard" ? "A3" : "A4";
  const Paper paper = paper_of(options.paper);
  if (options.kind == "vboard") {
    const double size = options.tag_size > 0.0 ? options.tag_size : 0.16;
    const Board board = v_board(size, options.height);
    print_board(board, 1.25 * size, radians(30.0), paper, options.output);
    if (!options.description.empty()) write_whole(options.description, drawn_board_text(board), "--description");
    say_target(options, paper, board_block(board));
    return 0;
  }
  CalibrationTarget wanted;
  wanted.family = options.family;
  wanted.dictionary = options.dictionary;
  wanted.first_id = options.id;
  wanted.tag_size = options.tag_size;
  wanted.tag_spacing = options.spacing;
  wanted.square = options.square;
  wanted.marker = options.marker;
  if (options.kind == "charuco") {
    wanted.type = CalibrationTarget::Type::charuco;
    wanted.squares_x = options.columns.value_or(10);
    wanted.squares_y = options.rows.value_or(7);
  } else if (options.kind == "taggrid" || options.kind == "aprilgrid") {
    wanted.type = options.kind == "taggrid" ? CalibrationTarget::Type::taggrid : CalibrationTarget::Type::aprilgrid;
    wanted.tag_cols = options.columns.value_or(6);
    wanted.tag_rows = options.rows.value_or(4);
  } else if (options.kind == "tag") {
    wanted.type = CalibrationTarget::Type::tag;
  } else {
    throw Failure(ExitCode::usage,
                  "--kind " + options.kind + " is unknown; known are charuco, taggrid, aprilgrid, tag, vboard");
  }
  const CalibrationTarget drawn = fitted(wanted, paper);
  print_target(drawn, paper, options.output);
  if (!options.description.empty()) write_whole(options.description, target_text(drawn), "--description");
  say_target(options, paper, target_block(drawn));
  return 0;
}

const char* const hand_eye_details =
    "DIR holds corners.csv (stop,id,u,v; with several frames of a stop frame, too, and if known sigma_px), "
    "board_points.csv (id,x,y,z), problem.yaml and tracker.csv or odometry.csv.\n"
    "The result file has camera, T_base_cam, odometry (with wheels), T_base_cam_sigma {xy_mm per axis, z_mm, rot_deg "
    "of\n"
    "the whole angle}, unobservable, rejected_views, verdict (good or refused), quality, and T_base_cam_covariance\n"
    "(x y z roll pitch yaw and, with wheels, r_left r_right track; m, rad). --json writes the same to stdout.\n"
    "Views of a single tag from within 25 degrees of its normal are left out of start values (the paper's cone) if 8\n"
    "others remain; --leave-out-frontal leaves them out of the solution, too. quality.stops marks them.\n"
    "height_known says whether `dock` may lean on the height in T_base_cam: without --camera-height or a surveyed "
    "board it\n"
    "is an arbitrary number, and `dock` refuses the rig.\n"
    "Good stops: 25 to 60 degrees to both sides of the board, 1.2 to 1.8 m away, turned so that the board stands left "
    "and\n"
    "right in the picture by turns, ten frames each. For wheels forty: from 50 degrees on one side to the other and "
    "back,\n"
    "1.25 and 2.75 m away by turns, at each place one stop with the board left and one with it right in the picture.\n"
    "Exit code 7: refused; the file is written with what is known, and `tagdock dock` will not take it.";

const char* const intrinsics_details =
    "TARGET.yaml: type charuco (squares_x, squares_y, square, marker, dictionary), aprilgrid or taggrid (tag_cols,\n"
    "tag_rows, tag_size, tag_spacing, family), or tag (family, id, tag_size), all optionally with points\n"
    "[[id, x, y, z], ..] and measured_over_drawn_x, measured_over_drawn_y. Lengths in m.\n"
    "The result file has camera, projection_sigma_px {max, center} (root of the mean square length of the "
    "projection's\n"
    "error at infinity, after the best turn), rejected_views, verdict (good or refused), quality, and "
    "camera_covariance\n"
    "(12 x 12: fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6). --json writes the same to stdout.\n"
    "Exit code 7: refused; the file is written with what is known.";

}  // namespace

void add_calibrate(CLI::App& program, Action& action) {
  CLI::App* verb =
      program.add_subcommand("calibrate", "camera, its place on the base, wheels, station; with a verdict");
  verb->require_subcommand(0, 1);

  const auto print = std::make_shared<TargetOptions>();
  CLI::App* sheet = verb->add_subcommand("target", "a board to print at its true size, as PDF, and its description");
  sheet
      ->add_option("--kind", print->kind,
                   "charuco, taggrid, aprilgrid, tag, or vboard (a station's board of three tags)")
      ->capture_default_str();
  sheet->add_option("--paper", print->paper, "A0 .. A5, letter, tabloid; landscape; A4, or A3 for a vboard");
  sheet->add_option("--output", print->output, "PDF file to write")->required();
  sheet->add_option("--description", print->description,
                    "YAML file that `calibrate` (or, of a vboard, `dock --board`) reads");
  sheet->add_option("--cols", print->columns, "squares or tags across");
  sheet->add_option("--rows", print->rows, "squares or tags down");
  sheet->add_option("--square", print->square, "side of a square [m]; as large as fits if not given");
  sheet->add_option("--marker", print->marker, "side of a mark [m]; three quarters of a square if not given");
  sheet->add_option("--dictionary", print->dictionary, "of the marks, as OpenCV names it")->capture_default_str();
  sheet->add_option("--tag-size", print->tag_size, "side of a tag's black square [m]; as large as fits if not given");
  sheet->add_option("--spacing", print->spacing, "gap between tags over their size")->capture_default_str();
  sheet->add_option("--family", print->family, "of the tags")->capture_default_str();
  sheet->add_option("--id", print->id, "of the tag, or of the grid's first one")->capture_default_str();
  sheet->add_option("--height", print->height, "of the vboard's tags above the floor [m]")->capture_default_str();
  sheet->add_flag("--json", print->json, "what was drawn as one JSON object on stdout");
  sheet->footer(
      "--json: kind, paper {name, width_mm, height_mm}, output, description (null if none was asked for), and target\n"
      "with the keys of its description or, of a vboard, board {family, tags}. Lengths in m if not named otherwise.\n"
      "Measure both rulers of 100 mm on the print; measured over drawn length goes into measured_over_drawn_x and _y "
      "of\n"
      "the description, of a vboard, too.");
  sheet->callback([print, &action] { action = [print] { return target(*print); }; });

  const auto from = std::make_shared<ConvertOptions>();
  CLI::App* other = verb->add_subcommand("convert", "a camera file in another program's format, and what that loses");
  other->add_option("--camera", from->camera, "any camera file that tagdock reads")->required();
  other->add_option("--format", from->format, "ros, opencv, kalibr, mrcal, visp or tagdock")->required();
  other->add_option("--output", from->output, "file to write")->required();
  other->add_flag("--json", from->json, "what was written as one JSON object on stdout");
  other->footer(
      "--json: format, output, camera (as the format holds it: width, height, fx, fy, cx, cy, dist), loss_px "
      "{max, rms}.");
  other->callback([from, &action] { action = [from] { return convert(*from); }; });

  const auto lens = std::make_shared<IntrinsicsOptions>();
  CLI::App* first = verb->add_subcommand("intrinsics", "the camera from pictures of a board");
  first->add_option("--images", lens->images, "folder of pictures")->required();
  first->add_option("--target", lens->target, "description of the board")->required();
  first->add_option("--output", lens->output, "camera file to write")->required();
  first->add_option("--lens", lens->lens, "auto, k1, k1_k2, k1_k2_p1_p2, k1_k2_p1_p2_k3 or rational")
      ->capture_default_str();
  first->add_option("--working-distance", lens->working_distance, "where px are told in mm, too [m]")
      ->capture_default_str();
  first->add_option("--report", lens->report, "HTML file, or PDF file if it ends in .pdf: maps, plots, verdict");
  first->add_option("--format", lens->formats,
                    "write the camera beside the output, too: ros, opencv, kalibr, mrcal, visp");
  first->add_flag("--flat-board", lens->flat_board, "take the board for flat (to see what its bow does)");
  first->add_flag("--json", lens->json, "the result as one JSON object on stdout");
  first->footer(intrinsics_details);
  first->callback([lens, &action] { action = [lens] { return intrinsics(*lens); }; });

  const auto hand = std::make_shared<HandEyeOptions>();
  CLI::App* step = verb->add_subcommand("hand-eye", "the camera's pose on the base, and the wheels, from stops");
  step->add_option("--dataset", hand->dataset, "folder with the stops")->required();
  step->add_option("--output", hand->output, "rig file to write")->required();
  step->add_option("--camera", hand->camera,
                   "camera file that replaces the one in problem.yaml; the covariance that `calibrate "
                   "intrinsics`\nwrote into it is counted in the result");
  const auto* height =
      step->add_option("--camera-height", hand->camera_height, "height of the lens above the floor, by tape [m]");
  step->add_option("--camera-height-sigma", hand->camera_height_sigma, "how sure that is [m]")->capture_default_str();
  step->add_flag("--leave-out-frontal", hand->leave_out_frontal,
                 "no views of a single tag from within 25 degrees of its normal");
  step->add_option("--report", hand->report, "HTML file, or PDF file if it ends in .pdf: plots and verdict");
  step->add_flag("--json", hand->json, "the result as one JSON object on stdout");
  step->footer(hand_eye_details);
  step->callback([hand, height, &action] {
    hand->has_height = height->count() > 0;
    action = [hand] { return hand_eye(*hand); };
  });

  add_calibrate_station(*verb, action);
}

}  // namespace tagdock
