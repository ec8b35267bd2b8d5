#pragma once

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <map>
#include <string>
#include <vector>

namespace tagdock {

/// Writes an MCAP file (version 0 of its public specification): messages in chunks without compression, with their
/// index, schemas, channels, statistics and checksums.
class McapFile {
 public:
  /// @throws Failure (usage) when it cannot be written
  explicit McapFile(const std::filesystem::path& file);
  ~McapFile();
  McapFile(const McapFile&) = delete;
  McapFile& operator=(const McapFile&) = delete;

  /// A topic of JSON messages. @param schema  JSON schema of the name
  std::uint16_t add_channel(const std::string& topic, const std::string& schema_name, const std::string& schema);
  /// @param time_ns  of the log and of the publication, >= 0
  void write(std::uint16_t channel, std::uint64_t time_ns, const std::string& json);
  /// Writes the end of the file; called once. @throws Failure (usage) when the disk refused something
  void finish();

 private:
  struct Channel {
    std::uint16_t schema = 0;
    std::string topic;
    std::uint32_t messages = 0;
  };
  void put(const std::string& bytes);
  void finish_chunk();

  std::filesystem::path name_;
  std::ofstream stream_;
  std::uint64_t written_ = 0;
  std::vector<std::pair<std::string, std::string>> schemas_;  ///< name and text; ids are places from 1
  std::vector<Channel> channels_;                             ///< ids are places from 0
  std::string chunk_;
  std::map<std::uint16_t, std::vector<std::pair<std::uint64_t, std::uint64_t>>> chunk_index_;  ///< time and offset
  std::uint64_t chunk_first_ = 0, chunk_last_ = 0;
  std::uint64_t first_ = 0, last_ = 0, count_ = 0, chunks_ = 0;
  std::string chunk_records_;  ///< the chunk indices of the summary
  bool finished_ = false;
};

}  // namespace tagdock
