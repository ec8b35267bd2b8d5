// Round trip of a command over ROS 2 topics: a Twist to another process (ros2_peer echo), which answers with an
// Odometry.
//   ros2_bench PEER [COUNT]     50 a second, as a docking sends them
#include <algorithm>
#include <chrono>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <thread>
#include <vector>

#include "app/robots/ros2.h"
#include "tests/fakes/process.h"

using namespace tagdock;
using std::chrono::milliseconds;
using std::chrono::steady_clock;

int main(int argc, char** argv) {
  if (argc < 2) return std::fputs("ros2_bench PEER [COUNT]\n", stderr), 2;
  const int count = argc > 2 ? std::atoi(argv[2]) : 3000;
  Process peer({argv[1], "echo", "45"});
  if (peer.line() != "echoing") return 2;
  ros2::Link link(ros2::LinkConfig{45, "lo", {}, "ros2_bench"});
  const auto commands = link.publisher<ros2::Twist>("/cmd_vel");
  const auto odometry = link.subscription<ros2::OdometryMessage>("/odom", ros2::Delivery::best_effort, 10);
  while (commands.matched() == 0 || odometry.matched() == 0) std::this_thread::sleep_for(milliseconds(5));
  std::vector<double> round_us;
  int lost = 0;
  auto next = steady_clock::now();
  for (int i = 0; i < count; ++i, next += milliseconds(20)) {
    std::this_thread::sleep_until(next);
    ros2::Twist twist;
    twist.linear.x = i;
    const auto sent = steady_clock::now();
    commands.write(twist);
    bool back = false;
    while (!back && steady_clock::now() - sent < milliseconds(200)) {
      link.wait(milliseconds(50));
      for (const ros2::OdometryMessage& message : odometry.take()) back = back || message.twist.linear.x == i;
    }
    if (back)
      round_us.push_back(std::chrono::duration<double, std::micro>(steady_clock::now() - sent).count());
    else
      ++lost;
  }
  std::sort(round_us.begin(), round_us.end());
  const auto at = [&](double p) {
    return round_us[static_cast<std::size_t>(p * static_cast<double>(round_us.size() - 1))];
  };
  std::printf("%zu round trips, %d lost: median %.0f us, 95 %% %.0f, 99 %% %.0f, largest %.0f us\n", round_us.size(),
              lost, at(0.5), at(0.95), at(0.99), at(1.0));
  return lost == 0 ? 0 : 1;
}
