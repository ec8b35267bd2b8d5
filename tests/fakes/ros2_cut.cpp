// Cuts the link between a driving program and the simulated robot, again and again, and measures at the robot when its
// drive was without a command and when its wheels stood.
//   ros2_cut TAGDOCK PEER TRIALS [LIMIT_MS]
// In turn: the driving program is killed, frozen, or the network device goes down (only in a private namespace). Ends
// non-zero when the wheels did not stand after a cut, or not within LIMIT_MS.
#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <net/if.h>
#include <random>
#include <sstream>
#include <string>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <thread>
#include <vector>

#include "process.h"

using namespace tagdock;
using std::chrono::milliseconds;
using std::chrono::steady_clock;

namespace {

constexpr const char* domain = "44";
constexpr const char* speed = "0.15";
constexpr double resting = 0.005;            // m/s
constexpr std::int64_t watched = 950000000;  // ns after a cut; then comes the next trial

std::int64_t now() { return steady_clock::now().time_since_epoch().count(); }

struct Moment {
  std::int64_t time = 0;
  double command = 0.0;
  double wheels = 0.0;
};

// Columns: monotonic_ns, commands, command_linear, command_angular, wheel_linear, ...
std::vector<Moment> read_log(const std::string& file) {
  std::ifstream stream(file);
  std::vector<Moment> all;
  std::string line;
  std::getline(stream, line);
  while (std::getline(stream, line)) {
    std::istringstream fields(line);
    std::vector<std::string> field;
    for (std::string one; std::getline(fields, one, ',');) field.push_back(one);
    if (field.size() >= 5) all.push_back({std::stoll(field[0]), std::stod(field[2]), std::stod(field[4])});
  }
  return all;
}

struct Cut {
  const char* how;
  std::int64_t time = 0;
  std::string said;
};

bool switch_loopback(bool up) {
  const int fd = ::socket(AF_INET, SOCK_DGRAM, 0);
  struct ifreq request = {};
  std::strcpy(request.ifr_name, "lo");
  bool done = ::ioctl(fd, SIOCGIFFLAGS, &request) == 0;
  request.ifr_flags = static_cast<short>(up ? request.ifr_flags | IFF_UP : request.ifr_flags & ~IFF_UP);
  done = done && ::ioctl(fd, SIOCSIFFLAGS, &request) == 0;
  ::close(fd);
  return done;
}

double quantile(std::vector<double> values, double p) {
  std::sort(values.begin(), values.end());
  return values.empty() ? 0.0 : values[static_cast<std::size_t>(p * static_cast<double>(values.size() - 1))];
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 4) {
    std::cerr << "ros2_cut TAGDOCK PEER TRIALS [LIMIT_MS]\n";
    return 2;
  }
  const int trials = std::atoi(argv[3]);
  const double limit_ms = argc > 4 ? std::atof(argv[4]) : 0.0;
  const bool private_network = std::system("test \"$(ip -o link show | wc -l)\" = 1") == 0;
  const std::string log = "/tmp/ros2_cut_" + std::to_string(::getpid()) + ".csv";
  Process robot({argv[1], "robot-sim", "--domain", domain, "--log", log});
  if (robot.line().empty()) return 2;
  std::mt19937 random(7);  // where in the period of 20 ms the cut falls
  std::vector<Cut> cuts;
  // Some more, since a stall of this machine can stop the robot before its link is cut; those prove nothing.
  for (int i = 0; i < trials + std::max(3, trials / 6); ++i) {
    Process peer({argv[2], "drive", domain, speed});
    if (const std::string line = peer.line(); line != "driving") {
      std::cerr << "trial " << i << ": " << line << "\n";
      return 1;
    }
    std::this_thread::sleep_for(milliseconds(900) + std::chrono::microseconds(random() % 20000));
    const int kind = i % (private_network ? 3 : 2);
    Cut cut{kind == 0 ? "killed" : kind == 1 ? "frozen" : "network down", now(), {}};
    if (kind == 0) peer.kill();
    if (kind == 1) peer.signal(SIGSTOP);
    if (kind == 2) {
      if (!switch_loopback(false)) return 2;
      std::this_thread::sleep_for(milliseconds(700));
      if (!switch_loopback(true)) return 2;
      cut.said = peer.line();  // the fault that it found itself; latched, although the network is back
    }
    cuts.push_back(cut);
    std::this_thread::sleep_for(milliseconds(1000));
  }
  robot.signal(SIGINT);
  while (!robot.line().empty()) {
  }
  const std::vector<Moment> moments = read_log(log);
  std::remove(log.c_str());

  std::vector<double> stopped_ms;
  std::vector<double> rested_ms;
  int good = 0;
  int judged = 0;
  int standing = 0;
  for (const Cut& cut : cuts) {
    std::int64_t last_command = cut.time;
    std::int64_t last_motion = cut.time;
    bool moved = false;
    for (const Moment& moment : moments) {
      if (moment.time > cut.time - 100000000 && moment.time <= cut.time) moved = moved || moment.wheels > 0.1;
      if (moment.time <= cut.time || moment.time > cut.time + watched) continue;
      if (moment.command != 0.0) last_command = moment.time;
      if (std::abs(moment.wheels) > resting) last_motion = moment.time;
    }
    if (judged == trials) break;
    if (!moved) {
      ++standing;
      continue;
    }
    ++judged;
    stopped_ms.push_back(static_cast<double>(last_command - cut.time) / 1e6 + 5.0);  // seen every 5 ms
    rested_ms.push_back(static_cast<double>(last_motion - cut.time) / 1e6 + 5.0);
    const bool in_time = rested_ms.back() < (limit_ms > 0.0 ? limit_ms : 900.0);
    const bool told = std::string(cut.how) != "network down" || cut.said.find("fault:") == 0;
    good += in_time && told;
    if (!(in_time && told))
      std::cout << cut.how << ": command gone after " << stopped_ms.back() << " ms, wheels at rest after "
                << rested_ms.back() << " ms; " << cut.said << "\n";
  }
  std::printf(
      "%d of %d cuts stopped the robot, which drove at %s m/s (%d more were not driving any more); the drive was "
      "without a "
      "command after median %.0f, 95 %% %.0f, largest %.0f ms; the wheels stood (below 5 mm/s) after median %.0f, "
      "largest "
      "%.0f ms\n",
      good, judged, speed, standing, quantile(stopped_ms, 0.5), quantile(stopped_ms, 0.95), quantile(stopped_ms, 1.0),
      quantile(rested_ms, 0.5), quantile(rested_ms, 1.0));
  return good == judged && judged == trials ? 0 : 1;
}
