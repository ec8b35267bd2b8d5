#pragma once

#include <array>
#include <chrono>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <fstream>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include "app/camera.h"
#include "servo/robot.h"

namespace tagdock {

/// The text streams of a session folder besides the camera's.
enum class SessionStream { odometry, sightings, commands, phases, events };

/// First line of a stream's CSV file.
std::string header(SessionStream stream);

/// One control cycle: what went in, so that it can be repeated, and the command that came out.
struct TickRecord {
  std::chrono::nanoseconds time{0};
  Twist2 command;
  std::string phase;                   ///< after the cycle
  std::optional<std::uint64_t> frame;  ///< number of the frame that was used in this cycle
  std::size_t odometry_read = 0;       ///< how many odometry readings were used in this cycle
  std::string camera = "ok";           ///< the camera's state word
  std::string request = "none";        ///< what the operator asked
  bool robot_linked = true;
  std::string camera_sentence;  ///< why the camera is lost, without commas
  std::string robot_sentence;   ///< why the robot is not linked, without commas

  bool operator==(const TickRecord&) const = default;
};

std::string line(const TickRecord& tick);
std::string line(const Odometry& odometry);

struct RecorderHealth {
  std::uint64_t frames_written = 0;
  std::uint64_t frames_dropped = 0;  ///< because the disk was slower than the camera
  std::string warning;               ///< a sentence when recording ended early; the docking goes on
};

struct RecorderOptions {
  bool compress = false;  ///< frames as PNG instead of PGM
  /// Free bytes of the disk; empty: as the file system says. For tests.
  std::function<std::uintmax_t()> free_space;
  /// Bytes of pictures that may wait for the disk: 6 s at 1280x1024 and 30 frames a second.
  std::size_t queue_bytes = 256'000'000;
};

/// Writes a session folder (CONTRACTS.md) from a thread of its own, so that the control loop never waits for the disk.
/// Each frame is a file that describes itself; its CSV line follows when the file is complete, so a crash costs at most
/// the frame that was being written; the disk is brought up to date every second, so a power cut costs about that.
/// Recording ends, with a warning, when less than 500 MB are left.
class SessionRecorder {
 public:
  /// Creates the folder and writes session.yaml first.
  /// @param wait  let the caller wait for the disk instead of dropping frames (simulations without a clock)
  /// Throws Failure(usage) when the folder exists and is not empty, cannot be written, or less than 2 GB are free.
  SessionRecorder(const std::filesystem::path& folder, const std::string& session_yaml, const std::string& sensor_yaml,
                  bool wait, RecorderOptions options = {});
  /// Writes what is queued and ends.
  ~SessionRecorder();
  SessionRecorder(const SessionRecorder&) = delete;
  SessionRecorder& operator=(const SessionRecorder&) = delete;

  void frame(const CameraFrame& frame);
  void line(SessionStream stream, std::string text);

  /// Writes what is queued, ends the thread; called by the destructor too.
  void finish();

  [[nodiscard]] RecorderHealth health() const;

 private:
  struct Line {
    SessionStream stream;
    std::string text;
  };
  using Item = std::variant<CameraFrame, Line>;

  void run();
  void keep_synced();
  void write(const CameraFrame& frame);
  void write(const Line& line);
  void give_up(const std::string& sentence);
  void look_at_disk();
  [[nodiscard]] std::uintmax_t free_space() const;

  std::filesystem::path folder_;
  bool wait_;
  RecorderOptions options_;
  std::ofstream frames_csv_;
  std::array<std::ofstream, 5> streams_;
  std::uint64_t next_file_ = 0;
  std::chrono::steady_clock::time_point next_look_{};

  mutable std::mutex mutex_;
  std::condition_variable arrived_;
  std::condition_variable taken_;
  std::condition_variable ended_;
  std::deque<Item> queue_;
  std::size_t queued_frames_ = 0;
  std::size_t queued_bytes_ = 0;  ///< of their pictures
  bool ending_ = false;
  bool gave_up_ = false;
  RecorderHealth health_;
  std::thread thread_;
  std::thread sync_thread_;
};

/// A frame as it lies in a session folder.
struct RecordedFrame {
  std::filesystem::path file;
  std::chrono::nanoseconds time{0};
  std::uint64_t number = 0;
  std::chrono::nanoseconds camera_time{0};
  std::chrono::nanoseconds arrived{0};
  double exposure_us = 0.0;
  double gain = 0.0;
  std::uint64_t lost_before = 0;
  std::uint32_t crc32 = 0;
};

/// A recorded session, read back. What is damaged is left out and said in `remarks`; nothing is repaired in place. A
/// whole frame without a line in data.csv (the program was killed between the two) is taken from what it says of
/// itself.
struct Session {
  std::filesystem::path folder;
  std::string session_yaml;
  std::vector<RecordedFrame> frames;
  std::vector<Odometry> odometry;
  std::vector<TickRecord> ticks;
  std::vector<std::string> sightings;  ///< lines without the header
  std::vector<std::string> commands;
  std::vector<std::string> phases;
  std::vector<std::string> remarks;
};

/// Throws Failure(usage) when the folder is no session.
Session read_session(const std::filesystem::path& folder);

/// Reads the pixels of a recorded frame.
/// Throws Failure(usage) with the file's name when it is missing, cut short or differs from its checksum.
Frame read_frame(const RecordedFrame& recorded);

}  // namespace tagdock
