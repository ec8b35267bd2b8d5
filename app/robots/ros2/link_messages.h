// The messages that there are: what a link's .cpp, with ROS 2 or without, makes of its templates. Included once, at its
// end.
#pragma once

#include "app/robots/ros2/link.h"

namespace tagdock::ros2 {

#define TAGDOCK_ROS2_MESSAGE(Message)                                                            \
  template Publisher<Message> Link::publisher<Message>(const std::string&);                      \
  template Subscription<Message> Link::subscription<Message>(const std::string&, Delivery, int); \
  template class Publisher<Message>;                                                             \
  template class Subscription<Message>;                                                          \
  template std::string type_name<Message>();
TAGDOCK_ROS2_MESSAGE(Bool)
TAGDOCK_ROS2_MESSAGE(String)
TAGDOCK_ROS2_MESSAGE(Twist)
TAGDOCK_ROS2_MESSAGE(TwistStamped)
TAGDOCK_ROS2_MESSAGE(PoseStamped)
TAGDOCK_ROS2_MESSAGE(OdometryMessage)
TAGDOCK_ROS2_MESSAGE(PathMessage)
TAGDOCK_ROS2_MESSAGE(DiagnosticArray)
TAGDOCK_ROS2_MESSAGE(AprilTagDetectionArray)
#undef TAGDOCK_ROS2_MESSAGE

}  // namespace tagdock::ros2
