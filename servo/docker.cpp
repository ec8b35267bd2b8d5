#include "servo/docker.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <utility>

namespace tagdock {
namespace {

constexpr std::size_t enough_ages = 5;  // to know the latency

double seconds(std::chrono::nanoseconds time) { return std::chrono::duration<double>(time).count(); }

// Phases in which the wheels rest, or turn the robot on the spot.
bool stands(const Phase& phase) {
  return std::holds_alternative<Acquiring>(phase) || std::holds_alternative<Validating>(phase) ||
         std::holds_alternative<Fixing>(phase) || std::holds_alternative<Paused>(phase) || is_over(phase);
}

DockingConfig with_rig(const Rig& rig, DockingConfig config) {
  config.rig = rig;
  check(config);
  return config;
}

}  // namespace

Docker::Docker(const Rig& rig, const DockingConfig& config)
    : config_(with_rig(rig, config)),
      filter_(rig, config.filter),
      gate_(config.gate),
      phase_(first_phase(config.errand, std::chrono::nanoseconds(0))),
      slip_(config.slip),
      declared_latency_(config.gate.declared_latency) {}

std::optional<Eigen::Isometry3d> Docker::predicted_view(std::chrono::nanoseconds time) const {
  return filter_.predicted_view(time);
}

std::optional<PoseEstimate> Docker::estimate(std::chrono::nanoseconds time) const { return filter_.estimate(time); }

std::optional<double> Docker::distance_to_go(const TickResult& result) const {
  return tagdock::distance_to_go(phase_, result.estimate, config_);
}

std::optional<Reason> Docker::take_odometry(const Tick& tick) {
  const OdometryLimits& limits = config_.gate.odometry;
  for (const Odometry& reading : tick.odometry) {
    if (std::optional<Reason> fault = odometry_fault(odometry_, reading, limits)) return fault;
    if (odometry_ && reading.time == odometry_->time) continue;  // the same reading once more
    filter_.predict(reading);
    if (odometry_) {
      const Pose2 motion = between(odometry_->T_odom_base, reading.T_odom_base);
      const double way = std::copysign(std::hypot(motion.x, motion.y), motion.x);
      travelled_ = way * travelled_ < 0.0 ? way : travelled_ + way;
    }
    odometry_ = reading;
    odometry_arrived_ = tick.now;
  }
  if (!tick.robot_linked)
    return Reason{Cause::robot_link,
                  tick.robot_sentence.empty() ? "the link to the robot is broken" : tick.robot_sentence};
  if (!odometry_) {
    if (tick.now - *started_ <= limits.first_reading) return std::nullopt;
    return Reason{Cause::robot_link, "the robot sent no odometry; is it switched on and its address right?"};
  }
  std::array<char, 160> text{};
  // What came last was measured before it came: with half the silence behind it nothing keeps coming.
  const bool stale = tick.now - odometry_->time > limits.max_silence;
  if (tick.now - *odometry_arrived_ > (stale ? limits.max_silence / 2 : limits.max_silence)) {
    std::snprintf(text.data(), text.size(), "the robot has been silent for %.0f ms",
                  1e3 * seconds(tick.now - (stale ? odometry_->time : *odometry_arrived_)));
    return Reason{Cause::robot_link, text.data()};
  }
  if (stale) {
    std::snprintf(text.data(), text.size(), "the newest odometry is %.0f ms old although it keeps coming",
                  1e3 * seconds(tick.now - odometry_->time));
    return Reason{Cause::odometry_stale, text.data()};
  }
  return std::nullopt;
}

void Docker::take_sighting(const Tick& tick, TickResult& result) {
  rest_.reset();
  if (!tick.sighting) return;
  const BoardSighting* board = std::get_if<BoardSighting>(&*tick.sighting);
  const std::optional<std::chrono::nanoseconds> time = board != nullptr ? std::optional(board->time) : tick.frame_time;
  // A frame from the future or older than one before is no frame.
  if (!time || *time > tick.now || (frame_time_ && *time <= *frame_time_)) return;
  frame_time_ = time;
  constexpr std::size_t remembered = 10;
  arrival_ages_.push_back(tick.now - *time);
  if (arrival_ages_.size() > remembered) arrival_ages_.pop_front();
  // A camera that always takes its time is no late camera: the filter works at image time. Only what comes on top while
  // the robot drives counts as age. More than this over what was declared is refused (step_acquiring).
  if (std::holds_alternative<Acquiring>(phase_) && arrival_ages_.size() >= enough_ages) {
    const auto measured = *std::min_element(arrival_ages_.begin(), arrival_ages_.end());
    if (measured <= config_.gate.declared_latency + config_.gate.hold_age) {
      declared_latency_ = std::max(declared_latency_, measured);
    }
  }

  if (board != nullptr) {
    result.sighting = filter_.update(*board);
    const SightingUse use = result.sighting->use;
    if (use != SightingUse::invalid && use != SightingUse::too_old && use != SightingUse::rejected) {
      sighting_time_ = board->time;
    }
    if (stands(phase_))
      slip_.reset();
    else if (auto sentence = slip_.take(*result.sighting, std::abs(travelled_))) {
      if (board->tags.size() == 1)
        *sentence += "; or the flat tag's mirrored pose was taken for its own: use a board with turned tags";
      slipped_ = Reason{Cause::slipped, *std::move(sentence)};
    }
    const bool fused = use == SightingUse::fused || use == SightingUse::fused_without_yaw;
    if (const auto T_odom_base = filter_.T_odom_base(board->time);
        T_odom_base && fused && std::holds_alternative<Fixing>(phase_))
      rest_ = rest_sighting(*result.sighting->sighting, *board, *T_odom_base);
    if (use == SightingUse::lost) {
      result.events.push_back({tick.now, "sightings do not fit the estimate any more; it is dropped"});
    }
  }

  // Notes on docking, 9: the board in fewer than 30 % of the frames over 5 s, where it should be in view.
  constexpr std::size_t frames = 100;
  constexpr std::ptrdiff_t few = 30;
  const Acquiring* acquiring = std::get_if<Acquiring>(&phase_);
  const bool expected = std::holds_alternative<Servoing>(phase_) || std::holds_alternative<Fixing>(phase_) ||
                        (acquiring != nullptr && acquiring->stage == Acquiring::Stage::standing);
  if (!expected) return;
  seen_lately_.push_back(board != nullptr);
  if (seen_lately_.size() > frames) seen_lately_.pop_front();
  if (!tags_dirty_told_ && sighting_time_ && seen_lately_.size() == frames &&
      std::count(seen_lately_.begin(), seen_lately_.end(), true) < few) {
    tags_dirty_told_ = true;
    result.events.push_back({tick.now, "the board is found in fewer than 30 % of the frames; are tags or lens dirty?"});
  }
}

Inputs Docker::inputs_of(const Tick& tick, const TickResult& result) const {
  Inputs inputs;
  inputs.now = tick.now;
  // A late cycle counts for a tenth of a second at most, as in the gate.
  constexpr std::chrono::nanoseconds nominal = std::chrono::milliseconds(20);
  constexpr std::chrono::nanoseconds longest = std::chrono::milliseconds(100);
  inputs.step = last_tick_ ? std::clamp(tick.now - *last_tick_, std::chrono::nanoseconds(1), longest) : nominal;
  inputs.odometry = *odometry_;
  inputs.estimate = result.estimate;
  if (sighting_time_) {
    if (const std::optional<Eigen::Isometry3d> seen = filter_.predicted_view(tick.now)) {
      inputs.view = marker_view(config_.rig.T_base_camera, *seen);
    }
    inputs.sighting_age = tick.now - *sighting_time_;
  }
  inputs.sighting = result.sighting;
  inputs.rest = rest_;
  if (tick.sighting && std::holds_alternative<Unseen>(*tick.sighting)) inputs.unseen = std::get<Unseen>(*tick.sighting);
  if (frame_time_) inputs.frame_age = tick.now - *frame_time_;
  inputs.declared_latency = declared_latency_;
  if (arrival_ages_.size() >= enough_ages) {
    inputs.latency = *std::min_element(arrival_ages_.begin(), arrival_ages_.end());
  }
  inputs.camera_sentence = tick.camera_sentence;
  inputs.request = tick.request;
  inputs.last_command = gate_.last();
  return inputs;
}

void Docker::enter(Phase next, const std::string& reason, std::chrono::nanoseconds now, TickResult& result) {
  const std::string change = std::string(name(phase_)) + " -> " + std::string(name(next));
  result.events.push_back({now, reason.empty() ? change : change + "  " + reason});
  result.phase_changed = true;
  phase_ = std::move(next);
}

TickResult Docker::tick(const Tick& tick) {
  TickResult result;
  result.next_tick = config_.segments.nominal_period;
  if (!started_) {
    started_ = tick.now;
    phase_ = first_phase(config_.errand, tick.now);
  }

  const std::optional<Reason> fault = take_odometry(tick);
  if (fault && !is_over(phase_)) {
    enter(Stopped{job_of(phase_), *fault}, fault->sentence, tick.now, result);
    gate_.latch(*fault);
  }
  take_sighting(tick, result);
  if (slipped_ && !is_over(phase_)) {
    enter(Stopped{job_of(phase_), *slipped_}, slipped_->sentence, tick.now, result);
    gate_.latch(*slipped_);
  }
  result.estimate = filter_.estimate(tick.now);

  Twist2 wanted;
  if (odometry_ && !is_over(phase_)) {
    Step next = step(phase_, inputs_of(tick, result), config_);
    if (name(next.next) != name(phase_)) {
      enter(std::move(next.next), next.reason, tick.now, result);
    } else {
      phase_ = std::move(next.next);
    }
    wanted = next.command;
    if (const Stopped* stopped = std::get_if<Stopped>(&phase_)) gate_.latch(stopped->reason);
  } else if (tick.request == Request::stop && !is_over(phase_)) {
    const Reason reason{Cause::stopped_by_person, "stopped by the operator or the guard"};
    enter(Stopped{job_of(phase_), reason}, reason.sentence, tick.now, result);
    gate_.latch(reason);
  }

  GateInputs gate;
  gate.now = tick.now;
  if (odometry_) {
    gate.odometry_time = odometry_->time;
    gate.wheel_speed = odometry_->velocity.linear;
  }
  gate.frame_time = frame_time_;
  gate.sighting_time = sighting_time_;
  gate.need = frame_need(phase_);
  gate.declared_latency = declared_latency_;
  const GateResult passed = gate_.pass(wanted, gate);
  result.command = passed.command;
  result.gate = passed.action;
  result.gate_reason = passed.why;
  if (passed.fault && !is_over(phase_)) {
    enter(Stopped{job_of(phase_), *passed.fault}, passed.fault->sentence, tick.now, result);
  }
  // One line when motion that was wanted is held, one when it goes on.
  const bool moving = wanted != Twist2{};
  const std::string_view held = passed.action == GateAction::held && moving ? passed.why : std::string_view{};
  if (moving && held != held_told_ && !is_over(phase_)) {
    result.events.push_back({tick.now, held.empty() ? std::string("goes on") : "held: " + std::string(held)});
    held_told_ = held;
  }

  if (const Following* following = std::get_if<Following>(&phase_)) {
    result.next_tick =
        control_period(travel_time(length(following->path), config_.segments), config_.segments.nominal_period);
  }
  result.over = is_over(phase_);
  last_tick_ = tick.now;
  return result;
}

}  // namespace tagdock
