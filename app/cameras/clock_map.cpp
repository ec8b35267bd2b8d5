#include "app/cameras/clock_map.h"

#include <algorithm>
#include <cmath>

namespace tagdock {

using std::chrono::nanoseconds;

namespace {

double seconds(nanoseconds time) { return std::chrono::duration<double>(time).count(); }

}  // namespace

ClockMap::ClockMap(const ClockMapConfig& config) : config_(config) {}

void ClockMap::restart(const Arrival& first) {
  arrivals_.assign(1, first);
  late_.clear();
  anchor_ = first;
  drift_ = 0.0;
}

nanoseconds ClockMap::offset_at(nanoseconds camera_time) const {
  return anchor_.offset +
         nanoseconds(std::llround(drift_ * static_cast<double>((camera_time - anchor_.camera_time).count())));
}

void ClockMap::fit() {
  const auto smallest = std::min_element(arrivals_.begin(), arrivals_.end(),
                                         [](const Arrival& a, const Arrival& b) { return a.offset < b.offset; });
  anchor_ = *smallest;
  drift_ = 0.0;
  if (arrivals_.back().camera_time - arrivals_.front().camera_time < config_.drift_after) return;

  // Lower convex hull, left to right (Andrew's chain): drop a corner while the next point lies below the line to it.
  const Arrival origin = arrivals_.front();
  std::vector<Arrival> hull;
  double mean_time = 0.0;
  for (const Arrival& arrival : arrivals_) {
    while (hull.size() >= 2) {
      const Arrival& a = hull[hull.size() - 2];
      const Arrival& b = hull.back();
      const double turn = seconds(b.camera_time - a.camera_time) * seconds(arrival.offset - a.offset) -
                          seconds(b.offset - a.offset) * seconds(arrival.camera_time - a.camera_time);
      if (turn > 0.0) break;
      hull.pop_back();
    }
    hull.push_back(arrival);
    mean_time += seconds(arrival.camera_time - origin.camera_time) / static_cast<double>(arrivals_.size());
  }
  for (std::size_t i = 1; i < hull.size(); ++i) {
    if (seconds(hull[i].camera_time - origin.camera_time) < mean_time) continue;
    const double slope =
        seconds(hull[i].offset - hull[i - 1].offset) / seconds(hull[i].camera_time - hull[i - 1].camera_time);
    if (std::abs(slope) > config_.largest_drift) return;  // noise: the smallest delay alone is the safer answer
    anchor_ = hull[i];
    drift_ = slope;
    return;
  }
}

nanoseconds ClockMap::arrived(nanoseconds camera_time, nanoseconds host_time) {
  const Arrival arrival{camera_time, host_time - camera_time};
  if (arrivals_.empty()) {
    restart(arrival);
    return host_time;
  }
  const nanoseconds lateness = arrival.offset - offset_at(camera_time);
  const bool backwards = camera_time <= (late_.empty() ? arrivals_ : late_).back().camera_time;
  if (lateness < -config_.jump || backwards) {
    // No packet arrives before it was sent: the camera's clock was set back or forth, or another camera speaks.
    ++jumps_;
    restart(arrival);
    return host_time;
  }
  if (lateness > config_.jump) {
    late_.push_back(arrival);
    if (static_cast<int>(late_.size()) < config_.late_frames_for_jump) return camera_time + offset_at(camera_time);
    ++jumps_;
    const std::vector<Arrival> recent = late_;
    restart(recent.front());
    arrivals_ = recent;
    fit();
    return camera_time + offset_at(camera_time);
  }
  late_.clear();
  arrivals_.push_back(arrival);
  const auto kept = std::find_if(arrivals_.begin(), arrivals_.end(),
                                 [&](const Arrival& a) { return camera_time - a.camera_time <= config_.window; });
  arrivals_.erase(arrivals_.begin(), kept);
  fit();
  return camera_time + offset_at(camera_time);
}

}  // namespace tagdock
