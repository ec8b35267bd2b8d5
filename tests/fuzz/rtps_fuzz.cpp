// Sends spoiled RTPS datagrams, headers and discovery, at the simulated robot and at a program that drives it.
//   tests/in_namespace rtps_fuzz TAGDOCK PEER COUNT [SEED]
// What the two say to each other is listened to on the loopback device (root, or a user namespace), then sent to both
// again with bytes changed: in discovery anywhere, in data only in the headers, since a command of which only the
// number is another one is a command. Ends non-zero when one of the two crashed, the robot moved, or they do not hear
// each other any more.
#include <array>
#include <chrono>
#include <cstdint>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <iostream>
#include <linux/if_ether.h>
#include <linux/if_packet.h>
#include <map>
#include <memory>
#include <netinet/in.h>
#include <random>
#include <set>
#include <sys/socket.h>
#include <thread>
#include <tuple>
#include <vector>

#include "tests/fakes/process.h"

using namespace tagdock;
using std::chrono::milliseconds;
using std::chrono::steady_clock;
using Bytes = std::vector<std::uint8_t>;

namespace {

constexpr const char* domain = "45";

struct Datagram {
  std::uint16_t port = 0;
  Bytes bytes;
};

/// RTPS datagrams on the loopback device, one of each length and port and kind of first submessages.
std::vector<Datagram> listened(milliseconds time) {
  const int handle = ::socket(AF_PACKET, SOCK_DGRAM | SOCK_CLOEXEC, htons(ETH_P_IP));
  if (handle < 0) {
    std::perror("rtps_fuzz: listening needs root or a user namespace");
    std::exit(2);
  }
  timeval patience{0, 100000};
  ::setsockopt(handle, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
  std::vector<Datagram> found;
  std::map<std::tuple<std::uint16_t, std::size_t, std::uint8_t>, int> seen;
  for (const auto end = steady_clock::now() + time; steady_clock::now() < end;) {
    std::array<std::uint8_t, 65536> packet{};
    const ssize_t size = ::recv(handle, packet.data(), packet.size(), 0);
    if (size < 48 || packet[9] != IPPROTO_UDP) continue;
    const std::size_t ip = 4U * (packet[0] & 15U);
    const auto port = static_cast<std::uint16_t>(packet[ip + 2] << 8 | packet[ip + 3]);
    const std::uint8_t* rtps = &packet[ip + 8];
    const std::size_t length = static_cast<std::size_t>(size) - ip - 8;
    if (length < 24 || std::memcmp(rtps, "RTPS", 4) != 0) continue;
    constexpr int of_each = 4;
    if (++seen[{port, length, rtps[20]}] <= of_each) found.push_back({port, {rtps, rtps + length}});
  }
  ::close(handle);
  return found;
}

/// Where in a datagram bytes may be changed: everywhere but in the payload of a user's topic.
std::set<std::size_t> user_payload(const Bytes& bytes) {
  std::set<std::size_t> kept;
  for (std::size_t at = 20; at + 4 <= bytes.size();) {
    const bool little = (bytes[at + 1] & 1) != 0;
    std::size_t length = little ? bytes[at + 2] | bytes[at + 3] << 8 : bytes[at + 2] << 8 | bytes[at + 3];
    if (length == 0) length = bytes.size() - at - 4;
    constexpr std::uint8_t data = 0x15;
    // The writer's entity id ends in its kind; those of discovery have the two upper bits set.
    if (bytes[at] == data && at + 16 <= bytes.size() && (bytes[at + 15] & 0xc0) == 0)
      for (std::size_t i = at + 24; i < std::min(bytes.size(), at + 4 + length); ++i) kept.insert(i);
    at += 4 + length;
  }
  return kept;
}

Bytes spoiled(const Datagram& datagram, std::mt19937& random) {
  constexpr std::uint8_t odd[] = {0, 1, 0x7f, 0x80, 0xff};
  Bytes bytes = datagram.bytes;
  const std::set<std::size_t> kept = user_payload(bytes);
  for (std::size_t times = 1 + random() % 4; times > 0; --times) {
    const std::size_t at = random() % bytes.size();
    switch (random() % 6) {
      case 0:
        if (kept.empty()) bytes.resize(std::max<std::size_t>(1, at));
        break;
      case 1:
        if (kept.empty())
          bytes.insert(bytes.begin() + static_cast<std::ptrdiff_t>(at), random() % 64, odd[random() % 5]);
        break;
      case 2:  // a length of a submessage, a parameter or a string
        for (std::size_t i = at; i < std::min(bytes.size(), at + 4); ++i)
          if (!kept.contains(i)) bytes[i] = odd[random() % 5];
        break;
      default:
        if (!kept.contains(at)) bytes[at] = random() % 2 == 0 ? odd[random() % 5] : static_cast<std::uint8_t>(random());
    }
  }
  return bytes;
}

double number_after(const std::string& text, const std::string& key) {
  const auto at = text.find("\"" + key + "\":");
  return at == std::string::npos ? -1.0 : std::atof(text.c_str() + at + key.size() + 3);
}

}  // namespace

int main(int argc, char** argv) {
  if (argc < 4) {
    std::cerr << "rtps_fuzz TAGDOCK PEER COUNT [SEED]\n";
    return 2;
  }
  const long count = std::atol(argv[3]);
  std::mt19937 random(argc > 4 ? static_cast<unsigned>(std::atol(argv[4])) : 1U);
  const std::string log = "/tmp/rtps_fuzz_" + std::to_string(::getpid()) + ".csv";
  Process robot({argv[1], "robot-sim", "--domain", domain, "--json", "--log", log});
  if (robot.line().empty()) return 2;
  std::vector<Datagram> datagrams;
  {
    // Its zeros are what is listened to; it is gone when the robot is attacked, or its faults would count as ours.
    std::thread listener([&] { datagrams = listened(milliseconds(5000)); });
    std::this_thread::sleep_for(milliseconds(300));
    Process peer({argv[2], "drive", domain, "0"});
    listener.join();
  }
  std::map<std::uint16_t, int> ports;
  for (const Datagram& one : datagrams) ++ports[one.port];
  std::printf("%zu datagrams listened to, for %zu ports\n", datagrams.size(), ports.size());
  if (datagrams.size() < 10) return 2;
  auto peer = std::make_unique<Process>(std::vector<std::string>{argv[2], "drive", domain, "0"});
  if (peer->line() != "driving") return 2;
  std::map<std::string, int> ends;  // of the driver
  std::string robot_end;
  const int handle = ::socket(AF_INET, SOCK_DGRAM | SOCK_CLOEXEC, 0);
  long sent = 0;
  for (; sent < count; ++sent) {
    const Datagram& one = datagrams[random() % datagrams.size()];
    const Bytes bytes = spoiled(one, random);
    // What was for one of the two goes to any port that either has.
    auto port = ports.begin();
    std::advance(port, static_cast<long>(random() % ports.size()));
    sockaddr_in to{};
    to.sin_family = AF_INET;
    to.sin_port = htons(random() % 2 == 0 ? one.port : port->first);
    to.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    ::sendto(handle, bytes.data(), bytes.size(), 0, reinterpret_cast<const sockaddr*>(&to), sizeof to);
    if (sent % 20 == 19) std::this_thread::sleep_for(milliseconds(1));
    if (sent % 200 != 199) continue;
    robot_end = robot.ended();
    if (!robot_end.empty()) break;
    if (const std::string end = peer->ended(); !end.empty()) {
      ++ends[end];
      peer = std::make_unique<Process>(std::vector<std::string>{argv[2], "drive", domain, "0"});
    }
  }
  ::close(handle);
  peer->kill();
  std::this_thread::sleep_for(milliseconds(4000));  // the lease of what was announced is 2 s
  // A driver that comes now is heard.
  bool heard = false;
  if (robot.ended().empty()) {
    Process next({argv[2], "drive", domain, "0"});
    heard = next.line() == "driving";
    std::this_thread::sleep_for(milliseconds(500));
  }
  robot.signal(SIGINT);
  std::string report;
  for (std::string line = robot.line(); !line.empty(); line = robot.line())
    if (line.find("tagdock-robot-sim/1") != std::string::npos || !report.empty()) report += line;
  std::remove(log.c_str());
  const double travelled = number_after(report, "travelled_m");
  bool crashed = !robot_end.empty();
  std::string ends_told;
  for (const auto& [end, times] : ends) {
    ends_told += (ends_told.empty() ? "" : ", ") + std::to_string(times) + " times with " + end;
    crashed = crashed || end.find("signal") == 0;
  }
  std::printf(
      "%ld spoiled datagrams: the robot %s and travelled %g m, took %g commands, refused %g; the driver ended %s; "
      "a new driver is %s\n",
      sent, robot_end.empty() ? "lives" : ("ENDED BY " + robot_end).c_str(), travelled,
      number_after(report, "commands"), number_after(report, "refused"),
      ends_told.empty() ? "never" : ends_told.c_str(), heard ? "heard" : "NOT HEARD");
  return !crashed && heard && travelled == 0.0 ? 0 : 1;
}
