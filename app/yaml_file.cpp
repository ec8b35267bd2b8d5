#include "app/yaml_file.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <set>
#include <sstream>

#include <yaml-cpp/eventhandler.h>
#include <yaml-cpp/yaml.h>

#include "app/failure.h"
#include "app/nearest_word.h"

namespace tagdock {
namespace {

constexpr std::size_t largest_file = 256 * 1024;
constexpr int deepest = 16;

[[noreturn]] void refuse_at(const std::string& file, const YAML::Mark& mark, const std::string& sentence) {
  throw Failure(ExitCode::usage,
                file + ":" + std::to_string(mark.line + 1) + ":" + std::to_string(mark.column + 1) + ": " + sentence);
}

std::string shortest(double value) {
  std::ostringstream text;
  text << value;
  return text.str();
}

// Looks at the file before any tree is built: depth, aliases (a tree with them may never end), keys given twice.
class Inspector : public YAML::EventHandler {
 public:
  explicit Inspector(std::string file) : file_(std::move(file)) {}

  void OnDocumentStart(const YAML::Mark&) override {}
  void OnDocumentEnd() override {}
  void OnNull(const YAML::Mark& mark, YAML::anchor_t) override { value(mark, "~"); }
  void OnAlias(const YAML::Mark& mark, YAML::anchor_t) override { refuse_at(file_, mark, "aliases are not read"); }
  void OnScalar(const YAML::Mark& mark, const std::string&, YAML::anchor_t anchor, const std::string& text) override {
    if (anchor != 0) refuse_at(file_, mark, "anchors are not read");
    value(mark, text);
  }
  void OnSequenceStart(const YAML::Mark& mark, const std::string&, YAML::anchor_t, YAML::EmitterStyle::value) override {
    value(mark, "[");
    push(mark, false);
  }
  void OnSequenceEnd() override { levels_.pop_back(); }
  void OnMapStart(const YAML::Mark& mark, const std::string&, YAML::anchor_t, YAML::EmitterStyle::value) override {
    value(mark, "{");
    push(mark, true);
  }
  void OnMapEnd() override { levels_.pop_back(); }

 private:
  struct Level {
    bool map = false;
    bool key_next = true;
    std::set<std::string> keys = {};
  };

  void push(const YAML::Mark& mark, bool map) {
    if (static_cast<int>(levels_.size()) >= deepest) refuse_at(file_, mark, "nested deeper than 16 levels");
    levels_.push_back({map});
  }

  void value(const YAML::Mark& mark, const std::string& text) {
    if (levels_.empty() || !levels_.back().map) return;
    Level& level = levels_.back();
    if (level.key_next && !level.keys.insert(text).second)
      refuse_at(file_, mark, "the key " + text + " is given twice");
    level.key_next = !level.key_next;
  }

  std::string file_;
  std::vector<Level> levels_;
};

std::optional<double> number_of(const std::string& text) {
  double value = 0.0;
  const char* begin = text.data();
  if (!text.empty() && text.front() == '+') ++begin;
  const auto [end, error] = std::from_chars(begin, text.data() + text.size(), value);
  if (error != std::errc() || end != text.data() + text.size() || !std::isfinite(value)) return std::nullopt;
  return value;
}

}  // namespace

struct YamlMap::State {
  std::string file;
  std::string path;  // of keys, with a dot at the end unless empty
  YAML::Node node;
  std::set<std::string, std::less<>> asked;
  std::vector<std::shared_ptr<State>> taken;

  [[nodiscard]] std::string name(std::string_view key) const { return path + std::string(key); }

  YAML::Node find(std::string_view key) {
    asked.emplace(key);
    for (const auto& entry : node)
      if (entry.first.IsScalar() && entry.first.Scalar() == key) return entry.second;
    return YAML::Node(YAML::NodeType::Undefined);
  }

  YAML::Node need(std::string_view key) {
    const YAML::Node found = find(key);
    if (!found.IsDefined()) refuse_at(file, node.Mark(), "the key " + name(key) + " is missing");
    return found;
  }

  double number(const YAML::Node& value, const std::string& what, double least, double most) const {
    const auto parsed = value.IsScalar() ? number_of(value.Scalar()) : std::nullopt;
    if (!parsed)
      refuse_at(file, value.Mark(),
                what + (value.IsScalar() ? " is " + value.Scalar() + ", which is not a finite number"
                                         : " must be one number"));
    if (*parsed < least || *parsed > most)
      refuse_at(file, value.Mark(),
                what + " is " + value.Scalar() + "; it must be between " + shortest(least) + " and " + shortest(most));
    return *parsed;
  }

  std::shared_ptr<State> submap(const YAML::Node& value, const std::string& what) {
    if (!value.IsMap()) refuse_at(file, value.Mark(), what + " must be a map of keys and values");
    for (const auto& known : taken)
      if (known->path == what + ".") return known;  // asked for before
    auto state = std::make_shared<State>();
    state->file = file;
    state->path = what + ".";
    state->node = value;
    taken.push_back(state);
    return state;
  }

  void finish() const {
    for (const auto& entry : node) {
      const std::string key = entry.first.IsScalar() ? entry.first.Scalar() : "(not a word)";
      if (asked.contains(key)) continue;
      std::string sentence = "the key " + name(key) + " is not known";
      const std::string nearest = nearest_word(key, {asked.begin(), asked.end()});
      if (!nearest.empty()) {
        sentence += "; did you mean " + nearest + "?";
      } else {
        sentence += "; known here are";
        for (const std::string& word : asked) sentence += " " + word;
      }
      refuse_at(file, entry.first.Mark(), sentence);
    }
    for (const auto& state : taken) state->finish();
  }
};

YamlMap::YamlMap(std::shared_ptr<State> state) : state_(std::move(state)) {}

YamlMap YamlMap::load(const std::filesystem::path& file) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(file, error))
    throw Failure(ExitCode::usage, file.string() + ": there is no such file");
  const auto size = std::filesystem::file_size(file, error);
  if (error || size > largest_file)
    throw Failure(ExitCode::usage, file.string() + ": larger than 256 KiB, so not a file of ours");
  std::ifstream stream(file);
  std::stringstream text;
  text << stream.rdbuf();
  if (!stream) throw Failure(ExitCode::usage, file.string() + ": cannot be read");
  return parse(text.str(), file.string());
}

YamlMap YamlMap::parse(const std::string& text, const std::string& name) {
  auto state = std::make_shared<State>();
  state->file = name;
  try {
    std::istringstream stream(text);
    YAML::Parser parser(stream);
    Inspector inspector(name);
    parser.HandleNextDocument(inspector);
    state->node = YAML::Load(text);
  } catch (const YAML::ParserException& error) {
    refuse_at(name, error.mark, "not YAML: " + error.msg);
  }
  if (state->node.IsNull()) state->node = YAML::Node(YAML::NodeType::Map);  // an empty file sets nothing
  if (!state->node.IsMap()) refuse_at(name, state->node.Mark(), "must be a map of keys and values");
  return YamlMap(state);
}

bool YamlMap::has(std::string_view key) { return state_->find(key).IsDefined(); }

double YamlMap::number(std::string_view key, double least, double most) {
  return state_->number(state_->need(key), state_->name(key), least, most);
}

std::int64_t YamlMap::integer(std::string_view key, std::int64_t least, std::int64_t most) {
  const YAML::Node value = state_->need(key);
  const double number = state_->number(value, state_->name(key), static_cast<double>(least), static_cast<double>(most));
  if (number != std::floor(number))
    refuse_at(state_->file, value.Mark(), state_->name(key) + " is " + value.Scalar() + "; it must be a whole number");
  return static_cast<std::int64_t>(number);
}

std::string YamlMap::text(std::string_view key) {
  const YAML::Node value = state_->need(key);
  if (!value.IsScalar()) refuse_at(state_->file, value.Mark(), state_->name(key) + " must be one word or text");
  return value.Scalar();
}

std::vector<double> YamlMap::numbers(std::string_view key, std::size_t least_count, std::size_t most_count) {
  const YAML::Node value = state_->need(key);
  const std::string name = state_->name(key);
  if (!value.IsSequence() || value.size() < least_count || value.size() > most_count)
    refuse_at(state_->file, value.Mark(),
              name + " must be a list of " + std::to_string(least_count) +
                  (most_count > least_count ? " to " + std::to_string(most_count) : "") + " numbers");
  std::vector<double> values;
  for (std::size_t i = 0; i < value.size(); ++i)
    values.push_back(state_->number(value[i], name + "[" + std::to_string(i) + "]", -1e12, 1e12));
  return values;
}

YamlMap YamlMap::map(std::string_view key) { return YamlMap(state_->submap(state_->need(key), state_->name(key))); }

std::vector<YamlMap> YamlMap::maps(std::string_view key) {
  const YAML::Node value = state_->need(key);
  if (!value.IsSequence()) refuse_at(state_->file, value.Mark(), state_->name(key) + " must be a list");
  std::vector<YamlMap> maps;
  for (std::size_t i = 0; i < value.size(); ++i)
    maps.push_back(YamlMap(state_->submap(value[i], state_->name(key) + "[" + std::to_string(i) + "]")));
  return maps;
}

void YamlMap::read(std::string_view key, double& value, double least, double most) {
  if (has(key)) value = number(key, least, most);
}

void YamlMap::read(std::string_view key, int& value, int least, int most) {
  if (has(key)) value = static_cast<int>(integer(key, least, most));
}

void YamlMap::read(std::string_view key, bool& value) {
  if (!has(key)) return;
  const std::string word = text(key);
  if (word != "true" && word != "false") refuse(key, "is " + word + "; it must be true or false");
  value = word == "true";
}

void YamlMap::read(std::string_view key, std::string& value) {
  if (has(key)) value = text(key);
}

std::optional<YamlMap> YamlMap::optional_map(std::string_view key) {
  if (!has(key)) return std::nullopt;
  return map(key);
}

void YamlMap::finish() const { state_->finish(); }

void YamlMap::refuse(std::string_view key, const std::string& sentence) const {
  const YAML::Node value = state_->find(key);
  refuse_at(state_->file, value.IsDefined() ? value.Mark() : state_->node.Mark(), state_->name(key) + " " + sentence);
}

const std::string& YamlMap::file() const { return state_->file; }

std::vector<std::string> YamlMap::keys() const {
  std::vector<std::string> words;
  for (const auto& entry : state_->node)
    if (entry.first.IsScalar()) words.push_back(entry.first.Scalar());
  return words;
}

}  // namespace tagdock
