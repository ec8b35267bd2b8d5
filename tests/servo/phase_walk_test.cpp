#include <map>
#include <random>
#include <set>

#include <catch2/catch.hpp>

#include "servo/docking.h"

using namespace tagdock;

namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

/// Draws what one cycle knows, in moods that last: a robot that stands at the dock, one that sees nothing, ...
class Moods {
 public:
  explicit Moods(unsigned seed) : random_(seed) {}

  [[nodiscard]] bool chance(double probability) { return real(0.0, 1.0) < probability; }
  [[nodiscard]] double real(double low, double high) {
    return std::uniform_real_distribution<double>(low, high)(random_);
  }
  [[nodiscard]] int whole(int low, int high) { return std::uniform_int_distribution<int>(low, high)(random_); }

  void change(const DockingConfig& config) {
    mood_ = {};
    const Pose2 goal = goal_of_axle(config);
    const std::array<Pose2, 6> places = {Pose2{0.0, 0.0, 0.0},  Pose2{-1.2, 0.0, 0.0}, Pose2{-2.5, 0.4, -0.15},
                                         Pose2{-0.3, 0.1, 0.1}, Pose2{0.0, 0.01, 0.0}, Pose2{-3.5, 0.2, -0.05}};
    const Pose2 base = goal * places[static_cast<std::size_t>(whole(0, 5))];
    if (!chance(0.1)) {
      PoseEstimate estimate;
      estimate.T_station_base = base;
      const double sigma = chance(0.15) ? 0.02 : 0.0005;
      estimate.covariance = Eigen::Vector3d(sigma * sigma, sigma * sigma, 0.01 * sigma * sigma).asDiagonal();
      mood_.estimate = estimate;
    }
    if (!chance(0.1)) mood_.view = MarkerView{chance(0.8) ? 0.0 : 0.3, chance(0.3) ? 5.5 : 2.0};
    if (!chance(0.1)) mood_.frame_age = chance(0.9) ? milliseconds(80) : milliseconds(whole(100, 7000));
    if (!chance(0.1)) mood_.sighting_age = chance(0.85) ? milliseconds(80) : milliseconds(whole(100, 7000));
    if (chance(0.03)) mood_.latency = milliseconds(whole(0, 900));
    mood_.declared_latency = milliseconds(80);
    if (!chance(0.2)) {
      FilterUpdate update;
      update.use = chance(0.9) ? SightingUse::fused : SightingUse::ambiguous;
      PlanarSighting sighting;
      sighting.T_station_base = base;
      const double sigma = 0.0005;
      sighting.covariance = Eigen::Vector3d(sigma * sigma, sigma * sigma, sigma * sigma).asDiagonal();
      update.sighting = sighting;
      mood_.sighting = update;
    } else if (chance(0.5)) {
      mood_.unseen = Unseen::other_tags;
    }
    mood_.odometry.velocity = chance(0.75) ? Twist2{} : Twist2{0.1, 0.0};
    swing_ = chance(0.1);
    lasts_ = whole(1, 90);
    hurry_ = chance(0.1);
  }

  Inputs next(const DockingConfig& config) {
    if (lasts_-- <= 0) change(config);
    const std::chrono::nanoseconds step =
        hurry_ ? std::chrono::nanoseconds(milliseconds(whole(100, 9000))) : std::chrono::nanoseconds(milliseconds(20));
    now_ += step;
    Inputs inputs = mood_;
    inputs.now = now_;
    inputs.step = milliseconds(20);
    inputs.odometry.time = now_;
    if (inputs.sighting) inputs.sighting->sighting->time = now_;
    if (inputs.sighting && inputs.sighting->use == SightingUse::fused)
      inputs.rest = RestSighting{*inputs.sighting->sighting, inputs.odometry.T_odom_base, {}};
    if (swing_ && inputs.estimate) inputs.estimate->T_station_base.yaw += (whole(0, 1) == 0 ? 0.05 : -0.05);
    if (chance(0.002))
      inputs.request = std::array{Request::pause, Request::resume, Request::cancel,
                                  Request::stop,  Request::pause,  Request::resume}[static_cast<std::size_t>(
          whole(0, 5))];
    return inputs;
  }

  [[nodiscard]] std::chrono::nanoseconds now() const { return now_; }

 private:
  std::mt19937 random_;
  Inputs mood_;
  int lasts_ = 0;
  bool hurry_ = false;
  bool swing_ = false;
  std::chrono::nanoseconds now_{0};
};

}  // namespace

TEST_CASE("a walk through all that can happen takes the transitions of the table: each of them, and no other") {
  Moods moods(1992);
  DockingConfig config;
  // Paths as short as following allows: what is looked for are the ways between phases, not the driving.
  config.run_in.distance = 0.0004;
  bool refuse = false;
  double length_of_paths = 0.0;
  config.planner = [&](const Pose2& from, const Pose2&) -> std::variant<Path, std::string> {
    if (refuse) return std::string("no room");
    return Path{from, {{length_of_paths, 0.0, 0.0}}};
  };
  std::map<std::pair<std::string, std::string>, int> taken;
  for (int walk = 0; walk < 6000; ++walk) {
    config.errand = moods.chance(0.15) ? Errand::undock : Errand::dock;
    config.back_off.safe_pose = moods.chance(0.3);
    Phase phase = first_phase(config.errand, moods.now());
    refuse = moods.chance(0.3);
    length_of_paths = moods.chance(0.7) ? 0.0004 : 0.3;
    config.back_off.retries = moods.whole(0, 2);
    moods.change(config);
    for (int i = 0; i < 400 && !is_over(phase); ++i) {
      Step next = step(phase, moods.next(config), config);
      if (name(next.next) != name(phase)) {
        ++taken[{std::string(name(phase)), std::string(name(next.next))}];
        CHECK_FALSE(next.reason.empty());
      }
      phase = std::move(next.next);
    }
  }
  for (const auto& [way, times] : taken) {
    CAPTURE(way.first, way.second, times);
    const bool listed = std::any_of(transitions().begin(), transitions().end(), [&](const Transition& row) {
      return (row.from == way.first || row.from == "any") && row.to == way.second;
    });
    CHECK(listed);
  }
  for (const Transition& row : transitions()) {
    CAPTURE(row.from, row.to, row.word);
    std::size_t ways = 0;
    for (const auto& [way, times] : taken)
      if ((row.from == way.first || row.from == "any") && row.to == way.second) ++ways;
    // What is said of any phase is seen from most of the seven that act.
    CHECK(ways >= (row.from == "any" ? 5u : 1u));
  }
}
