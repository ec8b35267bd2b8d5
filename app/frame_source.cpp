#include "app/frame_source.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <memory>
#include <sstream>

#include <opencv2/imgproc.hpp>
#include <opencv2/videoio.hpp>

#include "app/cameras/image_sequence.h"
#include "app/failure.h"
#include "app/image_file.h"
#include "app/session.h"

namespace tagdock {
namespace {

using std::chrono::nanoseconds;
namespace fs = std::filesystem;

std::function<cv::Mat1b()> loader(const fs::path& file) {
  return [file] {
    auto image = read_grey(file);
    if (const std::string* sentence = std::get_if<std::string>(&image)) throw Failure(ExitCode::usage, *sentence);
    return std::get<cv::Mat1b>(image);
  };
}

template <class Number>
bool parse(const std::string& text, Number& value) {
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  return error == std::errc() && end == text.data() + text.size();
}

/// Lines "time<separator>file" of a list; `file` is relative to `folder` and stays inside it.
void read_list(const fs::path& list, char separator, const fs::path& folder,
               const std::function<bool(const std::string&, nanoseconds&)>& time_of, FrameSource& source) {
  std::ifstream stream(list);
  std::size_t number = 0;
  for (std::string line; std::getline(stream, line);) {
    ++number;
    while (!line.empty() && (line.back() == '\r' || line.back() == ' ')) line.pop_back();
    if (line.empty() || line.front() == '#') continue;
    const auto refuse = [&](const std::string& why) {
      source.remarks.push_back(list.filename().string() + ":" + std::to_string(number) + ": " + why);
    };
    const auto comma = line.find(separator);
    std::string file = comma == std::string::npos ? "" : line.substr(comma + 1);
    file.erase(0, std::min(file.find_first_not_of(' '), file.size()));
    file = file.substr(0, file.find(separator));
    nanoseconds time{0};
    if (comma == std::string::npos || !time_of(line.substr(0, comma), time)) {
      refuse("not a time and a file");
      continue;
    }
    if (file.empty() || fs::path(file).is_absolute() || file.find("..") != std::string::npos) {
      refuse("the file is not inside the folder");
      continue;
    }
    if (std::error_code error; !fs::is_regular_file(folder / file, error)) {
      refuse(file + " is missing");
      continue;
    }
    source.frames.push_back({file, (folder / file).string(), time, source.frames.size(), loader(folder / file)});
  }
  std::stable_sort(source.frames.begin(), source.frames.end(),
                   [](const SourceFrame& a, const SourceFrame& b) { return a.time < b.time; });
}

/// Reads one after the other without going back; a picture out of turn is sought.
class Video {
 public:
  explicit Video(const std::string& file) : file_(file), video_(file) {}
  [[nodiscard]] bool opened() const { return video_.isOpened(); }
  [[nodiscard]] double rate() const { return video_.get(cv::CAP_PROP_FPS); }
  [[nodiscard]] double count() const { return video_.get(cv::CAP_PROP_FRAME_COUNT); }
  cv::Mat1b read(std::int64_t index) {
    if (index != next_) video_.set(cv::CAP_PROP_POS_FRAMES, static_cast<double>(index));
    cv::Mat image;
    if (!video_.read(image))
      throw Failure(ExitCode::usage, file_ + ": picture " + std::to_string(index) + " cannot be read");
    next_ = index + 1;
    cv::Mat1b gray;
    if (image.channels() == 3)
      cv::cvtColor(image, gray, cv::COLOR_BGR2GRAY);
    else
      image.convertTo(gray, CV_8U);
    return gray;
  }

 private:
  std::string file_;
  cv::VideoCapture video_;
  std::int64_t next_ = 0;
};

FrameSource session_frames(const std::string& where) {
  FrameSource source{"session", {}, {}};
  const Session session = read_session(where);
  source.remarks = session.remarks;
  for (const RecordedFrame& frame : session.frames)
    source.frames.push_back({frame.file.filename().string(), frame.file.string(), frame.time, frame.number,
                             [frame] { return read_frame(frame).gray; }});
  return source;
}

FrameSource video_frames(const std::string& where) {
  FrameSource source{"video", {}, {}};
  // OpenCV asks every plugin it has about a file that is not there.
  if (!std::filesystem::is_regular_file(where))
    throw Failure(ExitCode::usage, where + ": there is no such folder, pattern of numbered files or video");
  auto video = std::make_shared<Video>(where);
  const double rate = video->opened() ? video->rate() : 0.0;
  const double count = video->opened() ? video->count() : 0.0;
  constexpr double most = 1e7;
  if (!(rate > 0.0 && rate < 1e4 && count >= 1.0 && count < most))
    throw Failure(ExitCode::usage,
                  where + ": neither a folder, a numbered pattern such as I%04d.pgm, nor a video that can be read");
  for (std::int64_t i = 0; i < static_cast<std::int64_t>(count); ++i)
    source.frames.push_back({where + "#" + std::to_string(i), "",
                             nanoseconds(std::llround(1e9 * static_cast<double>(i) / rate)),
                             static_cast<std::uint64_t>(i), [video, i] { return video->read(i); }});
  return source;
}

}  // namespace

FrameSource open_frames(const std::string& where, double rate) {
  const fs::path folder(where);
  std::error_code error;
  const auto ns_of = [](const std::string& text, nanoseconds& time) {
    std::int64_t count = 0;
    const bool good = parse(text, count);
    time = nanoseconds(count);
    return good;
  };
  const auto seconds_of = [](const std::string& text, nanoseconds& time) {
    double seconds = 0.0;
    if (!parse(text, seconds) || !std::isfinite(seconds) || std::abs(seconds) > 9e9) return false;
    // Seconds since 1970 with six decimals: a double would keep 0.2 us, so the decimals are read on their own.
    const auto point = text.find('.');
    std::int64_t whole = 0, part = 0;
    std::string decimals = point == std::string::npos ? "" : text.substr(point + 1).substr(0, 9);
    const std::string digits = text.substr(0, point);
    if (digits.find_first_not_of("0123456789") != std::string::npos || digits.empty() || !parse(digits, whole)) {
      time = nanoseconds(std::llround(1e9 * seconds));
      return true;
    }
    decimals.resize(9, '0');
    if (!parse(decimals, part)) return false;
    time = nanoseconds(whole * 1'000'000'000 + part);
    return true;
  };
  FrameSource source;
  if (fs::is_regular_file(folder / "session.yaml", error)) {
    source = session_frames(where);
  } else if (const auto euroc = {folder / "mav0" / "cam0", folder / "cam0"};
             std::any_of(euroc.begin(), euroc.end(),
                         [&](const fs::path& cam) { return fs::is_regular_file(cam / "data.csv", error); })) {
    const fs::path cam =
        fs::is_regular_file(folder / "mav0" / "cam0" / "data.csv", error) ? folder / "mav0" / "cam0" : folder / "cam0";
    source.kind = "euroc";
    read_list(cam / "data.csv", ',', cam / "data", ns_of, source);
  } else if (fs::is_regular_file(folder / "rgb.txt", error)) {
    source.kind = "tum";
    read_list(folder / "rgb.txt", ' ', folder, seconds_of, source);
  } else if (fs::is_directory(folder, error) || where.find('%') != std::string::npos) {
    source.kind = "images";
    for (const fs::path& file : list_images(where)) {
      const std::size_t index = source.frames.size();
      source.frames.push_back({file.string(), file.string(),
                               nanoseconds(std::llround(1e9 * static_cast<double>(index) / rate)), index,
                               loader(file)});
    }
  } else {
    source = video_frames(where);
  }
  if (source.frames.empty()) throw Failure(ExitCode::usage, where + ": there is no picture in it that can be used");
  return source;
}

void keep_between(FrameSource& source, double from_s, double to_s) {
  if (source.frames.empty()) return;
  const nanoseconds first = source.frames.front().time;
  std::erase_if(source.frames, [&](const SourceFrame& frame) {
    const double seconds = std::chrono::duration<double>(frame.time - first).count();
    return seconds < from_s || seconds > to_s;
  });
}

}  // namespace tagdock
