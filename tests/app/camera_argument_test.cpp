#include <catch2/catch.hpp>

#include "app/cameras/gvcp_probe.h"
#include "app/cameras/open_camera.h"
#include "app/failure.h"

namespace tagdock {
namespace {

std::string refusal(const std::string& argument) {
  try {
    parse_camera_argument(argument);
  } catch (const Failure& failure) {
    CHECK(failure.code() == ExitCode::usage);
    return failure.what();
  }
  return "not refused";
}

TEST_CASE("a camera argument says which camera") {
  CHECK(parse_camera_argument("sim") == CameraArgument(SimulatedCamera{}));
  CHECK(parse_camera_argument("gige:127.0.0.1") == CameraArgument(GigeAddress{"127.0.0.1"}));
  CHECK(parse_camera_argument("gige:127.255.3.9") == CameraArgument(GigeAddress{"127.255.3.9"}));
  CHECK(parse_camera_argument("gige:21998523") == CameraArgument(GigeSerial{"21998523"}));
  CHECK(parse_camera_argument("gige:TD000001") == CameraArgument(GigeSerial{"TD000001"}));
  CHECK(parse_camera_argument("images:a folder:with colons") == CameraArgument(Images{"a folder:with colons"}));
}

TEST_CASE("an address outside 127.0.0.0/8 is refused before anything is sent") {
  for (const std::string address : {"192.168.0.5", "128.0.0.1", "126.255.255.255", "0.0.0.0", "255.255.255.255"}) {
    CAPTURE(address);
    CHECK_THAT(refusal("gige:" + address), Catch::Contains(address) && Catch::Contains("outside 127.0.0.0/8"));
    GigeSettings settings;
    settings.address = address;
    CHECK_THROWS_AS(open_gige(settings, std::chrono::steady_clock::now()), Failure);
  }
}

TEST_CASE("what is not an address is never looked up") {
  // inet_aton would take the short, the octal and the hexadecimal forms.
  for (const std::string address : {"127.1", "127.0.0.1.", "127.0.0.256", "127.0.0.1:3956", "::1", "127.000.000.001"}) {
    CAPTURE(address);
    CHECK_THAT(refusal("gige:" + address), Catch::Contains("not a numeric address"));
  }
  CHECK_THROWS_AS(LoopbackAddress("localhost"), Failure);
  CHECK_THROWS_AS(LoopbackAddress(""), Failure);
  for (const std::string argument : {"", "gige", "gige:", "images:", "webcam", "SIM"}) {
    CAPTURE(argument);
    CHECK_THAT(refusal(argument), Catch::Contains("write sim, gige:127.x.y.z, gige:SERIAL or images:DIR"));
  }
}

}  // namespace
}  // namespace tagdock
