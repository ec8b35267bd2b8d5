#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace YAML {
class Node;
}

namespace tagdock {

/// A map of a YAML file that is read strictly: every refusal is a Failure(usage) that names file, line, column, key,
/// value and what would be right; a key that nobody asked for is refused by `finish`, with the nearest known key.
/// Files are at most 256 KiB, 16 levels deep, without aliases and without a key twice.
class YamlMap {
 public:
  static YamlMap load(const std::filesystem::path& file);
  static YamlMap parse(const std::string& text, const std::string& name);

  [[nodiscard]] bool has(std::string_view key);

  /// A key that must be there.
  [[nodiscard]] double number(std::string_view key, double least, double most);
  [[nodiscard]] std::int64_t integer(std::string_view key, std::int64_t least, std::int64_t most);
  [[nodiscard]] std::string text(std::string_view key);
  [[nodiscard]] std::vector<double> numbers(std::string_view key, std::size_t least_count, std::size_t most_count);
  [[nodiscard]] YamlMap map(std::string_view key);
  [[nodiscard]] std::vector<YamlMap> maps(std::string_view key);

  /// A key that may be missing: `value` is written only if the key is there.
  void read(std::string_view key, double& value, double least, double most);
  void read(std::string_view key, int& value, int least, int most);
  void read(std::string_view key, bool& value);
  void read(std::string_view key, std::string& value);
  [[nodiscard]] std::optional<YamlMap> optional_map(std::string_view key);

  /// Refuses keys that nobody asked for, here and in the maps taken from this one.
  void finish() const;

  /// A refusal of a key of this map in the same form; for checks that span several keys.
  [[noreturn]] void refuse(std::string_view key, const std::string& sentence) const;

  /// File name as given.
  [[nodiscard]] const std::string& file() const;
  /// The keys of this map, in their order.
  [[nodiscard]] std::vector<std::string> keys() const;

 private:
  struct State;
  explicit YamlMap(std::shared_ptr<State> state);
  std::shared_ptr<State> state_;
};

}  // namespace tagdock
