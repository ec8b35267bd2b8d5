#pragma once

#include <chrono>
#include <cstdint>
#include <vector>

namespace tagdock {

struct ClockMapConfig {
  std::chrono::nanoseconds window = std::chrono::seconds(10);  ///< how long an arrival counts
  /// Drift is only read off a window at least this long; before, the smallest delay alone counts.
  std::chrono::nanoseconds drift_after = std::chrono::seconds(5);
  double largest_drift = 200e-6;  ///< crystals are within 100 ppm, host and camera add up; more is noise
  /// An arrival further off than this is another clock, not a late packet. Measured on a loaded machine, 7170 frames:
  /// the latest came 50 ms late.
  std::chrono::nanoseconds jump = std::chrono::milliseconds(50);
  int late_frames_for_jump = 3;  ///< a single late arrival may be a stall of the host, this many in a row are a jump
};

/// Camera time -> host time, learnt from arrivals alone.
/// A frame arrives at its camera time, plus the offset of the two clocks, plus a delay that is never negative and now
/// and then small. So the line of the clocks lies below all points (camera time, host minus camera time) and touches
/// them: it is the edge of their lower convex hull over the mean camera time.
/// After Moon, Skelly and Towsley, "Estimation and removal of clock skew from network delay measurements", INFOCOM
/// 1999. The smallest delay itself cannot be seen; who knows it subtracts it.
class ClockMap {
 public:
  explicit ClockMap(const ClockMapConfig& config = {});

  /// Takes in one arrival.
  /// @return the host time at which the frame would have arrived with the smallest delay
  std::chrono::nanoseconds arrived(std::chrono::nanoseconds camera_time, std::chrono::nanoseconds host_time);

  /// Host seconds gained per camera second, less one.
  [[nodiscard]] double drift() const { return drift_; }
  /// How often the camera's clock was set anew.
  [[nodiscard]] std::uint64_t jumps() const { return jumps_; }

 private:
  struct Arrival {
    std::chrono::nanoseconds camera_time;
    std::chrono::nanoseconds offset;  ///< host minus camera time
  };

  void restart(const Arrival& first);
  void fit();
  [[nodiscard]] std::chrono::nanoseconds offset_at(std::chrono::nanoseconds camera_time) const;

  ClockMapConfig config_;
  std::vector<Arrival> arrivals_;  ///< by camera time
  std::vector<Arrival> late_;      ///< too late for the present line, perhaps the beginning of a new one
  Arrival anchor_{};               ///< a point of the line
  double drift_ = 0.0;
  std::uint64_t jumps_ = 0;
};

}  // namespace tagdock
