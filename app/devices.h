#pragma once

#include <chrono>
#include <cstdint>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "app/camera.h"
#include "app/config.h"
#include "app/docking_loop.h"
#include "planning/pose2.h"
#include "servo/robot.h"

namespace tagdock {

/// The time of a session. Live it is the machine's steady clock; a simulation without a network makes its own.
class SessionClock {
 public:
  virtual ~SessionClock() = default;
  [[nodiscard]] virtual std::chrono::nanoseconds now() const = 0;
  virtual void sleep_until(std::chrono::nanoseconds time) = 0;
};

/// What a docking is connected to.
struct Devices {
  std::unique_ptr<SessionClock> clock;
  std::unique_ptr<Camera> camera;
  std::unique_ptr<Robot> robot;
  /// Simulated only: camera point and heading in the station frame, for the report and never for the docking.
  std::function<Pose2()> true_camera_point;
  /// Simulated only: the same against a docking pose, at the station as it stands now (World::docking_error).
  std::function<Pose2(const Pose2&)> true_docking_error;
  std::string camera_name;         ///< for people: what was opened
  std::string robot_name;          ///< the same
  std::vector<std::string> notes;  ///< sentences for a person: what the camera does differently from what was asked
  /// Tells others what the docking does, after every cycle; empty where nobody listens.
  std::function<void(const DockingLoop::Inputs&, const DockingLoop::Outputs&, const Docker&, const CameraHealth&)>
      tell_others;
  /// The camera model that belongs to the frames as they come: the rig's, or a part of it or a coarser one where the
  /// receive buffer did not allow whole frames.
  CameraModel camera_model;
  int binning = 1;  ///< sensor pixels a frame's pixel is averaged from, in each direction
};

struct DeviceOptions {
  std::uint64_t seed = 1;
  /// Simulation only: frames come in-process and time runs this many times faster than real; 0 as fast as it can.
  /// Without it the simulation runs in real time and its frames come over GigE Vision on loopback.
  std::optional<double> speedup;
  /// A GigE camera sends its whole sensor, whatever camera the rig describes; the rig's camera model stays as it is.
  bool whole_sensor = false;
  /// A simulated world as it is before somebody moves the dock, knocks the camera or breaks anything: for teaching.
  bool untouched = false;
};

/// Opens what the configuration asks for.
/// Throws Failure: usage for words that mean nothing, camera when nobody answers, robot_link.
Devices open_devices(const Config& config, const DeviceOptions& options);

}  // namespace tagdock
