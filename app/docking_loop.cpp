#include "app/docking_loop.h"

#include <algorithm>
#include <cstdio>

#include "app/failure.h"

namespace tagdock {
namespace {

std::string digits(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.17g", value);
  return text;
}

// Text that goes into one field of a CSV line.
std::string one_field(std::string text) {
  std::replace(text.begin(), text.end(), ',', ';');
  // Also what ends a line elsewhere: the reader takes a '\r' at the end of a line for a part of its end.
  std::replace_if(
      text.begin(), text.end(), [](char c) { return c == '\n' || c == '\r' || c == '\0'; }, ' ');
  return text;
}

struct RequestWord {
  Request request;
  const char* word;
};
constexpr RequestWord request_words[] = {{Request::none, "none"},
                                         {Request::pause, "pause"},
                                         {Request::resume, "resume"},
                                         {Request::cancel, "cancel"},
                                         {Request::stop, "stop"}};

std::string word_of(Request request) {
  for (const RequestWord& known : request_words)
    if (known.request == request) return known.word;
  return "none";
}

}  // namespace

DockingLoop::DockingLoop(const Config& config)
    : locator_(config.rig, config.board, config.locator), docker_(config.rig, config.docking) {}

DockingLoop::Outputs DockingLoop::cycle(const Inputs& inputs) {
  Outputs outputs;
  Tick tick;
  tick.now = inputs.now;
  tick.odometry = inputs.odometry;
  tick.camera = inputs.camera;
  tick.camera_sentence = one_field(inputs.camera_sentence);
  tick.robot_linked = inputs.robot_linked;
  tick.robot_sentence = one_field(inputs.robot_sentence);
  tick.request = inputs.request;
  if (inputs.frame) {
    outputs.sighting = locator_.locate(*inputs.frame, docker_.predicted_view(inputs.frame->time));
    outputs.sighting_line = sighting_line(*inputs.frame, *outputs.sighting);
    tick.sighting = outputs.sighting;
    tick.frame_time = inputs.frame->time;
  }
  const std::string before(name(docker_.phase()));
  outputs.docking = docker_.tick(tick);
  const std::string after(name(docker_.phase()));

  for (const Odometry& odometry : inputs.odometry) outputs.odometry_lines.push_back(line(odometry));
  TickRecord record;
  record.time = inputs.now;
  record.command = outputs.docking.command;
  record.phase = after;
  if (inputs.frame) record.frame = inputs.frame->number;
  record.odometry_read = inputs.odometry.size();
  record.camera = inputs.camera == CameraState::streaming ? "ok" : "lost";
  record.request = word_of(inputs.request);
  record.robot_linked = inputs.robot_linked;
  record.camera_sentence = tick.camera_sentence;
  record.robot_sentence = tick.robot_sentence;
  outputs.command_line = line(record);
  if (outputs.docking.phase_changed) {
    std::string why;
    for (const Event& event : outputs.docking.events) why += (why.empty() ? "" : " | ") + event.text;
    outputs.phase_line = std::to_string(inputs.now.count()) + "," + before + "," + after + "," + one_field(why);
  }
  return outputs;
}

DockingLoop::Inputs inputs_of(const TickRecord& tick, std::vector<Odometry> odometry, std::optional<Frame> frame) {
  DockingLoop::Inputs inputs;
  inputs.now = tick.time;
  inputs.odometry = std::move(odometry);
  inputs.frame = std::move(frame);
  inputs.camera = tick.camera == "ok" ? CameraState::streaming : CameraState::lost;
  inputs.camera_sentence = tick.camera_sentence;
  inputs.robot_linked = tick.robot_linked;
  inputs.robot_sentence = tick.robot_sentence;
  for (const RequestWord& known : request_words)
    if (tick.request == known.word) inputs.request = known.request;
  return inputs;
}

std::string sighting_line(const Frame& frame, const Sighting& sighting) {
  std::string text = std::to_string(frame.time.count()) + "," + std::to_string(frame.number) + ",";
  if (const Unseen* unseen = std::get_if<Unseen>(&sighting))
    return text + std::string(word(*unseen)) + std::string(33, ',');
  const BoardSighting& board = std::get<BoardSighting>(sighting);
  const Eigen::Vector3d t = board.T_camera_station.translation();
  const Eigen::Quaterniond q(board.T_camera_station.linear());
  text += "board";
  for (const double value : {t.x(), t.y(), t.z(), q.x(), q.y(), q.z(), q.w(), board.reprojection_rms_px,
                             board.chi2_per_coordinate, board.log_odds})
    text += "," + digits(value);
  text += ",";
  for (std::size_t i = 0; i < board.tags.size(); ++i) text += (i == 0 ? "" : " ") + std::to_string(board.tags[i].id);
  text += board.unrefined ? ",1" : ",0";
  for (int row = 0; row < 6; ++row)
    for (int column = row; column < 6; ++column) text += "," + digits(board.covariance(row, column));
  return text;
}

}  // namespace tagdock
