#include "app/cameras/gige_process.h"

#include <arpa/inet.h>
#include <atomic>
#include <csignal>
#include <fcntl.h>
#include <future>
#include <map>
#include <memory>
#include <mutex>
#include <netinet/in.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>
#include <utility>

#include "app/cameras/gige_client.h"
#include "app/cameras/gige_messages.h"
#include "app/cameras/shared_frames.h"
#include "app/failure.h"

namespace tagdock {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using std::chrono::steady_clock;

constexpr milliseconds report_period{50};

/// All UDP sockets of this process: one of them is where Aravis sends its commands from.
std::vector<LocalPort> udp_ports() {
  std::vector<LocalPort> ports;
  constexpr int most_handles = 256;
  for (int handle = 3; handle < most_handles; ++handle) {
    int type = 0;
    socklen_t size = sizeof type;
    if (::getsockopt(handle, SOL_SOCKET, SO_TYPE, &type, &size) != 0 || type != SOCK_DGRAM) continue;
    sockaddr_in here{};
    size = sizeof here;
    if (::getsockname(handle, reinterpret_cast<sockaddr*>(&here), &size) != 0 || here.sin_family != AF_INET) continue;
    if (here.sin_port != 0) ports.push_back({ntohl(here.sin_addr.s_addr), ntohs(here.sin_port)});
  }
  return ports;
}

class Client {
 public:
  explicit Client(int socket) : socket_(socket), woken_(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK)) {}
  ~Client() { ::close(woken_); }
  Client(const Client&) = delete;
  Client& operator=(const Client&) = delete;

  int run() {
    auto next_report = steady_clock::now();
    while (!end_) {
      pollfd wanted[] = {{socket_, POLLIN, 0}, {woken_, POLLIN, 0}};
      ::poll(wanted, 2, static_cast<int>(report_period.count()) / 2);
      std::uint64_t ignored = 0;
      if ((wanted[1].revents & POLLIN) != 0) (void)!::read(woken_, &ignored, sizeof ignored);
      listen();
      if (opening_.valid() && opening_.wait_for(milliseconds(0)) == std::future_status::ready) finish_opening();
      hand_frame_over();
      if (steady_clock::now() >= next_report || changed_.exchange(false)) {
        say_how_it_is();
        next_report = steady_clock::now() + report_period;
      }
    }
    // A camera that is dead may take seconds to let go; whoever asked for the end does not wait for that.
    if (opening_.valid()) ::_exit(0);
    camera_.reset();
    return 0;
  }

 private:
  void listen() {
    while (auto received = receive_message(socket_)) {
      if (received->handle >= 0) ::close(received->handle);
      if (received->closed) {
        end_ = true;
        return;
      }
      if (const auto request = unpacked_request(received->message.data(), received->message.size()))
        std::visit([this](const auto& one) { obey(one); }, *request);
    }
  }

  void obey(const OpenRequest& request) {
    if (camera_ || opening_.valid()) return;
    GigeClientHooks hooks;
    hooks.pictures = [this](int count, int rows, int columns) { return pictures(count, rows, columns); };
    hooks.changed = [this](const CameraHealth& health) { changed(health); };
    hooks.frame_ready = [this] { wake(); };
    hooks.stuck = [] { ::_exit(gige_client_stuck); };
    opening_ = std::async(std::launch::async, [request, hooks] {
      return open_gige_client(request.settings, steady_clock::time_point(request.session_start), hooks);
    });
  }
  void obey(const FrameReturned& frame) { lent_.erase({frame.memory, frame.slot}); }
  void obey(const AdjustRequest& wanted) {
    if (camera_) camera_->adjust(wanted.exposure_us, wanted.gain);
  }
  void obey(const TriggerRequest&) {
    if (camera_) camera_->trigger();
  }
  void obey(const EndRequest&) { end_ = true; }

  void finish_opening() {
    try {
      camera_ = opening_.get();
      tell_what_was_opened();
    } catch (const Failure& failure) {
      send_message(socket_, packed(ClientReport(OpenFailed{failure.code(), failure.what()})));
      end_ = true;
    }
  }

  void tell_what_was_opened() { send_message(socket_, packed(ClientReport(CameraOpened{camera_->actual()}))); }

  /// Called by the thread that opens the camera, also when it opens it again.
  std::vector<cv::Mat1b> pictures(int count, int rows, int columns) {
    auto memory = std::make_shared<SharedFrames>(count, rows, columns);
    std::vector<cv::Mat1b> pictures;
    for (int i = 0; i < count; ++i)
      pictures.push_back(lent_picture(memory->at(i), rows, columns, [memory] {}));  // keeps the memory
    const std::lock_guard lock(mutex_);
    ++memory_number_;
    send_message(socket_, packed(ClientReport(MemoryMade{memory_number_, count, rows, columns})), memory->handle());
    memory_ = std::move(memory);
    return pictures;
  }

  /// Called by the client's threads: each state is told, even one that is over soon. Counts wait for their frame: woken
  /// for them, `run` would look for it too early.
  void changed(const CameraHealth& health) {
    bool other_state = false;
    {
      const std::lock_guard lock(mutex_);
      other_state = last_health_.state != health.state || last_health_.reason != health.reason;
      const bool opened_again = last_health_.state != "streaming" && health.state == "streaming";
      last_health_ = health;
      if (other_state) send_message(socket_, packed(ClientReport(HealthReport{health})));
      // Aravis has the camera's control and no stream yet.
      if (other_state && health.state == "claiming")
        send_message(socket_, packed(ClientReport(SocketsMade{udp_ports()})));
      if (opened_again) opened_again_ = true;
    }
    changed_ = true;
    if (other_state) wake();
  }

  void wake() const {
    const std::uint64_t one = 1;
    (void)!::write(woken_, &one, sizeof one);
  }

  void say_how_it_is() {
    const std::lock_guard lock(mutex_);
    send_message(socket_, packed(ClientReport(HealthReport{last_health_})));
  }

  void hand_frame_over() {
    if (!camera_) return;
    if (opened_again_.exchange(false)) tell_what_was_opened();
    std::optional<CameraFrame> taken = camera_->newest(nanoseconds(0));
    if (!taken) return;
    if (changed_.exchange(false)) say_how_it_is();  // whoever has the frame finds it counted
    const cv::Mat1b& gray = taken->frame.gray;
    FrameReady ready;
    {
      const std::lock_guard lock(mutex_);
      if (!memory_) return;
      ready.slot = memory_->index_of(gray.data);
      ready.memory = memory_number_;
    }
    if (ready.slot < 0) return;  // of a connection that is over
    ready.rows = gray.rows;
    ready.columns = gray.cols;
    ready.number = taken->frame.number;
    ready.lost_before = taken->lost_before;
    ready.time = taken->frame.time;
    ready.arrived = taken->arrived;
    ready.camera_time = taken->camera_time;
    ready.exposure_us = taken->exposure_us;
    ready.gain = taken->gain;
    const auto kept = lent_.emplace(std::pair(ready.memory, ready.slot), gray).first;
    if (!send_message(socket_, packed(ClientReport(ready)))) lent_.erase(kept);
  }

  const int socket_;
  const int woken_;
  bool end_ = false;
  std::future<std::unique_ptr<Camera>> opening_;
  std::unique_ptr<Camera> camera_;
  std::map<std::pair<std::uint32_t, std::int32_t>, cv::Mat1b> lent_;  ///< frames that the other process has
  std::atomic<bool> changed_{false};
  std::atomic<bool> opened_again_{false};

  std::mutex mutex_;  ///< guards what follows
  std::shared_ptr<SharedFrames> memory_;
  std::uint32_t memory_number_ = 0;
  CameraHealth last_health_;
};

}  // namespace

int serve_gige_client(int socket) {
  // It is expected to be aborted by bad datagrams; that shall not fill the disk.
  const rlimit none{0, 0};
  ::setrlimit(RLIMIT_CORE, &none);
  std::signal(SIGINT, SIG_IGN);
  std::signal(SIGTERM, SIG_IGN);
  int type = 0;
  socklen_t size = sizeof type;
  if (::getsockopt(socket, SOL_SOCKET, SO_TYPE, &type, &size) != 0 || type != SOCK_SEQPACKET)
    throw Failure(ExitCode::usage, "camera-client is started by tagdock itself, not by hand");
  ::fcntl(socket, F_SETFD, FD_CLOEXEC);
  return Client(socket).run();
}

}  // namespace tagdock
