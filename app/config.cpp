#include "app/config.h"

#include <algorithm>
#include <chrono>
#include <stdexcept>

#include <Eigen/LU>

#include "app/failure.h"
#include "app/fields.h"
#include "app/rig_file.h"
#include "app/sensor_error_file.h"
#include "app/taught_fields.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;

void milliseconds(Fields& fields, std::string_view key, nanoseconds& value, double least, double most) {
  double number = static_cast<double>(value.count()) / 1e6;
  const double before = number;
  fields.number(key, number, least, most);
  if (number != before) value = nanoseconds(static_cast<std::int64_t>(std::llround(number * 1e6)));
}

void seconds(Fields& fields, std::string_view key, nanoseconds& value, double least, double most) {
  double number = static_cast<double>(value.count()) / 1e9;
  const double before = number;
  fields.number(key, number, least, most);
  if (number != before) value = nanoseconds(static_cast<std::int64_t>(std::llround(number * 1e9)));
}

void visit(Fields& fields, CameraConfig& camera) {
  fields.word("source", camera.source, {});
  fields.number("exposure_us", camera.exposure_us, 10.0, 100000.0);
  fields.number("gain", camera.gain, 0.0, 48.0);
  fields.number("frame_rate", camera.frame_rate, 1.0, 200.0);
  fields.integer("receive_buffer_bytes", camera.receive_buffer, 65536, 1 << 30);
  fields.flag("auto_exposure", camera.auto_exposure);
  fields.word("pixel_format", camera.pixel_format,
              {"Mono8", "Mono10", "Mono10Packed", "Mono12", "Mono12Packed", "Mono16"});
  fields.flag("ptp", camera.ptp);
  fields.flag("chunks", camera.chunks);
  fields.number("latency_ms", camera.latency_ms, 0.0, 1000.0);
}

void visit(Fields& fields, Ros2Config& ros2) {
  fields.integer("domain", ros2.domain, -1, 101);
  fields.word("namespace", ros2.name_space, {});
  fields.word("interface", ros2.interface, {});
  fields.word("peers", ros2.peers, {});
  fields.word("cmd_vel_type", ros2.cmd_vel_type, {"auto", "Twist", "TwistStamped"});
  fields.number("wait_s", ros2.wait_s, 0.1, 600.0);
  fields.group("frames", [&](Fields& inner) {
    inner.word("odom", ros2.odom_frame, {});
    inner.word("base", ros2.base_frame, {});
    inner.word("camera", ros2.camera_frame, {});
  });
  fields.group("topics", [&](Fields& inner) {
    Ros2Topics& topics = ros2.topics;
    inner.word("cmd_vel", topics.cmd_vel, {});
    inner.word("odom", topics.odom, {});
    inner.word("obstacle_stop", topics.obstacle_stop, {});
    inner.word("obstacle_slow", topics.obstacle_slow, {});
    inner.word("detected_dock_pose", topics.detected_dock_pose, {});
    inner.word("detections", topics.detections, {});
    inner.word("docking_path", topics.path, {});
    inner.word("docking_status", topics.status, {});
    inner.word("diagnostics", topics.diagnostics, {});
    inner.word("ground_truth", topics.ground_truth, {});
  });
}

void visit(Fields& fields, TagLocatorConfig& locator) {
  std::string method(word(locator.method));
  fields.word("method", method, {"apriltag", "tanh", "filter", "erf", "best"});
  locator.method = *corner_method(method);
  fields.flag("joint", locator.joint);
  fields.integer("decimate", locator.detector.decimate, 1, 8);
  fields.integer("max_hamming", locator.detector.max_hamming, 0, 2);
  fields.number("border_px", locator.detector.border_px, 0.0, 100.0);
  fields.number("region_margin", locator.region_margin, 0.05, 5.0);
  fields.number("sigma_roll_deg", locator.sigma_roll_deg, 0.001, 45.0);
  fields.number("sigma_pitch_deg", locator.sigma_pitch_deg, 0.001, 45.0);
  fields.number("sigma_height_mm", locator.sigma_height_mm, 0.01, 10000.0);
}

// Standard deviations, and what is common to them.
void visit_covariance(Fields& fields, Eigen::Matrix3d& covariance) {
  const Eigen::Vector3d before = covariance.diagonal().cwiseSqrt();
  Eigen::Vector3d sigma = before;
  fields.number("sigma_x_m", sigma.x(), 0.0, 1.0);
  fields.number("sigma_y_m", sigma.y(), 0.0, 1.0);
  fields.degrees("sigma_yaw_deg", sigma.z(), 0.0, 45.0);
  const auto common = [&](int i, int j) {
    return before(i) > 0.0 && before(j) > 0.0 ? covariance(i, j) / (before(i) * before(j)) : 0.0;
  };
  std::vector<double> correlation = {common(0, 1), common(0, 2), common(1, 2)};
  const std::vector<double> correlation_before = correlation;
  fields.numbers("correlation", correlation, 3, 3);
  if (sigma == before && correlation == correlation_before) return;
  Eigen::Matrix3d shape = Eigen::Matrix3d::Identity();
  shape(0, 1) = shape(1, 0) = correlation[0];
  shape(0, 2) = shape(2, 0) = correlation[1];
  shape(1, 2) = shape(2, 1) = correlation[2];
  fields.require(shape.determinant() >= 0.0 && *std::max_element(correlation.begin(), correlation.end()) <= 1.0 &&
                     *std::min_element(correlation.begin(), correlation.end()) >= -1.0,
                 "correlation",
                 "of x with y, x with yaw and y with yaw must each be between -1 and 1 and fit together");
  covariance = sigma.asDiagonal() * shape * sigma.asDiagonal();
}

void visit(Fields& fields, DockingConfig& docking) {
  fields.group("dock_pose", [&](Fields& inner) {
    inner.number("x_m", docking.dock_pose.x, -20.0, 0.0);
    inner.number("y_m", docking.dock_pose.y, -20.0, 20.0);
    inner.degrees("yaw_deg", docking.dock_pose.yaw, -180.0, 180.0);
  });
  std::string errand = docking.errand == Errand::dock ? "dock" : "undock";
  fields.word("errand", errand, {"dock", "undock"});
  docking.errand = errand == "dock" ? Errand::dock : Errand::undock;
  fields.group("taught", [&](Fields& inner) {
    visit_taught(inner, docking.dock_pose_taught, docking.dock_pose_covariance, docking.taught_hang);
    inner.number("most_height_change_m", docking.hang_limits.height, 0.0, 1.0);
    inner.degrees("most_tilt_change_deg", docking.hang_limits.tilt, 0.0, 45.0);
  });
  fields.number("board_width_m", docking.board_width, 0.02, 5.0);
  fields.group("filter", [&](Fields& inner) {
    PoseFilterConfig& filter = docking.filter;
    inner.number("forward_noise", filter.forward_noise, 1e-5, 1.0);
    inner.number("sideways_noise", filter.sideways_noise, 1e-5, 1.0);
    inner.number("yaw_noise", filter.yaw_noise, 1e-5, 1.0);
    inner.number("castor_scrub", filter.castors.scrub, 0.0, 2.0);
    inner.number("castor_scrub_sigma", filter.castors.scrub_sigma, 0.0, 2.0);
    inner.number("castor_scrub_wander", filter.castors.scrub_wander, 0.0, 2.0);
    inner.number("turn_noise", filter.turn_noise, 0.0, 1.0);
    inner.number("pull_sigma", filter.pull_sigma, 0.0, 1.0);
    inner.number("stretch_sigma", filter.stretch_sigma, 0.0, 1.0);
    inner.degrees("camera_yaw_sigma_deg", filter.camera_yaw_sigma, 0.0, 10.0);
    inner.number("gate", filter.gate, 1.0, 1e6);
    inner.number("corner_bias_px", filter.corner_bias_px, 0.0, 5.0);
  });
  fields.group("limits", [&](Fields& inner) {
    CommandGateConfig& gate = docking.gate;
    inner.number("max_speed", gate.max_speed, 0.01, 0.3);
    inner.degrees("max_turn_rate_deg", gate.max_turn_rate, 1.0, 90.0);
    inner.number("acceleration", gate.acceleration, 0.01, 3.0);
    inner.degrees("turn_acceleration_deg", gate.turn_acceleration, 1.0, 1000.0);
    milliseconds(inner, "odometry_age_ms", gate.odometry.max_age, 10.0, 1000.0);
    milliseconds(inner, "robot_silence_ms", gate.odometry.max_silence, 20.0, 2000.0);
    milliseconds(inner, "half_speed_age_ms", gate.half_speed_age, 10.0, 2000.0);
    milliseconds(inner, "hold_age_ms", gate.hold_age, 10.0, 2000.0);
    seconds(inner, "back_off_age_s", gate.back_off_age, 0.1, 60.0);
    seconds(inner, "give_up_age_s", gate.give_up_age, 0.1, 60.0);
  });
  fields.group("segments", [&](Fields& inner) {
    OdometryControllerConfig& segments = docking.segments;
    inner.number("damping", segments.damping, 0.001, 1.0);
    milliseconds(inner, "period_ms", segments.nominal_period, 5.0, 200.0);
    inner.number("max_speed", segments.max_speed, 0.01, 0.3);
    inner.number("acceleration", segments.acceleration, 0.01, 3.0);
    inner.number("deceleration", segments.deceleration, 0.01, 3.0);
    inner.flag("fuse_sightings", docking.fuse_in_segments);
    inner.number("fused_damping", docking.fused_damping, 0.001, 1.0);
  });
  fields.group("servo", [&](Fields& inner) {
    std::string law = docking.servo.law == ServoLaw::line ? "line" : "centering";
    inner.word("law", law, {"line", "centering"});
    docking.servo.law = law == "line" ? ServoLaw::line : ServoLaw::centering;
    inner.number("length_m", docking.line.length, 0.1, 5.0);
    inner.number("lengths_per_lag", docking.lengths_per_lag, 0.0, 10.0);
    inner.number("max_speed", docking.line.max_speed, 0.01, 0.3);
    inner.number("braking", docking.line.braking, 0.005, 3.0);
    inner.number("end_speed", docking.line.end_speed, 0.001, 0.3);
    inner.number("speed_per_distance", docking.line.speed_per_distance, 0.05, 20.0);
    inner.number("response_time_s", docking.line.response_time, 0.0, 2.0);
    inner.number("gain", docking.centering.gain, 0.01, 10.0);
    inner.number("turn_gain", docking.centering.turn_gain, 0.01, 10.0);
    inner.number("max_sigma_y_m", docking.servo.max_sigma_y, 1e-4, 1.0);
    seconds(inner, "timeout_s", docking.servo.timeout, 1.0, 600.0);
  });
  fields.group("run_in", [&](Fields& inner) {
    inner.number("wanted_m", docking.entry.run_in, 0.0, 10.0);
    inner.number("least_m", docking.entry.min_run_in, 0.0, 10.0);
    inner.number("castors_m", docking.run_in.distance, 0.0, 10.0);
  });
  fields.group("acquire", [&](Fields& inner) {
    inner.integer("sightings", docking.acquire.sightings, 1, 1000);
    inner.number("max_sigma_y_m", docking.acquire.max_sigma_y, 1e-4, 1.0);
    inner.degrees("max_sigma_yaw_deg", docking.acquire.max_sigma_yaw, 0.001, 45.0);
    seconds(inner, "timeout_s", docking.acquire.timeout, 1.0, 600.0);
  });
  fields.group("tolerance", [&](Fields& inner) {
    inner.number("x_m", docking.fix.tolerance_x, 1e-4, 1.0);
    inner.number("y_m", docking.fix.tolerance_y, 1e-4, 1.0);
    inner.degrees("yaw_deg", docking.fix.tolerance_yaw, 0.01, 45.0);
    inner.integer("sightings", docking.fix.sightings, 1, 1000);
  });
  fields.group("fix", [&](Fields& inner) {
    std::string method = docking.fix.method == FixMethod::smoothed ? "smoothed" : "average";
    inner.word("method", method, {"smoothed", "average"});
    docking.fix.method = method == "smoothed" ? FixMethod::smoothed : FixMethod::average;
    inner.number("lasting_corner_px", docking.fix.smoother.lasting_px, 0.001, 10.0);
    inner.number("untaught_corner_px", docking.fix.untaught_corner_px, 0.0, 1.0);
  });
  fields.group("slip", [&](Fields& inner) {
    inner.degrees("yaw_deg", docking.slip.yaw, 0.1, 90.0);
    inner.number("yaw_way_m", docking.slip.yaw_way, 0.02, 5.0);
    inner.number("place_m", docking.slip.place, 0.001, 1.0);
    inner.number("place_way_m", docking.slip.place_way, 0.02, 5.0);
    inner.number("castor_times", docking.slip.castor_times, 0.0, 100.0);
  });
  fields.group("retry", [&](Fields& inner) {
    inner.integer("retries", docking.back_off.retries, 0, 10);
    inner.number("camera_distance_m", docking.back_off.camera_distance, 0.3, 10.0);
    inner.flag("safe_pose", docking.back_off.safe_pose);
  });
  fields.group("undock",
               [&](Fields& inner) { inner.number("camera_distance_m", docking.undock.camera_distance, 0.3, 10.0); });
}

void visit(Fields& fields, Config& config) {
  int version = 1;
  fields.integer("version", version, 1, 1);
  fields.group("camera", [&](Fields& inner) { visit(inner, config.camera); });
  fields.word("robot", config.robot, {"sim", "ros2", "none"});
  fields.group("ros2", [&](Fields& inner) { visit(inner, config.ros2); });
  fields.group("rig", [&](Fields& inner) { visit(inner, config.rig); });
  fields.group("board", [&](Fields& inner) { visit(inner, config.board); });
  fields.group("detection", [&](Fields& inner) {
    visit(inner, config.locator);
    inner.word("sensor_errors", config.sensor_errors, {});
  });
  fields.group("docking", [&](Fields& inner) { visit(inner, config.docking); });
  fields.group("simulation", [&](Fields& inner) {
    inner.word("scenario", config.simulation.scenario, {});
    inner.group("taught_at", [&](Fields& at) {
      at.flag("known", config.simulation.taught_at_known);
      at.number("x_m", config.simulation.taught_at.x, -20.0, 20.0);
      at.number("y_m", config.simulation.taught_at.y, -20.0, 20.0);
      at.degrees("yaw_deg", config.simulation.taught_at.yaw, -180.0, 180.0);
    });
    inner.group("faults", [&](Fields& faults) {
      faults.number("camera_dies_at_s", config.simulation.faults.camera_dies_at_s, 0.0, 1e6);
      faults.number("odometry_nan_at_s", config.simulation.faults.odometry_nan_at_s, 0.0, 1e6);
      faults.flag("no_board", config.simulation.faults.no_board);
    });
  });
}

}  // namespace

void visit_taught(Fields& fields, bool& measured, Eigen::Matrix3d& covariance, std::optional<BoardHang>& hang) {
  fields.flag("measured", measured);
  visit_covariance(fields, covariance);
  fields.require(measured == (covariance.diagonal().minCoeff() > 0.0), "measured",
                 "goes with sigma_x_m, sigma_y_m and sigma_yaw_deg above 0, and those with measured: true; "
                 "`tagdock teach` writes them together");
  bool hangs = hang.has_value();
  fields.flag("board_checked", hangs);
  fields.require(!hangs || measured, "board_checked", "needs measured: true: it is part of teaching");
  BoardHang taught = hang.value_or(BoardHang{});
  fields.number("camera_height_m", taught.camera_height, -10.0, 10.0);
  fields.degrees("roll_deg", taught.roll, -45.0, 45.0);
  fields.degrees("pitch_deg", taught.pitch, -45.0, 45.0);
  fields.require(!hangs || taught.camera_height != 0.0, "board_checked",
                 "needs camera_height_m, roll_deg and pitch_deg as they were seen; `tagdock teach` writes them");
  if (hangs)
    hang = taught;
  else
    hang.reset();
}

Config read_config(YamlMap map) {
  Config config;
  FieldReader reader(map);
  visit(reader, config);
  map.finish();
  config.locator.detector.family = config.board.family;
  config.docking.rig = config.rig;
  config.docking.board = config.board;
  config.docking.filter.sensor =
      sensor_errors_of(config.sensor_errors, config.rig, config.board, map.file() + ": detection.sensor_errors");
  config.docking.gate.declared_latency =
      nanoseconds(static_cast<std::int64_t>(std::llround(config.camera.latency_ms * 1e6)));
  try {
    check(config.rig.camera);
    check(config.docking);
  } catch (const std::invalid_argument& error) {
    throw Failure(ExitCode::usage, map.file() + ": " + error.what());
  }
  return config;
}

Config read_config(const std::filesystem::path& file) { return read_config(YamlMap::load(file)); }

Config parse_config(const std::string& text, const std::string& name) {
  return read_config(YamlMap::parse(text, name));
}

std::string to_yaml(const Config& config) {
  FieldWriter writer;
  Config copy = config;
  visit(writer, copy);
  return writer.text();
}

}  // namespace tagdock
