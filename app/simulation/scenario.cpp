#include "app/simulation/scenario.h"

#include <map>

#include "app/yaml_file.h"

namespace tagdock {
namespace {

/// What a number of the file is given in.
enum class Unit { si, degrees, thousandths };

double to_si(double value, Unit unit) {
  if (unit == Unit::degrees) return radians(value);
  return unit == Unit::thousandths ? value / 1000.0 : value;
}

/// One number of the file: where it goes, and what the file may say in which unit.
struct Key {
  const char* section;
  const char* name;
  double* value;
  double least, most;
  Unit unit = Unit::si;
};

std::vector<Key> keys_of(Scenario& scenario) {
  constexpr Unit degree = Unit::degrees;
  constexpr Unit ms = Unit::thousandths;
  constexpr Unit mm = Unit::thousandths;
  StartScenario& start = scenario.start;
  DriveScenario& drive = scenario.drive;
  CameraScenario& camera = scenario.camera;
  Sensor& sensor = camera.sensor;
  ChassisScenario& chassis = scenario.chassis;
  ResidualScenario& residuals = scenario.residuals;
  StationScenario& station = scenario.station;
  FaultScenario& faults = scenario.faults;
  return {
      {"start", "range", &start.range, 0.5, 8.0},
      {"start", "range_sigma", &start.range_sigma, 0.0, 0.5},
      {"start", "bearing_deg", &start.bearing, -60.0, 60.0, degree},
      {"start", "bearing_sigma_deg", &start.bearing_sigma, 0.0, 10.0, degree},
      {"start", "bearing_spread_deg", &start.bearing_spread, 0.0, 45.0, degree},
      {"start", "heading_deg", &start.heading, -90.0, 90.0, degree},
      {"start", "heading_sigma_deg", &start.heading_sigma, 0.0, 10.0, degree},
      {"start", "heading_spread_deg", &start.heading_spread, 0.0, 45.0, degree},
      {"start", "castor_angle", &start.castor_angle, -3.15, 3.15},
      {"start", "castor_sigma", &start.castor_sigma, 0.0, 3.15},

      {"drive", "dead_time", &drive.dead_time, 0.0, 1.0},
      {"drive", "lag", &drive.lag, 0.005, 2.0},
      {"drive", "acceleration", &drive.acceleration, 0.01, 5.0},
      {"drive", "angular_acceleration", &drive.angular_acceleration, 0.01, 20.0},
      {"drive", "command_timeout", &drive.command_timeout, 0.02, 1.0},
      {"drive", "stop_deceleration", &drive.stop_deceleration, 0.05, 10.0},
      {"drive", "dead_band", &drive.dead_band, 0.0, 0.1},
      {"drive", "mass", &drive.mass, 1.0, 1e5},
      {"drive", "drive_load_share", &drive.drive_load_share, 0.05, 1.0},
      {"drive", "track", &drive.track, 0.05, 5.0},
      {"drive", "castor_ahead", &drive.castor_ahead, 0.0, 5.0},
      {"drive", "castor_aside", &drive.castor_aside, 0.0, 5.0},
      {"drive", "castor_trail", &drive.castor_trail, 0.005, 0.5},
      {"drive", "scrub_radius", &drive.scrub_radius, 0.0, 0.5},
      {"drive", "scrub_factor", &drive.scrub_factor, 0.0, 10.0},
      {"drive", "friction", &drive.friction, 0.0, 2.0},
      {"drive", "friction_cap", &drive.friction_cap, 0.0, 3.0},
      {"drive", "creepage", &drive.creepage, 0.01, 1000.0},
      {"drive", "creep_stiffness", &drive.creep_stiffness, 0.1, 1000.0},
      {"drive", "over_turn", &drive.over_turn, -0.2, 0.2},
      {"drive", "over_turn_field_sigma", &drive.over_turn_field_sigma, 0.0, 0.2},
      {"drive", "field_length", &drive.field_length, 0.01, 100.0},
      {"drive", "over_turn_exponent", &drive.over_turn_exponent, 0.0, 5.0},
      {"drive", "floor_coupling", &drive.floor_coupling, -1.0, 1.0},
      {"drive", "friction_run_sigma", &drive.friction_run_sigma, 0.0, 2.0},
      {"drive", "friction_castor_sigma", &drive.friction_castor_sigma, 0.0, 2.0},
      {"drive", "friction_field_sigma", &drive.friction_field_sigma, 0.0, 2.0},
      {"drive", "turn_scale_sigma", &drive.turn_scale_sigma, 0.0, 0.1},
      {"drive", "speed_scale_sigma", &drive.speed_scale_sigma, 0.0, 0.1},
      {"drive", "wheel_difference_sigma", &drive.wheel_difference_sigma, 0.0, 0.1},
      {"drive", "yaw_walk", &drive.yaw_walk, 0.0, 0.1},
      {"drive", "left_radius_error", &drive.left_radius_error, -0.1, 0.1},
      {"drive", "right_radius_error", &drive.right_radius_error, -0.1, 0.1},
      {"drive", "patch_length", &drive.patch_length, 0.0, 10.0},
      {"drive", "patch_period", &drive.patch_period, 0.05, 20.0},
      {"drive", "patch_friction", &drive.patch_friction, 0.0, 10.0},
      {"drive", "patch_over_turn", &drive.patch_over_turn, -0.5, 0.5},
      {"drive", "slick_from", &drive.slick_from, 0.0, 10.0},
      {"drive", "slick_to", &drive.slick_to, 0.0, 10.0},
      {"drive", "slick_slip", &drive.slick_slip, 0.0, 1.0},

      {"camera", "frame_rate", &camera.frame_rate, 1.0, 200.0},
      {"camera", "exposure_ms", &camera.exposure, 0.01, 100.0, ms},
      {"camera", "latency_ms", &camera.latency, 0.0, 2000.0, ms},
      {"camera", "latency_jitter_ms", &camera.latency_jitter, 0.0, 500.0, ms},
      {"camera", "loss", &camera.loss, 0.0, 1.0},
      {"camera", "psf_sigma_px", &sensor.psf_sigma_px, 0.25, 3.5},
      {"camera", "levels_per_ms", &sensor.levels_per_ms, 0.01, 1e4},
      {"camera", "black_level", &sensor.black_level, 0.0, 100.0},
      {"camera", "read_noise", &sensor.read_noise, 0.0, 50.0},
      {"camera", "electrons_per_level", &sensor.electrons_per_level, 0.0, 1e4},
      {"camera", "gamma", &sensor.gamma, 0.3, 4.0},
      {"camera", "vignetting", &sensor.vignetting, 0.0, 0.9},

      {"chassis", "pitch_sigma_deg", &chassis.pitch_sigma, 0.0, 5.0, degree},
      {"chassis", "roll_sigma_deg", &chassis.roll_sigma, 0.0, 5.0, degree},
      {"chassis", "height_sigma_mm", &chassis.height_sigma, 0.0, 50.0, mm},

      {"residuals", "camera_place_sigma_mm", &residuals.camera_place_sigma, 0.0, 100.0, mm},
      {"residuals", "camera_angle_sigma_deg", &residuals.camera_angle_sigma, 0.0, 5.0, degree},
      {"residuals", "focal_length_sigma", &residuals.focal_length_sigma, 0.0, 0.05},
      {"residuals", "principal_point_sigma_px", &residuals.principal_point_sigma_px, 0.0, 20.0},
      {"residuals", "tag_place_sigma_mm", &residuals.tag_place_sigma, 0.0, 20.0, mm},
      {"residuals", "tag_angle_sigma_deg", &residuals.tag_angle_sigma, 0.0, 5.0, degree},
      {"residuals", "camera_bump_deg", &residuals.camera_bump, -10.0, 10.0, degree},

      {"station", "moved_x_mm", &station.moved.x, -500.0, 500.0, mm},
      {"station", "moved_y_mm", &station.moved.y, -500.0, 500.0, mm},
      {"station", "moved_yaw_deg", &station.moved.yaw, -30.0, 30.0, degree},
      {"station", "sunk_mm", &station.sunk, -500.0, 500.0, mm},
      {"station", "lean_deg", &station.lean, -30.0, 30.0, degree},
      {"station", "lamp_strength", &station.lamp_strength, 0.0, 1000.0},
      {"station", "ambient", &station.ambient, 0.0, 100.0},
      {"station", "light_change", &station.light_change, 0.0, 100.0},
      {"station", "light_change_range", &station.light_change_range, 0.0, 10.0},

      {"faults", "frames_stop_range", &faults.frames_stop_range, 0.0, 10.0},
      {"faults", "odometry_stops_range", &faults.odometry_stops_range, 0.0, 10.0},
      {"faults", "link_silent_range", &faults.link_silent_range, 0.0, 10.0},
      {"faults", "range_spread", &faults.range_spread, 0.0, 5.0},
  };
}

Dirt read_dirt(YamlMap map) {
  Dirt dirt;
  dirt.tag = static_cast<int>(map.integer("tag", 0, 100000));
  dirt.x = map.number("x", -1.0, 1.0);
  dirt.y = map.number("y", -1.0, 1.0);
  dirt.width = map.number("width", 0.0005, 1.0);
  dirt.height = map.number("height", 0.0005, 1.0);
  dirt.angle = radians(map.number("angle_deg", -180.0, 180.0));
  dirt.reflectance = map.number("reflectance", 0.0, 1.0);
  return dirt;
}

Scenario read_onto(const std::filesystem::path& file, bool may_be_based) {
  YamlMap map = YamlMap::load(file);
  Scenario scenario;
  const std::string name = map.text("name");
  bool based = false;
  if (map.has("based_on")) {
    if (!may_be_based) map.refuse("based_on", "is not allowed in a file that another one is based on");
    const std::filesystem::path base = map.text("based_on");
    if (base.has_parent_path()) map.refuse("based_on", "must be the name of a file beside this one, without a folder");
    scenario = read_onto(file.parent_path() / base, false);
    based = true;
  }
  scenario.name = name;
  std::map<std::string, YamlMap> sections;
  for (const Key& key : keys_of(scenario)) {
    auto section = sections.find(key.section);
    if (section == sections.end()) {
      if (based && !map.has(key.section)) continue;
      section = sections.emplace(key.section, map.map(key.section)).first;
    }
    if (based && !section->second.has(key.name)) continue;
    *key.value = to_si(section->second.number(key.name, key.least, key.most), key.unit);
  }
  if (const auto station = sections.find("station"); station != sections.end())
    if (!based || station->second.has("dirt")) {
      scenario.station.dirt.clear();
      for (const YamlMap& dirt : station->second.maps("dirt")) scenario.station.dirt.push_back(read_dirt(dirt));
    }
  map.finish();
  return scenario;
}

}  // namespace

Scenario read_scenario(const std::filesystem::path& file) { return read_onto(file, true); }

}  // namespace tagdock
