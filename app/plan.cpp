// Verb: poses -> plan, or why there is none; draws it.
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iostream>
#include <limits>
#include <memory>
#include <sstream>
#include <vector>

#include <nlohmann/json.hpp>

#include "app/config.h"
#include "app/failure.h"
#include "app/output_file.h"
#include "app/plan_picture.h"
#include "app/verbs.h"
#include "planning/docking_plan.h"
#include "planning/drift.h"
#include "planning/time_law.h"

namespace tagdock {
namespace {

using nlohmann::json;

constexpr const char* csv_header = "id,time_ns,status,sx,sy,sth,gx,gy,gth,length,curv_start,curv_end\n";

enum class Mode { forward, dubins, reeds_shepp };

/// The command line as it was given.
struct PlanArguments {
  std::string from, to, batch, output, svg, board, config, sensor_errors;
  std::vector<std::string> keep_out;
  double max_curvature = TurnLimits{}.max_curvature;
  double max_sharpness = TurnLimits{}.max_sharpness;
  double initial_straight = 0.0;
  double final_straight = 0.0;
  double softness = 0.0;
  std::string mode = "forward";
  std::string as = "clothoids";
  int arc_steps = 0;
  double arc_deviation = 0.0;
  double arc_curvature_step = 0.0;
  double view_deg = 0.0;
  double camera_ahead = ViewWish{}.camera_ahead;
  double camera_yaw_deg = 0.0;
  double board_width = 2.0 * ViewWish{}.board_half_width;
  double min_range = ViewWish{}.min_range;
  double max_range = ViewWish{}.max_range;
  std::vector<std::string> tags;
  std::vector<double> incidence_deg = {degrees(ViewWish{}.least_incidence), degrees(ViewWish{}.most_incidence)};
  double measure_over = ViewWish{}.measured_over_last;
  std::vector<double> footprint = {Footprint{}.ahead, Footprint{}.behind, Footprint{}.width};
  double keep_out_margin = KeepOut{}.margin;
  double contact_within = 0.0;
  double period_length = 0.0;
  WheelLimits wheels;
  bool reverse = false;
  bool as_json = false;
  bool explain = false;
};

struct Query {
  std::string id;
  Pose2 start;
  Pose2 goal;
  TurnLimits limits;
};

/// What the camera will tell, as far as its errors were measured.
struct Sureness {
  std::optional<Eigen::Vector3d> start, goal;  ///< one sigma of x, y [m] and yaw [rad] of one frame, station frame
  std::string refusal;                         ///< why the robot would not dock there; empty: it would
  std::string warning;                         ///< what it would hold against the start
};

struct Answer {
  const DockingPlanResult& result;
  long long time_ns = 0;
  std::optional<Sureness> sureness = std::nullopt;  ///< with a robot

  [[nodiscard]] bool refused_as_unsure() const {
    return sureness && !sureness->refusal.empty() && std::holds_alternative<DockingPlan>(result);
  }
};

std::string_view trimmed(std::string_view text) {
  const auto blank = [](char c) { return c == ' ' || c == '\t' || c == '\r'; };
  while (!text.empty() && blank(text.front())) text.remove_prefix(1);
  while (!text.empty() && blank(text.back())) text.remove_suffix(1);
  return text;
}

/// A number as written; what overflows becomes infinite and what underflows zero, so that it is refused by its value.
std::optional<double> parsed(std::string_view text) {
  text = trimmed(text);
  if (!text.empty() && text.front() == '+') text.remove_prefix(1);
  double value = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || end != text.data() + text.size()) return std::nullopt;
  if (error == std::errc::result_out_of_range) return std::strtod(std::string(text).c_str(), nullptr);
  if (error != std::errc{}) return std::nullopt;
  return value;
}

std::vector<std::string_view> split(std::string_view line) {
  std::vector<std::string_view> fields;
  for (;;) {
    const std::size_t comma = line.find(',');
    fields.push_back(trimmed(line.substr(0, comma)));
    if (comma == std::string_view::npos) return fields;
    line.remove_prefix(comma + 1);
  }
}

/// "X,Y,YAW_DEG" of an option.
Pose2 pose_option(const std::string& text, const char* option) {
  const auto fields = split(text);
  Pose2 pose;
  const std::array<double*, 3> into = {&pose.x, &pose.y, &pose.yaw};
  for (std::size_t i = 0; i < 3; ++i) {
    const std::optional<double> value = fields.size() == 3 ? parsed(fields[i]) : std::nullopt;
    if (!value)
      throw Failure(ExitCode::usage,
                    std::string(option) + " is \"" + text + "\"; it must be three numbers X,Y,YAW_DEG");
    *into[i] = *value;
  }
  pose.yaw = radians(pose.yaw);
  return pose;
}

/// "X,Y,X,Y,X,Y" of --keep-out.
Polygon polygon_option(const std::string& text) {
  const auto fields = split(text);
  Polygon polygon;
  bool fine = fields.size() >= 6 && fields.size() % 2 == 0;
  for (std::size_t i = 0; fine && i < fields.size(); i += 2) {
    const std::optional<double> x = parsed(fields[i]);
    const std::optional<double> y = parsed(fields[i + 1]);
    fine = x && y && std::isfinite(*x) && std::isfinite(*y);
    if (fine) polygon.push_back({*x, *y});
  }
  if (!fine)
    throw Failure(ExitCode::usage, "--keep-out is \"" + text + "\"; it must be three corners or more, X,Y,X,Y,X,Y");
  return polygon;
}

/// As %.17g: what is read back is the same number.
void append_exact(std::string& text, double value) {
  char digits[40];
  text.append(digits, std::to_chars(digits, digits + sizeof digits, value, std::chars_format::general, 17).ptr);
}

std::string exact(double value) {
  std::string text;
  append_exact(text, value);
  return text;
}

std::string_view status(const Answer& answer) {
  const DockingPlanResult& result = answer.result;
  if (answer.refused_as_unsure()) return "unsure_at_dock";
  if (std::holds_alternative<DockingPlan>(result)) return "ok";
  if (std::holds_alternative<AlreadyThere>(result)) return "already_there";
  return word(std::get<PlanRefusal>(result).reason);
}

const Path* path_of(const Answer& answer) {
  const auto* plan = answer.refused_as_unsure() ? nullptr : std::get_if<DockingPlan>(&answer.result);
  return plan != nullptr ? &plan->path : nullptr;
}

// Curvature at a segment's end; rounding of length times sharpness may leave a trace of what is zero by construction.
double printed_end_curvature(const Path& path, std::size_t index) {
  const Segment& segment = path.segments[index];
  const double next = index + 1 < path.segments.size() ? path.segments[index + 1].curvature : 0.0;
  const double own = segment.end_curvature();
  return std::abs(own - next) <= 4e-16 * (std::abs(segment.curvature) + std::abs(own)) ? next : own;
}

/// @param line  memory that stays from line to line
void write_csv(std::ostream& out, const Query& query, const Answer& answer, std::string& line) {
  line.assign(query.id).append(",").append(std::to_string(answer.time_ns)).append(",").append(status(answer));
  for (const double value :
       {query.start.x, query.start.y, query.start.yaw, query.goal.x, query.goal.y, query.goal.yaw}) {
    line += ',';
    if (std::isfinite(value)) append_exact(line, value);
  }
  if (const Path* path = path_of(answer)) {
    for (std::size_t i = 0; i < path->segments.size(); ++i) {
      const Segment& segment = path->segments[i];
      line += ',';
      append_exact(line, segment.length);
      line += ',';
      append_exact(line, segment.curvature);
      line += ',';
      if (segment.sharpness != 0.0) append_exact(line, printed_end_curvature(*path, i));
    }
  }
  line += '\n';
  out << line;
}

/// One sigma [m, m, rad] of the end pose in the frame of the goal, driven by odometry alone with the default drift.
Eigen::Vector3d predicted_sigma(const Path& path, const Pose2& goal) {
  const Eigen::Matrix3d station = covariance_at_end(path, Eigen::Matrix3d::Zero(), OdometryDrift{});
  Eigen::Matrix3d turned = Eigen::Matrix3d::Identity();
  turned(0, 0) = turned(1, 1) = std::cos(goal.yaw);
  turned(0, 1) = std::sin(goal.yaw);
  turned(1, 0) = -turned(0, 1);
  return (turned * station * turned.transpose()).diagonal().cwiseSqrt();
}

/// One sigma of what one frame tells at a pose of the axle in the station frame; none where it was not measured.
std::optional<Eigen::Vector3d> measured_sigma(const Config& robot, const Pose2& T_station_axle) {
  if (!robot.docking.filter.sensor) return std::nullopt;
  const auto measured = lens_covariance(*robot.docking.filter.sensor, T_station_axle * camera_point(robot.rig),
                                        0.5 * horizontal_view(robot.rig.camera));
  return measured ? std::optional<Eigen::Vector3d>(measured->diagonal().cwiseSqrt()) : std::nullopt;
}

std::string sigma_words(const Eigen::Vector3d& sigma) {
  char text[100];
  std::snprintf(text, sizeof text, "%.3g mm, %.3g mm and %.3g degrees", 1e3 * sigma.x(), 1e3 * sigma.y(),
                degrees(sigma.z()));
  return text;
}

/// @param leaves  the way leads out of the dock: nothing is asked of its end
Sureness sureness_of(const Config& robot, const Query& query, const Pose2& board, bool leaves) {
  Sureness sure;
  sure.start = measured_sigma(robot, between(board, query.start));
  sure.goal = measured_sigma(robot, between(board, query.goal));
  if (leaves) return sure;
  const DockingConfig& docking = robot.docking;
  // As `dock` does before it drives.
  const Eigen::Vector3d tolerance(docking.fix.tolerance_x, docking.fix.tolerance_y, docking.fix.tolerance_yaw);
  if (sure.goal && (sure.goal->array() > tolerance.array()).any())
    sure.refusal = "from the docking pose the camera tells x, y and yaw by " + sigma_words(*sure.goal) +
                   " only (sensor errors as measured), but the tolerance is " + sigma_words(tolerance) +
                   "; dock nearer or use a board with turned tags";
  if (!sure.start) return sure;
  // There it asks for the axle's y, which the yaw moves.
  const Pose2 T_board_start = between(board, query.start);
  const double lever = (T_board_start * camera_point(robot.rig)).x - T_board_start.x;
  const double sigma_y = std::hypot(sure.start->y(), lever * sure.start->z());
  if (sigma_y > docking.acquire.max_sigma_y || sure.start->z() > docking.acquire.max_sigma_yaw) {
    char text[200];
    std::snprintf(text, sizeof text,
                  "at the start the axle's y and yaw are known to %.1f mm and %.2f degrees; the robot drives off with "
                  "%.1f mm and %.2f degrees at most",
                  1e3 * sigma_y, degrees(sure.start->z()), 1e3 * docking.acquire.max_sigma_y,
                  degrees(docking.acquire.max_sigma_yaw));
    sure.warning = text;
  }
  return sure;
}

json json_pose(const Pose2& pose) { return {{"x", pose.x}, {"y", pose.y}, {"yaw", pose.yaw}}; }

void add_words(json& object, const std::vector<Candidate>& candidates) {
  if (candidates.empty()) return;
  json words = json::array();
  for (const Candidate& candidate : candidates)
    words.push_back({{"word", candidate.word.name()},
                     {"length", candidate.solved ? json(candidate.word.length) : json()},
                     {"cusps", candidate.word.cusps()},
                     {"verdict", candidate.verdict}});
  object["reeds_shepp"] = std::move(words);
}

json as_json(const Query& query, const Answer& answer, const WheelLimits& wheels) {
  json object{{"id", query.id},
              {"time_ns", answer.time_ns},
              {"status", std::string(status(answer))},
              {"from", json_pose(query.start)},
              {"to", json_pose(query.goal)}};
  if (answer.sureness) {
    const auto sigma = [](const std::optional<Eigen::Vector3d>& value) {
      return value ? json{{"x", value->x()}, {"y", value->y()}, {"yaw", value->z()}} : json();
    };
    object["measured_sigma"] = {{"start", sigma(answer.sureness->start)}, {"goal", sigma(answer.sureness->goal)}};
    if (!answer.sureness->warning.empty()) object["warning"] = answer.sureness->warning;
  }
  if (answer.refused_as_unsure()) {
    object["sentence"] = answer.sureness->refusal;
    return object;
  }
  if (const auto* plan = std::get_if<DockingPlan>(&answer.result)) {
    object["length"] = plan->length;
    object["shortest"] = plan->shortest;
    object["peak_curvature"] = plan->peak_curvature;
    object["sharpness"] = plan->sharpness;
    json segments = json::array();
    for (std::size_t i = 0; i < plan->path.segments.size(); ++i) {
      const Segment& segment = plan->path.segments[i];
      segments.push_back(
          {{"length", segment.length},
           {"curv_start", segment.curvature},
           {"curv_end", segment.sharpness != 0.0 ? printed_end_curvature(plan->path, i) : segment.curvature}});
    }
    object["segments"] = std::move(segments);
    if (plan->largest_bearing > 0.0) object["largest_bearing"] = plan->largest_bearing;
    if (plan->period_length > 0.0) object["period_length"] = plan->period_length;
    const Eigen::Vector3d sigma = predicted_sigma(plan->path, query.goal);
    object["predicted_sigma"] = {{"along", sigma.x()}, {"across", sigma.y()}, {"yaw", sigma.z()}};
    if (const std::optional<TimeLaw> law = time_law(plan->path, wheels)) {
      json timings = json::array();
      for (const SegmentTiming& timing : law->segments)
        timings.push_back(
            {{"periods", timing.periods}, {"entry", timing.entry}, {"cruise", timing.cruise}, {"exit", timing.exit}});
      object["time_law"] = {{"duration", law->duration()}, {"period", law->period}, {"segments", std::move(timings)}};
    }
    add_words(object, plan->candidates);
  } else if (const auto* refusal = std::get_if<PlanRefusal>(&answer.result)) {
    object["sentence"] = refusal->sentence;
    object["cure"] = refusal->cure;
    add_words(object, refusal->candidates);
  }
  return object;
}

/// Every word with what speaks against it.
void explain_words(std::ostream& out, const std::vector<Candidate>& candidates) {
  if (candidates.empty()) return;
  out << "the 48 Reeds-Shepp words at full curvature, to the end of the last turn, and what speaks against each:\n";
  char line[80];
  for (const Candidate& candidate : candidates) {
    if (candidate.solved)
      std::snprintf(line, sizeof line, "  %-12s %10.4f m  ", candidate.word.name().c_str(), candidate.word.length);
    else
      std::snprintf(line, sizeof line, "  %-12s %10s    ", candidate.word.name().c_str(), "-");
    out << line << candidate.verdict << "\n";
  }
}

void explain(std::ostream& out, const Query& query, const Answer& answer, const WheelLimits& wheels) {
  char line[300];
  const auto say = [&](const char* pattern, auto... values) {
    std::snprintf(line, sizeof line, pattern, values...);
    out << line;
  };
  if (const auto* refusal = std::get_if<PlanRefusal>(&answer.result)) {
    out << "no plan (" << word(refusal->reason) << "): " << refusal->sentence << "\n";
    if (!refusal->cure.empty()) out << "what would help: " << refusal->cure << "\n";
    explain_words(out, refusal->candidates);
    return;
  }
  if (answer.sureness) {
    for (const auto& [place, sigma] :
         {std::pair("start", answer.sureness->start), std::pair("goal", answer.sureness->goal)})
      out << "from the " << place << " one frame tells x, y and yaw "
          << (sigma ? "by " + sigma_words(*sigma) : std::string("by what was not measured (detection.sensor_errors)"))
          << "\n";
    if (!answer.sureness->warning.empty()) out << "warning: " << answer.sureness->warning << "\n";
  }
  if (answer.refused_as_unsure()) {
    out << "no plan (unsure_at_dock): " << answer.sureness->refusal << "\n";
    return;
  }
  const auto* plan = std::get_if<DockingPlan>(&answer.result);
  if (plan == nullptr) {
    out << "already there: start and goal are the same pose\n";
    return;
  }
  const bool quick = answer.time_ns < 1'000'000;
  say("planned in %.1f %s: %.4f m in %zu segments, %d direction changes; shortest within the limits %.4f m\n",
      (quick ? 1e-3 : 1e-6) * static_cast<double>(answer.time_ns), quick ? "us" : "ms", plan->length,
      plan->path.segments.size(), cusps(plan->path), plan->shortest);
  say("largest curvature %.4f of %.4f 1/m, sharpness %.4f of %.4f 1/m2\n", plan->peak_curvature,
      query.limits.max_curvature, plan->sharpness, query.limits.max_sharpness);
  if (plan->largest_bearing > 0.0) say("board's edge at most %.2f deg from the axis\n", degrees(plan->largest_bearing));
  const Pose2 end = between(query.goal, end_pose(plan->path));
  say("ends %.2g m and %.2g rad beside the goal\n", std::hypot(end.x, end.y), std::abs(wrap_angle(end.yaw)));
  const Eigen::Vector3d sigma = predicted_sigma(plan->path, query.goal);
  say("driven by odometry alone it ends within %.1f mm along, %.1f mm across and %.2f deg (one sigma, default drift)\n",
      1e3 * sigma.x(), 1e3 * sigma.y(), degrees(sigma.z()));
  if (plan->period_length > 0.0)
    say("every segment is a whole multiple of %.6f m, the way of one period at constant speed\n", plan->period_length);
  if (const std::optional<TimeLaw> law = time_law(plan->path, wheels))
    say("takes %.2f s: wheels up to %.2f m/s, %.2f m/s2, %.1f m/s3; every segment a whole number of %.0f ms periods\n",
        law->duration(), wheels.wheel_speed, wheels.wheel_acceleration, wheels.wheel_jerk, 1e3 * law->period);
  else
    out << "no time law: a segment is too short to be driven in whole periods within the wheels' limits\n";
  say("%4s %10s %10s %10s %10s %10s %10s\n", "no", "length", "curvature", "to", "x", "y", "yaw_deg");
  Pose2 pose = plan->path.start;
  for (std::size_t i = 0; i < plan->path.segments.size(); ++i) {
    const Segment& segment = plan->path.segments[i];
    pose = pose_along(pose, segment, segment.length);
    say("%4zu %10.4f %10.4f %10.4f %10.4f %10.4f %10.3f\n", i + 1, segment.length, segment.curvature,
        printed_end_curvature(plan->path, i) * (segment.sharpness != 0.0) +
            segment.curvature * (segment.sharpness == 0.0),
        pose.x, pose.y, degrees(pose.yaw));
  }
  explain_words(out, plan->candidates);
}

/// Where the data goes: a file, or stdout.
class Sink {
 public:
  explicit Sink(const std::string& file) : file_name_(file) {
    if (file.empty()) return;
    file_.open(file);
    if (!file_) throw Failure(ExitCode::usage, "cannot write " + file + ": " + std::strerror(errno));
  }
  [[nodiscard]] std::ostream& stream() { return file_name_.empty() ? std::cout : file_; }
  void finish() {
    stream().flush();
    if (!stream())
      throw Failure(ExitCode::usage, "writing " + (file_name_.empty() ? "stdout" : file_name_) + " failed");
  }

 private:
  std::string file_name_;
  std::ofstream file_;
};

Answer answered(const Query& query, Mode mode, DockingPlanConfig& config, DockingPlanner& planner) {
  config.limits = query.limits;
  const auto begin = std::chrono::steady_clock::now();
  const DockingPlanResult& result =
      mode == Mode::forward
          ? planner.plan(query.start, query.goal, config)
          : planner.manoeuvre(query.start, query.goal, config, mode == Mode::dubins ? Driving::forward : Driving::both);
  return {result,
          std::chrono::duration_cast<std::chrono::nanoseconds>(std::chrono::steady_clock::now() - begin).count()};
}

/// In reverse with a camera that looks ahead: the robot backs out of a dock.
bool leaves_dock(const PlanArguments& arguments) { return arguments.reverse && arguments.camera_yaw_deg == 0.0; }

/// Foot of the board: as given, or where the robot's docking pose has it, or 1 m from the docking pose to where the
/// camera looks. The dock is the goal, or the start of a way out in reverse.
Pose2 board_of(const PlanArguments& arguments, const Query& query, const std::optional<Config>& robot) {
  const Pose2& dock = leaves_dock(arguments) ? query.start : query.goal;
  if (!arguments.board.empty()) return pose_option(arguments.board, "--board");
  if (robot) return dock * inverse(goal_of_axle(robot->docking));
  return dock * Pose2{0.0, 0.0, radians(arguments.camera_yaw_deg)} * Pose2{1.0, 0.0, 0.0};
}

int plan_one(const PlanArguments& arguments, Mode mode, DockingPlanConfig config, const std::optional<Config>& robot) {
  Query query{"0", pose_option(arguments.from, "--from"), pose_option(arguments.to, "--to"), config.limits};
  config.list_candidates = arguments.explain || arguments.as_json || !arguments.svg.empty();
  const Pose2 board = board_of(arguments, query, robot);
  if (config.view) config.view->T_station_board = board;
  DockingPlanner planner;
  Answer answer = answered(query, mode, config, planner);
  if (robot) answer.sureness = sureness_of(*robot, query, board, leaves_dock(arguments));

  Sink sink(arguments.output);
  if (arguments.as_json) {
    sink.stream() << as_json(query, answer, arguments.wheels).dump(2) << '\n';
  } else {
    std::string line;
    sink.stream() << csv_header;
    write_csv(sink.stream(), query, answer, line);
  }
  sink.finish();
  if (arguments.explain) explain(std::cerr, query, answer, arguments.wheels);
  if (!arguments.svg.empty()) {
    PlanScene scene{query.start,     query.goal, board, query.limits, config.view.value_or(ViewWish{}),
                    config.keep_out, {},         {}};
    if (const Path* path = path_of(answer)) scene.law = time_law(*path, arguments.wheels);
    const std::string driven = arguments.reverse ? "in reverse" : arguments.mode;
    char title[160] = "";
    if (const auto* plan = std::get_if<DockingPlan>(&answer.result); plan != nullptr && !answer.refused_as_unsure())
      std::snprintf(title, sizeof title, "%s: %.3f m, %zu segments, curvature up to %.3f 1/m", driven.c_str(),
                    plan->length, plan->path.segments.size(), plan->peak_curvature);
    else
      std::snprintf(title, sizeof title, "%s: %s", driven.c_str(), std::string(status(answer)).c_str());
    scene.title = title;
    Sink picture(arguments.svg);
    picture.stream() << plan_picture(answer.result, scene);
    picture.finish();
  }
  if (const auto* refusal = std::get_if<PlanRefusal>(&answer.result)) {
    if (!arguments.explain)
      std::cerr << "tagdock: no plan: " << refusal->sentence
                << (refusal->cure.empty() ? "" : "; what would help: " + refusal->cure) << "\n";
    const bool bad_question = refusal->reason == NoPlan::not_finite || refusal->reason == NoPlan::too_large ||
                              refusal->reason == NoPlan::bad_limit;
    return static_cast<int>(bad_question ? ExitCode::usage : ExitCode::failed);
  }
  if (!arguments.explain && answer.sureness && !answer.sureness->warning.empty())
    std::cerr << "tagdock: " << answer.sureness->warning << "\n";
  if (answer.refused_as_unsure()) {
    if (!arguments.explain) std::cerr << "tagdock: no plan: " << answer.sureness->refusal << "\n";
    return static_cast<int>(ExitCode::failed);
  }
  return static_cast<int>(ExitCode::done);
}

/// Where the columns stand in a file of queries.
struct Columns {
  std::size_t count = 0;
  std::size_t id = 0;
  std::array<std::size_t, 6> poses{};
  std::optional<std::size_t> curvature, sharpness;
};

Columns columns_of(std::string_view header, const std::string& file) {
  const auto names = split(header);
  const auto find = [&](std::string_view name) -> std::optional<std::size_t> {
    for (std::size_t i = 0; i < names.size(); ++i)
      if (names[i] == name) return i;
    return std::nullopt;
  };
  const auto need = [&](std::string_view name) {
    const auto found = find(name);
    if (!found)
      throw Failure(ExitCode::usage, file + ", line 1: the column \"" + std::string(name) +
                                         "\" is missing; queries have id,sx,sy,sth,gx,gy,gth,kappa_max,sigma_max");
    return *found;
  };
  Columns columns;
  columns.count = names.size();
  columns.id = need("id");
  const std::array<const char*, 6> pose_names = {"sx", "sy", "sth", "gx", "gy", "gth"};
  for (std::size_t i = 0; i < 6; ++i) columns.poses[i] = need(pose_names[i]);
  columns.curvature = find("kappa_max");
  columns.sharpness = find("sigma_max");
  return columns;
}

int plan_batch(const PlanArguments& arguments, Mode mode, DockingPlanConfig config,
               const std::optional<Config>& robot) {
  config.list_candidates = false;
  config.find_cures = arguments.as_json;  // the CSV has no room for them
  check_not_an_input("--output", arguments.output, {arguments.batch});
  std::ifstream in(arguments.batch);
  if (!in) throw Failure(ExitCode::usage, "cannot read " + arguments.batch + ": " + std::strerror(errno));
  std::string line;
  if (!std::getline(in, line))
    throw Failure(ExitCode::usage, arguments.batch + " is empty; its first line must name the columns");
  if (line.starts_with("\xEF\xBB\xBF")) line.erase(0, 3);
  const Columns columns = columns_of(line, arguments.batch);
  Sink sink(arguments.output);
  if (!arguments.as_json) sink.stream() << csv_header;
  DockingPlanner planner;
  std::string csv_line;
  int number = 1;
  bool malformed = false;
  while (std::getline(in, line)) {
    ++number;
    if (trimmed(line).empty()) continue;
    const auto fields = split(line);
    Query query;
    query.id = columns.id < fields.size() ? std::string(fields[columns.id]) : "";
    query.limits = config.limits;
    std::string fault;
    if (fields.size() > columns.count)
      fault = "has " + std::to_string(fields.size()) + " fields, the first line names " + std::to_string(columns.count);
    const auto read = [&](std::size_t column, double& into) {
      if (!fault.empty()) return;
      const std::optional<double> value = column < fields.size() ? parsed(fields[column]) : std::nullopt;
      if (value)
        into = *value;
      else
        fault = "column " + std::to_string(column + 1) +
                (column < fields.size() ? ": \"" + std::string(fields[column].substr(0, 40)) + "\" is not a number"
                                        : " is missing");
    };
    read(columns.poses[0], query.start.x);
    read(columns.poses[1], query.start.y);
    read(columns.poses[2], query.start.yaw);
    read(columns.poses[3], query.goal.x);
    read(columns.poses[4], query.goal.y);
    read(columns.poses[5], query.goal.yaw);
    if (columns.curvature) read(*columns.curvature, query.limits.max_curvature);
    if (columns.sharpness) read(*columns.sharpness, query.limits.max_sharpness);
    if (!fault.empty()) {
      malformed = true;
      std::cerr << "tagdock: " << arguments.batch << ", line " << number << ", " << fault << "\n";
      if (arguments.as_json)
        sink.stream() << json{{"id", query.id}, {"time_ns", 0}, {"status", "malformed"}, {"sentence", fault}}.dump(
                             -1, ' ', false, json::error_handler_t::replace)
                      << '\n';
      else
        sink.stream() << query.id << ",0,malformed,,,,,,\n";
      continue;
    }
    const Pose2 board = board_of(arguments, query, robot);
    if (config.view) config.view->T_station_board = board;
    Answer answer = answered(query, mode, config, planner);
    if (robot) answer.sureness = sureness_of(*robot, query, board, leaves_dock(arguments));
    if (arguments.as_json)
      sink.stream() << as_json(query, answer, arguments.wheels).dump(-1, ' ', false, json::error_handler_t::replace)
                    << '\n';
    else
      write_csv(sink.stream(), query, answer, csv_line);
  }
  sink.finish();
  return static_cast<int>(malformed ? ExitCode::usage : ExitCode::done);
}

int run(const PlanArguments& arguments) {
  const bool one = !arguments.from.empty() || !arguments.to.empty();
  if (arguments.batch.empty() && (arguments.from.empty() || arguments.to.empty()))
    throw Failure(ExitCode::usage, "give --from and --to, or --batch; see tagdock plan --help");
  if (!arguments.batch.empty() && (one || !arguments.svg.empty() || arguments.explain))
    throw Failure(ExitCode::usage, "--batch answers a file; --from, --to, --svg and --explain are for one plan");
  if (arguments.as == "clothoids" &&
      (arguments.arc_steps > 0 || arguments.arc_deviation > 0.0 || arguments.arc_curvature_step > 0.0))
    throw Failure(ExitCode::usage, "--arc-steps, --arc-deviation and --arc-curvature-step need --as arcs");
  for (const auto& [value, name] :
       {std::pair{arguments.initial_straight, "--initial-straight"},
        std::pair{arguments.final_straight, "--final-straight"}, std::pair{arguments.softness, "--softness"},
        std::pair{arguments.arc_deviation, "--arc-deviation"},
        std::pair{arguments.arc_curvature_step, "--arc-curvature-step"}, std::pair{arguments.view_deg, "--view-deg"},
        std::pair{arguments.board_width, "--board-width"}, std::pair{arguments.min_range, "--min-range"},
        std::pair{arguments.max_range, "--max-range"}, std::pair{arguments.keep_out_margin, "--keep-out-margin"},
        std::pair{arguments.contact_within, "--contact-within"}, std::pair{arguments.period_length, "--period-length"},
        std::pair{arguments.footprint[0], "--footprint"}, std::pair{arguments.footprint[1], "--footprint"},
        std::pair{arguments.footprint[2], "--footprint"}}) {
    if (!(value >= 0.0) || !std::isfinite(value))
      throw Failure(ExitCode::usage,
                    std::string(name) + " is " + exact(value) + "; it must be finite and not negative");
  }
  if (!(arguments.view_deg < 180.0) || !std::isfinite(arguments.camera_ahead) ||
      !std::isfinite(arguments.camera_yaw_deg) || !std::isfinite(arguments.measure_over))
    throw Failure(ExitCode::usage,
                  "--view-deg must be below 180, and --camera-ahead, --camera-yaw-deg and --measure-over finite");
  if (arguments.view_deg == 0.0 && !arguments.tags.empty())
    throw Failure(ExitCode::usage, "--tag needs --view-deg: incidence is a part of the view");
  if (arguments.period_length > 0.0 && (arguments.as != "arcs" || arguments.mode != "forward"))
    throw Failure(ExitCode::usage, "--period-length needs --as arcs and --mode forward");
  if (arguments.reverse && arguments.mode != "forward")
    throw Failure(ExitCode::usage, "--reverse needs --mode forward; --mode reeds-shepp drives in reverse by itself");
  for (const auto& [value, name] :
       {std::pair{arguments.wheels.speed, "--speed"}, std::pair{arguments.wheels.wheel_speed, "--wheel-speed"},
        std::pair{arguments.wheels.wheel_acceleration, "--wheel-acceleration"},
        std::pair{arguments.wheels.wheel_jerk, "--wheel-jerk"},
        std::pair{arguments.wheels.track_width, "--track-width"}, std::pair{arguments.wheels.period, "--period"},
        std::pair{arguments.wheels.approach_deceleration, "--approach-deceleration"}}) {
    if (!(value > 0.0) || !std::isfinite(value))
      throw Failure(ExitCode::usage, std::string(name) + " is " + exact(value) + "; it must be finite and positive");
  }
  if (arguments.arc_steps < 0 || arguments.arc_steps > 1000)
    throw Failure(ExitCode::usage, "--arc-steps is " + std::to_string(arguments.arc_steps) + "; it must be 1 to 1000");

  DockingPlanConfig config;
  config.limits = {arguments.max_curvature, arguments.max_sharpness};
  config.straights = {arguments.initial_straight, arguments.final_straight};
  config.arcs = arguments.as == "arcs";
  config.arc_wish = {arguments.arc_steps, arguments.arc_deviation, arguments.arc_curvature_step};
  if (arguments.arc_steps == 0 && arguments.arc_deviation == 0.0 && arguments.arc_curvature_step == 0.0)
    config.arc_wish = DockingPlanConfig{}.arc_wish;
  config.softness = arguments.softness;
  if (arguments.view_deg > 0.0) {
    config.view = ViewWish{};
    config.view->horizontal_view = radians(arguments.view_deg);
    config.view->camera_ahead = arguments.camera_ahead;
    config.view->board_half_width = 0.5 * arguments.board_width;
    config.view->camera_yaw = radians(arguments.camera_yaw_deg);
    config.view->min_range = arguments.min_range;
    config.view->max_range = arguments.max_range;
    config.view->least_incidence = radians(arguments.incidence_deg[0]);
    config.view->most_incidence = radians(arguments.incidence_deg[1]);
    config.view->measured_over_last = arguments.measure_over;
    for (const std::string& text : arguments.tags) config.view->tags.push_back(pose_option(text, "--tag"));
  }
  config.reverse = arguments.reverse;
  config.period_length = arguments.period_length;
  config.keep_out.footprint = {arguments.footprint[0], arguments.footprint[1], arguments.footprint[2]};
  config.keep_out.margin = arguments.keep_out_margin;
  // A dock is at the goal, or at the start of a way out in reverse.
  (leaves_dock(arguments) ? config.keep_out.contact_until : config.keep_out.contact_within) = arguments.contact_within;
  if (const std::optional<PlanRefusal> fault = refuse_wishes(config)) throw Failure(ExitCode::usage, fault->sentence);
  for (const std::string& text : arguments.keep_out) config.keep_out.polygons.push_back(polygon_option(text));
  const Mode mode = arguments.mode == "forward"  ? Mode::forward
                    : arguments.mode == "dubins" ? Mode::dubins
                                                 : Mode::reeds_shepp;
  if (mode != Mode::forward && (arguments.final_straight > 0.0 || arguments.initial_straight > 0.0 || config.view ||
                                !config.keep_out.polygons.empty()))
    throw Failure(ExitCode::usage,
                  "--final-straight, --initial-straight, --view-deg and --keep-out need --mode forward");
  std::optional<Config> robot;
  if (!arguments.config.empty() || !arguments.sensor_errors.empty()) {
    robot = arguments.config.empty() ? Config{} : read_config(arguments.config);
    if (!arguments.sensor_errors.empty()) robot->sensor_errors = arguments.sensor_errors;
    robot = parse_config(to_yaml(*robot), "(configuration of this plan)");
  }
  return arguments.batch.empty() ? plan_one(arguments, mode, config, robot)
                                 : plan_batch(arguments, mode, config, robot);
}

}  // namespace

void add_plan(CLI::App& program, Action& action) {
  auto arguments = std::make_shared<PlanArguments>();
  CLI::App* verb =
      program.add_subcommand("plan", "Plan a path between two poses of the axle, or say why there is none.");
  verb->add_option("--from", arguments->from, "start pose X,Y,YAW_DEG (m, degrees)");
  verb->add_option("--to", arguments->to, "goal pose X,Y,YAW_DEG");
  verb->add_option("--batch", arguments->batch, "CSV of queries: id,sx,sy,sth,gx,gy,gth,kappa_max,sigma_max (m, rad)");
  verb->add_option("--output", arguments->output, "write the plans here instead of stdout");
  verb->add_option("--max-curvature", arguments->max_curvature, "1/m")->capture_default_str();
  verb->add_option("--max-sharpness", arguments->max_sharpness, "change of curvature per metre, 1/m2")
      ->capture_default_str();
  verb->add_option("--initial-straight", arguments->initial_straight, "least straight before the first turn, m")
      ->capture_default_str();
  verb->add_option("--final-straight", arguments->final_straight, "least straight run-in at the goal, m")
      ->capture_default_str();
  verb->add_option(
          "--mode", arguments->mode,
          "forward: no reverse, no loop, refuses what cannot be; dubins: forward with loops; reeds-shepp: also "
          "in reverse")
      ->capture_default_str()
      ->check(CLI::IsMember({"forward", "dubins", "reeds-shepp"}));
  verb->add_option("--as", arguments->as, "clothoids, or arcs of constant curvature")
      ->capture_default_str()
      ->check(CLI::IsMember({"clothoids", "arcs"}));
  verb->add_option("--arc-steps", arguments->arc_steps, "arcs per ramp (5 if nothing is asked for)")
      ->check(CLI::Range(1, 1000));
  verb->add_option("--arc-deviation", arguments->arc_deviation, "largest distance from the clothoid path, m");
  verb->add_option("--arc-curvature-step", arguments->arc_curvature_step,
                   "largest jump of curvature between arcs, 1/m");
  verb->add_option("--softness", arguments->softness,
                   "how much longer than the shortest a softer path may be, as a fraction (mode forward)")
      ->capture_default_str();
  verb->add_option("--view-deg", arguments->view_deg, "keep the board within this horizontal view (mode forward)");
  verb->add_option("--camera-ahead", arguments->camera_ahead, "camera before the axle, m")->capture_default_str();
  verb->add_option("--camera-yaw-deg", arguments->camera_yaw_deg, "where the camera looks; 180: backwards")
      ->capture_default_str();
  verb->add_option("--min-range", arguments->min_range, "least distance of the camera from the board, m")
      ->capture_default_str();
  verb->add_option("--max-range", arguments->max_range, "largest distance of the camera from the board, m")
      ->capture_default_str();
  verb->add_option("--tag", arguments->tags,
                   "a tag X,Y,YAW_DEG in the board's frame (x into the wall); at the start and over the last\n"
                   "--measure-over metres one of them must be seen within --incidence-deg off its normal");
  verb->add_option("--incidence-deg", arguments->incidence_deg, "least and largest angle off a tag's normal")
      ->expected(2)
      ->capture_default_str();
  verb->add_option("--measure-over", arguments->measure_over,
                   "m; 0: yaw is measured at the goal, negative: at the start only")
      ->capture_default_str();
  verb->add_option("--board", arguments->board,
                   "foot of the board X,Y,YAW_DEG (default: 1 m ahead of the dock; with --config where its dock_pose "
                   "has it)");
  verb->add_option("--config", arguments->config,
                   "configuration of the robot (YAML): says how sure its camera is at start and goal, and refuses a "
                   "goal from which it could not dock");
  verb->add_option("--sensor-errors", arguments->sensor_errors,
                   "the same with another map: none, shipped, or a file of `evaluate accuracy-map`; alone, of the "
                   "default robot");
  verb->add_option("--board-width", arguments->board_width, "m")->capture_default_str();
  verb->add_option("--keep-out", arguments->keep_out,
                   "corners X,Y,X,Y,X,Y of a polygon that the robot must keep away from (mode forward)");
  verb->add_option("--footprint", arguments->footprint, "robot before and behind its axle and its width, m")
      ->expected(3)
      ->capture_default_str();
  verb->add_option("--keep-out-margin", arguments->keep_out_margin, "room to keep around the footprint, m")
      ->capture_default_str();
  verb->add_option("--contact-within", arguments->contact_within,
                   "so many metres of the way at the dock may touch (the last; the first with --reverse)")
      ->capture_default_str();
  verb->add_flag("--reverse", arguments->reverse,
                 "drive the whole path backwards: leave a dock, or dock with the back (mode forward)");
  verb->add_option("--period-length", arguments->period_length,
                   "cut arcs into whole multiples of about this length, speed times control period, m");
  verb->add_option("--speed", arguments->wheels.speed, "m/s, for the time law")->capture_default_str();
  verb->add_option("--wheel-speed", arguments->wheels.wheel_speed, "m/s")->capture_default_str();
  verb->add_option("--wheel-acceleration", arguments->wheels.wheel_acceleration, "m/s2")->capture_default_str();
  verb->add_option("--wheel-jerk", arguments->wheels.wheel_jerk, "m/s3")->capture_default_str();
  verb->add_option("--track-width", arguments->wheels.track_width, "m")->capture_default_str();
  verb->add_option("--period", arguments->wheels.period, "control period, s")->capture_default_str();
  verb->add_option("--approach-deceleration", arguments->wheels.approach_deceleration,
                   "speed shrinks with what remains: v^2 <= 2 a remaining, m/s2")
      ->capture_default_str();
  verb->add_option("--svg", arguments->svg, "draw the plan into this file");
  verb->add_flag("--json", arguments->as_json, "JSON instead of CSV; one object a query");
  verb->add_flag("--explain", arguments->explain, "say on stderr what was planned and every Reeds-Shepp word");
  verb->footer(
      "Output: id,time_ns,status,sx,sy,sth,gx,gy,gth, then length,curv_start,curv_end per segment (curv_end empty:\n"
      "constant curvature). Length is negative in reverse; curvature is positive to the left for the direction the\n"
      "robot faces, also in reverse; the heading changes by signed length times mean curvature. All curvatures at the\n"
      "ends are zero. Status: ok; already_there (start and goal are the same pose to rounding, no segments); or\n"
      "  no_room          no path within the limits without a loop (what would cure it: on stderr for one plan, or in "
      "JSON)\n"
      "  tag_out_of_view  every path within the limits loses the board\n"
      "  keep_out         every path within the limits touches what must not be touched\n"
      "  bad_incidence    no tag is seen within --incidence-deg where yaw is measured\n"
      "  not_exact        rounding at this scale spoils every solution, or no path fits into --period-length\n"
      "  not_finite       a pose or limit is NaN or infinite\n"
      "  too_large        a coordinate above 1e12 m, a heading above 1e9 rad or a limit outside of 1e-12..1e12\n"
      "  unsure_at_dock   with --config or --sensor-errors: one frame at the goal tells less than the tolerance asks\n"
      "  bad_limit        a limit is zero, negative or denormal\n"
      "  malformed        the line of the batch is not numbers; also said on stderr, exit code 2 at the end\n"
      "JSON: id, time_ns, status, from, to {x, y, yaw}; with a plan length, shortest, peak_curvature, sharpness,\n"
      "segments [{length, curv_start, curv_end}], predicted_sigma {along, across, yaw} (odometry alone), time_law\n"
      "{duration, period, segments [{periods, entry, cruise, exit}]} if there is one, largest_bearing, period_length,\n"
      "reeds_shepp (48) [{word, length or null, cusps, verdict}]; else sentence, cure, reeds_shepp (not in a batch).\n"
      "With --config also measured_sigma {start, goal} {x, y, yaw} in the board's frame (null: not measured), "
      "warning.\n"
      "Exit code: 0 planned (batch: every line answered), 1 no plan, 2 bad question.");
  verb->callback([arguments, &action] { action = [arguments] { return run(*arguments); }; });
}

}  // namespace tagdock
