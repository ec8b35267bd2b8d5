#pragma once

#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <memory>
#include <mutex>
#include <string>
#include <thread>

#include "app/simulation/gige_server.h"
#include "app/simulation/shared_world.h"

namespace tagdock {

/// The simulated world in real time, shown by a GigE Vision camera on the loopback device.
/// One thread takes the exposures and renders, a second one puts each frame on the wire when its latency is over, so
/// that frames arrive as late as the scenario says, however long rendering takes.
class LiveWorld {
 public:
  /// @param served  address, serial number and abilities of the camera; its sensor and its rate are the world's
  /// Throws Failure(camera) when the address is taken.
  LiveWorld(std::shared_ptr<SharedWorld> world, const SimulationFaults& faults,
            std::chrono::steady_clock::time_point session_start, const GigeServerSettings& served);
  ~LiveWorld();
  LiveWorld(const LiveWorld&) = delete;
  LiveWorld& operator=(const LiveWorld&) = delete;

  /// The camera, for its faults and its figures.
  [[nodiscard]] GigeServer& server() { return server_; }

 private:
  struct Pending {
    ServedFrame frame;
    std::chrono::nanoseconds due{0};
  };

  void expose();
  void put_on_the_wire();
  [[nodiscard]] std::chrono::nanoseconds now() const;

  std::shared_ptr<SharedWorld> world_;
  SimulationFaults faults_;
  std::chrono::steady_clock::time_point session_start_;
  double first_exposure_us_;
  GigeServer server_;
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<Pending> pending_;
  bool ending_ = false;
  std::thread exposing_;
  std::thread sending_;
};

}  // namespace tagdock
