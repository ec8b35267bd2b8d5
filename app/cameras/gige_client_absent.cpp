// Compiled in place of gige_client.cpp when Aravis was not found.
#include "app/cameras/gige_client.h"
#include "app/failure.h"

namespace tagdock {

std::unique_ptr<Camera> open_gige_client(const GigeSettings&, std::chrono::steady_clock::time_point,
                                         const GigeClientHooks&) {
  throw Failure(
      ExitCode::camera,
      "this program was built without Aravis and cannot open a GigE camera: install libaravis-dev and build again");
}

}  // namespace tagdock
