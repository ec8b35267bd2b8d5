// The other side of a GigE Vision test, as a process that can be killed or stopped.
//   gige_peer serve SERIAL [WxH]   a simulated camera on 127.0.0.1 that streams until it is killed
//   gige_peer watch WHICH [N]  a client that opens gige:WHICH, says "streaming" at its first frame and ends after N
//                              frames, or when it is killed; exit code as the program's
//   gige_peer camera-client    the Aravis client of a test that itself is not our program (app/cameras/gige.h)
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <string>
#include <thread>

#include "app/cameras/gige_process.h"
#include "app/cameras/open_camera.h"
#include "app/failure.h"
#include "app/simulation/gige_server.h"

namespace {

using namespace tagdock;
using namespace std::chrono_literals;
using std::chrono::steady_clock;

[[noreturn]] void serve(const std::string& serial, const std::string& size) {
  GigeServerSettings settings;
  settings.serial = serial;
  // Small if not said otherwise, for the thread sanitizer looks at every byte that is copied.
  if (std::sscanf(size.c_str(), "%dx%d", &settings.width, &settings.height) != 2) std::exit(2);
  GigeServer server(settings);
  std::cout << "serving" << std::endl;
  const auto start = steady_clock::now();
  const cv::Mat1b gray(settings.height, settings.width, static_cast<unsigned char>(128));
  for (std::uint64_t number = 1;; ++number) {
    server.publish({gray, number, steady_clock::now() - start});
    std::this_thread::sleep_until(start + number * 40ms);
  }
}

int watch(const std::string& which, long frames) {
  const auto camera = open_camera(parse_camera_argument("gige:" + which), GigeSettings{}, 25.0, steady_clock::now());
  long seen = 0;
  while (seen < frames) {
    if (!camera->newest(0ns)) {
      std::this_thread::sleep_for(1ms);
      continue;
    }
    if (++seen == 1) std::cout << "streaming" << std::endl;
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  if (argc == 2 && std::string(argv[1]) == gige_client_word) return serve_gige_client(gige_client_socket);
  const std::string role = argc >= 3 ? argv[1] : "";
  try {
    if (role == "serve") serve(argv[2], argc > 3 ? argv[3] : "320x256");
    if (role == "watch") return watch(argv[2], argc > 3 ? std::atol(argv[3]) : 1L << 40);
  } catch (const Failure& failure) {
    std::cerr << failure.what() << "\n";
    return static_cast<int>(failure.code());
  }
  std::cerr << "usage: gige_peer serve SERIAL | gige_peer watch WHICH [FRAMES]\n";
  return 2;
}
