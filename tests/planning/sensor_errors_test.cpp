#include "planning/sensor_errors.h"

#include <catch2/catch.hpp>

using namespace tagdock;

namespace {

// Two distances, two bearings, two places; errors grow with all of them. The farthest oblique cell at the side is
// blind.
SensorErrors small_map() {
  SensorErrors errors;
  errors.distances = {1.0, 3.0};
  errors.bearings = {0.0, radians(30.0)};
  errors.places = {0.0, 0.8};
  for (const double place : {1.0, 2.0})
    for (const double bearing : {1.0, 3.0})
      for (const double distance : {1.0, 5.0}) {
        const double size = place * bearing * distance;
        errors.cells.push_back(SensorErrors::Sigma{0.001 * size, 0.002 * size, 0.0005 * size});
      }
  errors.cells.back().reset();
  return errors;
}

}  // namespace

TEST_CASE("sensor errors are those of a cell on it, and between the cells beside them") {
  const SensorErrors errors = small_map();
  CHECK(errors.at(1.0, 0.0, 0.0)->along == Approx(0.001));
  CHECK(errors.at(3.0, 0.0, 0.0)->across == Approx(0.010));
  CHECK(errors.at(2.0, 0.0, 0.0)->heading == Approx(0.0015));         // half way from 1 to 5
  CHECK(errors.at(2.0, radians(15.0), 0.0)->along == Approx(0.006));  // 3 times 2
  CHECK(errors.at(1.0, 0.0, -0.4)->along == Approx(0.0015));          // the same to both sides
  CHECK(errors.at(1.0, radians(-30.0), 0.0)->along == Approx(0.003));
  CHECK(errors.at(0.3, 0.0, 0.0)->along == Approx(0.001));  // nearer than measured
}

TEST_CASE("beyond what was measured, and where the board was not seen, nothing is told") {
  const SensorErrors errors = small_map();
  CHECK_FALSE(errors.at(3.1, 0.0, 0.0));
  CHECK_FALSE(errors.at(1.0, radians(31.0), 0.0));
  CHECK_FALSE(errors.at(1.0, 0.0, 0.9));
  CHECK_FALSE(errors.at(3.0, radians(30.0), 0.8));
  CHECK_FALSE(errors.at(2.9, radians(29.0), 0.7));  // the blind cell has a share in it
  CHECK(errors.at(3.0, radians(30.0), 0.0));
}

TEST_CASE("along and across the line of sight become x and y of the station") {
  const SensorErrors errors = small_map();
  const double half_view = radians(27.0);
  const auto ahead = lens_covariance(errors, {-1.0, 0.0, 0.0}, half_view);
  REQUIRE(ahead);
  CHECK((*ahead)(0, 0) == Approx(1e-6));
  CHECK((*ahead)(1, 1) == Approx(4e-6));
  CHECK((*ahead)(2, 2) == Approx(0.25e-6));
  // From the right of the axis, looking at the board: the line of sight is turned by 30 degrees.
  const double c = std::cos(radians(30.0));
  const double s = std::sin(radians(30.0));
  const auto oblique = lens_covariance(errors, {-c, -s, radians(30.0)}, half_view);
  REQUIRE(oblique);
  CHECK((*oblique)(0, 0) == Approx(9e-6 * (c * c + 4.0 * s * s)));
  CHECK((*oblique)(1, 1) == Approx(9e-6 * (s * s + 4.0 * c * c)));
  CHECK((*oblique)(0, 1) == Approx(9e-6 * c * s * (1.0 - 4.0)));
  CHECK_FALSE(lens_covariance(errors, {-1.0, 0.0, radians(40.0)}, half_view));  // looks past the board
}
