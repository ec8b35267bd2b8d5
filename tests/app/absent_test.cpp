// The program as it is built where Aravis and Cyclone DDS are not installed: their doors' stand-ins are linked in place
// of the doors.
#include <catch2/catch.hpp>

#include "app/cameras/gige_client.h"
#include "app/failure.h"
#include "app/robots/ros2.h"

namespace tagdock {
namespace {

using Catch::Matchers::Contains;

TEST_CASE("without Cyclone DDS a robot on ROS 2 topics is refused with what to install") {
  try {
    (void)open_ros2(Ros2Config{}, OdometryLimits{}, std::chrono::steady_clock::now());
    FAIL("a robot was opened");
  } catch (const Failure& failure) {
    CHECK(failure.code() == ExitCode::robot_link);
    CHECK_THAT(failure.what(), Contains("without Cyclone DDS") && Contains("cyclonedds-dev"));
  }
}

TEST_CASE("without Aravis a GigE camera is refused with what to install") {
  GigeSettings settings;
  settings.address = "127.0.0.1";
  try {
    (void)open_gige_client(settings, std::chrono::steady_clock::now());
    FAIL("a camera was opened");
  } catch (const Failure& failure) {
    CHECK_THAT(failure.what(), Contains("without Aravis") && Contains("libaravis-dev"));
  }
}

}  // namespace
}  // namespace tagdock
