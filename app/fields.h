#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include <Eigen/Geometry>

#include "app/yaml_file.h"

namespace tagdock {

/// The keys of a configuration, told once and used both to read and to write it: what visits a struct says for each
/// value its key, unit (in the key's name) and range.
class Fields {
 public:
  virtual ~Fields() = default;

  virtual void number(std::string_view key, double& value, double least, double most) = 0;
  virtual void integer(std::string_view key, int& value, int least, int most) = 0;
  virtual void flag(std::string_view key, bool& value) = 0;
  /// One of the words allowed; any text if none are listed.
  virtual void word(std::string_view key, std::string& value, const std::vector<std::string>& allowed) = 0;
  virtual void numbers(std::string_view key, std::vector<double>& values, std::size_t least, std::size_t most) = 0;
  virtual void group(std::string_view key, const std::function<void(Fields&)>& visit) = 0;
  /// A list of groups; `resize` makes room before each element is visited.
  virtual void list(std::string_view key, std::size_t count, const std::function<void(std::size_t)>& resize,
                    const std::function<void(Fields&, std::size_t)>& visit) = 0;
  /// A check that spans several keys: refused when reading, nothing when writing.
  virtual void require(bool good, std::string_view key, const std::string& sentence) = 0;

  /// An angle that people read and write in degrees and the program keeps in radians.
  void degrees(std::string_view key, double& radians, double least_deg, double most_deg);
  /// {t: [x, y, z], q_xyzw: [..]}; quaternions that are not of unit length to 1e-3 are refused.
  void transform(std::string_view key, Eigen::Isometry3d& value);
};

/// Reads keys that are there and leaves the others at their defaults; unknown keys are refused by YamlMap::finish.
class FieldReader final : public Fields {
 public:
  explicit FieldReader(YamlMap map) : map_(std::move(map)) {}
  void number(std::string_view key, double& value, double least, double most) override;
  void integer(std::string_view key, int& value, int least, int most) override;
  void flag(std::string_view key, bool& value) override;
  void word(std::string_view key, std::string& value, const std::vector<std::string>& allowed) override;
  void numbers(std::string_view key, std::vector<double>& values, std::size_t least, std::size_t most) override;
  void group(std::string_view key, const std::function<void(Fields&)>& visit) override;
  void list(std::string_view key, std::size_t count, const std::function<void(std::size_t)>& resize,
            const std::function<void(Fields&, std::size_t)>& visit) override;
  void require(bool good, std::string_view key, const std::string& sentence) override;

 private:
  YamlMap map_;
};

/// Writes every key as YAML; numbers as short as reads back to the last bit.
class FieldWriter final : public Fields {
 public:
  explicit FieldWriter(int indent = 0) : indent_(indent) {}
  void number(std::string_view key, double& value, double least, double most) override;
  void integer(std::string_view key, int& value, int least, int most) override;
  void flag(std::string_view key, bool& value) override;
  void word(std::string_view key, std::string& value, const std::vector<std::string>& allowed) override;
  void numbers(std::string_view key, std::vector<double>& values, std::size_t least, std::size_t most) override;
  void group(std::string_view key, const std::function<void(Fields&)>& visit) override;
  void list(std::string_view key, std::size_t count, const std::function<void(std::size_t)>& resize,
            const std::function<void(Fields&, std::size_t)>& visit) override;
  void require(bool, std::string_view, const std::string&) override {}

  [[nodiscard]] const std::string& text() const { return text_; }

 private:
  void start(std::string_view key);
  int indent_;
  std::string text_;
};

}  // namespace tagdock
