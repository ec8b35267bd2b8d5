// Verb: doctor. Is this machine, camera and configuration fit, and what to do if not.
#include <arpa/inet.h>
#include <cstdlib>
#include <filesystem>
#include <iostream>
#include <memory>
#include <netinet/in.h>
#include <sys/socket.h>
#include <thread>
#include <unistd.h>

#include <nlohmann/json.hpp>

#include "app/cameras/gvcp_probe.h"
#include "app/cameras/receive_buffer.h"
#include "app/config.h"
#include "app/failure.h"
#include "app/rig_file.h"
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
  const std::string figures =
      "at the dock the board leaves room for a heading error of " + std::to_string(degrees(limit)) + " degrees";
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
    config = parse_config(to_yaml(config), "(configuration)");
    findings.push_back(
        {Verdict::good, options.config.empty() ? "the built-in configuration" : options.config + " is sound", ""});
    findings.push_back(check_view(config));
    findings.push_back(check_camera(config));
  } catch (const Failure& failure) {
    findings.push_back({Verdict::fault, failure.what(), "mend that line"});
  }
  findings.push_back(check_loopback());
  findings.push_back(check_receive_buffer(config));
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
  verb->add_option("--record", options->record, "folder where recordings would go")->capture_default_str();
  verb->add_flag("--json", options->json, "findings as JSON");
  verb->footer("Exit code 0 when nothing is at fault, 1 otherwise. Nothing is changed and nothing moves.");
  verb->callback([options, &action] { action = [options] { return doctor(*options); }; });
}

}  // namespace tagdock
