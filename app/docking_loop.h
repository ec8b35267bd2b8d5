#pragma once

#include <chrono>
#include <optional>
#include <string>
#include <vector>

#include "app/config.h"
#include "app/session.h"
#include "detection/tag_locator.h"
#include "servo/docker.h"

namespace tagdock {

enum class CameraState { streaming, lost };

/// One cycle of the way of a frame (HOUSE.md): frame -> locator -> pose filter -> docking::step -> gate.
/// Live, simulated and replayed dockings are this object fed from different places; the same inputs give the same
/// outputs to the last bit.
class DockingLoop {
 public:
  explicit DockingLoop(const Config& config);

  struct Inputs {
    std::chrono::nanoseconds now{0};
    std::vector<Odometry> odometry;  ///< since the last cycle, oldest first
    std::optional<Frame> frame;      ///< the newest, if there is a new one
    CameraState camera = CameraState::streaming;
    std::string camera_sentence;  ///< why it is lost
    bool robot_linked = true;
    std::string robot_sentence;  ///< why it is not
    Request request = Request::none;
  };
  struct Outputs {
    std::optional<Sighting> sighting;
    TickResult docking;
    /// What a session records of this cycle, without the ends of lines.
    std::vector<std::string> odometry_lines;
    std::optional<std::string> sighting_line;
    std::string command_line;
    std::optional<std::string> phase_line;
  };
  Outputs cycle(const Inputs& inputs);

  [[nodiscard]] const Docker& docker() const { return docker_; }

 private:
  TagLocator locator_;
  Docker docker_;
};

/// The inputs of a recorded cycle.
/// @param odometry  the readings that it used
DockingLoop::Inputs inputs_of(const TickRecord& tick, std::vector<Odometry> odometry, std::optional<Frame> frame);

/// Text made fit for one field of a CSV line: commas become semicolons, ends of lines spaces.
std::string one_field(std::string text);

/// A sighting as a line of sightings.csv.
std::string sighting_line(const Frame& frame, const Sighting& sighting);

}  // namespace tagdock
