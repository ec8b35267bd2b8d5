#pragma once

#include <chrono>
#include <memory>
#include <string>
#include <vector>

#include "app/robots/ros2/messages.h"

namespace tagdock::ros2 {

/// Where the topics are. There is no authentication in it: whoever reaches the interface can publish.
struct LinkConfig {
  int domain = 0;                  ///< 0..101: above, the ports of ROS 2 meet those that Linux gives to others
  std::string interface = "lo";    ///< network interface; lo keeps every packet inside 127.0.0.0/8
  std::vector<std::string> peers;  ///< addresses asked by unicast, where multicast does not reach
  std::string process;             ///< how we are called in what others see, for example "tagdock dock"
};

/// The domain that ROS_DOMAIN_ID names, else 0. Throws Failure(usage) when it is no number of 0..101.
int domain_of_environment();

/// The full name of a topic: what begins with / is left, the rest goes below the namespace.
/// Throws Failure(usage) with the rule when it is no ROS 2 name.
std::string full_name(const std::string& name_space, const std::string& topic);

/// How samples are delivered. Writers of ours are always reliable: those match readers of both kinds.
enum class Delivery {
  best_effort,  ///< a reader that takes both kinds of writers
  reliable      ///< a reader that misses nothing and does not see best-effort writers
};

/// Somebody else's end of a topic.
struct Endpoint {
  std::string type;  ///< as ROS 2 writes it: geometry_msgs/msg/Twist
  std::string who;   ///< a process, as far as it says who it is
  bool operator==(const Endpoint&) const = default;
};

template <class Message>
class Publisher;
template <class Message>
class Subscription;

/// ROS 2 topics over DDS, without ROS. One a process; it is the only door to Cyclone DDS.
class Link {
 public:
  /// Joins the domain. Throws Failure: usage for an interface that is not there, robot_link when DDS cannot start.
  explicit Link(const LinkConfig& config);
  ~Link();
  Link(const Link&) = delete;
  Link& operator=(const Link&) = delete;

  /// @param topic  full name, with its leading /
  template <class Message>
  [[nodiscard]] Publisher<Message> publisher(const std::string& topic);
  /// @param depth  newest samples kept between two calls of take
  template <class Message>
  [[nodiscard]] Subscription<Message> subscription(const std::string& topic, Delivery delivery, int depth);

  /// Waits until a subscription has something, at most so long.
  void wait(std::chrono::nanoseconds at_most) const;

  /// Others that publish or subscribe a topic now, of whatever type.
  [[nodiscard]] std::vector<Endpoint> publishers_of(const std::string& topic) const;
  [[nodiscard]] std::vector<Endpoint> subscribers_of(const std::string& topic) const;

  struct Core;

 private:
  std::shared_ptr<Core> core_;
};

/// Only the newest sample is kept for readers that lost it: after a cut nobody is sent old commands.
template <class Message>
class Publisher {
 public:
  /// Never throws and never waits; what cannot be sent is lost, as on any network.
  void write(const Message& message) const noexcept;
  /// Waits until every reliable reader has the last sample.
  void flush(std::chrono::nanoseconds at_most) const noexcept;
  /// Readers of others (and of ours) that get what is written.
  [[nodiscard]] int matched() const noexcept;

 private:
  friend class Link;
  std::shared_ptr<Link::Core> core_;
  int writer_ = 0;
};

template <class Message>
class Subscription {
 public:
  /// What arrived since the last call, oldest first. Payloads that are no such message were dropped before.
  [[nodiscard]] std::vector<Message> take() const;
  [[nodiscard]] int matched() const noexcept;

 private:
  friend class Link;
  std::shared_ptr<Link::Core> core_;
  int reader_ = 0;
};

/// The type's name as ROS 2 writes it.
template <class Message>
[[nodiscard]] std::string type_name();

}  // namespace tagdock::ros2
