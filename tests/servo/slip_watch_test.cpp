#include "servo/slip_watch.h"

#include <catch2/catch.hpp>

using namespace tagdock;
using Catch::Matchers::Contains;

namespace {

FilterUpdate update(SightingUse use, const Pose2& innovation, const Pose2& correction, double castor_turn = 0.0) {
  return {use, std::nullopt, 0.0, innovation, correction, castor_turn};
}

constexpr double settled = 1.0;  // m: the castors trail

// Feeds a slip of so much per metre, of which the filter puts right what it sees at once.
std::optional<double> stopped_after(double yaw_per_m, double y_per_m, double most, double castors_per_m = 0.0) {
  SlipWatch watch{SlipConfig{}};
  constexpr double step = 0.006;  // m between frames
  for (int i = 1; i * step < most; ++i) {
    const Pose2 slipped{0.0, step * y_per_m, step * yaw_per_m};
    if (watch.take(update(SightingUse::fused, slipped, slipped, i * step * castors_per_m), settled + i * step))
      return i * step;
  }
  return std::nullopt;
}

}  // namespace

TEST_CASE("encoders and camera apart by 3 degrees over 0.3 m are a slip, by less they are not") {
  CHECK_FALSE(stopped_after(radians(2.8) / 0.3, 0.0, 3.0));
  const auto way = stopped_after(radians(6.0) / 0.3, 0.0, 3.0);
  REQUIRE(way);
  CHECK(*way < 0.18);  // 3 degrees are reached at 0.15 m; three sightings say so
  CHECK(*way > 0.15);
  CHECK(stopped_after(radians(-6.0) / 0.3, 0.0, 3.0) == way);
}

TEST_CASE("castors that turn round are allowed twice what they are believed to do") {
  CHECK_FALSE(stopped_after(radians(8.5) / 0.3, 0.0, 3.0, radians(3.0) / 0.3));
  CHECK(stopped_after(radians(9.5) / 0.3, 0.0, 3.0, radians(3.0) / 0.3));
}

TEST_CASE("before the castors have settled nothing is judged") {
  SlipWatch watch{SlipConfig{}};
  const Pose2 large{0.0, 0.0, radians(1.0)};
  for (int i = 1; i < 20; ++i) CHECK_FALSE(watch.take(update(SightingUse::fused, large, large), 0.03 * i));
}

TEST_CASE("50 mm aside over 0.2 m are a slip") {
  CHECK_FALSE(stopped_after(0.0, 0.045 / 0.2, 3.0));
  CHECK(stopped_after(0.0, 0.060 / 0.2, 3.0));
}

TEST_CASE("a single wrong sighting is none, three that are rejected in a row are, and the sentence has figures") {
  SlipWatch watch{SlipConfig{}};
  CHECK_FALSE(watch.take(update(SightingUse::fused, {}, {}), settled + 0.1));
  CHECK_FALSE(watch.take(update(SightingUse::rejected, {0.0, 0.0, 0.2}, {}), settled + 0.11));
  CHECK_FALSE(watch.take(update(SightingUse::fused, {}, {}), settled + 0.12));
  CHECK_FALSE(watch.take(update(SightingUse::rejected, {0.0, 0.0, 0.2}, {}), settled + 0.13));
  CHECK_FALSE(watch.take(update(SightingUse::rejected, {0.0, 0.0, 0.2}, {}), settled + 0.14));
  const auto sentence = watch.take(update(SightingUse::rejected, {0.0, 0.0, 0.2}, {}), settled + 0.15);
  REQUIRE(sentence);
  CHECK_THAT(*sentence, Contains("11.5 degrees") && Contains("slip"));
}

TEST_CASE("a sighting that does not know its yaw is no witness of slip, a sure one is") {
  for (const double sigma_yaw : {radians(0.1), radians(4.0)}) {
    SlipWatch watch{SlipConfig{}};
    PlanarSighting sighting;
    sighting.covariance.diagonal() << 1e-6, 1e-6, 0.5 * sigma_yaw * sigma_yaw;
    sighting.bias_covariance(2, 2) = 0.5 * sigma_yaw * sigma_yaw;
    bool stopped = false;
    for (int i = 1; i < 10; ++i) {
      FilterUpdate one = update(SightingUse::rejected, {0.0, 0.0, radians(8.0)}, {});
      one.sighting = sighting;
      stopped = stopped || watch.take(one, settled + 0.006 * i);
    }
    CHECK(stopped == (sigma_yaw < radians(1.0)));
  }
}

TEST_CASE("what was put right before a standstill does not count afterwards") {
  SlipWatch watch{SlipConfig{}};
  const Pose2 large{0.0, 0.0, radians(2.0)};
  CHECK_FALSE(watch.take(update(SightingUse::fused, large, large), settled + 0.10));
  watch.reset();
  for (int i = 0; i < 5; ++i)
    CHECK_FALSE(
        watch.take(update(SightingUse::fused, i == 0 ? large : Pose2{}, i == 0 ? large : Pose2{}), settled + 0.11));
}
