#include "app/fields.h"

#include <algorithm>
#include <charconv>
#include <cmath>

#include "planning/pose2.h"

namespace tagdock {
namespace {

// The shortest text that reads back as the same number to the last bit: people edit these files.
std::string digits(double value) {
  char text[32];
  const std::to_chars_result end = std::to_chars(text, text + sizeof text, value);
  std::string result(text, end.ptr);
  // YAML 1.1 takes a number with an exponent and without a point for a word.
  const std::size_t exponent = result.find('e');
  if (exponent != std::string::npos && result.find('.') == std::string::npos) result.insert(exponent, ".0");
  return result;
}

std::string in_quotes(const std::string& text) {
  std::string result = "\"";
  for (const char letter : text) {
    if (letter == '"' || letter == '\\') result += '\\';
    result += letter;
  }
  return result + "\"";
}

}  // namespace

void Fields::degrees(std::string_view key, double& radians_value, double least_deg, double most_deg) {
  double in_degrees = tagdock::degrees(radians_value);
  const double before = in_degrees;
  number(key, in_degrees, least_deg, most_deg);
  if (in_degrees != before) radians_value = radians(in_degrees);
}

void Fields::transform(std::string_view key, Eigen::Isometry3d& value) {
  group(key, [&](Fields& fields) {
    const Eigen::Quaterniond rotation(value.linear());
    std::vector<double> t(value.translation().data(), value.translation().data() + 3);
    std::vector<double> q = {rotation.x(), rotation.y(), rotation.z(), rotation.w()};
    const std::vector<double> t_before = t;
    const std::vector<double> q_before = q;
    fields.numbers("t", t, 3, 3);
    fields.numbers("q_xyzw", q, 4, 4);
    if (t == t_before && q == q_before) return;
    const Eigen::Quaterniond read(q[3], q[0], q[1], q[2]);
    fields.require(std::abs(read.norm() - 1.0) < 1e-3, "q_xyzw", "is not a unit quaternion [x, y, z, w]");
    value = Eigen::Isometry3d::Identity();
    value.linear() = read.normalized().toRotationMatrix();
    value.translation() << t[0], t[1], t[2];
  });
}

void FieldReader::number(std::string_view key, double& value, double least, double most) {
  map_.read(key, value, least, most);
}

void FieldReader::integer(std::string_view key, int& value, int least, int most) { map_.read(key, value, least, most); }

void FieldReader::flag(std::string_view key, bool& value) { map_.read(key, value); }

void FieldReader::word(std::string_view key, std::string& value, const std::vector<std::string>& allowed) {
  if (!map_.has(key)) return;
  value = map_.text(key);
  if (allowed.empty() || std::find(allowed.begin(), allowed.end(), value) != allowed.end()) return;
  std::string sentence = "is " + value + "; it must be one of";
  for (const std::string& other : allowed) sentence += " " + other;
  map_.refuse(key, sentence);
}

void FieldReader::numbers(std::string_view key, std::vector<double>& values, std::size_t least, std::size_t most) {
  if (map_.has(key)) values = map_.numbers(key, least, most);
}

void FieldReader::group(std::string_view key, const std::function<void(Fields&)>& visit) {
  if (auto map = map_.optional_map(key)) {
    FieldReader reader(*map);
    visit(reader);
  }
}

void FieldReader::list(std::string_view key, std::size_t, const std::function<void(std::size_t)>& resize,
                       const std::function<void(Fields&, std::size_t)>& visit) {
  if (!map_.has(key)) return;
  const std::vector<YamlMap> maps = map_.maps(key);
  resize(maps.size());
  for (std::size_t i = 0; i < maps.size(); ++i) {
    FieldReader reader(maps[i]);
    visit(reader, i);
  }
}

void FieldReader::require(bool good, std::string_view key, const std::string& sentence) {
  if (!good) map_.refuse(key, sentence);
}

void FieldWriter::start(std::string_view key) {
  text_.append(static_cast<std::size_t>(indent_), ' ').append(key).append(":");
}

void FieldWriter::number(std::string_view key, double& value, double, double) {
  start(key);
  text_ += " " + digits(value) + "\n";
}

void FieldWriter::integer(std::string_view key, int& value, int, int) {
  start(key);
  text_ += " " + std::to_string(value) + "\n";
}

void FieldWriter::flag(std::string_view key, bool& value) {
  start(key);
  text_ += value ? " true\n" : " false\n";
}

void FieldWriter::word(std::string_view key, std::string& value, const std::vector<std::string>&) {
  start(key);
  text_ += " " + in_quotes(value) + "\n";
}

void FieldWriter::numbers(std::string_view key, std::vector<double>& values, std::size_t, std::size_t) {
  start(key);
  text_ += " [";
  for (std::size_t i = 0; i < values.size(); ++i) text_ += (i == 0 ? "" : ", ") + digits(values[i]);
  text_ += "]\n";
}

void FieldWriter::group(std::string_view key, const std::function<void(Fields&)>& visit) {
  start(key);
  FieldWriter inner(indent_ + 2);
  visit(inner);
  text_ += inner.text().empty() ? " {}\n" : "\n" + inner.text();
}

void FieldWriter::list(std::string_view key, std::size_t count, const std::function<void(std::size_t)>&,
                       const std::function<void(Fields&, std::size_t)>& visit) {
  start(key);
  text_ += count == 0 ? " []\n" : "\n";
  for (std::size_t i = 0; i < count; ++i) {
    FieldWriter inner(indent_ + 4);
    visit(inner, i);
    std::string element = inner.text();
    element.replace(static_cast<std::size_t>(indent_) + 2, 1, "-");
    text_ += element;
  }
}

}  // namespace tagdock
