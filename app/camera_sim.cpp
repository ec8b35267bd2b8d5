// Verb: camera-sim. A GigE Vision camera on the loopback device that shows a folder, a session or the simulated world,
// with faults on command: for tests, demonstrations and other GigE Vision software.
#include <atomic>
#include <cmath>
#include <fcntl.h>
#include <filesystem>
#include <functional>
#include <iostream>
#include <memory>
#include <optional>
#include <poll.h>
#include <thread>
#include <unistd.h>

#include <nlohmann/json.hpp>

#include "app/cameras/image_sequence.h"
#include "app/config.h"
#include "app/failure.h"
#include "app/image_file.h"
#include "app/option_checks.h"
#include "app/priority.h"
#include "app/ros2_options.h"
#include "app/session.h"
#include "app/simulation/fault_script.h"
#include "app/simulation/gige_server.h"
#include "app/simulation/live_world.h"
#include "app/simulation/scenario.h"
#include "app/simulation/told_place.h"
#include "app/stop_signal.h"
#include "app/verbs.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;
using std::chrono::steady_clock;

struct CameraSimOptions {
  std::string source = "world";
  GigeServerSettings served;
  double rate = 25.0;
  std::vector<std::string> faults;
  std::string scenario;
  std::string config;
  std::string world = "own";
  std::optional<int> domain;
  std::string name_space;
  std::vector<std::string> remaps;
  std::uint64_t seed = 1;
  double seconds = 0.0;
  bool once = false;
  bool json = false;
};

/// Whatever shows pictures through a camera on the wire.
class Show {
 public:
  virtual ~Show() = default;
  virtual GigeServer& server() = 0;
  [[nodiscard]] virtual bool ended() const { return false; }
};

class WorldShow final : public Show {
 public:
  explicit WorldShow(const CameraSimOptions& options) {
    Config config = options.config.empty() ? Config{} : read_config(options.config);
    if (options.domain) config.ros2.domain = *options.domain;
    if (!options.name_space.empty()) config.ros2.name_space = options.name_space;
    for (const std::string& rule : options.remaps) remap(config.ros2, rule);
    const std::string file = options.scenario.empty() ? config.simulation.scenario : options.scenario;
    Scenario scenario = file.empty() ? Scenario{} : read_scenario(file);
    scenario.camera.frame_rate = options.rate;
    const auto start = steady_clock::now();
    auto world = std::make_shared<SharedWorld>(scenario, config.rig, config.board, options.seed);
    if (options.world == "dds") {
      (void)prefer_this_thread();  // a real camera has its own computer, too
      place_ = std::make_unique<ToldPlace>(world, config.ros2, start);
      place_->wait(std::chrono::duration_cast<nanoseconds>(std::chrono::duration<double>(config.ros2.wait_s)));
    }
    world_ = std::make_unique<LiveWorld>(world, SimulationFaults{}, start, options.served);
  }
  GigeServer& server() override { return world_->server(); }

 private:
  std::unique_ptr<ToldPlace> place_;
  std::unique_ptr<LiveWorld> world_;  // goes first
};

/// One picture of a folder or a session.
struct Slide {
  std::function<cv::Mat1b()> load;
  nanoseconds time{0};  ///< since the first
  std::uint64_t number = 0;
};

/// Pictures one after the other, from the beginning again when they end.
class SlideShow final : public Show {
 public:
  SlideShow(const CameraSimOptions& options, std::vector<Slide> slides, nanoseconds pause)
      : slides_(std::move(slides)), pause_(pause), once_(options.once) {
    const cv::Mat1b first = slides_.front().load();
    GigeServerSettings served = options.served;
    served.width = first.cols;
    served.height = first.rows;
    served.frame_rate = options.rate;
    server_ = std::make_unique<GigeServer>(served);
    thread_ = std::thread([this] { run(); });
  }
  ~SlideShow() override {
    end_ = true;
    thread_.join();
  }
  GigeServer& server() override { return *server_; }
  [[nodiscard]] bool ended() const override { return ended_; }

 private:
  void run() {
    const auto begin = steady_clock::now();
    nanoseconds round_begin{0};
    std::uint64_t number_begin = 1;
    while (!end_) {
      for (const Slide& slide : slides_) {
        const auto due = begin + round_begin + slide.time;
        cv::Mat1b gray;
        try {
          gray = slide.load();
        } catch (const Failure& failure) {
          std::cerr << "camera-sim: " << failure.what() << "\n";
          continue;
        }
        while (!end_ && steady_clock::now() < due)
          std::this_thread::sleep_until(std::min(due, steady_clock::now() + std::chrono::milliseconds(50)));
        if (end_) return;
        try {
          server_->publish({gray, number_begin + slide.number, steady_clock::now() - begin + clock_ahead});
        } catch (const Failure&) {
          std::cerr << "camera-sim: a picture of another size than the first is left out\n";
        }
      }
      round_begin += slides_.back().time + pause_;
      number_begin += slides_.back().number + 1;
      if (!once_) continue;
      std::this_thread::sleep_for(std::chrono::milliseconds(100));  // the last one is on its way
      ended_ = true;
      return;
    }
  }

  // The camera's clock began at another time than this program.
  static constexpr nanoseconds clock_ahead = std::chrono::seconds(1000);

  std::vector<Slide> slides_;
  nanoseconds pause_;
  bool once_;
  std::unique_ptr<GigeServer> server_;
  std::atomic<bool> end_{false};
  std::atomic<bool> ended_{false};
  std::thread thread_;
};

std::unique_ptr<Show> open_show(const CameraSimOptions& options) {
  const nanoseconds period(std::llround(1e9 / options.rate));
  if (options.source == "world") return std::make_unique<WorldShow>(options);
  std::vector<Slide> slides;
  if (std::filesystem::is_regular_file(std::filesystem::path(options.source) / "session.yaml")) {
    const Session session = read_session(options.source);
    for (const std::string& remark : session.remarks) std::cerr << "camera-sim: " << remark << "\n";
    if (session.frames.empty()) throw Failure(ExitCode::usage, options.source + ": no frame was recorded in it");
    for (const RecordedFrame& frame : session.frames)
      slides.push_back({[frame] { return read_frame(frame).gray; }, frame.time - session.frames.front().time,
                        frame.number - session.frames.front().number});
  } else {
    for (const std::filesystem::path& file : list_images(options.source))
      slides.push_back({[file]() -> cv::Mat1b {
                          auto image = read_grey(file);
                          if (const std::string* sentence = std::get_if<std::string>(&image))
                            throw Failure(ExitCode::usage, *sentence);
                          return std::get<cv::Mat1b>(image);
                        },
                        static_cast<std::int64_t>(slides.size()) * period, slides.size()});
  }
  return std::make_unique<SlideShow>(options, std::move(slides), period);
}

std::string status_of(GigeServer& server, nanoseconds now, bool json) {
  const ServedSettings client = server.client();
  const nlohmann::ordered_json status = {
      {"time_s", std::chrono::duration<double>(now).count()},
      {"streaming", client.streaming},
      {"sent", server.sent()},
      {"packets_sent_again", server.sent_again()},
      {"exposure_us", client.exposure_us},
      {"gain_db", client.gain},
      {"frame_rate", client.frame_rate},
      {"region", {client.region.x, client.region.y, client.region.width, client.region.height}}};
  if (json) return status.dump();
  char text[200];
  std::snprintf(text, sizeof text,
                "%s, %llu frames sent, exposure %g us, gain %g dB, %g frames/s, region %dx%d at (%d, %d)",
                client.streaming ? "streaming" : "no client streams", static_cast<unsigned long long>(server.sent()),
                client.exposure_us, client.gain, client.frame_rate, client.region.width, client.region.height,
                client.region.x, client.region.y);
  return text;
}

/// Lines typed at the program; none at the end of the file or without a new one.
class Typed {
 public:
  std::optional<std::string> line(int wait_ms) {
    if (const auto end = text_.find('\n'); end != std::string::npos) {
      std::string one = text_.substr(0, end);
      text_.erase(0, end + 1);
      return one;
    }
    pollfd in{closed_ ? -1 : STDIN_FILENO, POLLIN, 0};
    if (::poll(&in, 1, wait_ms) <= 0) return std::nullopt;
    char part[512];
    const ssize_t size = ::read(STDIN_FILENO, part, sizeof part);
    closed_ = size <= 0;
    if (size > 0) text_.append(part, static_cast<std::size_t>(size));
    return std::nullopt;
  }

 private:
  std::string text_;
  bool closed_ = false;
};

int camera_sim(const CameraSimOptions& options) {
  if (!(options.rate >= 0.5 && options.rate <= 200.0))
    throw Failure(ExitCode::usage, "--rate must be between 0.5 and 200 frames a second");
  std::vector<FaultCommand> script;
  for (const std::string& text : options.faults) script.push_back(parse_fault(text));
  std::stable_sort(script.begin(), script.end(), [](const auto& a, const auto& b) { return a.at < b.at; });
  const StopSignal stop_signal;
  const std::unique_ptr<Show> show = open_show(options);
  const auto begin = steady_clock::now();
  // JSON has stdout for itself.
  (options.json ? std::cerr : std::cout) << "serving " << options.source << " as a GigE Vision camera, serial "
                                         << options.served.serial << ", at " << options.served.address << std::endl;
  Typed typed;
  std::uint64_t seed = options.seed;
  std::size_t done = 0;
  while (!stop_signal.requested() && !show->ended()) {
    const nanoseconds now = steady_clock::now() - begin;
    if (options.seconds > 0.0 && std::chrono::duration<double>(now).count() >= options.seconds) break;
    std::optional<FaultCommand> command;
    if (done < script.size() && script[done].at <= now) {
      command = script[done++];
    } else if (const std::optional<std::string> line = typed.line(20); line && !line->empty()) {
      try {
        command = parse_fault(*line);
      } catch (const Failure& failure) {
        std::cerr << failure.what() << "\n";
      }
    }
    if (!command) continue;
    if (command->what == FaultCommand::What::quit) break;
    // As a camera that lost its power: no answer any more, and nobody is told.
    if (command->what == FaultCommand::What::die) ::_exit(static_cast<int>(ExitCode::done));
    if (command->what == FaultCommand::What::status)
      std::cout << status_of(show->server(), now, options.json) << std::endl;
    else
      apply(*command, show->server(), seed++);
  }
  return static_cast<int>(ExitCode::done);
}

}  // namespace

void add_camera_sim(CLI::App& program, Action& action) {
  auto options = std::make_shared<CameraSimOptions>();
  CLI::App* verb = program.add_subcommand(
      "camera-sim", "A simulated GigE Vision camera on the loopback device, with faults on command.");
  verb->add_option("source", options->source,
                   "world (the simulated room), a session folder, a folder of images, or a numbered pattern")
      ->capture_default_str();
  verb->add_option("--address", options->served.address, "numeric, inside 127.0.0.0/8")->capture_default_str();
  verb->add_option("--serial", options->served.serial, "serial number, at most 15 characters")->capture_default_str();
  verb->add_option("--rate", options->rate, "frames a second; a session keeps its own times")->capture_default_str();
  verb->add_flag("--resend", options->served.resend, "offer to send lost packets again");
  verb->add_flag("--once", options->once, "end after the last picture instead of beginning again");
  verb->add_option("--fault", options->faults, "\"[AFTER_S] COMMAND\", see below; may be given several times")
      ->allow_extra_args(false);
  verb->add_option("--scenario", options->scenario, "world: scenario file (YAML, see data/scenarios)");
  verb->add_option("--config", options->config, "world: configuration (YAML) with the rig and the board");
  verb->add_option("--world", options->world,
                   "own, or dds: the robot is where robot-sim says that it is, on the topic ground_truth")
      ->check(CLI::IsMember({"own", "dds"}))
      ->capture_default_str();
  add_ros2_options(*verb, options->domain, options->name_space, options->remaps);
  verb->add_option("--seed", options->seed, "world and malformed datagrams: seed")->capture_default_str();
  verb->add_option("--seconds", options->seconds, "end after this time; 0 never")
      ->check(not_negative())
      ->capture_default_str();
  verb->add_flag("--json", options->json, "status as JSON");
  verb->footer("Commands, as --fault or typed as lines while it runs:\n" + fault_words() +
               "Examples:\n  tagdock camera-sim world --fault \"5 lose 0.001\" --fault \"20 die\"\n"
               "  tagdock camera-sim photos --address 127.0.0.2 --rate 10\n"
               "  arv-tool-0.8 -a 127.0.0.1 control Width Height ExposureTime\n"
               "Exit codes: 0 done, 2 usage, 3 another camera has the address, 5 nobody says where the robot is.");
  verb->callback([options, &action] { action = [options] { return camera_sim(*options); }; });
}

}  // namespace tagdock
