#include "app/cameras/gige.h"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <fcntl.h>
#include <map>
#include <memory>
#include <mutex>
#include <poll.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <thread>
#include <unistd.h>
#include <utility>

#include "app/cameras/gige_messages.h"
#include "app/cameras/gige_process.h"
#include "app/cameras/gvcp_probe.h"
#include "app/cameras/mailbox.h"
#include "app/cameras/shared_frames.h"
#include "app/failure.h"

namespace tagdock {
namespace {

using std::chrono::milliseconds;
using std::chrono::nanoseconds;
using std::chrono::steady_clock;

// The client reports every 50 ms; a machine under load may hold it up, and 500 ms is when a camera must be called lost.
constexpr milliseconds silence_is_loss{400};
constexpr milliseconds silence_is_death{2000};
constexpr milliseconds patience_when_opening{15000};  // Aravis tries for 2.5 s at each of several steps
constexpr int deaths_while_opening = 3;               // then it is not bad luck with a datagram
constexpr milliseconds longest_pause{250};            // between two deaths and starts of the client
constexpr milliseconds good_run{5000};                // after which a death counts as the first
constexpr milliseconds patience_at_end{500};

/// The process of the client and our end of the socket pair. Movable; whoever holds it last ends the process.
class ClientProcess {
 public:
  explicit ClientProcess(const std::vector<std::string>& program) {
    int ends[2];
    if (::socketpair(AF_UNIX, SOCK_SEQPACKET | SOCK_CLOEXEC, 0, ends) != 0)
      throw Failure(ExitCode::internal, std::string("no socket pair: ") + std::strerror(errno));
    socket_ = std::shared_ptr<const int>(new int(ends[0]), [](const int* handle) {
      ::close(*handle);
      delete handle;
    });
    std::vector<std::string> words = program;
    if (words.empty()) words = {"/proc/self/exe", gige_client_word};
    std::vector<char*> arguments;
    for (std::string& word : words) arguments.push_back(word.data());
    arguments.push_back(nullptr);
    posix_spawn_file_actions_t actions;
    ::posix_spawn_file_actions_init(&actions);
    ::posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    // GLib writes to both when a datagram is malformed; what is wrong is said by our own sentences.
    if (std::getenv("TAGDOCK_CAMERA_CLIENT_TALKS") == nullptr) {
      ::posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, "/dev/null", O_WRONLY, 0);
      ::posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, "/dev/null", O_WRONLY, 0);
    }
    ::posix_spawn_file_actions_adddup2(&actions, ends[1], gige_client_socket);
    posix_spawnattr_t attributes;
    ::posix_spawnattr_init(&attributes);
    sigset_t none;
    ::sigemptyset(&none);
    ::posix_spawnattr_setsigmask(&attributes, &none);
    ::posix_spawnattr_setpgroup(&attributes, 0);  // Ctrl-C is for us: we end it when the robot stands
    ::posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETPGROUP);
    const int failed = ::posix_spawn(&id_, arguments[0], &actions, &attributes, arguments.data(), environ);
    ::posix_spawnattr_destroy(&attributes);
    ::posix_spawn_file_actions_destroy(&actions);
    ::close(ends[1]);
    if (failed != 0)
      throw Failure(ExitCode::internal,
                    "the camera client " + words.front() + " cannot be started: " + std::strerror(failed));
  }
  ~ClientProcess() { kill(); }
  ClientProcess(const ClientProcess&) = delete;
  ClientProcess& operator=(const ClientProcess&) = delete;

  /// Shared with the frames that are out: they say over it when they are given back.
  [[nodiscard]] const std::shared_ptr<const int>& socket() const { return socket_; }

  void send(const ClientRequest& request) const { send_message(*socket_, packed(request)); }

  /// How it ended, if it has; it ends at once when asked for by `kill`.
  std::string kill() {
    if (id_ <= 0) return {};
    ::kill(id_, SIGKILL);
    return wait(0);
  }

  /// Lets it give the camera back.
  void end() {
    if (id_ <= 0) return;
    send(EndRequest{});
    const auto deadline = steady_clock::now() + patience_at_end;
    while (steady_clock::now() < deadline) {
      if (!wait(WNOHANG).empty()) return;
      std::this_thread::sleep_for(milliseconds(2));
    }
    kill();
  }

  /// A word or two about how it ended; empty if it has not.
  std::string wait(int options) {
    int status = 0;
    if (id_ <= 0 || ::waitpid(id_, &status, options) != id_) return {};
    id_ = 0;
    if (WIFEXITED(status) && WEXITSTATUS(status) == gige_client_stuck) return "it was stuck in malformed packets";
    if (WIFSIGNALED(status)) return "signal " + std::to_string(WTERMSIG(status));
    return "exit code " + std::to_string(WEXITSTATUS(status));
  }

 private:
  pid_t id_ = 0;
  std::shared_ptr<const int> socket_;
};

class IsolatedGige final : public Camera {
 public:
  IsolatedGige(const GigeSettings& settings, steady_clock::time_point session_start)
      : settings_(settings), session_start_(session_start) {
    if (!settings_.address.empty()) look_who_controls(LoopbackAddress(settings_.address));
    start();
    open_first();
    thread_ = std::thread([this] { run(); });
  }

  ~IsolatedGige() override {
    end_ = true;
    thread_.join();
    if (client_) client_->end();
  }

  std::optional<CameraFrame> newest(nanoseconds) override { return mailbox_.take(); }

  CameraHealth health() const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    CameraHealth health = told_;
    health.received += before_.received;
    health.incomplete += before_.incomplete;
    health.lost += before_.lost;
    // What the client's box replaced was never seen here, what ours replaced was never taken.
    health.overwritten += before_.overwritten + overwritten_;
    health.reconnects += before_.reconnects;
    health.stale += before_.stale;
    health.resent += before_.resent;
    health.restarts = restarts_;
    health.history = history_;
    return health;
  }

  CameraSettings actual() const override {
    const std::lock_guard<std::mutex> lock(mutex_);
    return actual_;
  }

  void adjust(double exposure_us, double gain) override { request(AdjustRequest{exposure_us, gain}); }
  void trigger() override { request(TriggerRequest{}); }

 private:
  /// Any thread.
  void request(const ClientRequest& what) {
    std::shared_ptr<const int> socket;
    {
      const std::lock_guard<std::mutex> lock(mutex_);
      socket = socket_;
    }
    if (socket) send_message(*socket, packed(what));
  }

  void enter(const std::string& state, const std::string& reason) {
    const std::lock_guard<std::mutex> lock(mutex_);
    told_.state = state;
    told_.reason = reason;
    remember();
  }

  /// The lock is held.
  void remember() {
    if (!history_.empty() && history_.back().state == told_.state) return;
    constexpr std::size_t remembered = 32;
    history_.push_back({told_.state, steady_clock::now() - session_start_});
    if (history_.size() > remembered) history_.erase(history_.begin());
  }

  /// Another client, which is told to open the camera. A spare one has its start behind it.
  void start() {
    memory_.clear();
    opened_ = false;
    first_of_client_ = true;
    last_end_.clear();
    client_ = spare_ ? std::move(spare_) : std::make_unique<ClientProcess>(settings_.client_program);
    last_word_ = steady_clock::now();
    client_->send(OpenRequest{settings_, session_start_.time_since_epoch()});
    const std::lock_guard<std::mutex> lock(mutex_);
    socket_ = client_->socket();
  }

  /// Before a process is started: a person hears at once why nothing comes, and who does not wait is refused.
  void look_who_controls(const LoopbackAddress& address) const {
    if (!is_controlled(address, milliseconds(50)).value_or(false)) return;
    if (settings_.take_over_wait == milliseconds(0))
      throw Failure(ExitCode::camera, "the camera at " + address.text() +
                                          " is controlled by another program: end that program and try again");
    if (settings_.waiting)
      settings_.waiting("another program controls the camera at " + address.text() + "; waiting whether it is alive");
  }

  void open_first() {
    const auto deadline = steady_clock::now() + patience_when_opening + settings_.take_over_wait;
    int deaths = 0;
    while (!opened_) {
      if (listen()) {
        if (refused_) throw Failure(refused_->code, refused_->sentence);
        continue;
      }
      if (++deaths == deaths_while_opening)
        throw Failure(ExitCode::camera, "the camera client ended " + std::to_string(deaths) +
                                            " times while it opened the camera (" + last_end_ +
                                            "): does something else send to this machine's ports?");
      give_back();
      start();
      if (steady_clock::now() > deadline)
        throw Failure(ExitCode::camera, "the camera client does not come to an end with opening the camera");
    }
  }

  void run() {
    milliseconds pause{0};
    auto opened_at = steady_clock::now();
    while (!end_) {
      if (opened_ && !spare_) spare_ = std::make_unique<ClientProcess>(settings_.client_program);
      if (listen() && !refused_) continue;
      if (refused_) {
        enter("lost", refused_->sentence);
        refused_.reset();
        client_->kill();
        pause = std::max(pause, milliseconds(100));
      }
      lose_client();
      pause = steady_clock::now() - opened_at > good_run ? milliseconds(0)
                                                         : std::min(longest_pause, 2 * pause + milliseconds(10));
      for (const auto until = steady_clock::now() + pause; !end_ && steady_clock::now() < until;)
        std::this_thread::sleep_for(milliseconds(5));
      if (end_) return;
      give_back();
      try {
        start();
      } catch (const Failure& failure) {
        enter("lost", failure.what());
        std::this_thread::sleep_for(longest_pause);
      }
      opened_at = steady_clock::now();
    }
  }

  /// The counts of a client that is gone stay in ours.
  void lose_client() {
    const std::lock_guard<std::mutex> lock(mutex_);
    before_.received += told_.received;
    before_.incomplete += told_.incomplete;
    before_.lost += told_.lost;
    before_.overwritten += told_.overwritten;
    before_.reconnects += told_.reconnects;
    before_.stale += told_.stale;
    before_.resent += told_.resent;
    ++restarts_;
    was_open_ = was_open_ || opened_;
    const std::string reason = told_.state == "lost" && last_end_.empty()
                                   ? told_.reason
                                   : "the process that talks to the camera ended (" + last_end_ +
                                         "), as a malformed datagram makes it do; starting it again";
    told_ = CameraHealth{};
    told_.state = "lost";
    told_.reason = reason;
    remember();
  }

  /// In the place of a client that is gone.
  void give_back() {
    const std::string& address = actual_.address.empty() ? settings_.address : actual_.address;
    if (address.empty()) return;
    give_control_back(LoopbackAddress(address), ports_, milliseconds(20));
    ports_.clear();
  }

  /// Takes what the client says, and notices when it says nothing. @return false when it is gone
  bool listen() {
    pollfd wanted{*client_->socket(), POLLIN, 0};
    constexpr int look_for_end_ms = 20;
    ::poll(&wanted, 1, look_for_end_ms);
    while (auto received = receive_message(*client_->socket())) {
      if (received->closed) {
        last_end_ = client_->kill();
        return false;
      }
      last_word_ = steady_clock::now();
      const auto report = unpacked_report(received->message.data(), received->message.size());
      bool good = report.has_value();
      if (report) good = std::visit([&](const auto& one) { return take(one, received->handle); }, *report);
      if (received->handle >= 0) ::close(received->handle);
      if (!good) {
        client_->kill();
        last_end_ = "it spoke nonsense";
        return false;
      }
    }
    const auto silence = steady_clock::now() - last_word_;
    if (silence > silence_is_death + (opened_ ? milliseconds(0) : milliseconds(2000))) {
      client_->kill();
      last_end_ = "it hung";
      return false;
    }
    if (opened_ && silence > silence_is_loss) enter("lost", "the process that talks to the camera does not answer");
    return true;
  }

  bool take(const MemoryMade& made, int& handle) {
    if (handle < 0) return false;
    try {
      memory_.clear();
      memory_.emplace(made.memory,
                      std::make_shared<SharedFrames>(std::exchange(handle, -1), made.count, made.rows, made.columns));
    } catch (const Failure&) {
      return false;
    }
    return true;
  }

  bool take(const SocketsMade& sockets, int) {
    ports_ = sockets.ports;
    return true;
  }

  bool take(const CameraOpened& opened, int) {
    opened_ = true;
    const std::lock_guard<std::mutex> lock(mutex_);
    actual_ = opened.actual;
    if (was_open_) ++before_.reconnects;
    was_open_ = false;
    // Only the same camera again, whoever answers at its address later.
    const std::size_t space = actual_.identity.rfind(' ');
    if (settings_.serial.empty() && space != std::string::npos) settings_.serial = actual_.identity.substr(space + 1);
    return true;
  }

  bool take(const OpenFailed& failed, int) {
    refused_ = failed;
    return true;
  }

  bool take(const HealthReport& report, int) {
    const std::lock_guard<std::mutex> lock(mutex_);
    told_ = report.health;
    remember();
    return true;
  }

  bool take(const FrameReady& ready, int) {
    const auto found = memory_.find(ready.memory);
    if (found == memory_.end()) return false;
    const std::shared_ptr<SharedFrames>& memory = found->second;
    if (ready.slot < 0 || ready.slot >= memory->count() || ready.rows <= 0 || ready.rows > memory->rows() ||
        ready.columns != memory->columns())
      return false;
    CameraFrame frame;
    // The picture stays where Aravis put it; the last copy of it that goes tells the client.
    frame.frame.gray = lent_picture(memory->at(ready.slot), ready.rows, ready.columns,
                                    [memory, socket = client_->socket(), number = ready.memory, slot = ready.slot] {
                                      send_message(*socket, packed(ClientRequest(FrameReturned{number, slot})));
                                    });
    frame.frame.time = ready.time;
    // The numbers of another client follow on those of the one before.
    if (first_of_client_ && last_number_ != 0)
      number_offset_ = static_cast<std::int64_t>(last_number_ + 1 - ready.number);
    first_of_client_ = false;
    last_number_ = frame.frame.number =
        static_cast<std::uint64_t>(static_cast<std::int64_t>(ready.number) + number_offset_);
    frame.arrived = ready.arrived;
    frame.camera_time = ready.camera_time;
    frame.exposure_us = ready.exposure_us;
    frame.gain = ready.gain;
    frame.lost_before = ready.lost_before;
    const bool overwrote = mailbox_.put(std::move(frame));
    const std::lock_guard<std::mutex> lock(mutex_);
    overwritten_ += overwrote ? 1 : 0;
    return true;
  }

  GigeSettings settings_;
  const steady_clock::time_point session_start_;
  Mailbox<CameraFrame> mailbox_;
  std::atomic<bool> end_{false};

  mutable std::mutex mutex_;  ///< guards what follows
  std::shared_ptr<const int> socket_;
  CameraHealth told_;    ///< by the present client
  CameraHealth before_;  ///< the sums of those before it
  std::uint64_t overwritten_ = 0;
  std::uint64_t restarts_ = 0;
  std::vector<CameraStateChange> history_;
  CameraSettings actual_;

  // Of the thread that listens (and of the constructor before it).
  std::unique_ptr<ClientProcess> client_;
  std::unique_ptr<ClientProcess> spare_;  ///< started, and told nothing yet: it opens the camera when the other dies
  std::map<std::uint32_t, std::shared_ptr<SharedFrames>> memory_;
  std::vector<LocalPort> ports_;
  steady_clock::time_point last_word_{};
  std::string last_end_;
  std::optional<OpenFailed> refused_;
  bool opened_ = false;
  bool was_open_ = false;
  bool first_of_client_ = true;
  std::uint64_t last_number_ = 0;
  std::int64_t number_offset_ = 0;

  std::thread thread_;
};

}  // namespace

std::unique_ptr<Camera> open_gige(const GigeSettings& settings, steady_clock::time_point session_start) {
  return std::make_unique<IsolatedGige>(settings, session_start);
}

}  // namespace tagdock
