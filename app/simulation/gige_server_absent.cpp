// Compiled in place of gige_server.cpp when Aravis was not found.
#include "app/failure.h"
#include "app/simulation/gige_server.h"

namespace tagdock {

class GigeServer::Implementation {};

GigeServer::GigeServer(const GigeServerSettings&) {
  throw Failure(
      ExitCode::camera,
      "this program was built without Aravis and cannot simulate a GigE camera: install libaravis-dev and build again");
}
GigeServer::~GigeServer() = default;
void GigeServer::publish(const ServedFrame&) {}
ServedSettings GigeServer::client() const { return {}; }
std::uint64_t GigeServer::sent() const { return 0; }
void GigeServer::lose_packets(double) {}
void GigeServer::silence(bool) {}
void GigeServer::stop() {}

}  // namespace tagdock
