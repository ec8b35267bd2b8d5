#include "app/session.h"

#include <algorithm>
#include <charconv>
#include <cinttypes>
#include <cstdio>
#include <cstring>
#include <fcntl.h>
#include <map>
#include <set>
#include <sstream>
#include <unistd.h>
#include <zlib.h>

#include "app/failure.h"
#include "app/image_file.h"
#include "app/png_file.h"

namespace tagdock {
namespace {

// In the column `robot`: linked, broken, or broken with the reason after a colon.
constexpr std::string_view robot_broken = "broken";

constexpr std::uintmax_t free_at_start = 2'000'000'000;  // HOUSE.md: a recording does not start with less
constexpr std::uintmax_t free_at_end = 500'000'000;      // and ends here
constexpr std::chrono::seconds look_at_disk_every{1};    // at 1280x1024 and 30 frames a second: 39 MB

constexpr std::array<const char*, 5> stream_files = {"odometry.csv", "sightings.csv", "commands.csv", "phases.csv",
                                                     "events.csv"};
constexpr const char* frames_header =
    "#timestamp [ns],filename,frame_id,t_camera_ns,t_host_ns,exposure_us,gain,lost_before,crc32";

std::uint32_t checksum(const cv::Mat1b& gray) {
  uLong crc = ::crc32(0L, Z_NULL, 0);
  for (int row = 0; row < gray.rows; ++row) crc = ::crc32(crc, gray.ptr(row), static_cast<uInt>(gray.cols));
  return static_cast<std::uint32_t>(crc);
}

std::string number(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.17g", value);
  return text;
}

std::vector<std::string> split(const std::string& text) {
  std::vector<std::string> fields;
  std::string::size_type begin = 0;
  while (true) {
    const auto end = text.find(',', begin);
    fields.push_back(text.substr(begin, end == std::string::npos ? end : end - begin));
    if (end == std::string::npos) return fields;
    begin = end + 1;
  }
}

template <class Number>
bool parse(const std::string& text, Number& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size();
}

bool parse_ns(const std::string& text, std::chrono::nanoseconds& value) {
  std::int64_t count = 0;
  if (!parse(text, count)) return false;
  value = std::chrono::nanoseconds(count);
  return true;
}

bool parse(const std::string& text, Odometry& odometry) {
  const auto fields = split(text);
  return fields.size() >= 6 && parse_ns(fields[0], odometry.time) && parse(fields[1], odometry.T_odom_base.x) &&
         parse(fields[2], odometry.T_odom_base.y) && parse(fields[3], odometry.T_odom_base.yaw) &&
         parse(fields[4], odometry.velocity.linear) && parse(fields[5], odometry.velocity.angular);
}

bool parse(const std::string& text, TickRecord& tick) {
  const auto fields = split(text);
  if (fields.size() < 10 || !parse_ns(fields[0], tick.time) || !parse(fields[1], tick.command.linear) ||
      !parse(fields[2], tick.command.angular) || !parse(fields[5], tick.odometry_read))
    return false;
  tick.phase = fields[3];
  if (!fields[4].empty()) {
    std::uint64_t frame = 0;
    if (!parse(fields[4], frame)) return false;
    tick.frame = frame;
  }
  tick.camera = fields[6];
  tick.request = fields[7];
  tick.robot_linked = fields[8] == "linked";
  if (fields[8].starts_with(robot_broken) && fields[8].size() > robot_broken.size() + 2)
    tick.robot_sentence = fields[8].substr(robot_broken.size() + 2);
  tick.camera_sentence = fields[9];
  return true;
}

bool parse(const std::string& text, RecordedFrame& frame) {
  const auto fields = split(text);
  if (fields.size() < 9 || !parse_ns(fields[0], frame.time) || !parse(fields[2], frame.number) ||
      !parse_ns(fields[3], frame.camera_time) || !parse_ns(fields[4], frame.arrived) ||
      !parse(fields[5], frame.exposure_us) || !parse(fields[6], frame.gain) || !parse(fields[7], frame.lost_before) ||
      !parse(fields[8], frame.crc32))
    return false;
  frame.file = fields[1];
  return true;
}

// The complete lines of a stream; a last line without its end is a record that was being written in a crash.
std::vector<std::string> lines_of(const std::filesystem::path& file, std::vector<std::string>& remarks) {
  std::vector<std::string> lines;
  std::ifstream stream(file, std::ios::binary);
  if (!stream) {
    remarks.push_back(file.filename().string() + " is missing");
    return lines;
  }
  std::string text;
  bool first = true;
  while (std::getline(stream, text)) {
    if (stream.eof()) {
      if (!text.empty()) remarks.push_back(file.filename().string() + ": the last line is cut short and left out");
      break;
    }
    if (!text.empty() && text.back() == '\r') text.pop_back();
    if (!first) lines.push_back(text);
    first = false;
  }
  return lines;
}

/// Whether a frame's file was written to its end; looks at its beginning and its size only.
bool is_whole(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::error_code error;
  const std::uintmax_t size = std::filesystem::file_size(file, error);
  if (!stream || error) return false;
  if (file.extension() == ".png") {
    constexpr std::array<char, 12> end{0, 0, 0, 0, 'I', 'E', 'N', 'D', '\xae', '\x42', '\x60', '\x82'};
    std::array<char, end.size()> last{};
    stream.seekg(-static_cast<std::streamoff>(end.size()), std::ios::end);
    stream.read(last.data(), last.size());
    return stream && last == end;
  }
  std::array<char, 400> head{};
  stream.read(head.data(), head.size() - 1);
  const char* at = std::strchr(head.data(), '\n');
  if (std::strncmp(head.data(), "P5", 2) != 0 || at == nullptr) return false;
  while (at != nullptr && at[1] == '#') at = std::strchr(at + 1, '\n');
  unsigned long width = 0, height = 0;
  int used = 0;
  if (at == nullptr || std::sscanf(at, "%lu %lu 255%n", &width, &height, &used) != 2 || used == 0) return false;
  constexpr unsigned long most = 1UL << 16;
  if (width > most || height > most) return false;
  return size == static_cast<std::uintmax_t>(at - head.data() + used + 1) + std::uintmax_t{width} * height;
}

/// A frame from what its file says of itself; none if it says nothing, or is not whole.
std::optional<RecordedFrame> frame_of_itself(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::string head(400, '\0');
  stream.read(head.data(), static_cast<std::streamsize>(head.size()));
  const auto begin = head.find("tagdock 1 seq=");
  if (begin == std::string::npos || !is_whole(file)) return std::nullopt;
  RecordedFrame frame;
  std::int64_t time = 0;
  std::uint64_t sequence = 0;
  if (std::sscanf(head.c_str() + begin, "tagdock 1 seq=%" SCNu64 " t_ns=%" SCNd64 " id=%" SCNu64 " exp_us=%lf gain=%lf",
                  &sequence, &time, &frame.number, &frame.exposure_us, &frame.gain) != 5)
    return std::nullopt;
  const auto pixels = read_grey(file);
  if (!std::holds_alternative<cv::Mat1b>(pixels)) return std::nullopt;
  frame.file = file;
  frame.time = frame.arrived = frame.camera_time = std::chrono::nanoseconds(time);
  frame.crc32 = checksum(std::get<cv::Mat1b>(pixels));
  return frame;
}

/// Whole frames that have no line, for the program was killed between the two.
void adopt_frames(Session& session, const std::set<std::string>& known) {
  std::error_code error;
  std::vector<std::filesystem::path> found;
  for (std::filesystem::directory_iterator at(session.folder / "cam0" / "data", error), end; !error && at != end;
       at.increment(error))
    if (!known.contains(at->path().filename().string())) found.push_back(at->path());
  std::sort(found.begin(), found.end());
  for (const std::filesystem::path& file : found) {
    const std::string name = file.filename().string();
    if (const auto frame = frame_of_itself(file)) {
      session.frames.push_back(*frame);
      session.remarks.push_back(name + " has no line in data.csv; taken from what it says of itself");
    } else {
      session.remarks.push_back(name + " has no line in data.csv and is not whole; left out");
    }
  }
}

}  // namespace

std::string header(SessionStream stream) {
  switch (stream) {
    case SessionStream::odometry:
      return "time_ns,x,y,yaw,linear,angular";
    case SessionStream::sightings:
      return "time_ns,frame,result,tx,ty,tz,qx,qy,qz,qw,rms_px,chi2,log_odds,tags,unrefined,s00,s01,s02,s03,s04,s05,"
             "s11,s12,s13,s14,s15,s22,s23,s24,s25,s33,s34,s35,s44,s45,s55";
    case SessionStream::commands:
      return "time_ns,linear,angular,phase,frame,odometry_read,camera,request,robot,camera_sentence";
    case SessionStream::phases:
      return "time_ns,from,to,reason";
    case SessionStream::events:
      return "time_ns,text";
  }
  return "";
}

std::string line(const TickRecord& tick) {
  return std::to_string(tick.time.count()) + "," + number(tick.command.linear) + "," + number(tick.command.angular) +
         "," + tick.phase + "," + (tick.frame ? std::to_string(*tick.frame) : "") + "," +
         std::to_string(tick.odometry_read) + "," + tick.camera + "," + tick.request +
         (tick.robot_linked ? ",linked,"
                            : "," + std::string(robot_broken) +
                                  (tick.robot_sentence.empty() ? "" : ": " + tick.robot_sentence) + ",") +
         tick.camera_sentence;
}

std::string line(const Odometry& odometry) {
  return std::to_string(odometry.time.count()) + "," + number(odometry.T_odom_base.x) + "," +
         number(odometry.T_odom_base.y) + "," + number(odometry.T_odom_base.yaw) + "," +
         number(odometry.velocity.linear) + "," + number(odometry.velocity.angular);
}

SessionRecorder::SessionRecorder(const std::filesystem::path& folder, const std::string& session_yaml,
                                 const std::string& sensor_yaml, bool wait, RecorderOptions options)
    : folder_(folder), wait_(wait), options_(std::move(options)) {
  const auto refuse = [&](const std::string& why) {
    throw Failure(ExitCode::usage, "--record " + folder.string() + ": " + why);
  };
  std::error_code error;
  if (std::filesystem::exists(folder_, error) &&
      !(std::filesystem::is_directory(folder_, error) && std::filesystem::is_empty(folder_, error)))
    refuse("exists and is not an empty folder; nothing recorded is ever overwritten, name a new one");
  std::filesystem::create_directories(folder_ / "cam0" / "data", error);
  if (error) refuse("cannot be created: " + error.message());
  if (const std::uintmax_t available = free_space(); available < free_at_start)
    refuse("only " + std::to_string(available / 1'000'000) + " MB are free there; a recording needs 2000 MB");
  const auto write_whole = [&](const std::filesystem::path& file, const std::string& text) {
    std::ofstream stream(file);
    stream << text << std::flush;
    if (!stream) refuse(file.filename().string() + " cannot be written");
  };
  write_whole(folder_ / "session.yaml", session_yaml);
  write_whole(folder_ / "cam0" / "sensor.yaml", sensor_yaml);
  frames_csv_.open(folder_ / "cam0" / "data.csv", std::ios::binary);
  frames_csv_ << frames_header << "\n" << std::flush;
  bool good = static_cast<bool>(frames_csv_);
  for (std::size_t i = 0; i < streams_.size(); ++i) {
    streams_[i].open(folder_ / stream_files[i], std::ios::binary);
    streams_[i] << header(static_cast<SessionStream>(i)) << "\n" << std::flush;
    good = good && streams_[i];
  }
  if (!good) refuse("its CSV files cannot be written");
  thread_ = std::thread([this] { run(); });
  sync_thread_ = std::thread([this] { keep_synced(); });
}

SessionRecorder::~SessionRecorder() { finish(); }

void SessionRecorder::frame(const CameraFrame& frame) {
  std::unique_lock lock(mutex_);
  if (gave_up_ || ending_) return;
  const std::size_t size = frame.frame.gray.total();
  const auto has_room = [&] { return queued_frames_ == 0 || queued_bytes_ + size <= options_.queue_bytes; };
  if (!has_room()) {
    if (!wait_) {
      ++health_.frames_dropped;
      return;
    }
    taken_.wait(lock, [&] { return has_room() || gave_up_; });
  }
  // A frame lies in one of the camera's few places. When the disk lags, it is copied (0.2 ms), or a slow disk would
  // take the places away from the docking.
  constexpr std::size_t most_places = 3;
  CameraFrame kept = frame;
  if (queued_frames_ >= most_places) kept.frame.gray = frame.frame.gray.clone();
  queue_.emplace_back(std::move(kept));
  ++queued_frames_;
  queued_bytes_ += size;
  arrived_.notify_one();
}

void SessionRecorder::line(SessionStream stream, std::string text) {
  const std::lock_guard lock(mutex_);
  if (gave_up_ || ending_) return;
  queue_.emplace_back(Line{stream, std::move(text)});
  arrived_.notify_one();
}

void SessionRecorder::finish() {
  {
    const std::lock_guard lock(mutex_);
    if (!ending_ && health_.frames_dropped > 0)
      queue_.emplace_back(Line{SessionStream::events, "0," + std::to_string(health_.frames_dropped) +
                                                          " frames were not recorded because the disk was too slow"});
    ending_ = true;
    arrived_.notify_one();
  }
  ended_.notify_one();
  if (thread_.joinable()) thread_.join();
  if (sync_thread_.joinable()) sync_thread_.join();
}

RecorderHealth SessionRecorder::health() const {
  const std::lock_guard lock(mutex_);
  return health_;
}

// What others wrote to the same disk is synced with it and can take seconds, so the writer does not wait for it.
void SessionRecorder::keep_synced() {
  const int handle = ::open(folder_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
  if (handle < 0) return;
  std::unique_lock lock(mutex_);
  while (!ended_.wait_for(lock, look_at_disk_every, [this] { return ending_; })) {
    lock.unlock();
    ::syncfs(handle);
    lock.lock();
  }
  ::close(handle);
}

void SessionRecorder::run() {
  while (true) {
    std::deque<Item> items;
    {
      std::unique_lock lock(mutex_);
      arrived_.wait(lock, [this] { return !queue_.empty() || ending_; });
      if (queue_.empty()) break;
      // One frame at a time, with the lines before it, so that a full queue empties as the disk goes.
      while (!queue_.empty()) {
        items.push_back(std::move(queue_.front()));
        queue_.pop_front();
        if (const CameraFrame* frame = std::get_if<CameraFrame>(&items.back())) {
          --queued_frames_;
          queued_bytes_ -= frame->frame.gray.total();
          break;
        }
      }
      taken_.notify_all();
    }
    for (const Item& item : items) std::visit([this](const auto& what) { write(what); }, item);
    for (std::ofstream& stream : streams_) stream.flush();
    const std::lock_guard lock(mutex_);
    if (gave_up_) break;
  }
}

void SessionRecorder::write(const CameraFrame& frame) {
  const cv::Mat1b& gray = frame.frame.gray;
  char name[32];
  std::snprintf(name, sizeof name, "I%06" PRIu64 ".%s", next_file_, options_.compress ? "png" : "pgm");
  char comment[200];
  std::snprintf(comment, sizeof comment, "tagdock 1 seq=%" PRIu64 " t_ns=%" PRId64 " id=%" PRIu64 " exp_us=%g gain=%g",
                next_file_, static_cast<std::int64_t>(frame.frame.time.count()), frame.frame.number, frame.exposure_us,
                frame.gain);
  std::FILE* file = std::fopen((folder_ / "cam0" / "data" / name).c_str(), "wb");
  bool good = file != nullptr;
  if (good && options_.compress) {
    const std::vector<std::uint8_t> bytes = png_of(gray, comment);
    good = std::fwrite(bytes.data(), 1, bytes.size(), file) == bytes.size();
  } else if (good) {
    good = std::fprintf(file, "P5\n# %s\n%d %d\n255\n", comment, gray.cols, gray.rows) > 0;
    for (int row = 0; good && row < gray.rows; ++row)
      good = std::fwrite(gray.ptr(row), 1, static_cast<std::size_t>(gray.cols), file) ==
             static_cast<std::size_t>(gray.cols);
  }
  if (file != nullptr) good = std::fclose(file) == 0 && good;
  if (!good) return give_up(std::string("cannot write ") + name + "; recording ended, the docking goes on");
  std::ostringstream text;
  text << frame.frame.time.count() << "," << name << "," << frame.frame.number << "," << frame.camera_time.count()
       << "," << frame.arrived.count() << "," << number(frame.exposure_us) << "," << number(frame.gain) << ","
       << frame.lost_before << "," << checksum(gray) << "\n";
  frames_csv_ << text.str() << std::flush;  // one write of one whole line
  if (!frames_csv_) return give_up("cannot write cam0/data.csv; recording ended, the docking goes on");
  ++next_file_;
  {
    const std::lock_guard lock(mutex_);
    ++health_.frames_written;
  }
  look_at_disk();
}

std::uintmax_t SessionRecorder::free_space() const {
  if (options_.free_space) return options_.free_space();
  std::error_code error;
  const auto space = std::filesystem::space(folder_, error);
  return error ? free_at_start : space.available;
}

void SessionRecorder::look_at_disk() {
  const auto now = std::chrono::steady_clock::now();
  if (now < next_look_) return;
  next_look_ = now + look_at_disk_every;
  if (free_space() < free_at_end)
    give_up("less than 500 MB are left on the disk; recording ended, the docking goes on");
}

void SessionRecorder::write(const Line& line) {
  std::ofstream& stream = streams_[static_cast<std::size_t>(line.stream)];
  stream << line.text << "\n";
  if (!stream)
    give_up(std::string("cannot write ") + stream_files[static_cast<std::size_t>(line.stream)] +
            "; recording ended, the docking goes on");
}

void SessionRecorder::give_up(const std::string& sentence) {
  const std::lock_guard lock(mutex_);
  gave_up_ = true;
  health_.warning = sentence;
  taken_.notify_all();
}

Session read_session(const std::filesystem::path& folder) {
  Session session;
  session.folder = folder;
  std::ifstream yaml(folder / "session.yaml");
  if (!yaml) throw Failure(ExitCode::usage, folder.string() + ": no session.yaml in it, so not a session folder");
  std::stringstream text;
  text << yaml.rdbuf();
  session.session_yaml = text.str();

  std::set<std::string> known;
  for (const std::string& row : lines_of(folder / "cam0" / "data.csv", session.remarks)) {
    RecordedFrame frame;
    if (!parse(row, frame) || frame.file.has_parent_path()) {
      session.remarks.push_back("cam0/data.csv: not a line of ours: " + row);
      continue;
    }
    known.insert(frame.file.string());
    frame.file = folder / "cam0" / "data" / frame.file;
    std::error_code error;
    if (!std::filesystem::is_regular_file(frame.file, error)) {
      session.remarks.push_back(frame.file.filename().string() + " is missing; its line is left out");
      continue;
    }
    if (!is_whole(frame.file)) {
      session.remarks.push_back(frame.file.filename().string() + " is cut short; its line is left out");
      continue;
    }
    session.frames.push_back(frame);
  }
  adopt_frames(session, known);
  std::stable_sort(session.frames.begin(), session.frames.end(),
                   [](const RecordedFrame& a, const RecordedFrame& b) { return a.time < b.time; });
  const auto read = [&](SessionStream stream) {
    return lines_of(folder / stream_files[static_cast<std::size_t>(stream)], session.remarks);
  };
  for (const std::string& row : read(SessionStream::odometry)) {
    Odometry odometry;
    if (parse(row, odometry))
      session.odometry.push_back(odometry);
    else
      session.remarks.push_back("odometry.csv: not a line of ours: " + row);
  }
  session.commands = read(SessionStream::commands);
  for (const std::string& row : session.commands) {
    TickRecord tick;
    if (parse(row, tick))
      session.ticks.push_back(tick);
    else
      session.remarks.push_back("commands.csv: not a line of ours: " + row);
  }
  session.sightings = read(SessionStream::sightings);
  session.phases = read(SessionStream::phases);
  return session;
}

Frame read_frame(const RecordedFrame& recorded) {
  Frame frame;
  auto image = read_grey(recorded.file);
  if (const std::string* sentence = std::get_if<std::string>(&image)) throw Failure(ExitCode::usage, *sentence);
  frame.gray = std::get<cv::Mat1b>(image);
  if (checksum(frame.gray) != recorded.crc32)
    throw Failure(ExitCode::usage, recorded.file.string() + ": its pixels differ from the checksum in data.csv");
  frame.time = recorded.time;
  frame.number = recorded.number;
  return frame;
}

}  // namespace tagdock
