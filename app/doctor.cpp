// Verb: doctor. Is this machine, camera and configuration fit, and what to do if not.
#include <arpa/inet.h>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <memory>
#include <netinet/in.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/timex.h>
#include <thread>
#include <unistd.h>

#include <nlohmann/json.hpp>

#include "app/cameras/gige.h"
#include "app/cameras/gvcp_probe.h"
#include "app/cameras/receive_buffer.h"
#include "app/config.h"
#include "app/failure.h"
#include "app/rig_file.h"
#include "app/robots/ros2.h"
#include "app/ros2_options.h"
#include "app/verbs.h"
#include "servo/line_following.h"

namespace tagdock {
namespace {

enum class Verdict { good, advice, fault };

struct Finding {
  Verdict verdict;
  std::string what;
  std::string cure;  ///< what a person can do; empty when good
};

struct DoctorOptions {
  std::string config;
  std::string camera;
  std::string rig;
  std::string board;
  std::string record = ".";
  std::string robot;
  std::optional<int> domain;
  std::string name_space;
  std::vector<std::string> remaps;
  bool json = false;
};

Finding check_loopback() {
  const int socket = ::socket(AF_INET, SOCK_DGRAM, 0);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  const bool good = socket >= 0 && ::bind(socket, reinterpret_cast<sockaddr*>(&address), sizeof address) == 0;
  if (socket >= 0) ::close(socket);
  if (good) return {Verdict::good, "the loopback device carries 127.0.0.1", ""};
  return {Verdict::fault, "the loopback device does not carry 127.0.0.1", "as root: ip link set lo up"};
}

Finding check_receive_buffer(const Config& config) {
  const RegionSize size{config.rig.camera.width, config.rig.camera.height};
  const std::size_t needed = needed_receive_buffer(size);
  const std::size_t granted = granted_receive_buffer(needed);
  const std::string figures = "receive buffer for " + std::to_string(size.width) + "x" + std::to_string(size.height) +
                              ": " + std::to_string(granted) + " of " + std::to_string(needed) + " bytes granted";
  if (granted >= needed) return {Verdict::good, figures, ""};
  const SmallerImage coarser = image_that_fits(size, granted, 2);
  const RegionSize part = region_that_fits(size, granted);
  return {Verdict::advice,
          figures + "; frames would be " + std::to_string(coarser.size.width) + "x" +
              std::to_string(coarser.size.height) + " only, from a camera that cannot bin pixels " +
              std::to_string(part.width) + "x" + std::to_string(part.height) + " of the view",
          "as root: sysctl -w net.core.rmem_max=" + std::to_string(needed) +
              "   (and the same line in /etc/sysctl.d to keep it)"};
}

Finding check_camera(const Config& config) {
  const std::string& source = config.camera.source;
  if (source == "sim") {
    if (!gvcp_port_is_taken(LoopbackAddress("127.0.0.1")))
      return {Verdict::good, "port 3956 of 127.0.0.1 is free for the simulated camera", ""};
    return {Verdict::fault, "port 3956 of 127.0.0.1 is taken, so the simulated camera cannot start",
            "end the other camera simulator (often another tagdock dock)"};
  }
  if (source.starts_with("gige:") && source.find('.') != std::string::npos) {
    const LoopbackAddress address(source.substr(5));
    if (const auto camera = probe_camera(address, std::chrono::milliseconds(500)))
      return {Verdict::good,
              "a camera answers at " + address.text() + ": " + camera->vendor + " " + camera->model + ", serial " +
                  camera->serial,
              ""};
    return {Verdict::fault, "no camera answers at " + address.text(), "is it powered, and is the address right?"};
  }
  if (source.starts_with("gige:")) {
    for (const CameraIdentity& camera : probe_loopback(std::chrono::milliseconds(500)))
      if (camera.serial == source.substr(5))
        return {Verdict::good, "camera " + camera.serial + " answers at " + camera.address, ""};
    return {Verdict::fault, "no camera with serial " + source.substr(5) + " answers on the loopback device",
            "is it powered, and is the serial number right?"};
  }
  const std::string folder = source.starts_with("images:") ? source.substr(7) : source;
  std::error_code error;
  if (std::filesystem::is_directory(folder, error)) return {Verdict::good, "images from " + folder, ""};
  return {Verdict::fault, "camera " + source + ": not a folder of images",
          "sim, gige:127.x.y.z, gige:SERIAL or images:DIR"};
}

Finding check_control(const Config& config) {
  if (!config.camera.source.starts_with("gige:") || config.camera.source.find('.') == std::string::npos)
    return {Verdict::good, "no network camera is asked for, so nobody can hold its control", ""};
  const LoopbackAddress address(config.camera.source.substr(5));
  const auto controlled = is_controlled(address, std::chrono::milliseconds(200));
  if (controlled.value_or(false))
    return {Verdict::fault, "another program controls the camera at " + address.text(),
            "end that program; one that crashed lets go after 3 s"};
  if (!controlled)
    return {Verdict::advice, "whether another program controls the camera at " + address.text() + " cannot be asked",
            "as for the camera itself"};
  return {Verdict::good, "nobody else controls the camera at " + address.text(), ""};
}

Finding check_untested(const Config& config) {
  std::string used;
  const auto name = [&used](const char* key) { used += std::string(used.empty() ? "" : ", ") + "camera." + key; };
  if (config.camera.ptp) name("ptp");
  if (config.camera.chunks) name("chunks");
  if (config.camera.pixel_format != "Mono8") name("pixel_format");
  const std::string what =
      "no real GigE camera was ever tried. With the simulated one: packet resend, software trigger, chunk data, pixels "
      "of 10, 12 and 16 bits, PTP status. With none: the clock by PTP, packet sizes beyond the loopback device";
  if (used.empty()) return {Verdict::good, what + ". Nothing of it is switched on", ""};
  return {Verdict::advice, what + ". Switched on: " + used,
          "try it with your camera (tagdock record) before relying on it, or leave it off"};
}

Finding check_client() {
  try {
    GigeSettings nobody;
    nobody.address = "127.255.255.254";  // never given to a camera
    (void)open_gige(nobody, std::chrono::steady_clock::now());
  } catch (const Failure& failure) {
    const std::string sentence = failure.what();
    if (sentence.find("no camera at") != std::string::npos)
      return {Verdict::good, "the process that talks to GigE cameras starts and answers", ""};
    return {Verdict::fault, "GigE cameras cannot be used: " + sentence,
            "install libaravis-0.8-0, and allow new processes"};
  }
  return {Verdict::advice, "something answers as a camera at 127.255.255.254", "end that program"};
}

Finding check_permissions(const std::string& folder) {
  std::string missing;
  if (::access(folder.c_str(), W_OK) != 0) missing += ", writing to " + folder;
  if (const int socket = ::socket(AF_INET, SOCK_DGRAM, 0); socket >= 0)
    ::close(socket);
  else
    missing += ", UDP sockets";
  if (const int memory = ::memfd_create("doctor", MFD_CLOEXEC); memory >= 0)
    ::close(memory);
  else
    missing += ", shared memory";
  rlimit handles{};
  ::getrlimit(RLIMIT_NOFILE, &handles);
  constexpr rlim_t enough = 256;
  if (handles.rlim_cur < enough) missing += ", " + std::to_string(enough) + " open files (ulimit -n)";
  if (missing.empty()) return {Verdict::good, "sockets, shared memory, open files and " + folder + " are allowed", ""};
  return {Verdict::fault, "not allowed: " + missing.substr(2),
          "give this user the right, or run as another one; root is not needed"};
}

Finding check_calibration(const Config& config, bool given) {
  const CameraModel& camera = config.rig.camera;
  const double view_deg = degrees(horizontal_view(camera));
  char figures[200];
  std::snprintf(figures, sizeof figures,
                "calibration: %dx%d pixels, f %.1f px, view %.0f degrees, camera %.2f m above the floor", camera.width,
                camera.height, camera.fx, view_deg, config.rig.T_base_camera.translation().z());
  const bool centred = std::abs(camera.cx - 0.5 * camera.width) < 0.15 * camera.width &&
                       std::abs(camera.cy - 0.5 * camera.height) < 0.15 * camera.height;
  const bool square = std::abs(camera.fx / camera.fy - 1.0) < 0.05;
  if (!centred || !square)
    return {Verdict::fault, std::string(figures) + "; the centre or the pixels' shape is not a lens'",
            "calibrate again: tagdock calibrate intrinsics"};
  if (!given && config.camera.source != "sim")
    return {Verdict::fault, std::string(figures) + ": the built-in one, not that of your camera",
            "give the result of tagdock calibrate with --rig"};
  return {Verdict::good, figures, ""};
}

Finding check_robot(const Config& config) {
  if (config.robot == "sim") return {Verdict::good, "robot link: the simulated robot, in this process", ""};
  if (config.robot == "none")
    return {Verdict::advice, "robot link: none, so nothing will be driven",
            "set robot in the configuration, or --robot"};
  const std::string where = "robot link: ROS 2 domain " + std::to_string(domain_of(config.ros2)) + " on " +
                            config.ros2.interface + ", " + topic(config.ros2, config.ros2.topics.odom);
  const Ros2Look look = look_for_ros2(config.ros2, std::chrono::seconds(3), std::chrono::seconds(1));
  if (!look.missing.empty())
    return {
        Verdict::fault, where + ": " + look.missing,
        "start the robot; then domain (ROS_DOMAIN_ID, --domain), ros2.interface, --namespace and --remap must agree "
        "with it"};
  char figures[120];
  std::snprintf(figures, sizeof figures, ": %llu odometry readings in 1 s, the largest gap %.0f ms",
                static_cast<unsigned long long>(look.readings), static_cast<double>(look.largest_gap.count()) / 1e6);
  const double silence_ms = static_cast<double>(config.docking.gate.odometry.max_silence.count()) / 1e6;
  constexpr std::uint64_t least = 20;
  if (look.readings < least)
    return {Verdict::fault, where + figures, "docking needs 20 readings a second or more, better 50: raise its rate"};
  // Half of what stops the robot leaves no room for a bad moment.
  if (static_cast<double>(look.largest_gap.count()) / 1e6 > 0.5 * silence_ms)
    return {Verdict::advice,
            where + figures + "; a silence of " + std::to_string(std::lround(silence_ms)) + " ms stops the robot",
            "look for what holds it up: load of either machine, wireless links, a low rate"};
  return {Verdict::good, where + figures, ""};
}

Finding check_clock() {
  timespec resolution{};
  ::clock_getres(CLOCK_MONOTONIC, &resolution);
  if (resolution.tv_sec > 0 || resolution.tv_nsec > 1'000'000)
    return {Verdict::fault, "the steady clock has steps of more than 1 ms", "use a kernel with high-resolution timers"};
  timex state{};
  const bool followed = ::adjtimex(&state) != TIME_ERROR;
  // How late a sleep of 1 ms ends tells how late a control cycle may begin.
  double latest_ms = 0.0;
  for (int i = 0; i < 50; ++i) {
    const auto before = std::chrono::steady_clock::now();
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
    latest_ms = std::max(
        latest_ms, std::chrono::duration<double, std::milli>(std::chrono::steady_clock::now() - before).count() - 1.0);
  }
  char figures[160];
  std::snprintf(figures, sizeof figures, "clock: steady, in steps of %ld ns; a sleep of 1 ms ended up to %.1f ms late",
                resolution.tv_nsec, latest_ms);
  constexpr double late_ms = 20.0;  // a cycle
  if (latest_ms > late_ms)
    return {Verdict::advice, std::string(figures) + ": this machine is busy", "end other work while docking"};
  if (!followed)
    return {Verdict::advice,
            std::string(figures) + "; the wall clock follows no server, so dates of recordings may be off",
            "install systemd-timesyncd or chrony; docking does not need it"};
  return {Verdict::good, figures, ""};
}

Finding check_disk(const std::string& folder) {
  std::error_code error;
  const auto space = std::filesystem::space(folder, error);
  if (error) return {Verdict::fault, folder + ": " + error.message(), "name a folder that exists with --record"};
  const std::string figures = std::to_string(space.available / 1'000'000) + " MB are free at " + folder;
  if (space.available >= 2'000'000'000) return {Verdict::good, figures + " for recordings", ""};
  return {Verdict::advice, figures + "; a recording needs 2000 MB", "free some space, or record elsewhere"};
}

Finding check_view(const Config& config) {
  const DockingConfig& docking = config.docking;
  const LineTarget target{goal_of_axle(docking), camera_point(config.rig).x, 0.5 * horizontal_view(config.rig.camera),
                          docking.board_width};
  const double limit = heading_limit(target, -docking.dock_pose.x, docking.line, true);
  char figures_text[120];
  std::snprintf(figures_text, sizeof figures_text,
                "at the dock the board leaves room for a heading error of %.1f degrees", degrees(limit));
  const std::string figures = figures_text;
  if (limit >= docking.line.min_heading) return {Verdict::good, figures, ""};
  return {Verdict::fault, figures + "; 3 are needed to steer with the board in view",
          "dock farther from the board, use a smaller board, or a wider lens"};
}

Finding check_processors() {
  const unsigned count = std::thread::hardware_concurrency();
  if (count >= 2) return {Verdict::good, std::to_string(count) + " processors", ""};
  return {Verdict::advice, "one processor only",
          "the simulated world and the docking share it; simulate with --speedup, or with a lower camera.frame_rate"};
}

Finding check_screen() {
  if (std::getenv("DISPLAY") != nullptr) return {Verdict::good, "a screen for --view", ""};
  return {Verdict::advice, "no screen, so no --view", "run on a desktop, or under xvfb-run"};
}

int doctor(const DoctorOptions& options) {
  std::vector<Finding> findings;
  Config config;
  try {
    if (!options.config.empty()) config = read_config(options.config);
    if (!options.rig.empty()) config.rig = read_rig(options.rig);
    if (!options.board.empty()) config.board = read_board(options.board);
    if (!options.camera.empty()) config.camera.source = options.camera;
    if (!options.robot.empty()) config.robot = options.robot;
    if (options.domain) config.ros2.domain = *options.domain;
    if (!options.name_space.empty()) config.ros2.name_space = options.name_space;
    for (const std::string& rule : options.remaps) remap(config.ros2, rule);
    config = parse_config(to_yaml(config), "(configuration)");
    findings.push_back(
        {Verdict::good, options.config.empty() ? "the built-in configuration" : options.config + " is sound", ""});
    findings.push_back(check_view(config));
    findings.push_back(check_calibration(config, !options.config.empty() || !options.rig.empty()));
    findings.push_back(check_camera(config));
    findings.push_back(check_control(config));
    findings.push_back(check_untested(config));
    findings.push_back(check_robot(config));
  } catch (const Failure& failure) {
    const std::string sentence = failure.what();
    const bool missing = sentence.find("there is no such file") != std::string::npos;
    findings.push_back({Verdict::fault, sentence, missing ? "give the file's place" : "mend that line"});
  }
  findings.push_back(check_loopback());
  findings.push_back(check_receive_buffer(config));
  findings.push_back(check_client());
  findings.push_back(check_permissions(options.record));
  findings.push_back(check_clock());
  findings.push_back(check_disk(options.record));
  findings.push_back(check_processors());
  findings.push_back(check_screen());

  constexpr const char* words[] = {"good", "advice", "fault"};
  bool faulty = false;
  nlohmann::ordered_json json;
  json["schema"] = "tagdock-doctor/1";
  for (const Finding& finding : findings) {
    faulty = faulty || finding.verdict == Verdict::fault;
    const char* word = words[static_cast<int>(finding.verdict)];
    json["findings"].push_back({{"verdict", word}, {"what", finding.what}, {"cure", finding.cure}});
    if (options.json) continue;
    std::cout << (finding.verdict == Verdict::good     ? "  good    "
                  : finding.verdict == Verdict::advice ? "  advice  "
                                                       : "  FAULT   ")
              << finding.what << "\n";
    if (!finding.cure.empty()) std::cout << "          -> " << finding.cure << "\n";
  }
  json["fit"] = !faulty;
  if (options.json) std::cout << json.dump(2) << "\n";
  return static_cast<int>(faulty ? ExitCode::failed : ExitCode::done);
}

}  // namespace

void add_doctor(CLI::App& program, Action& action) {
  auto options = std::make_shared<DoctorOptions>();
  CLI::App* verb =
      program.add_subcommand("doctor", "Is this machine, camera and configuration fit, and what to do if not.");
  verb->add_option("--config", options->config, "configuration to check (YAML)");
  verb->add_option("--rig", options->rig, "rig file to check");
  verb->add_option("--board", options->board, "board file to check");
  verb->add_option("--camera", options->camera, "sim, gige:127.x.y.z, gige:SERIAL or images:DIR");
  verb->add_option("--robot", options->robot, "sim, ros2 or none");
  add_ros2_options(*verb, options->domain, options->name_space, options->remaps);
  verb->add_option("--record", options->record, "folder where recordings would go")->capture_default_str();
  verb->add_flag("--json", options->json, "findings as JSON");
  verb->footer("Exit code 0 when nothing is at fault, 1 otherwise. Nothing is changed and nothing moves.");
  verb->callback([options, &action] { action = [options] { return doctor(*options); }; });
}

}  // namespace tagdock
