// Verbs of `calibrate` beside the camera and its place: the wizard, the station's board, teach-in, the two-minute
// check.
#include "app/calibrate_station.h"

#include <algorithm>
#include <array>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <memory>
#include <stdexcept>
#include <thread>

#include "app/calibration_images.h"
#include "app/calibration_report.h"
#include "app/calibration_result.h"
#include "app/camera_file.h"
#include "app/cameras/open_camera.h"
#include "app/csv_table.h"
#include "app/failure.h"
#include "app/hand_eye_dataset.h"
#include "app/image_file.h"
#include "app/output_file.h"
#include "app/png_file.h"
#include "app/printed_target.h"
#include "app/rig_file.h"
#include "app/stop_signal.h"
#include "app/target_file.h"
#include "app/view.h"
#include "calibration/rig_check.h"
#include "calibration/station_survey.h"
#include "calibration/wizard.h"
#include "detection/tag_locator.h"
#include "planning/pose2.h"

namespace tagdock {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

std::string line_of(const char* format, auto... values) {
  char text[512];
  std::snprintf(text, sizeof text, format, values...);
  return text;
}

std::vector<fs::path> pictures_of(const fs::path& folder) {
  std::vector<fs::path> files;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(folder, error))
    if (entry.is_regular_file() && entry.path().extension() == ".png") files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  return files;
}

// ---- the wizard ----------------------------------------------------------------------------------------------------

struct WizardOptions {
  std::string target;
  std::string camera = "gige:127.0.0.1";
  std::string session = "calibration_session";
  std::string output = "camera.yaml";
  double measured_x_mm = 0.0;
  double measured_y_mm = 0.0;
  int seconds = 600;
  bool view = false;
  bool json = false;
};

/// What the window shows: the corners that were found, where the board should go, and the same sentence as the
/// terminal.
ViewContent content_of(const cv::Mat1b& gray, const WizardState& state, const std::string& sentence) {
  ViewContent content;
  content.gray = gray;
  if (state.last)
    for (const SeenPoint& seen : state.last->corners) content.points.push_back(seen.pixel);
  if (state.result && !state.wishes.empty() && !state.finished) {
    Eigen::AlignedBox2d box;
    for (const Eigen::Vector3d& point : state.board) box.extend(Eigen::Vector2d(point.head<2>()));
    const Eigen::Vector2d rim[] = {
        box.min(), {box.max().x(), box.min().y()}, box.max(), {box.min().x(), box.max().y()}};
    Corners outline;
    bool before = true;
    for (std::size_t i = 0; i < outline.size(); ++i) {
      const Eigen::Vector3d at = state.wishes.front().T_camera_board * Eigen::Vector3d(rim[i].x(), rim[i].y(), 0.0);
      before = before && at.z() > 0.05;
      if (before) outline[i] = project(state.result->camera, at);
    }
    if (before) content.target.push_back(outline);
  }
  content.lines = {std::to_string(state.kept.size()) + " views kept" +
                   (state.result && std::isfinite(state.result->sigma_max_px)
                        ? line_of("; known to %.2f px at worst", state.result->sigma_max_px)
                        : "")};
  // A line of the window holds about a hundred letters.
  constexpr std::size_t most = 100;
  for (std::size_t at = 0; at < sentence.size();) {
    std::size_t length = sentence.size() - at;
    if (length > most) {
      const std::size_t space = sentence.rfind(' ', at + most);
      length = space == std::string::npos || space <= at ? most : space - at;
    }
    content.lines.push_back(sentence.substr(at, length));
    at += length + (at + length < sentence.size() && sentence[at + length] == ' ' ? 1 : 0);
  }
  return content;
}

/// Asks for a length that was measured along a ruler of 100 mm; an empty answer keeps what is known.
double asked_length(const char* axis, double known_share) {
  std::cerr << "length of the " << axis << " ruler as measured, in mm [" << 100.0 * known_share << "]: " << std::flush;
  std::string answer;
  if (!std::getline(std::cin, answer) || answer.empty()) return known_share;
  const double value = std::atof(answer.c_str());
  if (!(value > 90.0 && value < 110.0)) {
    std::cerr << "that is no length near 100 mm; kept as it was\n";
    return known_share;
  }
  return value / 100.0;
}

int wizard(const WizardOptions& options) {
  for (const auto& [option, value] :
       {std::pair("--measured-x", options.measured_x_mm), std::pair("--measured-y", options.measured_y_mm)})
    if (value != 0.0 && !(value > 90.0 && value < 110.0))
      throw Failure(ExitCode::usage, line_of("%s %g: is the ruler of 100 mm as measured on the print, between 90 and "
                                             "110 mm",
                                             option, value));
  CalibrationTarget target = read_target(options.target);
  const CameraArgument argument = parse_camera_argument(options.camera);
  const fs::path folder = options.session;
  std::vector<std::string> inputs{options.target};
  if (const auto* images = std::get_if<Images>(&argument)) {
    const fs::path where = images->where;
    const fs::path from = fs::is_directory(where) ? where : where.parent_path();
    std::error_code none;
    if (fs::equivalent(folder, from, none))
      throw Failure(ExitCode::usage, "--session " + options.session + ": is the folder of --camera; name another one");
    for (const std::string& file : files_in(from)) inputs.push_back(file);
  }
  std::error_code error;
  fs::create_directories(folder, error);
  if (error) throw Failure(ExitCode::usage, "--session " + options.session + ": " + error.message());
  // What a session keeps is read when it goes on.
  inputs.push_back((folder / "target.yaml").string());
  for (const fs::path& file : pictures_of(folder)) inputs.push_back(file.string());
  check_outputs({{"--output", options.output}}, inputs);
  const bool asks = target.measured.empty() && !fs::exists(folder / "target.yaml");
  if (fs::exists(folder / "target.yaml")) target = read_target(folder / "target.yaml");  // a session that goes on
  if (options.measured_x_mm > 0.0) target.scale_x = options.measured_x_mm / 100.0;
  if (options.measured_y_mm > 0.0) target.scale_y = options.measured_y_mm / 100.0;
  if (asks && options.measured_x_mm <= 0.0) target.scale_x = asked_length("x", target.scale_x);
  if (asks && options.measured_y_mm <= 0.0) target.scale_y = asked_length("y", target.scale_y);
  if (target.measured.empty()) write_whole(folder / "target.yaml", target_text(target));

  WizardConfig config;
  WizardState state;
  const TargetLayout layout = layouts_of(target).front();
  for (const TargetLayout::Corner& corner : layout.corners) state.board.push_back(corner.point);
  const TargetFinder finder(target);
  std::unique_ptr<View> window;
  const auto offer = [&](const std::string& name, const cv::Mat1b& gray, bool forced) {
    if (state.width == 0) {
      state.width = gray.cols;
      state.height = gray.rows;
    }
    if (gray.cols != state.width || gray.rows != state.height)
      throw Failure(ExitCode::usage, name + ": the session's pictures have " + std::to_string(state.width) + "x" +
                                         std::to_string(state.height) + " pixels, this one has another size");
    WizardStep made = step(state, view_of(name, finder.find(gray)), config, forced);
    state = std::move(made.next);
    if (!made.sentence.empty()) std::cerr << made.sentence << "\n";
    if (options.view) {
      if (!window) window = std::make_unique<View>("tagdock calibrate", gray.cols, gray.rows);
      window->show(content_of(gray, state, made.sentence.empty() ? advice(state, config) : made.sentence));
    }
    return made.keep;
  };
  // A session that was broken off goes on: every view was kept as a picture.
  for (const fs::path& file : pictures_of(folder)) {
    const auto image = read_grey(file);
    if (const auto* gray = std::get_if<cv::Mat1b>(&image)) offer(file.filename().string(), *gray, true);
  }
  if (!state.kept.empty()) std::cerr << "the session " << options.session << " goes on with its views\n";

  if (std::holds_alternative<SimulatedCamera>(argument))
    throw Failure(ExitCode::usage,
                  "--camera sim shows the station, not a calibration board; give gige:... or images:DIR");
  if (!state.finished) {
    const auto begin = std::chrono::steady_clock::now();
    const bool live = !std::holds_alternative<Images>(argument);
    constexpr double folder_rate = 50.0;  // pictures a second; nobody waits for a folder
    const std::unique_ptr<Camera> camera = open_camera(argument, GigeSettings{}, folder_rate, begin);
    std::cerr << advice(state, config) << "\n";
    const StopSignal stop;
    std::chrono::nanoseconds now{0};
    while (!state.finished && !stop.requested()) {
      // A folder has its own time, so that no picture is passed over while another is looked at.
      now = live ? std::chrono::steady_clock::now() - begin : now + std::chrono::milliseconds(20);
      if (now > std::chrono::seconds(options.seconds)) break;
      const std::optional<CameraFrame> frame = camera->newest(now);
      if (!frame) {
        const CameraHealth health = camera->health();
        if (health.state == "ended") break;
        if (health.state == "lost") throw Failure(ExitCode::camera, health.reason);
        if (live) std::this_thread::sleep_for(std::chrono::milliseconds(10));
        continue;
      }
      const std::string name = line_of("view%06llu.png", static_cast<unsigned long long>(state.kept.size()));
      if (!offer(name, frame->frame.gray, !live)) continue;
      const std::vector<std::uint8_t> png = png_of(frame->frame.gray, "");
      write_whole(folder / name, std::string(png.begin(), png.end()));  // whole or not there, however this ends
    }
    if (stop.requested()) {
      std::cerr << "stopped; the same command goes on from here\n";
      return static_cast<int>(ExitCode::interrupted);
    }
  }
  if (state.kept.empty()) throw Failure(ExitCode::calibration_refused, "no picture was kept that shows the board");
  // From the pictures that were kept, as `calibrate intrinsics` would: now that the lens is known, corners are fitted
  // through it.
  const FolderCalibration made = calibrate_from_folder(folder, target, IntrinsicsConfig{});
  const IntrinsicsResult& result = made.result;
  Json block = intrinsics_block(result, made.views.unreadable);
  block["quality"]["measured_over_drawn"] = {{"x", target.scale_x}, {"y", target.scale_y}};
  write_result(options.output, block);
  if (options.json) std::cout << block.dump(1) << "\n";
  const Report report = intrinsics_report(result, 2.0);
  write_whole(folder / "report.html", to_html(report));
  to_pdf(report, folder / "report.pdf");
  for (const std::string& sentence : report.verdict) std::cerr << sentence << "\n";
  std::cerr << "written: " << options.output << ", " << (folder / "report.html").string() << ", report.pdf\n";
  return static_cast<int>(result.complaints.empty() ? ExitCode::done : ExitCode::calibration_refused);
}

/// Without any argument: prints a board first, then walks through the calibration with it.
int from_nothing() {
  WizardOptions options;
  options.target = "board.yaml";
  if (fs::exists(options.target)) return wizard(options);
  CalibrationTarget board;
  board.squares_x = 10;
  board.squares_y = 7;
  board.dictionary = "DICT_5X5_100";
  const Paper paper = paper_of("A4");
  board = fitted(board, paper);
  print_target(board, paper, "board.pdf");
  write_whole(options.target, target_text(board));
  std::cerr
      << "There is no board.yaml here, so a board was drawn: print board.pdf at 100 %, glue it onto something stiff "
         "and flat, measure its two rulers, and run `tagdock calibrate` here again (or `tagdock calibrate wizard "
         "--camera ... --target ...`; `tagdock calibrate --help` lists the single steps).\n";
  return 0;
}

// ---- the station ---------------------------------------------------------------------------------------------------

struct StationOptions {
  std::string images;
  std::string camera;
  std::string board;
  std::string output;
  int reference = -1;
  bool json = false;
};

Json station_block(const BoardSurvey& survey, int reference, const std::vector<std::string>& unreadable) {
  Json block = board_block(survey.board);
  block["verdict"] = survey.complaints.empty() ? "good" : "refused";
  Json quality;
  quality["kind"] = "station";
  quality["reasons"] = survey.complaints;
  quality["reference"] = reference;
  quality["rms_px"] = survey.rms_px;
  quality["corner_noise_over_claimed"] = survey.over_claimed;
  quality["wing_angle_deg"] = survey.wing_angle_deg;
  Json tags = Json::array();
  for (const BoardSurvey::Moved& tag : survey.tags)
    tags.push_back({{"id", tag.id},
                    {"offset_mm", tag.offset_mm},
                    {"sigma_mm", tag.sigma_mm},
                    {"angle_deg", tag.angle_deg},
                    {"sigma_deg", tag.sigma_deg},
                    {"pictures", tag.views},
                    {"rms_px", tag.rms_px}});
  quality["tags"] = tags;
  Json pictures = Json::array();
  for (const BoardSurvey::Left& picture : survey.pictures)
    pictures.push_back({{"name", picture.name}, {"rms_px", picture.rms_px}});
  quality["pictures"] = pictures;
  quality["unreadable"] = unreadable;
  block["quality"] = quality;
  return block;
}

int station(const StationOptions& options) {
  std::vector<std::string> inputs = files_in(options.images);
  inputs.insert(inputs.end(), {options.camera, options.board});
  check_outputs({{"--output", options.output}}, inputs);
  const CameraFile camera = CameraFile::load(options.camera);
  const Board board = read_board(options.board);
  const int reference = options.reference >= 0 ? options.reference : board.tags[board.tags.size() / 2].id;
  std::string ids;
  for (const auto& tag : board.tags) ids += " " + std::to_string(tag.id);
  if (std::none_of(board.tags.begin(), board.tags.end(), [&](const auto& tag) { return tag.id == reference; }))
    throw Failure(ExitCode::usage, line_of("--reference %d: is no tag of %s, which has%s", reference,
                                           options.board.c_str(), ids.c_str()));
  TagDetectorConfig config;
  config.family = board.family;
  config.decimate = 1;
  const TagDetector detector(config);
  std::vector<TagView> views;
  std::vector<std::string> unreadable;
  std::vector<fs::path> files;
  std::error_code error;
  for (const auto& entry : fs::directory_iterator(options.images, error))
    if (entry.is_regular_file()) files.push_back(entry.path());
  if (error) throw Failure(ExitCode::usage, "--images " + options.images + ": " + error.message());
  std::sort(files.begin(), files.end());
  for (const fs::path& file : files) {
    const auto image = read_grey(file);
    const auto* gray = std::get_if<cv::Mat1b>(&image);
    if (gray == nullptr) {
      unreadable.push_back(std::get<std::string>(image));
      std::cerr << unreadable.back() << "\n";
      continue;
    }
    camera.require_size(gray->cols, gray->rows, file.string());
    TagView view{file.filename().string(), {}};
    for (const TagDetection& tag : detector.detect(*gray)) {
      const Refinement refinement = refine(*gray, board.family, tag, CornerMethod::best, camera.camera());
      if (const auto* refined = std::get_if<RefinedTag>(&refinement))
        view.tags.push_back({tag.id, refined->corners_px, std::sqrt(refined->covariance_px2.trace() / 8.0)});
    }
    views.push_back(view);
  }
  BoardSurvey survey;
  try {
    survey = survey_board(views, board, camera.camera(), reference);
  } catch (const std::invalid_argument& refused) {
    throw Failure(ExitCode::calibration_refused, options.images + ": " + refused.what());
  }
  const Json block = station_block(survey, reference, unreadable);
  write_result(options.output, block);
  if (options.json) std::cout << block.dump(1) << "\n";
  std::cerr
      << line_of(
             "%zu pictures used; corners leave %.3f px rms, %.2f times what they were measured to; the outer tags "
             "stand at %.2f degrees to each other",
             survey.pictures.size(), survey.rms_px, survey.over_claimed, survey.wing_angle_deg)
      << "\n";
  for (const BoardSurvey::Moved& tag : survey.tags)
    std::cerr << line_of("tag %d: %.2f mm (+- %.2f) and %.3f deg (+- %.3f) beside the board file, in %d pictures",
                         tag.id, tag.offset_mm, tag.sigma_mm, tag.angle_deg, tag.sigma_deg, tag.views)
              << "\n";
  if (survey.complaints.empty()) std::cerr << "GOOD\n";
  for (const std::string& complaint : survey.complaints) std::cerr << "REFUSED: " << complaint << "\n";
  return static_cast<int>(survey.complaints.empty() ? ExitCode::done : ExitCode::calibration_refused);
}

int teach(const std::string& file, bool json) {
  const CsvTable table = CsvTable::load(file);
  const std::size_t columns[] = {table.column("x"), table.column("y"), table.column("yaw")};
  std::vector<Pose2> poses;
  for (std::size_t row = 0; row < table.rows(); ++row)
    poses.push_back({table.number(row, columns[0]), table.number(row, columns[1]), table.number(row, columns[2])});
  const Taught taught = teach_in(poses);
  for (const std::size_t outlier : taught.outliers)
    std::cerr << "docking " << outlier + 1 << " lies more than 10 mm or 1 degree beside the others: left out\n";
  for (const std::string& complaint : taught.complaints) std::cerr << "REFUSED: " << complaint << "\n";
  std::cerr << line_of("spread of one docking by hand: %.2f mm, %.2f mm, %.3f deg", 1000.0 * taught.spread.x,
                       1000.0 * taught.spread.y, degrees(taught.spread.yaw))
            << "\n";
  if (json) {
    const Json block{{"dock_pose", {{"x", taught.mean.x}, {"y", taught.mean.y}, {"yaw", taught.mean.yaw}}},
                     {"spread", {{"x", taught.spread.x}, {"y", taught.spread.y}, {"yaw", taught.spread.yaw}}},
                     {"outliers", taught.outliers},
                     {"reasons", taught.complaints}};
    std::cout << block.dump(1) << "\n";
  } else if (taught.complaints.empty()) {
    std::cout << line_of("--dock-pose %.6f,%.6f,%.5f", taught.mean.x, taught.mean.y, degrees(taught.mean.yaw)) << "\n";
  }
  return static_cast<int>(taught.complaints.empty() ? ExitCode::done : ExitCode::calibration_refused);
}

int check_again(const std::string& dataset, const std::string& rig_file, bool json) {
  HandEyeProblem problem = read_hand_eye_dataset(dataset);
  const Rig rig = read_rig(rig_file);
  problem.camera = rig.camera;
  constexpr std::size_t fewest_stops = 5;
  if (problem.stops.size() < fewest_stops)
    throw Failure(ExitCode::calibration_refused,
                  line_of("%s: has %zu stops, too few to tell whether the calibration holds; add %zu", dataset.c_str(),
                          problem.stops.size(), fewest_stops - problem.stops.size()));
  RigCheck check;
  try {
    check = check_rig(problem, rig);
  } catch (const std::invalid_argument& refused) {
    throw Failure(ExitCode::calibration_refused, dataset + ": " + refused.what());
  }
  if (json) {
    const Json block{{"holds", check.holds},
                     {"surprise", check.surprise},
                     {"limit", check.limit},
                     {"moved_mm", check.moved_mm},
                     {"turned_deg", check.turned_deg},
                     {"sigma_mm", 1000.0 * check.now.xy_sigma},
                     {"sigma_deg", degrees(check.now.rotation_sigma)}};
    std::cout << block.dump(1) << "\n";
  }
  std::cerr
      << line_of(
             "against the rig the camera seems %.2f mm (+- %.2f) and %.3f deg (+- %.3f) away; chance explains up to "
             "%.1f, this is %.1f",
             check.moved_mm, 1000.0 * check.now.xy_sigma, check.turned_deg, degrees(check.now.rotation_sigma),
             check.limit, check.surprise)
      << "\n"
      << (check.holds ? "the calibration HOLDS, as far as these stops can tell\n"
                      : "the calibration NO LONGER HOLDS: calibrate again before docking\n");
  return static_cast<int>(check.holds ? ExitCode::done : ExitCode::calibration_refused);
}

}  // namespace

void add_calibrate_station(CLI::App& verb, Action& action) {
  const auto options = std::make_shared<WizardOptions>();
  CLI::App* walk = verb.add_subcommand("wizard", "walk through the camera's calibration, picture by picture");
  walk->add_option("--target", options->target, "description of the board")->required();
  walk->add_option("--camera", options->camera, "gige:127.x.y.z, gige:SERIAL or images:DIR")->capture_default_str();
  walk->add_option("--session", options->session, "folder that keeps every view; a session broken off goes on")
      ->capture_default_str();
  walk->add_option("--output", options->output, "camera file to write")->capture_default_str();
  walk->add_option("--measured-x", options->measured_x_mm,
                   "the x ruler of 100 mm as measured [mm]; asked if not given");
  walk->add_option("--measured-y", options->measured_y_mm, "the y ruler of 100 mm as measured [mm]");
  walk->add_flag("--view", options->view,
                 "a window with the picture, the corners found and where to hold the board next");
  walk->add_option("--seconds", options->seconds, "give up a live camera after this time")->capture_default_str();
  walk->add_flag("--json", options->json, "the result as one JSON object on stdout, as `calibrate intrinsics` has it");
  walk->callback([options, &action] { action = [options] { return wizard(*options); }; });

  const auto survey = std::make_shared<StationOptions>();
  CLI::App* board = verb.add_subcommand("station", "how the tags of a station's board really stand to each other");
  board->add_option("--images", survey->images, "pictures that show two or more of its tags")->required();
  board->add_option("--camera", survey->camera, "camera file")->required();
  board->add_option("--board", survey->board, "board as drawn")->required();
  board->add_option("--output", survey->output, "board file to write")->required();
  board->add_option("--reference", survey->reference, "tag that stays where the board file has it (the middle one)");
  board->add_flag("--json", survey->json, "the result as one JSON object on stdout");
  board->footer(
      "The result file has family and tags, as `dock --board` reads them, verdict (good or refused), and quality: "
      "reasons,\n"
      "reference, rms_px, corner_noise_over_claimed, wing_angle_deg, tags {id, offset_mm, sigma_mm, angle_deg, "
      "sigma_deg,\n"
      "pictures, rms_px}, pictures {name, rms_px}, unreadable. --json writes the same to stdout.\n"
      "Exit code 7: refused; the file is written with what is known, and `tagdock dock` will not take it.");
  board->callback([survey, &action] { action = [survey] { return station(*survey); }; });

  const auto teaching = std::make_shared<std::pair<std::string, bool>>();
  CLI::App* by_hand = verb.add_subcommand("teach", "the docking pose from some dockings by hand");
  by_hand
      ->add_option("--poses", teaching->first,
                   "CSV x,y,yaw (m, rad): camera point in the station frame, one line a docking")
      ->required();
  by_hand->add_flag("--json", teaching->second, "one JSON object on stdout instead of the option for `dock`");
  by_hand->callback([teaching, &action] { action = [teaching] { return teach(teaching->first, teaching->second); }; });

  const auto again = std::make_shared<std::array<std::string, 2>>();
  const auto json = std::make_shared<bool>(false);
  CLI::App* check = verb.add_subcommand("check", "does a rig still hold: some stops, two minutes");
  check->add_option("--dataset", (*again)[0], "folder with the stops, as for hand-eye; five or more")->required();
  check->add_option("--rig", (*again)[1], "rig file")->required();
  check->add_flag("--json", *json, "one JSON object on stdout");
  check->callback(
      [again, json, &action] { action = [again, json] { return check_again((*again)[0], (*again)[1], *json); }; });

  verb.callback([&verb, &action] {
    if (verb.get_subcommands().empty()) action = from_nothing;
  });
}

}  // namespace tagdock
