#include "app/campaign.h"

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <cstdio>
#include <exception>
#include <fcntl.h>
#include <fstream>
#include <map>
#include <mutex>
#include <sstream>
#include <sys/file.h>
#include <thread>
#include <unistd.h>

#include "app/distance_looks.h"
#include "app/failure.h"

namespace tagdock {
namespace {

constexpr const char* runs_file = "runs.csv";
constexpr const char* campaign_file = "campaign.yaml";
constexpr const char* share_file = "share.yaml";
constexpr const char* traces_folder = "traces";

std::string digits(double value) {
  char text[32];
  std::snprintf(text, sizeof text, "%.17g", value);
  return text;
}

std::string pose_fields(const std::optional<Pose2>& pose) {
  if (!pose) return ",,,";
  return "," + digits(pose->x) + "," + digits(pose->y) + "," + digits(pose->yaw);
}

std::vector<std::string> fields_of(const std::string& text) {
  std::vector<std::string> fields;
  std::string field;
  std::istringstream stream(text);
  while (std::getline(stream, field, ',')) fields.push_back(field);
  if (!text.empty() && text.back() == ',') fields.emplace_back();
  return fields;
}

std::string contents(const std::filesystem::path& file) {
  std::ifstream stream(file, std::ios::binary);
  std::ostringstream text;
  text << stream.rdbuf();
  return text.str();
}

void write(const std::filesystem::path& file, const std::string& text) {
  // First beside it, then in its place: a reader never sees half a file.
  const std::filesystem::path beside = file.string() + ".new";
  {
    std::ofstream stream(beside, std::ios::binary);
    stream << text << std::flush;
    if (!stream) throw Failure(ExitCode::usage, file.string() + ": cannot be written");
  }
  std::filesystem::rename(beside, file);
}

void make_folder(const std::filesystem::path& folder) {
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) throw Failure(ExitCode::usage, folder.string() + ": cannot be made: " + error.message());
}

class RecordReader {
 public:
  RecordReader(const std::filesystem::path& file, int line_number, const std::string& text)
      : where_(file.string() + ":" + std::to_string(line_number)), fields_(fields_of(text)) {}

  [[nodiscard]] const std::string& word(std::size_t column) const {
    if (column >= fields_.size())
      throw Failure(ExitCode::usage, where_ + ": has " + std::to_string(fields_.size()) +
                                         " fields; a run has 13 at least (seed,scenario,result,..)");
    return fields_[column];
  }
  [[nodiscard]] double number(std::size_t column) const {
    const std::string& text = word(column);
    char* end = nullptr;
    const double value = std::strtod(text.c_str(), &end);
    if (text.empty() || *end != '\0')
      throw Failure(ExitCode::usage,
                    where_ + ": field " + std::to_string(column + 1) + " is '" + text + "'; it must be a number");
    return value;
  }
  /// Empty where the column is missing or empty.
  [[nodiscard]] std::string optional_word(std::size_t column) const {
    return column < fields_.size() ? fields_[column] : std::string();
  }
  [[nodiscard]] std::optional<double> optional_number(std::size_t column) const {
    if (optional_word(column).empty()) return std::nullopt;
    return number(column);
  }
  [[nodiscard]] std::optional<Pose2> pose(std::size_t column) const {
    if (column >= fields_.size() || fields_[column].empty()) return std::nullopt;
    return Pose2{number(column), number(column + 1), number(column + 2)};
  }

 private:
  std::string where_;
  std::vector<std::string> fields_;
};

// Nobody else writes into a folder as long as this lives; not even the same command given twice.
class FolderLock {
 public:
  explicit FolderLock(const std::filesystem::path& folder)
      : descriptor_(::open(folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC)) {
    if (descriptor_ < 0 || ::flock(descriptor_, LOCK_EX | LOCK_NB) == 0 || errno != EWOULDBLOCK) return;
    ::close(descriptor_);
    throw Failure(ExitCode::usage, folder.string() +
                                       ": another `tagdock evaluate` is at work in this folder; wait for it, or give "
                                       "each --shard an --output of its own and --join them");
  }
  ~FolderLock() {
    if (descriptor_ >= 0) ::close(descriptor_);
  }
  FolderLock(const FolderLock&) = delete;
  FolderLock& operator=(const FolderLock&) = delete;

 private:
  int descriptor_;  ///< below zero where it cannot be locked
};

}  // namespace

std::vector<std::uint64_t> seeds_of(const CampaignShare& share) {
  std::vector<std::uint64_t> seeds;
  for (int i = share.shard; i < share.runs; i += share.shards)
    seeds.push_back(share.first_seed + static_cast<std::uint64_t>(i));
  return seeds;
}

void write_shares(const std::filesystem::path& folder, const std::vector<CampaignShare>& shares) {
  std::string text =
      "# Which runs of the campaign are meant to be here; `evaluate --join` tells from it what is missing.\n";
  for (const CampaignShare& share : shares)
    text += "- {first_seed: " + std::to_string(share.first_seed) + ", runs: " + std::to_string(share.runs) +
            ", shard: " + std::to_string(share.shard) + ", shards: " + std::to_string(share.shards) + "}\n";
  write(folder / share_file, text);
}

std::vector<CampaignShare> read_shares(const std::filesystem::path& folder) {
  std::vector<CampaignShare> shares;
  std::istringstream text(contents(folder / share_file));
  std::string one;
  for (int number = 1; std::getline(text, one); ++number) {
    if (one.empty() || one.front() == '#') continue;
    CampaignShare share;
    unsigned long long seed = 0;
    int length = -1;
    std::sscanf(one.c_str(), "- {first_seed: %llu, runs: %d, shard: %d, shards: %d}%n", &seed, &share.runs,
                &share.shard, &share.shards, &length);
    if (length != static_cast<int>(one.size()) || share.runs < 1 || share.shards < 1 || share.shard < 0 ||
        share.shard >= share.shards)
      throw Failure(ExitCode::usage, (folder / share_file).string() + ":" + std::to_string(number) +
                                         ": must be as - {first_seed: 1, runs: 100, shard: 0, shards: 4}");
    share.first_seed = seed;
    shares.push_back(share);
  }
  return shares;
}

std::string runs_header() {
  return "seed,scenario,result,reason,true_x,true_y,true_yaw,estimated_x,estimated_y,estimated_yaw,duration_s,attempts,"
         "stop_latency_ms,sigma_x,sigma_y,sigma_yaw,fault,fault_to_zero_ms,fault_to_stand_ms,start_x,start_y,start_yaw,"
         "start_seen_x,"
         "start_seen_y,start_seen_yaw";
}

std::string line(const RunRecord& record) {
  return std::to_string(record.seed) + "," + record.scenario + "," + record.result + "," + record.reason +
         pose_fields(record.true_error) + pose_fields(record.estimated) + "," + digits(record.duration_s) + "," +
         std::to_string(record.attempts) + "," + digits(record.stop_latency_ms) + pose_fields(record.sigma) + "," +
         record.fault + "," + (record.fault_to_zero_ms ? digits(*record.fault_to_zero_ms) : "") + "," +
         (record.fault_to_stand_ms ? digits(*record.fault_to_stand_ms) : "") +
         pose_fields(record.start ? std::optional(record.start->truth) : std::nullopt) +
         pose_fields(record.start ? std::optional(record.start->seen) : std::nullopt);
}

std::vector<RunRecord> read_runs(const std::filesystem::path& file) {
  const std::string text = contents(file);
  std::vector<RunRecord> records;
  std::size_t begin = 0;
  for (int number = 1; begin < text.size(); ++number) {
    const std::size_t end = text.find('\n', begin);
    if (end == std::string::npos) break;  // cut off
    const std::string one = text.substr(begin, end - begin);
    begin = end + 1;
    if (number == 1) {
      if (!one.starts_with("seed,scenario,result,reason,true_x"))
        throw Failure(ExitCode::usage, file.string() + ":1: is not the header of a runs.csv (seed,scenario,result,..)");
      continue;
    }
    const RecordReader reader(file, number, one);
    RunRecord record;
    record.seed = static_cast<std::uint64_t>(reader.number(0));
    record.scenario = reader.word(1);
    record.result = reader.word(2);
    record.reason = reader.word(3);
    record.true_error = {reader.number(4), reader.number(5), reader.number(6)};
    record.estimated = reader.pose(7);
    record.duration_s = reader.number(10);
    record.attempts = static_cast<int>(reader.number(11));
    record.stop_latency_ms = reader.number(12);
    record.sigma = reader.pose(13);
    record.fault = reader.optional_word(16);
    record.fault_to_zero_ms = reader.optional_number(17);
    record.fault_to_stand_ms = reader.optional_number(18);
    if (const auto truth = reader.pose(19), seen = reader.pose(22); truth && seen) record.start = {*truth, *seen};
    records.push_back(std::move(record));
  }
  return records;
}

void write_runs(const std::filesystem::path& folder, const std::vector<RunRecord>& records) {
  std::string text = runs_header() + "\n";
  for (const RunRecord& record : records) text += line(record) + "\n";
  write(folder / runs_file, text);
}

std::string campaign_text(const RunSettings& settings) {
  const auto line = [](const std::string& key, const std::string& value) { return key + ": \"" + value + "\"\n"; };
  const std::string law = settings.strategy == Strategy::paper                  ? "open"
                          : settings.config.docking.servo.law == ServoLaw::line ? "line"
                                                                                : "centering";
  return "version: 1\n" + line("program", "tagdock " TAGDOCK_VERSION) +
         line("strategy", settings.strategy == Strategy::servo ? "servo" : "paper") + line("law", law) +
         line("scenario_name", settings.scenario.name) + line("start", settings.start_name) +
         line("rig_name", settings.rig_name) + line("board_name", settings.board_name) +
         line("corners", settings.images ? std::string(word(settings.config.locator.method)) : settings.corners_name) +
         line("teach", settings.teach ? "on" : "off") + line("images", settings.images ? "on" : "off") +
         line("focal_length_px", digits(settings.config.rig.camera.fx)) +
         line("limits_lifted", settings.limits_lifted ? "yes" : "no") + "# corner errors\n" +
         to_yaml(settings.corner_errors) + to_yaml(settings.config) + "# scenario file\n" + settings.scenario_text;
}

std::string campaign_value(const std::string& text, const std::string& key) {
  const std::string begin = "\n" + key + ": \"";
  const std::size_t at = text.find(begin);
  if (at == std::string::npos) return "";
  const std::size_t from = at + begin.size();
  return text.substr(from, text.find('"', from) - from);
}

std::vector<RunRecord> run_campaign(const RunSettings& settings, const CampaignShare& share,
                                    const std::filesystem::path& folder,
                                    const std::function<void(int done, int wanted)>& progress) {
  make_folder(folder / traces_folder);
  const FolderLock alone(folder);
  const std::string text = campaign_text(settings);
  std::map<std::uint64_t, RunRecord> done;
  if (std::filesystem::exists(folder / campaign_file)) {
    if (contents(folder / campaign_file) != text)
      throw Failure(ExitCode::usage, (folder / campaign_file).string() +
                                         ": another campaign is in this folder; give --output another one");
    if (std::filesystem::exists(folder / runs_file))
      for (RunRecord& record : read_runs(folder / runs_file)) done.emplace(record.seed, std::move(record));
  }
  const std::vector<std::uint64_t> wanted = seeds_of(share);
  for (const auto& [seed, record] : done)
    if (!std::binary_search(wanted.begin(), wanted.end(), seed))
      throw Failure(ExitCode::usage, (folder / runs_file).string() + ": has a run of seed " + std::to_string(seed) +
                                         ", which this command does not ask for and would lose; give --runs, --seed "
                                         "and --shard as before (--runs may be more), or another --output");
  write(folder / campaign_file, text);
  write_shares(folder, {share});
  std::vector<std::uint64_t> missing;
  for (const std::uint64_t seed : wanted)
    if (!done.contains(seed)) missing.push_back(seed);

  std::vector<RunRecord> before;
  for (const auto& [seed, record] : done) before.push_back(record);
  write_runs(folder, before);
  std::ofstream stream(folder / runs_file, std::ios::binary | std::ios::app);
  std::mutex mutex;
  std::atomic<std::size_t> next{0};
  std::exception_ptr failure;
  const auto work = [&] {
    for (std::size_t i = next++; i < missing.size(); i = next++) {
      try {
        const bool traced = missing[i] - share.first_seed < traced_runs;
        RunTrace trace;
        RunRecord record = run_once(settings, missing[i], &trace);
        record.start = start_look(trace);
        const std::lock_guard lock(mutex);
        if (traced) write_trace(folder / traces_folder / (std::to_string(missing[i]) + ".csv"), trace);
        stream << line(record) << "\n" << std::flush;
        if (!stream)
          throw Failure(ExitCode::usage, (folder / runs_file).string() + ": cannot be written (is the disk full?)");
        done.emplace(record.seed, std::move(record));
        progress(static_cast<int>(done.size()), static_cast<int>(wanted.size()));
      } catch (...) {
        const std::lock_guard lock(mutex);
        if (!failure) failure = std::current_exception();
        next = missing.size();
      }
    }
  };
  {
    std::vector<std::jthread> threads;
    for (int i = 1; i < share.jobs; ++i) threads.emplace_back(work);
    work();
  }
  if (failure) std::rethrow_exception(failure);
  std::vector<RunRecord> records;
  for (auto& [seed, record] : done) records.push_back(std::move(record));
  stream.close();
  write_runs(folder, records);
  // A campaign's first shard keeps them for all; an ablation's figures are others.
  const std::filesystem::path looks = folder / looks_file;
  if (share.shard == 0 && !settings.limits_lifted && !std::filesystem::exists(looks))
    write_looks(looks, looks_over_distance(settings, share.first_seed));
  return records;
}

std::vector<RunTrace> read_traces(const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> files;
  if (std::filesystem::is_directory(folder / traces_folder))
    for (const auto& file : std::filesystem::directory_iterator(folder / traces_folder)) files.push_back(file.path());
  std::sort(files.begin(), files.end());
  std::vector<RunTrace> traces;
  for (const std::filesystem::path& file : files) traces.push_back(read_trace(file));
  return traces;
}

}  // namespace tagdock
