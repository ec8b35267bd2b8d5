// Compiled in place of gige.cpp when Aravis was not found.
#include "app/cameras/gige.h"
#include "app/failure.h"

namespace tagdock {

std::unique_ptr<Camera> open_gige(const GigeSettings&, std::chrono::steady_clock::time_point) {
  throw Failure(
      ExitCode::camera,
      "this program was built without Aravis and cannot open a GigE camera: install libaravis-dev and build again");
}

}  // namespace tagdock
