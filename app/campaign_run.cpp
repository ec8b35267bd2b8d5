#include "app/campaign_run.h"

#include <algorithm>
#include <cmath>

#include "app/simulation/draws.h"
#include "app/simulation/frame_schedule.h"
#include "app/simulation/untouched.h"
#include "detection/tag_locator.h"
#include "planning/docking_plan.h"
#include "servo/docker.h"
#include "servo/odometry_controller.h"

namespace tagdock {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;

constexpr std::uint64_t fault_purpose = 31;  // of random numbers; World has 11 to 16, SightingModel 21 and 22
constexpr nanoseconds longest_run = std::chrono::seconds(600);

// The world of one run with what the robot gets of it: sightings as they arrive, odometry, and nothing else.
class Run {
 public:
  Run(const RunSettings& settings, std::uint64_t seed, RunTrace* trace = nullptr)
      : settings_(settings),
        trace_(trace),
        world_(obeying(settings), settings.config.rig, settings.config.board, seed),
        model_(settings.config.rig, settings.config.board, settings.config.locator, settings.corner_errors, seed),
        fault_draw_(Draws(seed, fault_purpose).even()) {
    if (settings.images) locator_.emplace(settings.config.rig, settings.config.board, settings.config.locator);
  }

  [[nodiscard]] nanoseconds now() const { return now_; }

  /// The odometry since the last call, without a look.
  Tick read_odometry() {
    Tick tick;
    tick.now = now_;
    if (odometry_silent()) return tick;
    const Odometry odometry = world_.odometry();
    if (!last_odometry_ || odometry.time > *last_odometry_) tick.odometry.push_back(odometry);
    last_odometry_ = odometry.time;
    return tick;
  }

  /// Everything new since the last call.
  Tick read(const std::function<std::optional<Eigen::Isometry3d>(nanoseconds)>& predicted_view) {
    Tick tick = read_odometry();
    if (const auto frame = schedule_.newest(world_, now_);
        frame && !(fault_ == Fault::frames && frame->exposed >= broken_at_)) {
      last_frame_ = frame->exposed;
      tick.frame_time = frame->exposed;
      if (settings_.images)
        tick.sighting = locator_->locate(
            {world_.render(frame->exposed, RenderedRows::with_tags).gray, frame->exposed, frame->number},
            predicted_view(frame->exposed));
      else
        tick.sighting = model_.look(world_, frame->number, frame->exposed, predicted_view(frame->exposed));
    }
    if (tick.sighting) trace_sighting(*tick.sighting);
    return tick;
  }

  void drive(const Twist2& command, nanoseconds step) {
    if (fault_ != Fault::link) world_.command(command, now_);
    if (command != Twist2{}) last_moved_ = now_;
    if (fault_ != Fault::none && !zero_at_ && command == Twist2{}) zero_at_ = now_;
    now_ += step;
    world_.advance(now_);
    note_rest();
    trace_moment();
    break_what_breaks();
  }

  /// What the world knows at the end.
  void finish(RunRecord& record) {
    record.duration_s = std::chrono::duration<double>(now_).count();
    for (int i = 0; i < 100; ++i) drive({}, milliseconds(20));
    record.true_error = world_.docking_error(settings_.config.docking.dock_pose);
    record.stop_latency_ms = std::max(0.0, std::chrono::duration<double, std::milli>(rested_ - last_moved_).count());
    if (fault_ == Fault::none) return;
    const nanoseconds last_good = fault_ == Fault::frames ? last_frame_ : last_odometry_.value_or(broken_at_);
    const auto since = [&](const std::optional<nanoseconds>& time) {
      return time ? std::optional(std::chrono::duration<double, std::milli>(*time - last_good).count()) : std::nullopt;
    };
    record.fault = fault_ == Fault::frames ? "frames" : fault_ == Fault::odometry ? "odometry" : "link";
    record.fault_to_zero_ms = since(zero_at_);
    record.fault_to_stand_ms = since(stood_at_);
  }

 private:
  // The simulated sensor obeys the settings, as a real one would.
  static Scenario obeying(const RunSettings& settings) {
    Scenario scenario = settings.scenario;
    scenario.camera.frame_rate = settings.config.camera.frame_rate;
    scenario.camera.exposure = 1e-6 * settings.config.camera.exposure_us;
    return scenario;
  }

  enum class Fault { none, frames, odometry, link };

  [[nodiscard]] bool odometry_silent() const { return fault_ == Fault::odometry || fault_ == Fault::link; }

  void note_rest() {
    constexpr double still = 0.001;  // m/s and rad/s
    const Twist2& wheels = world_.truth().wheels;
    if (std::abs(wheels.linear) > still || std::abs(wheels.angular) > still)
      rested_ = world_.truth().time;
    else if (fault_ != Fault::none && !stood_at_)
      stood_at_ = world_.truth().time;
  }

  void break_what_breaks() {
    if (fault_ != Fault::none) return;
    const FaultScenario& faults = world_.scenario().faults;
    const double range = -world_.T_station_camera_point().x;
    const auto breaks = [&](double at) { return at > 0.0 && range < at + faults.range_spread * fault_draw_; };
    fault_ = breaks(faults.frames_stop_range)      ? Fault::frames
             : breaks(faults.odometry_stops_range) ? Fault::odometry
             : breaks(faults.link_silent_range)    ? Fault::link
                                                   : Fault::none;
    broken_at_ = now_;
  }

  void trace_moment() {
    constexpr nanoseconds between = milliseconds(100);
    if (trace_ == nullptr || (!trace_->empty() && now_ < traced_ + between)) return;
    traced_ = now_;
    trace_->push_back({std::chrono::duration<double>(now_).count(), world_.T_station_camera_point(), {}, {}});
  }

  void trace_sighting(const Sighting& sighting) {
    const BoardSighting* board = std::get_if<BoardSighting>(&sighting);
    if (trace_ == nullptr || board == nullptr) return;
    const Rig& rig = settings_.config.rig;
    const PlanarSighting planar = planar_sighting(rig, board->time, board->T_camera_station, board->covariance, 0.0);
    trace_->push_back({std::chrono::duration<double>(now_).count(), world_.T_station_camera_point(),
                       board->reprojection_rms_px, planar.T_station_base * camera_point(rig)});
  }

  const RunSettings& settings_;
  RunTrace* trace_;  ///< null: nobody wants it
  nanoseconds traced_{0};
  World world_;
  std::optional<TagLocator> locator_;  ///< with images
  SightingModel model_;
  FrameSchedule schedule_;
  nanoseconds now_{0};
  std::optional<nanoseconds> last_odometry_;
  nanoseconds last_moved_{0};
  double fault_draw_;  ///< -1..1
  Fault fault_ = Fault::none;
  nanoseconds broken_at_{0};
  nanoseconds last_frame_{0};  ///< mid-exposure of the newest that came
  std::optional<nanoseconds> zero_at_;
  std::optional<nanoseconds> stood_at_;
  nanoseconds rested_{0};
};

std::string one_field(std::string text) {
  for (char& letter : text)
    if (letter == ',' || letter == '\n' || letter == '"') letter = letter == ',' ? ';' : ' ';
  return text;
}

RunRecord run_servo(const RunSettings& settings, std::uint64_t seed, RunTrace* trace) {
  Run run(settings, seed, trace);
  RunRecord record;
  DockingConfig docking = settings.config.docking;
  if (settings.teach) {
    const std::optional<Fix> taught = taught_pose(settings, seed);
    if (!taught) {
      record.result = "failed";
      record.reason = "the docking pose could not be taught: the board is not seen well enough from there";
      run.finish(record);
      return record;
    }
    docking.dock_pose = taught->T_station_base * camera_point(settings.config.rig);
    docking.dock_pose_taught = true;
    docking.dock_pose_covariance = taught->covariance;
    docking.taught_hang = taught->hang;
  }
  Docker docker(settings.config.rig, docking);
  bool over = false;
  while (!over && run.now() < longest_run) {
    const TickResult result = docker.tick(run.read([&](nanoseconds time) { return docker.predicted_view(time); }));
    over = result.over;
    run.drive(result.command, result.next_tick);
  }
  record.result = over ? std::string(name(docker.phase())) : "timed_out";
  record.attempts = job_of(docker.phase()).attempts;
  if (const auto reason = reason_of(docker.phase())) record.reason = one_field(reason->sentence);
  const Fix* fix = nullptr;
  if (const Docked* docked = std::get_if<Docked>(&docker.phase())) fix = &docked->fix;
  if (const Failed* failed = std::get_if<Failed>(&docker.phase()); failed != nullptr && failed->fix)
    fix = &*failed->fix;
  if (fix != nullptr) {
    record.estimated = fix->error;
    const Eigen::Vector3d sigma = fix->covariance.diagonal().cwiseSqrt();
    record.sigma = Pose2{sigma.x(), sigma.y(), sigma.z()};
  }
  run.finish(record);
  return record;
}

// Stands until the filter has fused `count` sightings, and gives those; fewer if they did not come.
std::vector<RestSighting> look_at_standstill(Run& run, PoseFilter& filter, std::size_t count) {
  std::vector<RestSighting> fused;
  while (fused.size() < count && run.now() < std::chrono::seconds(30)) {
    const Tick tick = run.read([&](nanoseconds time) { return filter.predicted_view(time); });
    for (const Odometry& reading : tick.odometry) filter.predict(reading);
    if (const BoardSighting* seen = tick.sighting ? std::get_if<BoardSighting>(&*tick.sighting) : nullptr) {
      const FilterUpdate update = filter.update(*seen);
      const std::optional<Pose2> T_odom_base = filter.T_odom_base(seen->time);
      if (T_odom_base && (update.use == SightingUse::fused || update.use == SightingUse::acquired))
        fused.push_back(rest_sighting(*update.sighting, *seen, *T_odom_base));
    }
    run.drive({}, milliseconds(20));
  }
  return fused;
}

// The paper's limits: circles of 0.97 m, full curvature within 0.40 m (notes on docking, 4.8).
DockingPlanConfig paper_plan() {
  DockingPlanConfig plan;
  plan.limits = {1.0 / 0.97, 1.0 / 0.97 / 0.40};
  plan.straights = {};
  plan.softness = 0.0;
  plan.view.reset();
  plan.find_cures = plan.list_candidates = false;
  return plan;
}

RunRecord run_paper(const RunSettings& settings, std::uint64_t seed, RunTrace* trace) {
  constexpr std::size_t sightings_at_start = 20;
  Run run(settings, seed, trace);
  RunRecord record;
  // The marker-centring position: one pose, from the mean of what was seen at standstill.
  PoseFilter filter(settings.config.rig, settings.config.docking.filter);
  const bool seen = look_at_standstill(run, filter, sightings_at_start).size() == sightings_at_start;
  const std::optional<PoseEstimate> start = seen ? filter.estimate(run.now()) : std::nullopt;
  const std::optional<Pose2> odom_start = filter.T_odom_base(run.now());
  const Pose2 goal = settings.config.docking.dock_pose * inverse(camera_point(settings.config.rig));
  record.result = "failed";
  if (!start || !odom_start) {
    record.reason = "the tag was not seen well enough at the start";
    run.finish(record);
    return record;
  }
  const DockingPlanResult planned = plan_docking(start->T_station_base, goal, paper_plan());
  const DockingPlan* plan = std::get_if<DockingPlan>(&planned);
  if (plan == nullptr) {
    const PlanRefusal* refusal = std::get_if<PlanRefusal>(&planned);
    record.reason = refusal != nullptr ? one_field(refusal->sentence) : "already there";
    run.finish(record);
    return record;
  }
  OdometryControllerConfig controller = settings.config.docking.segments;
  controller.max_command = 0.4;
  const nanoseconds period = control_period(travel_time(plan->length, controller), controller.nominal_period);  // eq. 6
  const Pose2 T_station_odom = start->T_station_base * inverse(*odom_start);
  FollowState state;
  Pose2 pose = start->T_station_base;
  bool arrived = false;
  // Twice the way's time: without odometry it would drive on for ever, having no watchdog.
  const nanoseconds latest = run.now() + 2 * travel_time(plan->length, controller) + std::chrono::seconds(10);
  while (!arrived && run.now() < latest) {
    const Tick tick = run.read_odometry();
    if (!tick.odometry.empty()) pose = T_station_odom * tick.odometry.back().T_odom_base;
    const FollowStep step = follow(plan->path, state, pose, period, controller);
    state = step.next;
    arrived = step.arrived;
    run.drive(step.command, period);
  }
  record.result = arrived ? "arrived" : "timed_out";
  const Pose2 claimed = pose * camera_point(settings.config.rig);
  const Pose2& dock = settings.config.docking.dock_pose;
  record.estimated = Pose2{claimed.x - dock.x, claimed.y - dock.y, wrap_angle(claimed.yaw - dock.yaw)};
  run.finish(record);
  return record;
}

}  // namespace

std::optional<Fix> taught_pose(const RunSettings& settings, std::uint64_t seed) {
  constexpr std::size_t count = 40;
  RunSettings before = settings;
  before.scenario = untouched(settings.scenario);
  // The lens itself is put at the dock, wherever calibration believes that it sits on the robot.
  const Pose2& dock = settings.config.docking.dock_pose;
  const Eigen::Vector3d lens =
      true_rig(settings.config.rig, before.scenario.residuals, seed).T_base_camera.translation();
  const Pose2 T_station_base = dock * inverse(Pose2{lens.x(), lens.y(), 0.0});
  const Pose2 believed = T_station_base * Pose2{settings.config.rig.T_base_camera.translation().x(), 0.0, 0.0};
  StartScenario& start = before.scenario.start;
  start = {};
  start.range = std::hypot(believed.x, believed.y);
  start.bearing = std::atan2(-believed.y, -believed.x);
  start.heading = dock.yaw - start.bearing;
  start.range_sigma = start.bearing_sigma = start.bearing_spread = start.heading_sigma = start.heading_spread =
      start.castor_sigma = 0.0;
  Run run(before, seed);
  PoseFilter filter(settings.config.rig, settings.config.docking.filter);
  const std::vector<RestSighting> seen = look_at_standstill(run, filter, count);
  const std::optional<Pose2> T_odom_base = filter.T_odom_base(run.now());
  if (seen.size() < count || !T_odom_base) return std::nullopt;
  DockingConfig repeatable = settings.config.docking;  // what stays the same at every docking is part of the pose
  repeatable.dock_pose_taught = true;
  return fix_from(seen, *T_odom_base, repeatable);
}

Rig five_megapixel_rig() {
  Rig rig = default_rig();
  CameraModel camera;
  camera.width = 2448;
  camera.height = 2048;
  camera.fx = camera.fy = 8.0 / 0.00345;
  camera.cx = 1223.5;
  camera.cy = 1023.5;
  rig.camera = camera;
  return rig;
}

Board single_tag_board(double height) {
  Board board;
  board.tags = {{1, 0.16, upright_tag(0.0, 0.0, height, 0.0)}};
  return board;
}

RunRecord run_once(const RunSettings& settings, std::uint64_t seed, RunTrace* trace) {
  RunRecord record =
      settings.strategy == Strategy::servo ? run_servo(settings, seed, trace) : run_paper(settings, seed, trace);
  record.seed = seed;
  record.scenario = settings.scenario.name;
  return record;
}

}  // namespace tagdock
