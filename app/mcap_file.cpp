#include "app/mcap_file.h"

#include <algorithm>
#include <zlib.h>

#include "app/failure.h"

namespace tagdock {
namespace {

// Records of the specification, by their opcodes. All numbers are little-endian.
enum Record : std::uint8_t {
  header = 0x01,
  footer = 0x02,
  schema_record = 0x03,
  channel_record = 0x04,
  message = 0x05,
  chunk = 0x06,
  message_index = 0x07,
  chunk_index = 0x08,
  statistics = 0x0b,
  summary_offset = 0x0e,
  data_end = 0x0f
};
constexpr std::size_t chunk_size = 4 << 20;
const std::string magic("\x89MCAP0\r\n", 8);

template <class Number>
std::string number(Number value) {
  std::string bytes;
  for (std::size_t i = 0; i < sizeof value; ++i)
    bytes.push_back(static_cast<char>(static_cast<std::uint64_t>(value) >> 8 * i));
  return bytes;
}

/// A text or a list, with its length in bytes before it.
std::string counted(const std::string& bytes) { return number(static_cast<std::uint32_t>(bytes.size())) + bytes; }

std::string record(Record kind, const std::string& content) {
  return std::string(1, static_cast<char>(kind)) + number(static_cast<std::uint64_t>(content.size())) + content;
}

std::uint32_t crc(const std::string& bytes) {
  return static_cast<std::uint32_t>(::crc32_z(0, reinterpret_cast<const unsigned char*>(bytes.data()), bytes.size()));
}

std::string schema_text(std::uint16_t id, const std::string& name, const std::string& text) {
  return record(schema_record, number(id) + counted(name) + counted("jsonschema") + counted(text));
}

std::string channel_text(std::uint16_t id, std::uint16_t schema, const std::string& topic) {
  return record(channel_record, number(id) + number(schema) + counted(topic) + counted("json") + counted(""));
}

}  // namespace

McapFile::McapFile(const std::filesystem::path& file) : name_(file), stream_(file, std::ios::binary) {
  if (!stream_) throw Failure(ExitCode::usage, file.string() + ": cannot be written");
  put(magic);
  put(record(header, counted("") + counted("tagdock")));
}

McapFile::~McapFile() = default;

void McapFile::put(const std::string& bytes) {
  stream_.write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  written_ += bytes.size();
}

std::uint16_t McapFile::add_channel(const std::string& topic, const std::string& schema_name,
                                    const std::string& schema) {
  auto known =
      std::find_if(schemas_.begin(), schemas_.end(), [&](const auto& one) { return one.first == schema_name; });
  if (known == schemas_.end()) {
    schemas_.emplace_back(schema_name, schema);
    known = schemas_.end() - 1;
    chunk_ += schema_text(static_cast<std::uint16_t>(schemas_.size()), schema_name, schema);
  }
  const auto schema_id = static_cast<std::uint16_t>(known - schemas_.begin() + 1);
  const auto id = static_cast<std::uint16_t>(channels_.size());
  channels_.push_back({schema_id, topic, 0});
  chunk_ += channel_text(id, schema_id, topic);
  return id;
}

void McapFile::write(std::uint16_t channel, std::uint64_t time_ns, const std::string& json) {
  if (chunk_index_.empty()) chunk_first_ = chunk_last_ = time_ns;
  if (count_ == 0) first_ = last_ = time_ns;
  chunk_first_ = std::min(chunk_first_, time_ns);
  chunk_last_ = std::max(chunk_last_, time_ns);
  first_ = std::min(first_, time_ns);
  last_ = std::max(last_, time_ns);
  chunk_index_[channel].emplace_back(time_ns, chunk_.size());
  chunk_ += record(
      message, number(channel) + number(channels_.at(channel).messages++) + number(time_ns) + number(time_ns) + json);
  ++count_;
  if (chunk_.size() >= chunk_size) finish_chunk();
}

void McapFile::finish_chunk() {
  if (chunk_.empty()) return;
  const std::uint64_t begin = written_;
  const auto size = static_cast<std::uint64_t>(chunk_.size());
  put(record(chunk, number(chunk_first_) + number(chunk_last_) + number(size) + number(crc(chunk_)) + counted("") +
                        number(size) + chunk_));
  const std::uint64_t end = written_;
  std::string offsets;
  for (auto& [channel, entries] : chunk_index_) {
    std::stable_sort(entries.begin(), entries.end());
    offsets += number(channel) + number(written_);
    std::string list;
    for (const auto& [time, offset] : entries) list += number(time) + number(offset);
    put(record(message_index, number(channel) + counted(list)));
  }
  chunk_records_ +=
      record(chunk_index, number(chunk_first_) + number(chunk_last_) + number(begin) + number(end - begin) +
                              counted(offsets) + number(written_ - end) + counted("") + number(size) + number(size));
  ++chunks_;
  chunk_.clear();
  chunk_index_.clear();
  chunk_first_ = chunk_last_ = 0;
}

void McapFile::finish() {
  if (finished_) return;
  finished_ = true;
  finish_chunk();
  put(record(data_end, number(std::uint32_t{0})));
  const std::uint64_t summary_start = written_;
  std::string summary, offsets;
  const auto group = [&](Record kind, const std::string& records) {
    if (records.empty()) return;
    offsets += record(summary_offset, std::string(1, static_cast<char>(kind)) + number(summary_start + summary.size()) +
                                          number(static_cast<std::uint64_t>(records.size())));
    summary += records;
  };
  std::string part;
  for (std::size_t i = 0; i < schemas_.size(); ++i)
    part += schema_text(static_cast<std::uint16_t>(i + 1), schemas_[i].first, schemas_[i].second);
  group(schema_record, part);
  part.clear();
  std::string counts;
  for (std::size_t i = 0; i < channels_.size(); ++i) {
    part += channel_text(static_cast<std::uint16_t>(i), channels_[i].schema, channels_[i].topic);
    counts += number(static_cast<std::uint16_t>(i)) + number(std::uint64_t{channels_[i].messages});
  }
  group(channel_record, part);
  group(statistics,
        record(statistics, number(count_) + number(static_cast<std::uint16_t>(schemas_.size())) +
                               number(static_cast<std::uint32_t>(channels_.size())) + number(std::uint32_t{0}) +
                               number(std::uint32_t{0}) + number(static_cast<std::uint32_t>(chunks_)) + number(first_) +
                               number(last_) + counted(counts)));
  group(chunk_index, chunk_records_);
  const std::uint64_t offset_start = summary_start + summary.size();
  // The checksum covers the summary and the footer up to itself.
  std::string end = summary + offsets + std::string(1, static_cast<char>(footer)) + number(std::uint64_t{20}) +
                    number(summary_start) + number(offset_start);
  end += number(crc(end));
  put(end);
  put(magic);
  stream_.flush();
  if (!stream_) throw Failure(ExitCode::usage, name_.string() + ": could not be written whole");
}

}  // namespace tagdock
