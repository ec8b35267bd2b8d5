#pragma once

#include <optional>
#include <string>
#include <vector>

#include <CLI/CLI.hpp>

namespace tagdock {

/// The options that every verb on ROS 2 topics has.
inline void add_ros2_options(CLI::App& verb, std::optional<int>& domain, std::string& name_space,
                             std::vector<std::string>& remaps) {
  verb.add_option("--domain", domain, "ROS 2: domain, 0 to 101; without, ROS_DOMAIN_ID or 0")
      ->check(CLI::Range(0, 101));
  verb.add_option("--namespace", name_space, "ROS 2: namespace of the topics, for example /robot1");
  verb.add_option("--remap", remaps, "ROS 2: NAME:=TOPIC, for example odom:=/base/odom; may be given several times")
      ->allow_extra_args(false);
}

}  // namespace tagdock
