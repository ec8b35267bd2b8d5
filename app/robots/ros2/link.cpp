// The door to Cyclone DDS (with codec.cpp), through its C API. Topics only: services and actions differ between the
// vendors' ROS 2 middlewares (a request header inside or outside of the payload).
#include "app/robots/ros2/link.h"

#include <algorithm>
#include <arpa/inet.h>
#include <cctype>
#include <cerrno>
#include <charconv>
#include <cstdlib>
#include <cstring>
#include <dds/dds.h>
#include <dds/ddsrt/log.h>
#include <filesystem>
#include <map>
#include <mutex>
#include <net/if.h>
#include <netinet/in.h>
#include <set>
#include <sys/socket.h>

#include "app/failure.h"
#include "app/robots/ros2/codec.h"

namespace tagdock::ros2 {
namespace {

constexpr std::uint32_t endpoints_read = 256;  // more ends of topics than a docking robot has

Failure broken(const std::string& what, dds_return_t code) {
  return Failure(ExitCode::robot_link, "ROS 2 link: " + what + ": " + dds_strretcode(code));
}

dds_entity_t good(dds_entity_t entity, const std::string& what) {
  if (entity < 0) throw broken(what, entity);
  return entity;
}

struct QosDeleter {
  void operator()(dds_qos_t* qos) const { dds_delete_qos(qos); }
};
using Qos = std::unique_ptr<dds_qos_t, QosDeleter>;

Qos qos_of(Delivery delivery, int depth) {
  Qos qos(dds_create_qos());
  dds_qset_reliability(qos.get(),
                       delivery == Delivery::reliable ? DDS_RELIABILITY_RELIABLE : DDS_RELIABILITY_BEST_EFFORT, 0);
  dds_qset_durability(qos.get(), DDS_DURABILITY_VOLATILE);
  dds_qset_history(qos.get(), DDS_HISTORY_KEEP_LAST, depth);
  return qos;
}

// The two ways in which ROS 2 writes names: geometry_msgs/msg/Twist and, on the wire, geometry_msgs::msg::dds_::Twist_.
std::string ros_type(std::string name) {
  const std::string mangled = "::dds_::";
  if (const auto at = name.find(mangled); at != std::string::npos && name.ends_with('_')) {
    name.erase(at + 2, mangled.size() - 2);
    name.pop_back();
  }
  for (auto at = name.find("::"); at != std::string::npos; at = name.find("::")) name.replace(at, 2, "/");
  return name;
}

std::string wire_topic(const std::string& topic) { return "rt" + topic; }

// Everything stays inside 127.0.0.0/8 on lo: no multicast, and our own addresses are the only peers. Another interface
// has multicast as the network allows it, and the peers that were named.
std::string configuration(const LinkConfig& config) {
  const bool loopback = config.interface == "lo";
  std::string peers;
  for (const std::string& peer : config.peers) peers += "<Peer address=\"" + peer + "\"/>";
  if (loopback && peers.empty()) peers = "<Peer address=\"127.0.0.1\"/>";
  return "<Domain><General><Interfaces><NetworkInterface name=\"" + config.interface + "\"" +
         (loopback ? " multicast=\"false\"" : "") + "/></Interfaces>" +
         (loopback ? "<AllowMulticast>false</AllowMulticast>" : "") +
         "</General><Discovery><ParticipantIndex>auto</ParticipantIndex>"
         "<MaxAutoParticipantIndex>32</MaxAutoParticipantIndex><Peers>" +
         peers +
         // A process that died is forgotten after two seconds, so that its writer does not count as a second one.
         "</Peers><LeaseDuration>2 s</LeaseDuration></Discovery>"
         "<Tracing><Verbosity>none</Verbosity></Tracing></Domain>";
}

// Cyclone writes a line to stderr for every payload that is none: whoever sends many would fill the terminal and the
// log. What went wrong on our side comes back as a return value.
void keep_quiet() {
  dds_set_log_sink([](void*, const dds_log_data_t*) {}, nullptr);
}

/// UDP sockets of this process that take packets from every interface.
std::set<int> open_to_all() {
  std::set<int> found;
  std::error_code error;
  for (const auto& entry : std::filesystem::directory_iterator("/proc/self/fd", error)) {
    const int handle = std::atoi(entry.path().filename().c_str());
    int type = 0;
    socklen_t size = sizeof type;
    if (::getsockopt(handle, SOL_SOCKET, SO_TYPE, &type, &size) != 0 || type != SOCK_DGRAM) continue;
    sockaddr_in here{};
    size = sizeof here;
    if (::getsockname(handle, reinterpret_cast<sockaddr*>(&here), &size) == 0 && here.sin_family == AF_INET &&
        here.sin_port != 0 && here.sin_addr.s_addr == htonl(INADDR_ANY))
      found.insert(handle);
  }
  return found;
}

/// Cyclone 0.10 listens on all addresses of the machine whichever interface it was given, and who reaches its ports can
/// talk it into anything. From here on the kernel gives those sockets what comes over the interface, and nothing else.
/// @param earlier  sockets that are not Cyclone's
void keep_to_interface(const std::string& interface, const std::set<int>& earlier) {
  for (const int handle : open_to_all())
    if (!earlier.contains(handle) && ::setsockopt(handle, SOL_SOCKET, SO_BINDTODEVICE, interface.c_str(),
                                                  static_cast<socklen_t>(interface.size())) != 0)
      throw Failure(ExitCode::robot_link, "ROS 2 link: its sockets cannot be kept to the interface " + interface +
                                              ": " + std::strerror(errno));
}

bool plain_address(const std::string& text) {
  return !text.empty() && std::all_of(text.begin(), text.end(), [](unsigned char letter) {
    return std::isalnum(letter) != 0 || letter == '.' || letter == ':' || letter == '-' || letter == '_';
  });
}

std::string interfaces() {
  std::string names;
  struct if_nameindex* all = ::if_nameindex();
  for (auto* one = all; one != nullptr && one->if_index != 0; ++one) names += std::string(" ") + one->if_name;
  if (all != nullptr) ::if_freenameindex(all);
  return names;
}

}  // namespace

int domain_of_environment() {
  const char* text = std::getenv("ROS_DOMAIN_ID");
  if (text == nullptr || *text == 0) return 0;
  int domain = -1;
  const char* end = text + std::strlen(text);
  const auto [last, error] = std::from_chars(text, end, domain);
  if (error != std::errc() || last != end || domain < 0 || domain > 101)
    throw Failure(ExitCode::usage,
                  "ROS_DOMAIN_ID is " + std::string(text) + "; it must be a whole number between 0 and 101");
  return domain;
}

std::string full_name(const std::string& name_space, const std::string& topic) {
  std::string name = topic;
  if (!topic.starts_with('/')) {
    name = name_space + "/" + topic;
    if (!name.starts_with('/')) name = "/" + name;
  }
  const auto letter = [](char c) { return std::isalnum(static_cast<unsigned char>(c)) != 0 || c == '_'; };
  bool valid = !topic.empty() && name.size() > 1 && name.size() < 200;
  for (std::size_t i = 0; valid && i < name.size(); ++i) {
    const char next = i + 1 < name.size() ? name[i + 1] : '/';
    if (name[i] == '/')
      valid = letter(next) && std::isdigit(static_cast<unsigned char>(next)) == 0;
    else
      valid = letter(name[i]) && !(name[i] == '_' && next == '_');
  }
  if (!valid)
    throw Failure(ExitCode::usage, "\"" + name +
                                       "\" is no ROS 2 topic; names are letters, digits and single underscores, "
                                       "separated by / and not beginning with a digit");
  return name;
}

struct Link::Core {
  dds_entity_t domain = 0;
  dds_entity_t participant = 0;
  dds_entity_t waitset = 0;
  dds_entity_t publications = 0;
  dds_entity_t subscriptions = 0;
  dds_entity_t participants = 0;
  dds_guid_t own{};
  std::mutex mutex;
  std::map<std::string, dds_entity_t> topics;  // by name and type

  explicit Core(const LinkConfig& config) {
    if (::if_nametoindex(config.interface.c_str()) == 0)
      throw Failure(ExitCode::usage, "ros2.interface is " + config.interface +
                                         "; this machine has no such network interface, but:" + interfaces());
    for (const std::string& peer : config.peers)
      if (!plain_address(peer))
        throw Failure(ExitCode::usage, "ros2.peers has \"" + peer + "\"; it must be an address such as 192.168.1.7");
    keep_quiet();
    const auto id = static_cast<dds_domainid_t>(config.domain);
    const std::set<int> earlier = open_to_all();
    domain = dds_create_domain(id, configuration(config).c_str());
    // A second link of this process shares the first one's domain.
    if (domain == DDS_RETCODE_PRECONDITION_NOT_MET) domain = 0;
    if (domain < 0) throw broken("cannot start on interface " + config.interface, domain);
    try {
      Qos qos(dds_create_qos());
      dds_qset_entity_name(qos.get(), config.process.c_str());
      participant = good(dds_create_participant(id, qos.get(), nullptr),
                         "cannot join domain " + std::to_string(config.domain) + " on " + config.interface);
      dds_get_guid(participant, &own);
      keep_to_interface(config.interface, earlier);
      waitset = good(dds_create_waitset(participant), "cannot wait");
      const auto watch = [&](dds_entity_t topic) {
        return good(dds_create_reader(participant, topic, nullptr, nullptr), "cannot see who else is there");
      };
      publications = watch(DDS_BUILTIN_TOPIC_DCPSPUBLICATION);
      subscriptions = watch(DDS_BUILTIN_TOPIC_DCPSSUBSCRIPTION);
      participants = watch(DDS_BUILTIN_TOPIC_DCPSPARTICIPANT);
    } catch (...) {
      close();
      throw;
    }
  }
  ~Core() { close(); }
  Core(const Core&) = delete;
  Core& operator=(const Core&) = delete;

  void close() {
    if (participant > 0) dds_delete(participant);
    if (domain > 0) dds_delete(domain);
  }

  dds_entity_t topic(const std::string& name, const dds_topic_descriptor_t& descriptor) {
    const std::lock_guard lock(mutex);
    dds_entity_t& entity = topics[name + " " + descriptor.m_typename];
    if (entity == 0)
      entity = good(dds_create_topic(participant, &descriptor, wire_topic(name).c_str(), nullptr, nullptr),
                    "cannot use the topic " + name);
    return entity;
  }

  // What the process behind an endpoint says of itself.
  std::string who(const dds_guid_t& key) const {
    void* samples[endpoints_read] = {nullptr};
    dds_sample_info_t infos[endpoints_read];
    std::string text = "an unnamed process";
    const dds_return_t count = dds_read(participants, samples, infos, endpoints_read, endpoints_read);
    for (dds_return_t i = 0; i < count; ++i) {
      const auto* one = static_cast<const dds_builtintopic_participant_t*>(samples[i]);
      if (!infos[i].valid_data || std::memcmp(&one->key, &key, sizeof key) != 0) continue;
      const auto property = [&](const char* name, const char* before) {
        char* value = nullptr;
        if (!dds_qget_prop(one->qos, name, &value) || value == nullptr) return std::string();
        const std::string found = before + std::string(value);
        dds_free(value);
        return found;
      };
      const std::string process = property("__ProcessName", "");
      if (!process.empty()) text = process + property("__Pid", " ") + property("__Hostname", " on ");
    }
    if (count > 0) dds_return_loan(participants, samples, count);
    return text;
  }

  std::vector<Endpoint> others(dds_entity_t reader, const std::string& topic) const {
    void* samples[endpoints_read] = {nullptr};
    dds_sample_info_t infos[endpoints_read];
    std::vector<Endpoint> found;
    const std::string name = wire_topic(topic);
    const dds_return_t count = dds_read(reader, samples, infos, endpoints_read, endpoints_read);
    for (dds_return_t i = 0; i < count; ++i) {
      const auto* one = static_cast<const dds_builtintopic_endpoint_t*>(samples[i]);
      if (!infos[i].valid_data || infos[i].instance_state != DDS_IST_ALIVE || name != one->topic_name) continue;
      if (std::memcmp(&one->participant_key, &own, sizeof own) == 0) continue;
      found.push_back({ros_type(one->type_name), who(one->participant_key)});
    }
    if (count > 0) dds_return_loan(reader, samples, count);
    return found;
  }
};

Link::Link(const LinkConfig& config) : core_(std::make_shared<Core>(config)) {}
Link::~Link() = default;

void Link::wait(std::chrono::nanoseconds at_most) const {
  dds_attach_t woken[1];
  dds_waitset_wait(core_->waitset, woken, 1, at_most.count());
}

std::vector<Endpoint> Link::publishers_of(const std::string& topic) const {
  return core_->others(core_->publications, topic);
}
std::vector<Endpoint> Link::subscribers_of(const std::string& topic) const {
  return core_->others(core_->subscriptions, topic);
}

template <class Message>
Publisher<Message> Link::publisher(const std::string& topic) {
  Publisher<Message> publisher;
  publisher.core_ = core_;
  publisher.writer_ = good(dds_create_writer(core_->participant, core_->topic(topic, Codec<Message>::descriptor()),
                                             qos_of(Delivery::reliable, 1).get(), nullptr),
                           "cannot publish " + topic);
  return publisher;
}

template <class Message>
Subscription<Message> Link::subscription(const std::string& topic, Delivery delivery, int depth) {
  Subscription<Message> subscription;
  subscription.core_ = core_;
  subscription.reader_ = good(dds_create_reader(core_->participant, core_->topic(topic, Codec<Message>::descriptor()),
                                                qos_of(delivery, depth).get(), nullptr),
                              "cannot subscribe " + topic);
  const dds_entity_t condition = good(dds_create_readcondition(subscription.reader_, DDS_ANY_STATE), "cannot wait");
  dds_waitset_attach(core_->waitset, condition, condition);
  return subscription;
}

template <class Message>
void Publisher<Message>::write(const Message& message) const noexcept {
  try {
    Encoded<typename Codec<Message>::Wire> encoded;
    Codec<Message>::encode(message, encoded);
    dds_write(writer_, &encoded.wire);
  } catch (...) {  // no memory: the receiver's time-out stops the robot
  }
}

template <class Message>
void Publisher<Message>::flush(std::chrono::nanoseconds at_most) const noexcept {
  dds_wait_for_acks(writer_, at_most.count());
}

template <class Message>
int Publisher<Message>::matched() const noexcept {
  dds_publication_matched_status_t status{};
  return dds_get_publication_matched_status(writer_, &status) == DDS_RETCODE_OK ? static_cast<int>(status.current_count)
                                                                                : 0;
}

template <class Message>
std::vector<Message> Subscription<Message>::take() const {
  constexpr std::uint32_t at_once = 64;
  void* samples[at_once] = {nullptr};
  dds_sample_info_t infos[at_once];
  std::vector<Message> taken;
  while (true) {
    const dds_return_t count = dds_take(reader_, samples, infos, at_once, at_once);
    for (dds_return_t i = 0; i < count; ++i)
      if (infos[i].valid_data)
        taken.push_back(Codec<Message>::decode(*static_cast<const typename Codec<Message>::Wire*>(samples[i])));
    if (count > 0) dds_return_loan(reader_, samples, count);
    if (count < static_cast<dds_return_t>(at_once)) return taken;
  }
}

template <class Message>
int Subscription<Message>::matched() const noexcept {
  dds_subscription_matched_status_t status{};
  return dds_get_subscription_matched_status(reader_, &status) == DDS_RETCODE_OK
             ? static_cast<int>(status.current_count)
             : 0;
}

template <class Message>
std::string type_name() {
  return ros_type(Codec<Message>::descriptor().m_typename);
}

}  // namespace tagdock::ros2

#include "app/robots/ros2/link_messages.h"
