#include "servo/docking.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <limits>
#include <stdexcept>
#include <type_traits>
#include <utility>

#include <Eigen/Cholesky>
#include <Eigen/LU>

namespace tagdock {
namespace {

using Time = std::chrono::nanoseconds;

double seconds(Time time) { return std::chrono::duration<double>(time).count(); }

template <typename... Values>
std::string text(const char* format, Values... values) {
  std::array<char, 400> buffer{};
  std::snprintf(buffer.data(), buffer.size(), format, values...);
  return buffer.data();
}

// The line to drive along: the dock's, or beside it by what the last attempt missed.
LineTarget line_target(const Job& job, const DockingConfig& config) {
  return {goal_of_axle(config) * Pose2{0.0, job.aim, 0.0}, camera_point(config.rig).x,
          0.5 * horizontal_view(config.rig.camera), config.board_width};
}

double camera_distance(const Pose2& T_station_base, const DockingConfig& config) {
  return -(T_station_base * camera_point(config.rig)).x;
}

// Standard deviation of the camera point across the station's axis.
double sigma_y_of_camera(const PoseEstimate& estimate, const DockingConfig& config) {
  const Pose2 ahead = camera_point(config.rig);
  const double yaw = estimate.T_station_base.yaw;
  const Eigen::Vector3d across(0.0, 1.0, std::cos(yaw) * ahead.x - std::sin(yaw) * ahead.y);
  return std::sqrt(across.dot(estimate.covariance * across));
}

// The pose to steer by: with the heading that the robot has once its castors trail again. A law that answers to what
// they hold back answers to its own command, and swings (scrub of 0.2 rad/m, L of 0.4 m).
Pose2 steered_by(const PoseEstimate& estimate) {
  Pose2 pose = estimate.T_station_base;
  pose.yaw = wrap_angle(pose.yaw + estimate.held_back);
  return pose;
}

// The line law, no stiffer than the castors bear.
LineLawConfig law_for(const PoseEstimate& estimate, const DockingConfig& config) {
  LineLawConfig law = config.line;
  law.lag = heading_lag(estimate.castor_scrub, config.filter.castors);
  law.length = std::max(law.length, config.lengths_per_lag * law.lag);
  law.slow_length = std::max(law.slow_length, law.length);
  return law;
}

// What unequal wheels would turn the robot by is taken back before it happens.
Twist2 against_pull(Twist2 command, const PoseEstimate& estimate) {
  command.angular -= estimate.pull * command.linear;
  return command;
}

bool is_still(const Odometry& odometry) {
  constexpr double still_speed = 0.002;      // m/s
  constexpr double still_turn_rate = 0.003;  // rad/s
  return std::abs(odometry.velocity.linear) < still_speed && std::abs(odometry.velocity.angular) < still_turn_rate;
}

bool is_fused(const FilterUpdate& update) {
  return update.use == SightingUse::fused || update.use == SightingUse::fused_without_yaw;
}

// ------------------------------------------------------------------------------------------------ ends and retries

Step failed(const Job& job, Reason reason, std::optional<Fix> fix = std::nullopt) {
  std::string sentence = reason.sentence;
  return {Failed{job, std::move(reason), std::move(fix)}, {}, std::move(sentence)};
}

// Where the back-off before an attempt ends: from the same place the same way would be missed again.
double back_off_to(const Job& job, const DockingConfig& config) {
  const double near = config.back_off.camera_distance;
  if (job.giving_up) return near;
  return std::max(near, std::min(near + config.back_off.farther * (job.attempts - 1), job.came_from));
}

// The attempt did not succeed: another one after a back-off, or the end with the first cause.
Step next_attempt(const Job& job, const Reason& reason, const Inputs& inputs, const DockingConfig& config,
                  std::optional<Fix> fix = std::nullopt) {
  Job next = job;
  if (!next.first_cause) next.first_cause = reason;
  if (fix) next.last_fix = fix;
  if (job.attempts > config.back_off.retries || !inputs.estimate) {
    Reason first = *next.first_cause;
    if (job.attempts > 1) {
      first.sentence = text("failed after %d attempts: ", job.attempts) + first.sentence;
      if (reason.sentence != next.first_cause->sentence) first.sentence += "; the last time: " + reason.sentence;
    } else if (!inputs.estimate) {
      first.sentence += "; no second attempt, since the robot does not know where it is";
    }
    if (config.back_off.safe_pose && inputs.estimate) {
      next.giving_up = first;
      next.turn_allowed = false;
      return {BackingOff{next, inputs.now, std::nullopt}, {}, first.sentence};
    }
    return failed(next, std::move(first), std::move(fix));
  }
  ++next.attempts;
  next.turn_allowed = false;
  return {BackingOff{next, inputs.now, std::nullopt}, {}, reason.sentence};
}

// The estimate was lost on the way: find it again where the robot stands.
Step acquire_again(const Job& job, const Inputs& inputs, const DockingConfig& config, const std::string& where) {
  Reason reason{Cause::pose_uncertain, "the sightings did not fit odometry any more " + where};
  if (inputs.sighting && inputs.sighting->use == SightingUse::lost) {
    const Pose2& apart = inputs.sighting->innovation;
    reason.sentence += text(": they are %.0f mm and %.1f degrees apart; do the wheels slip, was the board moved?",
                            1e3 * std::hypot(apart.x, apart.y), degrees(std::abs(apart.yaw)));
  }
  Job next = job;
  if (!next.first_cause) next.first_cause = reason;
  if (job.attempts > config.back_off.retries) return failed(next, *next.first_cause);
  ++next.attempts;
  next.turn_allowed = false;
  Acquiring acquiring;
  acquiring.job = next;
  acquiring.since = acquiring.stage_since = inputs.now;
  return {acquiring, {}, reason.sentence};
}

template <typename Active>
Step timed_out(const Active& now, const Inputs& inputs, const DockingConfig& config) {
  return next_attempt(now.job,
                      {Cause::timed_out, text("%s took longer than %.0f s", std::string(name(Phase(now))).c_str(),
                                              seconds(inputs.now - now.since))},
                      inputs, config);
}

// ------------------------------------------------------------------------------------------------------- acquiring

bool sees_board(const Inputs& inputs) {
  constexpr Time recent = std::chrono::milliseconds(500);
  return inputs.view && inputs.sighting_age && *inputs.sighting_age < recent + inputs.declared_latency;
}

Reason unseen_reason(const Acquiring& now, const Inputs& inputs) {
  if (now.last_unseen == Unseen::other_tags) {
    return {Cause::wrong_tags, "tags are in view, but none of the board's; is this the right dock and board file?"};
  }
  if (now.last_unseen == Unseen::layout_mismatch) {
    return {Cause::wrong_tags, "the tags do not stand to each other as in the board file; is this the right dock?"};
  }
  if (now.last_unseen == Unseen::duplicate_tag) {
    return {Cause::wrong_tags, "one of the board's tags is seen twice; are two stations in view?"};
  }
  if (!inputs.sighting_age) {
    return {Cause::tag_never_seen,
            "the camera works, but the board was not in any frame; is the robot in front of "
            "the dock, the light on, the lens clean?"};
  }
  return {Cause::tag_lost, text("the board was last seen %.1f s ago", seconds(*inputs.sighting_age))};
}

// The way straight ahead that turns the castors, where the start leaves room for it.
std::optional<Path> run_in_path(const Job& job, const Inputs& inputs, const DockingConfig& config) {
  if (job.ran_in || job.attempts > 1 || !inputs.estimate || !inputs.view) return std::nullopt;
  if (config.run_in.distance <= 0.0 || std::abs(std::atan(inputs.view->x)) > config.run_in.max_bearing) {
    return std::nullopt;
  }
  const double after = inputs.view->depth - config.run_in.distance;
  if (after < config.run_in.min_distance_after) return std::nullopt;
  return Path{inputs.odometry.T_odom_base, {{config.run_in.distance, 0.0, 0.0}}};
}

// At the dock and asked to leave it.
Step leave(const Acquiring& now, const Inputs& inputs, const DockingConfig& config, const std::string& found) {
  const Pose2 error = between(config.dock_pose, inputs.estimate->T_station_base * camera_point(config.rig));
  if (std::hypot(error.x, error.y) < config.undock.near && std::abs(wrap_angle(error.yaw)) < config.undock.near_yaw) {
    Job job = now.job;
    job.turn_allowed = false;
    return {Undocking{job, inputs.now, std::nullopt}, {}, found};
  }
  return failed(now.job, {Cause::not_docked, text("the robot does not stand at the dock: %+.2f m ahead, %+.2f m to the "
                                                  "left and %+.1f degrees off",
                                                  error.x, error.y, degrees(wrap_angle(error.yaw)))});
}

Step acquired(const Acquiring& now, const Inputs& inputs, const DockingConfig& config, const std::string& found) {
  if (config.errand == Errand::undock) return leave(now, inputs, config, found);
  Job job = now.job;
  if (job.came_from == 0.0) job.came_from = camera_distance(inputs.estimate->T_station_base, config);
  if (const std::optional<Path> path = run_in_path(now.job, inputs, config)) {
    job.ran_in = true;
    return {RunningIn{job, inputs.now, *path, {}}, {}, found + ", room for a castor run-in"};
  }
  return {Validating{job, inputs.now}, {}, found};
}

Step step_acquiring(const Acquiring& before, const Inputs& inputs, const DockingConfig& config) {
  Acquiring now = before;
  if (inputs.unseen) now.last_unseen = inputs.unseen;
  if (inputs.sighting) now.last_unseen.reset();
  const Time in_stage = inputs.now - now.stage_since;
  const auto enter = [&](Acquiring::Stage stage) {
    now.stage = stage;
    now.stage_since = inputs.now;
    now.fused = 0;
    return Step{now, {}, {}};
  };
  if (inputs.now - now.since > config.acquire.timeout) {
    if (!sees_board(inputs)) return failed(now.job, unseen_reason(now, inputs));
    return failed(now.job, {Cause::timed_out, text("the board could not be centred and measured within %.0f s",
                                                   seconds(config.acquire.timeout))});
  }
  if (inputs.latency && *inputs.latency > inputs.declared_latency + config.gate.hold_age) {
    return failed(now.job,
                  {Cause::camera_slow,
                   text("frames are %.0f ms old when they arrive, but the rig declares %.0f ms; declare the latency or "
                        "cure it",
                        1e3 * seconds(*inputs.latency), 1e3 * seconds(inputs.declared_latency))});
  }

  const bool seen = sees_board(inputs);
  switch (now.stage) {
    case Acquiring::Stage::looking:
      if (seen) return enter(now.job.turn_allowed ? Acquiring::Stage::centering : Acquiring::Stage::standing);
      if (in_stage < config.acquire.unseen || !inputs.frame_age) return {now, {}, {}};
      if (!now.job.turn_allowed || now.sweep_leg >= 3 || config.acquire.sweep <= 0.0) {
        return failed(now.job, unseen_reason(now, inputs));
      }
      now.yaw_at_sweep = inputs.odometry.T_odom_base.yaw;
      now.sweep_leg = 0;
      return enter(Acquiring::Stage::sweeping);

    case Acquiring::Stage::sweeping: {
      if (seen) return enter(Acquiring::Stage::centering);
      constexpr std::array<double, 3> ends = {1.0, -1.0, 0.0};
      const double turned = inputs.odometry.T_odom_base.yaw - now.yaw_at_sweep;
      const double rest = ends[static_cast<std::size_t>(now.sweep_leg)] * config.acquire.sweep - turned;
      constexpr double arrival = 0.01;  // rad
      if (std::abs(rest) < arrival && ++now.sweep_leg == 3) return enter(Acquiring::Stage::looking);
      return {now, {0.0, std::clamp(2.0 * rest, -config.acquire.sweep_rate, config.acquire.sweep_rate)}, {}};
    }

    case Acquiring::Stage::centering: {
      if (!seen) return enter(Acquiring::Stage::looking);
      if (std::abs(std::atan(inputs.view->x)) < config.acquire.bearing) return enter(Acquiring::Stage::standing);
      const std::optional<Twist2> turn = center_marker(*inputs.view, inputs.view->depth, config.rig.T_base_camera,
                                                       Centering::turn_only, config.centering);
      if (!turn) return enter(Acquiring::Stage::looking);
      return {now, *turn, {}};
    }

    case Acquiring::Stage::standing:
      break;
  }

  if (inputs.sighting_age && *inputs.sighting_age > config.acquire.unseen) return enter(Acquiring::Stage::looking);
  if (!is_still(inputs.odometry)) {
    now.stage_since = inputs.now;
    now.fused = 0;
    return {now, {}, {}};
  }
  if (in_stage < config.acquire.settle) return {now, {}, {}};
  if (now.job.turn_allowed && inputs.view && std::abs(std::atan(inputs.view->x)) > 2.0 * config.acquire.bearing) {
    return enter(Acquiring::Stage::centering);
  }
  if (inputs.sighting && is_fused(*inputs.sighting)) ++now.fused;
  if (now.fused < config.acquire.sightings || !inputs.estimate) {
    constexpr Time patience = std::chrono::seconds(15);
    if (in_stage < patience) return {now, {}, {}};
    const bool ambiguous = inputs.sighting && inputs.sighting->use == SightingUse::ambiguous;
    return failed(now.job, {Cause::pose_uncertain,
                            ambiguous ? "the pose of a flat tag seen head-on has two solutions; come from the side or "
                                        "use a board with turned tags"
                                      : text("only %d sightings agreed within %.0f s of standing", now.fused,
                                             seconds(patience))});
  }
  const double sigma_y = std::sqrt(inputs.estimate->covariance(1, 1));
  const double sigma_yaw = std::sqrt(inputs.estimate->covariance(2, 2));
  const std::string found = text("range %.2f m, yaw %.1f deg, sigma y %.1f mm, yaw %.2f deg",
                                 camera_distance(inputs.estimate->T_station_base, config),
                                 degrees(inputs.estimate->T_station_base.yaw), 1e3 * sigma_y, degrees(sigma_yaw));
  if (sigma_y > config.acquire.max_sigma_y || sigma_yaw > config.acquire.max_sigma_yaw) {
    if (now.fused < 4 * config.acquire.sightings) return {now, {}, {}};
    return failed(now.job, {Cause::pose_uncertain, "the pose stays too uncertain to plan: " + found});
  }
  return acquired(now, inputs, config, found);
}

// ---------------------------------------------------------------------------------------------------------- run-in

Step step_running_in(const RunningIn& before, const Inputs& inputs, const DockingConfig& config) {
  RunningIn now = before;
  if (inputs.now - now.since > config.run_in.timeout) return timed_out(now, inputs, config);
  const FollowStep driven = follow(now.path_odom, now.follow, inputs.odometry.T_odom_base, inputs.step, config.segments,
                                   inputs.last_command.linear);
  now.follow = driven.next;
  if (!driven.arrived) return {now, driven.command, {}};
  Acquiring acquiring;
  acquiring.job = now.job;
  acquiring.since = acquiring.stage_since = inputs.now;
  return {acquiring, {}, text("driven %.2f m straight ahead", config.run_in.distance)};
}

// ------------------------------------------------------------------------------------------------------ validating

struct EntryCheck {
  bool good = false;
  std::string found;
};

// Whether the line law can start here.
EntryCheck entry_check(const Job& job, const PoseEstimate& estimate, const DockingConfig& config) {
  const double share = job.attempts > 1 ? config.entry.retry_share : 1.0;
  const Pose2 T_goal_base = between(goal_of_axle(config), steered_by(estimate));
  const LineLawConfig law = law_for(estimate, config);
  const double rest = -T_goal_base.x;
  const double heading = wrap_angle(T_goal_base.yaw);
  const double left = lateral_left(T_goal_base.y, heading, std::max(0.0, rest), law.length, law.lag);
  // Beyond this lateral error the heading limit holds the law back, and the estimate of what is left is too good.
  const double linear = (2.0 * law.length + law.lag) * std::tan(2.0 * config.line.min_heading);
  const bool good = rest > 0.0 && std::abs(left) < share * config.entry.lateral_left &&
                    std::abs(T_goal_base.y) < linear && std::abs(heading) < share * config.entry.max_heading;
  return {good, text("%.2f m to go, %+.1f mm beside the line, %+.2f deg", rest, 1e3 * T_goal_base.y, degrees(heading))};
}

// Whether the board's middle stays in view all along a path.
bool keeps_view(const Path& path, const DockingConfig& config) {
  const double half_view = 0.5 * horizontal_view(config.rig.camera) - config.entry.view_margin;
  const double whole = length(path);
  constexpr double spacing = 0.05;  // m
  const int steps = std::max(1, static_cast<int>(std::ceil(whole / spacing)));
  for (int i = 0; i <= steps; ++i) {
    const Pose2 T_station_base = point_at(path, whole * i / steps).pose;
    const std::optional<MarkerView> view =
        marker_view(config.rig.T_base_camera, level_view(config.rig, T_station_base));
    if (!view || std::abs(std::atan(view->x)) > half_view) return false;
  }
  return true;
}

// A path to an entry pose, with or without the wish to see the board all the way.
std::variant<Path, std::string> path_to(const Pose2& start, const Pose2& entry, bool keep_view,
                                        const DockingConfig& config) {
  if (config.planner) {
    std::variant<Path, std::string> answer = config.planner(start, entry);
    const Path* path = std::get_if<Path>(&answer);
    if (path != nullptr && keep_view && !keeps_view(*path, config)) return "on the path the board leaves the view";
    return answer;
  }
  DockingPlanConfig wish = config.plan;
  if (keep_view) {
    ViewWish view;
    view.horizontal_view = horizontal_view(config.rig.camera);
    view.margin = config.entry.view_margin;
    view.camera_ahead = camera_point(config.rig).x;
    view.board_half_width = 0.0;
    wish.view = view;
  }
  const DockingPlanResult answer = plan_docking(start, entry, wish);
  if (const DockingPlan* plan = std::get_if<DockingPlan>(&answer)) return plan->path;
  if (const PlanRefusal* refusal = std::get_if<PlanRefusal>(&answer)) {
    return refusal->cure.empty() ? refusal->sentence : refusal->sentence + "; " + refusal->cure;
  }
  return Path{start, {}};
}

std::optional<Step> planned(const Validating& now, const Inputs& inputs, const DockingConfig& config,
                            std::string& refusal) {
  const Pose2 start = inputs.estimate->T_station_base;
  const Pose2 goal = goal_of_axle(config);
  const auto to_follow = [&](const Path& path, bool blind, const std::string& reason) {
    Following following;
    following.job = now.job;
    following.job.turn_allowed = false;
    following.since = inputs.now;
    following.path = path;
    following.T_station_odom = start * inverse(inputs.odometry.T_odom_base);
    following.blind = blind;
    return Step{following, {}, reason};
  };
  constexpr double nearer = 0.1;          // m, between the entries that are tried
  constexpr double run_in_lengths = 4.0;  // of the law; after as many less than 10 % of an error are left
  const double wanted = std::max(config.entry.run_in, run_in_lengths * law_for(*inputs.estimate, config).length);
  for (double run_in = wanted; run_in > config.entry.min_run_in - 1e-9; run_in -= nearer) {
    const Pose2 entry = goal * Pose2{-run_in, 0.0, 0.0};
    std::variant<Path, std::string> answer = path_to(start, entry, false, config);
    // The softest path first; where the board leaves its view, one that was looked for with that in mind.
    const Path* path = std::get_if<Path>(&answer);
    if (path != nullptr && !keeps_view(*path, config)) {
      answer = path_to(start, entry, true, config);
      path = std::get_if<Path>(&answer);
    }
    if (path != nullptr && keeps_view(*path, config)) {
      return to_follow(*path, false,
                       text("path of %.2f m in %d segments, run-in %.1f m", length(*path),
                            static_cast<int>(path->segments.size()), run_in));
    }
    refusal = path != nullptr ? "on every path the board leaves the view" : std::get<std::string>(answer);
  }
  if (!config.entry.blind_entry || now.job.attempts > 1 || now.job.went_blind) return std::nullopt;
  for (double run_in = config.entry.blind_run_in; run_in > 0.0; run_in -= nearer) {
    const std::variant<Path, std::string> answer = path_to(start, goal * Pose2{-run_in, 0.0, 0.0}, false, config);
    if (const Path* path = std::get_if<Path>(&answer)) {
      return to_follow(*path, true,
                       text("path of %.2f m in %d segments; none with a run-in keeps the board in view, so back off "
                            "at its end",
                            length(*path), static_cast<int>(path->segments.size())));
    }
  }
  return std::nullopt;
}

// Whether one frame at the dock tells less than the tolerance asks for, as far as the sensor's errors were measured.
std::optional<std::string> unsure_at_dock(const DockingConfig& config) {
  if (!config.filter.sensor) return std::nullopt;
  const auto measured =
      lens_covariance(*config.filter.sensor, config.dock_pose, 0.5 * horizontal_view(config.rig.camera));
  if (!measured) return std::nullopt;
  const Eigen::Vector3d sigma = measured->diagonal().cwiseSqrt();
  if (sigma.x() <= config.fix.tolerance_x && sigma.y() <= config.fix.tolerance_y &&
      sigma.z() <= config.fix.tolerance_yaw)
    return std::nullopt;
  return text(
      "from the docking pose the camera tells x, y and yaw by %.1f mm, %.1f mm and %.2f degrees only (sensor errors as "
      "measured), but the tolerance is %.1f mm, %.1f mm and %.2f degrees; dock nearer or use a board with turned tags",
      1e3 * sigma.x(), 1e3 * sigma.y(), degrees(sigma.z()), 1e3 * config.fix.tolerance_x, 1e3 * config.fix.tolerance_y,
      degrees(config.fix.tolerance_yaw));
}

Step step_validating(const Validating& now, const Inputs& inputs, const DockingConfig& config) {
  if (!inputs.estimate) return acquire_again(now.job, inputs, config, "while planning");
  const Pose2 T_goal_base = between(goal_of_axle(config), inputs.estimate->T_station_base);
  if (std::abs(T_goal_base.x) < config.fix.tolerance_x && std::abs(T_goal_base.y) < config.fix.tolerance_y &&
      std::abs(wrap_angle(T_goal_base.yaw)) < config.fix.tolerance_yaw) {
    return {Fixing{now.job, inputs.now, {}}, {}, "the robot stands at the dock already"};
  }
  if (const std::optional<std::string> unsure = unsure_at_dock(config))
    return failed(now.job, {Cause::no_plan, *unsure});
  const EntryCheck entry = entry_check(now.job, *inputs.estimate, config);
  if (entry.good) {
    Servoing servoing;
    servoing.job = now.job;
    servoing.job.turn_allowed = false;
    servoing.since = inputs.now;
    return {servoing, {}, "on the dock's line: " + entry.found};
  }
  std::string refusal = "no path was tried";
  if (std::optional<Step> plan = planned(now, inputs, config, refusal)) return *std::move(plan);
  const Reason reason{Cause::no_plan, "there is no path to the dock from here (" + entry.found + "): " + refusal};
  if (now.job.went_blind && now.job.attempts == 1 && config.back_off.retries > 0) {
    // It came back from its blind run, and not onto the line: the next attempt is judged as every one after a back-off.
    Validating again = now;
    ++again.job.attempts;
    if (!again.job.first_cause) again.job.first_cause = reason;
    return {again, {}, {}};
  }
  constexpr double worth = 0.2;  // m; a shorter back-off changes nothing
  Job next = now.job;
  ++next.attempts;
  if (camera_distance(inputs.estimate->T_station_base, config) + worth > back_off_to(next, config)) {
    return failed(now.job, now.job.first_cause ? *now.job.first_cause : reason);
  }
  return next_attempt(now.job, reason, inputs, config);
}

// ------------------------------------------------------------------------------------------------------- following

Step to_servo(const Following& now, const Inputs& inputs, const DockingConfig& config) {
  const EntryCheck entry = entry_check(now.job, *inputs.estimate, config);
  if (!entry.good) return next_attempt(now.job, {Cause::entry_missed, "the path ended " + entry.found}, inputs, config);
  Servoing servoing;
  servoing.job = now.job;
  servoing.since = inputs.now;
  return {servoing, inputs.last_command, entry.found};
}

Step step_following(const Following& before, const Inputs& inputs, const DockingConfig& config) {
  Following now = before;
  if (!inputs.estimate) return acquire_again(now.job, inputs, config, "while a path was driven");
  const Time limit = 2 * travel_time(length(now.path), config.segments) + std::chrono::seconds(10);
  if (inputs.now - now.since > limit) return timed_out(now, inputs, config);

  OdometryControllerConfig controller = config.segments;
  if (!now.blind) controller.end_speed = config.line.max_speed;  // the line law takes over in motion
  const Pose2 by_odometry = now.T_station_odom * inputs.odometry.T_odom_base;
  const Pose2 pose = config.fuse_in_segments ? steered_by(*inputs.estimate) : by_odometry;
  if (config.fuse_in_segments) {
    controller.damping = config.fused_damping;
    controller.castor_scrub = inputs.estimate->castor_scrub;
    controller.castors = config.filter.castors;
    // With castors that lag by K a deviation y counted over l alone leaves the damping g (1 - K/l); over l + K it is
    // g l / (l + K), and no castor makes it negative (see LineLawConfig::lag).
    controller.lateral_length += heading_lag(inputs.estimate->castor_scrub, config.filter.castors);
  }
  const FollowStep driven = follow(now.path, now.follow, pose, inputs.step, controller, inputs.last_command.linear);
  now.follow = driven.next;
  constexpr double hand_over = 0.010;  // m before the end
  if (!now.blind && driven.remaining < hand_over) return to_servo(now, inputs, config);
  if (!driven.arrived)
    return {now, config.fuse_in_segments ? against_pull(driven.command, *inputs.estimate) : driven.command, {}};
  // A blind entry was planned to end here: the back-off belongs to the same attempt.
  now.job.went_blind = true;
  return {BackingOff{now.job, inputs.now, std::nullopt}, {}, "end of the path"};
}

// -------------------------------------------------------------------------------------------------------- servoing

Step to_fix(const Servoing& now, const Inputs& inputs) {
  const Pose2& there = inputs.estimate->T_station_base;
  return {Fixing{now.job, inputs.now, {}}, {}, text("standing at x %.4f m, y %+.4f m", there.x, there.y)};
}

Step step_servoing(const Servoing& before, const Inputs& inputs, const DockingConfig& config) {
  Servoing now = before;
  if (!inputs.estimate) return acquire_again(now.job, inputs, config, "on the line");
  if (now.reached) {
    if (inputs.now - *now.reached < config.servo.rest || !is_still(inputs.odometry)) {
      if (inputs.now - now.since > config.servo.timeout) return timed_out(now, inputs, config);
      return {now, {}, {}};
    }
    return to_fix(now, inputs);
  }
  if (inputs.now - now.since > config.servo.timeout) return timed_out(now, inputs, config);
  const Time unseen = inputs.sighting_age.value_or(inputs.now - now.since) - inputs.declared_latency;
  if (unseen > config.gate.back_off_age) {
    const bool no_frames = inputs.frame_age && *inputs.frame_age - inputs.declared_latency > config.gate.hold_age;
    return next_attempt(now.job,
                        {no_frames ? Cause::camera_lost : Cause::tag_lost,
                         text(no_frames ? "no frame from the camera for %.1f s on the line"
                                        : "the board was not seen for %.1f s on the line",
                              seconds(unseen))},
                        inputs, config);
  }

  now.travelled += std::abs(inputs.odometry.velocity.linear) * seconds(inputs.step);
  const LineLawConfig law = law_for(*inputs.estimate, config);
  const LineCommand line = follow_line(line_target(now.job, config), steered_by(*inputs.estimate), inputs.last_command,
                                       inputs.odometry.velocity.linear, inputs.step, now.slow, law);
  if (config.servo.law == ServoLaw::centering) {
    const double wanted = -config.dock_pose.x;
    if (!inputs.view) return {now, {}, {}};
    const double rest = inputs.view->depth - wanted - inputs.odometry.velocity.linear * config.line.response_time;
    if (std::abs(rest) < config.servo.centering_end) {
      now.reached = inputs.now;
      return {now, {}, {}};
    }
    const std::optional<Twist2> centering =
        center_marker(*inputs.view, wanted, config.rig.T_base_camera, Centering::turn_and_drive, config.centering);
    return {now, centering.value_or(Twist2{}), {}};
  }

  const double left = lateral_left(line.lateral, line.heading, std::max(0.0, line.remaining), law.length, law.lag);
  if (std::abs(left) > config.servo.max_left) {
    return next_attempt(now.job,
                        {Cause::drifted, text("%+.1f mm beside the line with %.2f m to go, %+.1f mm would be left",
                                              1e3 * line.lateral, line.remaining, 1e3 * left)},
                        inputs, config);
  }
  const double sigma_y = sigma_y_of_camera(*inputs.estimate, config);
  if (line.remaining < config.servo.sigma_within && sigma_y > config.servo.max_sigma_y) {
    return next_attempt(now.job, {Cause::drifted, text("the lateral position is known to %.1f mm only", 1e3 * sigma_y)},
                        inputs, config);
  }
  now.swing = watch(now.swing, now.travelled, line.heading, config.swing);
  if (swings(now.swing, config.swing)) {
    if (now.slow) {
      return next_attempt(now.job, {Cause::swinging, "the heading swings about the line, also when slow"}, inputs,
                          config);
    }
    now.slow = true;
    now.swing = {};
  }
  if (line.reached) now.reached = inputs.now;
  return {now, against_pull(line.command, *inputs.estimate), {}};
}

// ---------------------------------------------------------------------------------------------------------- fixing

// What is different about the board since the docking pose was taught, if anything.
std::optional<std::string> changed_hang(const BoardHang& hang, const DockingConfig& config) {
  if (!config.taught_hang) return std::nullopt;
  // The robot sees itself lifted by what the board has sunk, and tilted by what it was turned the other way.
  const double lowered = hang.camera_height - config.taught_hang->camera_height;
  const double roll = hang.roll - config.taught_hang->roll;
  const double pitch = hang.pitch - config.taught_hang->pitch;
  if (std::abs(lowered) <= config.hang_limits.height && std::hypot(roll, pitch) <= config.hang_limits.tilt)
    return std::nullopt;
  return text(
      "the board hangs %+.1f mm higher and turned by %+.2f, %+.2f degrees (roll, pitch) against when the docking "
      "pose was taught; has it been moved? put it back or teach again",
      -1e3 * lowered, -degrees(roll), -degrees(pitch));
}

Step step_fixing(const Fixing& before, const Inputs& inputs, const DockingConfig& config) {
  Fixing now = before;
  if (!inputs.estimate) return acquire_again(now.job, inputs, config, "at the dock");
  if (inputs.now - now.since > config.fix.timeout) {
    return next_attempt(now.job,
                        {Cause::tag_lost, text("only %d of %d sightings at the dock within %.0f s",
                                               static_cast<int>(now.sightings.size()), config.fix.sightings,
                                               seconds(config.fix.timeout))},
                        inputs, config);
  }
  if (!is_still(inputs.odometry)) {
    now.sightings.clear();
    return {now, {}, {}};
  }
  if (inputs.rest && inputs.rest->planar.time > now.since) now.sightings.push_back(*inputs.rest);
  if (static_cast<int>(now.sightings.size()) < config.fix.sightings) return {now, {}, {}};

  const std::optional<Fix> fix = fix_from(now.sightings, inputs.odometry.T_odom_base, config);
  if (const std::optional<std::string> change = changed_hang(fix->hang, config))
    return failed(now.job, {Cause::dock_changed, *change}, fix);
  const Eigen::Vector3d sigma = fix->covariance.diagonal().cwiseSqrt();
  const std::string found =
      text("error x %+.2f mm, y %+.2f mm, yaw %+.3f deg (sigma %.2f, %.2f mm, %.3f deg)", 1e3 * fix->error.x,
           1e3 * fix->error.y, degrees(fix->error.yaw), 1e3 * sigma.x(), 1e3 * sigma.y(), degrees(sigma.z()));
  const bool inside = std::abs(fix->error.x) + config.fix.sigmas * sigma.x() <= config.fix.tolerance_x &&
                      std::abs(fix->error.y) + config.fix.sigmas * sigma.y() <= config.fix.tolerance_y &&
                      std::abs(fix->error.yaw) + config.fix.sigmas * sigma.z() <= config.fix.tolerance_yaw;
  if (inside) return {Docked{now.job, *fix}, {}, found};
  Job job = now.job;
  const double miss = std::cos(config.dock_pose.yaw) * fix->error.y - std::sin(config.dock_pose.yaw) * fix->error.x;
  job.aim = std::clamp(job.aim - config.back_off.learning * miss, -config.back_off.max_aim, config.back_off.max_aim);
  return next_attempt(job, {Cause::outside_tolerance, "not surely within the tolerance: " + found}, inputs, config,
                      fix);
}

// ----------------------------------------------------------------------------------------------- back-off and pause

Step step_backing_off(const BackingOff& before, const Inputs& inputs, const DockingConfig& config) {
  BackingOff now = before;
  const bool late = inputs.now - now.since > config.back_off.timeout;
  if (now.job.giving_up && (now.reached || late || !inputs.estimate))
    return failed(now.job, *now.job.giving_up, now.job.last_fix);
  if (!inputs.estimate) return acquire_again(now.job, inputs, config, "in the back-off");
  if (late) return timed_out(now, inputs, config);
  if (!now.reached) {
    const LineCommand line = back_along_line(
        line_target(now.job, config), steered_by(*inputs.estimate), back_off_to(now.job, config), inputs.last_command,
        inputs.odometry.velocity.linear, inputs.step, law_for(*inputs.estimate, config));
    if (line.reached) now.reached = inputs.now;
    return {now, against_pull(line.command, *inputs.estimate), {}};
  }
  if (inputs.now - *now.reached < config.back_off.rest) return {now, {}, {}};
  Acquiring acquiring;
  acquiring.job = now.job;
  acquiring.job.turn_allowed = false;
  acquiring.since = acquiring.stage_since = inputs.now;
  return {acquiring, {}, text("backed off to %.2f m", camera_distance(inputs.estimate->T_station_base, config))};
}

Step step_undocking(const Undocking& before, const Inputs& inputs, const DockingConfig& config) {
  Undocking now = before;
  if (!inputs.estimate)
    return failed(now.job, {Cause::pose_uncertain, "the sightings did not fit odometry any more while undocking"});
  if (inputs.now - now.since > config.undock.timeout)
    return failed(now.job,
                  {Cause::timed_out, text("undocking took longer than %.0f s", seconds(config.undock.timeout))});
  if (now.reached) {
    if (inputs.now - *now.reached < config.back_off.rest || !is_still(inputs.odometry)) return {now, {}, {}};
    return {Undocked{now.job},
            {},
            text("%.2f m before the board", camera_distance(inputs.estimate->T_station_base, config))};
  }
  const LineCommand line = back_along_line(
      line_target(now.job, config), steered_by(*inputs.estimate), config.undock.camera_distance, inputs.last_command,
      inputs.odometry.velocity.linear, inputs.step, law_for(*inputs.estimate, config));
  if (line.reached) now.reached = inputs.now;
  return {now, against_pull(line.command, *inputs.estimate), {}};
}

Step step_paused(const Paused& now, const Inputs& inputs, const DockingConfig& config) {
  if (inputs.request == Request::resume) {
    // On the way out of the station nothing is asked anew.
    if (now.from == name(Undocking{})) return {Undocking{now.job, inputs.now, std::nullopt}, {}, "resumed"};
    if (now.from == name(BackingOff{})) return {BackingOff{now.job, inputs.now, std::nullopt}, {}, "resumed"};
    Acquiring acquiring;
    acquiring.job = now.job;
    acquiring.since = acquiring.stage_since = inputs.now;
    return {acquiring, {}, "resumed"};
  }
  if (inputs.now - now.since > config.pause_timeout) {
    return failed(now.job, {Cause::timed_out, text("paused for more than %.0f s", seconds(config.pause_timeout))});
  }
  return {now, {}, {}};
}

// What holds in every phase that is under way.
template <typename Active>
std::optional<Step> interrupted(const Active& now, const Inputs& inputs, const DockingConfig& config) {
  constexpr bool over = std::is_same_v<Active, Docked> || std::is_same_v<Active, Undocked> ||
                        std::is_same_v<Active, Failed> || std::is_same_v<Active, Stopped>;
  if (inputs.request == Request::stop) {
    const Reason reason{Cause::stopped_by_person, "stopped by the operator or the guard"};
    return Step{Stopped{now.job, reason}, {}, reason.sentence};
  }
  if (inputs.request == Request::cancel) {
    return failed(now.job, {Cause::cancelled, "cancelled by the operator"});
  }
  if constexpr (!over && !std::is_same_v<Active, Paused>) {
    if (inputs.request == Request::pause) {
      return Step{Paused{now.job, inputs.now, name(Phase(now))}, {}, "asked to wait"};
    }
    const Time age = inputs.frame_age ? *inputs.frame_age - inputs.declared_latency : inputs.now - now.since;
    if (age > config.gate.give_up_age) {
      const std::string why = inputs.camera_sentence.empty() ? std::string() : ": " + inputs.camera_sentence;
      return failed(now.job,
                    {Cause::camera_lost, (inputs.frame_age ? text("no frame from the camera for %.1f s", seconds(age))
                                                           : text("no frame at all within %.1f s", seconds(age))) +
                                             why});
    }
  }
  return std::nullopt;
}

}  // namespace

DockingPlanConfig entry_plan() {
  DockingPlanConfig plan;
  plan.straights = {0.0, 0.0};
  plan.list_candidates = false;
  return plan;
}

void check(const DockingConfig& config) {
  check(config.gate);
  check(config.rig.camera);
  const auto require = [](bool good, const std::string& sentence) {
    if (!good) throw std::invalid_argument(sentence);
  };
  require(is_finite(config.dock_pose) && config.dock_pose.x < 0.0,
          text("the docking pose x %g m, y %g m must be finite and before the wall (x below 0)", config.dock_pose.x,
               config.dock_pose.y));
  require(
      config.line.length >= 0.1 && config.line.slow_length >= config.line.length,
      text("line.length is %g m; it must be at least 0.1 m, and line.slow_length not below it", config.line.length));
  require(config.line.max_speed > 0.0 && config.line.max_speed <= config.gate.max_speed,
          text("line.max_speed is %g m/s; it must be above 0 and at most gate.max_speed, %g m/s", config.line.max_speed,
               config.gate.max_speed));
  require(config.segments.max_speed > 0.0 && config.segments.max_speed <= config.gate.max_speed,
          text("segments.max_speed is %g m/s; it must be above 0 and at most gate.max_speed, %g m/s",
               config.segments.max_speed, config.gate.max_speed));
  require(config.segments.damping > 0.0 && config.segments.damping <= 1.0,
          text("segments.damping is %g; it must be above 0 and at most 1", config.segments.damping));
  require(config.fix.sightings >= 1 && config.acquire.sightings >= 1,
          "fix.sightings and acquire.sightings must be at least 1");
  require(config.fix.tolerance_x > 0.0 && config.fix.tolerance_y > 0.0 && config.fix.tolerance_yaw > 0.0,
          "the tolerances of fix must be above 0");
  require(config.slip.yaw > 0.0 && config.slip.yaw_way > 0.0 && config.slip.place > 0.0 &&
              config.slip.place_way > 0.0 && config.slip.sightings >= 1,
          "the limits of slip must be above 0");
  require(config.slip.castor_times >= 0.0, "slip.castor_times must not be below 0");
  require(config.back_off.retries >= 0, "back_off.retries must not be negative");
  require(config.entry.min_run_in <= config.entry.run_in,
          text("run_in.least_m is %g m; it must be at most run_in.wanted_m, %g m", config.entry.min_run_in,
               config.entry.run_in));
  require(config.undock.camera_distance > -config.dock_pose.x,
          text("undock.camera_distance is %g m; it must be farther than the dock, %g m", config.undock.camera_distance,
               -config.dock_pose.x));
  require(config.back_off.camera_distance > -config.dock_pose.x,
          text("back_off.camera_distance is %g m; it must be farther than the dock, %g m",
               config.back_off.camera_distance, -config.dock_pose.x));
  const LineTarget target = line_target(Job{}, config);
  const double view = heading_limit(target, -config.dock_pose.x, config.line, true);
  require(
      view >= config.line.min_heading,
      text("at the docking pose the board of %g m fills the view so far that only %.1f degrees of heading are left; "
           "dock farther away or use a smaller board",
           config.board_width, degrees(view)));
}

Pose2 goal_of_axle(const DockingConfig& config) { return config.dock_pose * inverse(camera_point(config.rig)); }

std::string_view name(const Phase& phase) {
  struct Names {
    std::string_view operator()(const Acquiring&) const { return "acquiring"; }
    std::string_view operator()(const RunningIn&) const { return "castor run-in"; }
    std::string_view operator()(const Validating&) const { return "validating"; }
    std::string_view operator()(const Following&) const { return "following"; }
    std::string_view operator()(const Servoing&) const { return "servoing"; }
    std::string_view operator()(const Fixing&) const { return "fixing"; }
    std::string_view operator()(const BackingOff&) const { return "backing off"; }
    std::string_view operator()(const Undocking&) const { return "undocking"; }
    std::string_view operator()(const Paused&) const { return "paused"; }
    std::string_view operator()(const Docked&) const { return "docked"; }
    std::string_view operator()(const Undocked&) const { return "undocked"; }
    std::string_view operator()(const Failed&) const { return "failed"; }
    std::string_view operator()(const Stopped&) const { return "stopped"; }
  };
  return std::visit(Names{}, phase);
}

const Job& job_of(const Phase& phase) {
  return std::visit([](const auto& now) -> const Job& { return now.job; }, phase);
}

bool is_over(const Phase& phase) {
  return std::holds_alternative<Docked>(phase) || std::holds_alternative<Undocked>(phase) ||
         std::holds_alternative<Failed>(phase) || std::holds_alternative<Stopped>(phase);
}

std::optional<Reason> reason_of(const Phase& phase) {
  if (const Failed* failure = std::get_if<Failed>(&phase)) return failure->reason;
  if (const Stopped* stop = std::get_if<Stopped>(&phase)) return stop->reason;
  return std::nullopt;
}

FrameNeed frame_need(const Phase& phase) {
  if (std::holds_alternative<Servoing>(phase)) return FrameNeed::sightings;
  if (const Acquiring* acquiring = std::get_if<Acquiring>(&phase)) {
    return acquiring->stage == Acquiring::Stage::centering ? FrameNeed::sightings : FrameNeed::frames;
  }
  // Backwards over the ground that was just driven, away from the station: by odometry alone if need be.
  const bool back = std::holds_alternative<BackingOff>(phase) || std::holds_alternative<Undocking>(phase);
  return back ? FrameNeed::none : FrameNeed::frames;
}

Phase first_phase(Errand errand, std::chrono::nanoseconds now) {
  Acquiring acquiring;
  acquiring.job.turn_allowed = errand == Errand::dock;  // not between the station's walls
  acquiring.since = acquiring.stage_since = now;
  return acquiring;
}

std::span<const Transition> transitions() {
  static constexpr std::array<Transition, 35> table = {{
      {"acquiring", "castor run-in", "measured, with room ahead"},
      {"acquiring", "validating", "measured"},
      {"acquiring", "undocking", "at the dock, asked to leave it"},
      {"acquiring", "failed", "not seen, uncertain, not docked, camera slow or timed out"},
      {"castor run-in", "acquiring", "driven"},
      {"castor run-in", "backing off", "timed out"},
      {"castor run-in", "failed", "timed out"},
      {"validating", "fixing", "docked already"},
      {"validating", "servoing", "on the line"},
      {"validating", "following", "path found"},
      {"validating", "backing off", "no path from here"},
      {"validating", "acquiring", "estimate lost"},
      {"validating", "failed", "no path"},
      {"following", "servoing", "at the entry"},
      {"following", "backing off", "entry missed, timed out or blind"},
      {"following", "acquiring", "estimate lost"},
      {"following", "failed", "attempts used up"},
      {"servoing", "fixing", "at the goal"},
      {"servoing", "backing off", "tag lost, drifted, swinging or timed out"},
      {"servoing", "acquiring", "estimate lost"},
      {"servoing", "failed", "attempts used up"},
      {"fixing", "docked", "inside tolerance"},
      {"fixing", "backing off", "outside tolerance or not seen"},
      {"fixing", "acquiring", "estimate lost"},
      {"fixing", "failed", "attempts used up, or the board was moved"},
      {"backing off", "acquiring", "far enough, or estimate lost"},
      {"backing off", "failed", "attempts used up; at the safe pose"},
      {"undocking", "undocked", "far enough"},
      {"undocking", "failed", "estimate lost or timed out"},
      {"paused", "acquiring", "resumed"},
      {"paused", "backing off", "resumed on the way back"},
      {"paused", "undocking", "resumed on the way out"},
      {"any", "paused", "asked to"},
      {"any", "failed", "cancelled or camera lost"},
      {"any", "stopped", "fault, operator or guard"},
  }};
  return table;
}

std::optional<Fix> fix_from(std::span<const RestSighting> rests, const Pose2& T_odom_base,
                            const DockingConfig& config) {
  if (rests.empty()) return std::nullopt;
  const Pose2 ahead = camera_point(config.rig);
  std::vector<PlanarSighting> sightings;
  for (const RestSighting& rest : rests) {
    sightings.push_back(rest.planar);
    sightings.back().T_station_base = rest.planar.T_station_base * between(rest.T_odom_base, T_odom_base);
  }
  const Pose2 about = sightings.front().T_station_base * ahead;

  // Everything below is of the camera point: [x y yaw] against the first sighting's.
  const double count = static_cast<double>(sightings.size());
  std::vector<Eigen::Vector3d> points;
  std::vector<Eigen::Matrix3d> covariances;
  Eigen::Matrix3d information = Eigen::Matrix3d::Zero();
  Eigen::Vector3d weighted = Eigen::Vector3d::Zero();
  Eigen::Matrix3d bias = Eigen::Matrix3d::Zero();
  Eigen::Matrix3d by_pixel = Eigen::Matrix3d::Zero();
  for (const PlanarSighting& sighting : sightings) {
    const Pose2 point = sighting.T_station_base * ahead;
    const double yaw = sighting.T_station_base.yaw;
    Eigen::Matrix3d camera_by_base = Eigen::Matrix3d::Identity();
    camera_by_base(0, 2) = -std::sin(yaw) * ahead.x - std::cos(yaw) * ahead.y;
    camera_by_base(1, 2) = std::cos(yaw) * ahead.x - std::sin(yaw) * ahead.y;
    points.emplace_back(point.x - about.x, point.y - about.y, wrap_angle(point.yaw - about.yaw));
    covariances.emplace_back(camera_by_base * sighting.covariance * camera_by_base.transpose());
    bias += camera_by_base * sighting.bias_covariance * camera_by_base.transpose() / count;
    by_pixel += camera_by_base * sighting.covariance_per_px2 * camera_by_base.transpose() / count;
    const Eigen::Matrix3d inverse_covariance = covariances.back().inverse();
    information += inverse_covariance;
    weighted += inverse_covariance * points.back();
  }
  const Eigen::Vector3d mean = information.ldlt().solve(weighted);

  Fix fix;
  fix.sightings = static_cast<int>(sightings.size());
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Eigen::Vector3d error = points[i] - mean;
    fix.chi2 += error.dot(covariances[i].ldlt().solve(error));
  }
  if (sightings.size() > 1) fix.chi2 /= 3.0 * (count - 1.0);
  // What sightings at standstill scatter by is measured here; their own covariance is a claim, which a misfit widens by
  // more than it makes them scatter. Few sightings measure too little to go below the claim.
  constexpr double enough = 20.0;
  const double values = 3.0 * (count - 1.0);
  const double scatter = values < enough ? std::max(1.0, fix.chi2) : fix.chi2 * values / (values - 2.0);
  fix.covariance = scatter * information.inverse();
  Pose2 point{about.x + mean.x(), about.y + mean.y(), about.yaw + mean.z()};
  bool cancels = config.dock_pose_taught;
  if (config.fix.method == FixMethod::smoothed) {
    const std::optional<SmoothedRest> smoothed =
        smooth_rest(rests, T_odom_base, point * inverse(ahead), config.rig, config.board, config.fix.smoother);
    if (smoothed) {
      point = smoothed->T_station_base * ahead;
      Eigen::Matrix3d camera_by_base = Eigen::Matrix3d::Identity();
      camera_by_base(0, 2) = -(point.y - smoothed->T_station_base.y);
      camera_by_base(1, 2) = point.x - smoothed->T_station_base.x;
      fix.covariance = camera_by_base * smoothed->covariance * camera_by_base.transpose();
      by_pixel = camera_by_base * smoothed->covariance_per_px2 * camera_by_base.transpose();
      const double lasting_px = std::max(config.filter.corner_bias_px, smoothed->lasting_px);
      bias = lasting_px * lasting_px * by_pixel;
      fix.chi2 = smoothed->chi2;
    } else if (!config.board.tags.empty()) {
      // The average weighs the corners in another way than the pose was taught with: what they leave does not cancel.
      cancels = false;
    }
  }
  const double position = config.fix.calibration_position * config.fix.calibration_position;
  const double turn = config.fix.calibration_yaw * config.fix.calibration_yaw;
  if (config.dock_pose_taught) fix.covariance += config.dock_pose_covariance;
  if (cancels) {
    fix.covariance += config.fix.untaught_corner_px * config.fix.untaught_corner_px * by_pixel;
  } else {
    fix.covariance += bias;
    fix.covariance.diagonal() += Eigen::Vector3d(position, position, turn);
  }

  Eigen::Vector3d up = Eigen::Vector3d::Zero();
  for (const PlanarSighting& sighting : sightings) {
    fix.hang.camera_height += sighting.camera_height / count;
    up += sighting.up_station;
  }
  fix.hang.roll = -std::atan2(up.y(), up.z());
  fix.hang.pitch = std::atan2(up.x(), up.z());

  fix.T_station_base = point * inverse(ahead);
  fix.error = {point.x - config.dock_pose.x, point.y - config.dock_pose.y,
               wrap_angle(point.yaw - config.dock_pose.yaw)};
  return fix;
}

std::optional<double> distance_to_go(const Phase& phase, const std::optional<PoseEstimate>& estimate,
                                     const DockingConfig& config) {
  if (const Following* following = std::get_if<Following>(&phase)) {
    const Pose2 entry = end_pose(following->path);
    const Pose2 rest = between(goal_of_axle(config), entry);
    return length(following->path) - following->follow.reference + std::hypot(rest.x, rest.y);
  }
  if (!estimate) return std::nullopt;
  const Pose2 rest = between(goal_of_axle(config), estimate->T_station_base);
  return std::hypot(rest.x, rest.y);
}

Step step(const Phase& phase, const Inputs& inputs, const DockingConfig& config) {
  struct Stepper {
    const Inputs& inputs;
    const DockingConfig& config;

    Step operator()(const Acquiring& now) const { return step_acquiring(now, inputs, config); }
    Step operator()(const RunningIn& now) const { return step_running_in(now, inputs, config); }
    Step operator()(const Validating& now) const { return step_validating(now, inputs, config); }
    Step operator()(const Following& now) const { return step_following(now, inputs, config); }
    Step operator()(const Servoing& now) const { return step_servoing(now, inputs, config); }
    Step operator()(const Fixing& now) const { return step_fixing(now, inputs, config); }
    Step operator()(const BackingOff& now) const { return step_backing_off(now, inputs, config); }
    Step operator()(const Undocking& now) const { return step_undocking(now, inputs, config); }
    Step operator()(const Paused& now) const { return step_paused(now, inputs, config); }
    Step operator()(const Docked& now) const { return {now, {}, {}}; }
    Step operator()(const Undocked& now) const { return {now, {}, {}}; }
    Step operator()(const Failed& now) const { return {now, {}, {}}; }
    Step operator()(const Stopped& now) const { return {now, {}, {}}; }
  };
  if (!is_over(phase)) {
    const std::optional<Step> interruption =
        std::visit([&](const auto& now) { return interrupted(now, inputs, config); }, phase);
    if (interruption) return *interruption;
  }
  return std::visit(Stepper{inputs, config}, phase);
}

}  // namespace tagdock
