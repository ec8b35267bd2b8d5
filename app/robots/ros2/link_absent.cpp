// In place of link.cpp where Cyclone DDS was not found when tagdock was built.
#include "app/failure.h"
#include "app/robots/ros2/link.h"

namespace tagdock::ros2 {
namespace {

[[noreturn]] void absent() {
  throw Failure(ExitCode::robot_link,
                "this tagdock was built without Cyclone DDS and cannot speak ROS 2; install cyclonedds-dev and "
                "cyclonedds-tools and build again");
}

}  // namespace

struct Link::Core {};

int domain_of_environment() { absent(); }
std::string full_name(const std::string&, const std::string&) { absent(); }
Link::Link(const LinkConfig&) { absent(); }
Link::~Link() = default;
void Link::wait(std::chrono::nanoseconds) const {}
std::vector<Endpoint> Link::publishers_of(const std::string&) const { return {}; }
std::vector<Endpoint> Link::subscribers_of(const std::string&) const { return {}; }

template <class Message>
Publisher<Message> Link::publisher(const std::string&) {
  absent();
}
template <class Message>
Subscription<Message> Link::subscription(const std::string&, Delivery, int) {
  absent();
}
template <class Message>
void Publisher<Message>::write(const Message&) const noexcept {}
template <class Message>
void Publisher<Message>::flush(std::chrono::nanoseconds) const noexcept {}
template <class Message>
int Publisher<Message>::matched() const noexcept {
  return 0;
}
template <class Message>
std::vector<Message> Subscription<Message>::take() const {
  return {};
}
template <class Message>
int Subscription<Message>::matched() const noexcept {
  return 0;
}
template <class Message>
std::string type_name() {
  return {};
}

}  // namespace tagdock::ros2

#include "app/robots/ros2/link_messages.h"
