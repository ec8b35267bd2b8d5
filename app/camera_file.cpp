#include "app/camera_file.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <iostream>
#include <iterator>
#include <map>
#include <optional>
#include <stdexcept>
#include <utility>
#include <vector>

#include "app/failure.h"
#include "app/yaml_file.h"

namespace tagdock {
namespace {

constexpr std::uintmax_t largest_file = 16 * 1024 * 1024;  // mrcal keeps its whole optimisation in the file
constexpr double most_px = 65536.0;

/// A value with the place where it stands, for the two formats that are not YAML.
struct Placed {
  std::string text;
  int line = 0;
};

[[noreturn]] void refuse_at(const std::string& file, int line, const std::string& sentence) {
  throw Failure(ExitCode::usage, file + ":" + std::to_string(line) + ": " + sentence);
}

std::string trimmed(const std::string& text) {
  const auto first = text.find_first_not_of(" \t\r\n");
  if (first == std::string::npos) return "";
  return text.substr(first, text.find_last_not_of(" \t\r\n") - first + 1);
}

double number(const std::string& file, const std::string& key, const Placed& value) {
  const std::string text = trimmed(value.text);
  double parsed = 0.0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), parsed);
  if (text.empty() || error != std::errc() || end != text.data() + text.size() || !std::isfinite(parsed))
    refuse_at(file, value.line, key + " is " + text + ", which is not a finite number");
  return parsed;
}

int pixels(const std::string& file, const std::string& key, const Placed& value) {
  const double parsed = number(file, key, value);
  if (parsed != std::floor(parsed) || parsed < 1.0 || parsed > most_px)
    refuse_at(file, value.line, key + " is " + trimmed(value.text) + "; it must be a whole number of pixels");
  return static_cast<int>(parsed);
}

using Refuse = std::function<void(const std::string&)>;

/// Coefficients in the order of OpenCV and ROS: k1 k2 p1 p2 [k3 [k4 k5 k6 [s1 s2 s3 s4 [tx ty]]]].
void set_distortion(CameraModel& camera, const std::vector<double>& values, const Refuse& refuse) {
  const std::size_t count = values.size();
  if (count != 0 && count != 4 && count != 5 && count != 8 && count != 12 && count != 14)
    refuse("has " + std::to_string(count) + " values; 0, 4, 5 or 8 are understood");
  double* const places[] = {&camera.k1, &camera.k2, &camera.p1, &camera.p2,
                            &camera.k3, &camera.k4, &camera.k5, &camera.k6};
  for (std::size_t i = 0; i < count; ++i) {
    if (i < 8)
      *places[i] = values[i];
    else if (values[i] != 0.0)
      refuse("has thin prism or tilt terms, which are not modelled");
  }
}

/// The last word on values that only make sense together.
CameraModel sound(const CameraModel& camera, const Refuse& refuse) {
  try {
    check(camera);
  } catch (const std::invalid_argument& error) {
    refuse(std::string("gives a camera that cannot be: ") + error.what());
  }
  return camera;
}

// ---- YAML formats --------------------------------------------------------------------------------------------------

int size_of(YamlMap& map, std::string_view key) { return static_cast<int>(map.integer(key, 1, 65536)); }

Refuse refusal(const YamlMap& map, const std::string& key) {
  return [map, key](const std::string& sentence) { map.refuse(key, sentence); };
}

/// A row-major 3 x 3 matrix of a pinhole without skew.
void set_pinhole(CameraModel& camera, const std::vector<double>& k, const Refuse& refuse) {
  if (k[1] != 0.0 || k[3] != 0.0 || k[6] != 0.0 || k[7] != 0.0 || k[8] != 1.0)
    refuse("is not of the form [fx 0 cx, 0 fy cy, 0 0 1]");
  camera.fx = k[0];
  camera.cx = k[2];
  camera.fy = k[4];
  camera.cy = k[5];
  if (!(camera.fx > 0.0 && camera.fy > 0.0)) refuse("has a focal length that is not positive");
}

/// A matrix as `{rows, cols, data}` (ROS calibrator, OpenCV) or as a plain list (printed ROS message).
std::vector<double> matrix(YamlMap& map, const std::string& key, std::size_t least, std::size_t most, bool plain_list) {
  if (plain_list) return map.numbers(key, least, most);
  YamlMap sub = map.map(key);
  std::vector<double> values = sub.numbers("data", least, most);
  const auto rows = sub.integer("rows", 0, 1000);
  const auto columns = sub.integer("cols", 0, 1000);
  if (static_cast<std::size_t>(rows * columns) != values.size())
    sub.refuse("data", "has " + std::to_string(values.size()) + " values, not rows x cols");
  return values;
}

std::optional<std::string> first_known(YamlMap& map, std::initializer_list<const char*> words) {
  for (const char* word : words)
    if (map.has(word)) return word;
  return std::nullopt;
}

struct Read {
  CameraModel camera;
  Refuse refuse_size;
  Eigen::Matrix<double, 12, 12> covariance = Eigen::Matrix<double, 12, 12>::Zero();
};

Read from_ros(YamlMap& map) {
  CameraModel camera;
  const bool printed = !map.has("camera_matrix");  // a message as printed: K, D or k, d; width and height
  const std::string width = map.has("image_width") || !printed ? "image_width" : "width";
  const std::string height = map.has("image_height") || !printed ? "image_height" : "height";
  camera.width = size_of(map, width);
  camera.height = size_of(map, height);
  const std::string intrinsics = printed ? first_known(map, {"K", "k"}).value_or("K") : "camera_matrix";
  const std::string distortion = printed ? first_known(map, {"D", "d"}).value_or("D") : "distortion_coefficients";
  set_pinhole(camera, matrix(map, intrinsics, 9, 9, printed), refusal(map, intrinsics));
  const std::string model = map.text("distortion_model");
  if (model != "plumb_bob" && model != "rational_polynomial")
    map.refuse("distortion_model", "is " + model + "; plumb_bob and rational_polynomial are understood");
  set_distortion(camera, matrix(map, distortion, 0, 14, printed), refusal(map, distortion));
  return {sound(camera, refusal(map, intrinsics)), refusal(map, width)};
}

Read from_opencv(YamlMap& map) {
  CameraModel camera;
  const std::string width = first_known(map, {"image_width", "image_Width", "width"}).value_or("image_width");
  const std::string height = first_known(map, {"image_height", "image_Height", "height"}).value_or("image_height");
  camera.width = size_of(map, width);
  camera.height = size_of(map, height);
  const std::string intrinsics =
      first_known(map, {"camera_matrix", "Camera_Matrix", "cameraMatrix", "CameraMatrix", "K", "M1"})
          .value_or("camera_matrix");
  const std::string distortion = first_known(map, {"distortion_coefficients", "Distortion_Coefficients", "dist_coeffs",
                                                   "distCoeffs", "DistCoeffs", "D", "D1"})
                                     .value_or("distortion_coefficients");
  set_pinhole(camera, matrix(map, intrinsics, 9, 9, false), refusal(map, intrinsics));
  set_distortion(camera, matrix(map, distortion, 0, 14, false), refusal(map, distortion));
  if (map.has("fisheye_model") && map.text("fisheye_model") != "0")
    map.refuse("fisheye_model", "is on; fisheye lenses are not modelled");
  return {sound(camera, refusal(map, intrinsics)), refusal(map, width)};
}

Read from_kalibr(YamlMap& file) {
  YamlMap map = file.map("cam0");
  CameraModel camera;
  const std::string kind = map.text("camera_model");
  if (kind != "pinhole") map.refuse("camera_model", "is " + kind + "; only pinhole is understood");
  const std::vector<double> size = map.numbers("resolution", 2, 2);
  for (const double side : size)
    if (side != std::floor(side) || side < 1.0 || side > most_px)
      map.refuse("resolution", "must be two whole numbers of pixels");
  camera.width = static_cast<int>(size[0]);
  camera.height = static_cast<int>(size[1]);
  const std::vector<double> intrinsics = map.numbers("intrinsics", 4, 4);
  camera.fx = intrinsics[0];
  camera.fy = intrinsics[1];
  camera.cx = intrinsics[2];
  camera.cy = intrinsics[3];
  const std::string model = map.text("distortion_model");
  if (model == "radtan")
    set_distortion(camera, map.numbers("distortion_coeffs", 4, 4), refusal(map, "distortion_coeffs"));
  else if (model != "none")
    map.refuse("distortion_model", "is " + model + "; radtan and none are understood");
  return {sound(camera, refusal(map, "intrinsics")), refusal(map, "resolution")};
}

Read from_rig(YamlMap& file) {
  YamlMap map = file.map("camera");
  CameraModel camera;
  camera.width = size_of(map, "width");
  camera.height = size_of(map, "height");
  camera.fx = map.number("fx", 1e-3, 1e9);
  camera.fy = map.number("fy", 1e-3, 1e9);
  camera.cx = map.number("cx", -1e9, 1e9);
  camera.cy = map.number("cy", -1e9, 1e9);
  set_distortion(camera, map.numbers("dist", 0, 8), refusal(map, "dist"));
  Read read{sound(camera, refusal(map, "fx")), refusal(map, "width")};
  if (file.has("camera_covariance")) {
    const std::vector<double> values = file.numbers("camera_covariance", 144, 144);
    read.covariance = Eigen::Map<const Eigen::Matrix<double, 12, 12>>(values.data());
    if (!read.covariance.allFinite() ||
        (read.covariance - read.covariance.transpose()).norm() > 1e-6 * read.covariance.norm() ||
        (read.covariance.diagonal().array() < 0.0).any())
      file.refuse("camera_covariance",
                  "is no covariance: it must be finite, symmetric, and not negative on its diagonal");
  }
  return read;
}

Read from_yaml(const std::string& text, const std::string& name) {
  constexpr std::size_t largest_yaml = 256 * 1024;
  if (text.size() > largest_yaml)
    throw Failure(ExitCode::usage, name + ":1: larger than 256 KiB, so not a camera file");
  // OpenCV begins its files with "%YAML:1.0", which is no directive of YAML; as a comment it keeps the lines' numbers.
  std::string readable = text;
  if (readable.starts_with("%YAML:")) readable[0] = '#';
  YamlMap map = YamlMap::parse(readable, name);
  if (map.has("cam0")) return from_kalibr(map);
  if (map.has("distortion_model")) return from_ros(map);
  if (map.has("camera")) return from_rig(map);
  if (first_known(map, {"camera_matrix", "Camera_Matrix", "cameraMatrix", "CameraMatrix", "K", "M1"}))
    return from_opencv(map);
  throw Failure(
      ExitCode::usage,
      name + ":1: no camera in it: none of the keys camera, cam0, camera_matrix, K, distortion_model is there");
}

// ---- mrcal ---------------------------------------------------------------------------------------------------------

/// The value after a quoted key of a Python dictionary, up to the comma that ends it, brackets included.
Placed python_value(const std::string& text, const std::string& name, const std::string& key) {
  int line = 1;
  bool line_start = true;
  for (std::size_t i = 0; i < text.size(); ++i) {
    const char c = text[i];
    if (c == '\n') {
      ++line;
      line_start = true;
      continue;
    }
    if (line_start && c == '#') {  // a comment to the end of the line
      while (i + 1 < text.size() && text[i + 1] != '\n') ++i;
      continue;
    }
    if (c != ' ' && c != '\t') line_start = false;
    if (c != '\'' && c != '"') continue;
    const std::size_t close = text.find(c, i + 1);
    if (close == std::string::npos) refuse_at(name, line, "a quotation does not end");
    const std::string word = text.substr(i + 1, close - i - 1);
    line += static_cast<int>(std::count(word.begin(), word.end(), '\n'));
    i = close;
    const std::size_t colon = text.find_first_not_of(" \t", close + 1);
    if (word != key || colon == std::string::npos || text[colon] != ':') continue;
    std::size_t end = colon + 1;
    int depth = 0;
    while (end < text.size() && (depth > 0 || (text[end] != ',' && text[end] != '}'))) {
      depth += text[end] == '[' || text[end] == '(' ? 1 : text[end] == ']' || text[end] == ')' ? -1 : 0;
      ++end;
    }
    return {trimmed(text.substr(colon + 1, end - colon - 1)), line};
  }
  refuse_at(name, 1, "the key " + key + " is missing");
}

std::vector<Placed> python_list(const Placed& value, const std::string& name, const std::string& key) {
  const std::string& text = value.text;
  const bool list =
      text.size() >= 2 && ((text.front() == '[' && text.back() == ']') || (text.front() == '(' && text.back() == ')'));
  if (!list) refuse_at(name, value.line, key + " must be a list of numbers");
  std::vector<Placed> items;
  std::string item;
  for (const char c : text.substr(1, text.size() - 2) + ",") {
    if (c != ',') {
      item += c;
      continue;
    }
    if (!trimmed(item).empty()) items.push_back({trimmed(item), value.line});
    item.clear();
  }
  return items;
}

Read from_mrcal(const std::string& text, const std::string& name) {
  const Placed model = python_value(text, name, "lensmodel");
  const std::map<std::string, std::size_t> coefficients{{"LENSMODEL_PINHOLE", 0},
                                                        {"LENSMODEL_OPENCV4", 4},
                                                        {"LENSMODEL_OPENCV5", 5},
                                                        {"LENSMODEL_OPENCV8", 8},
                                                        {"LENSMODEL_OPENCV12", 12}};
  const std::string kind = model.text.size() > 2 ? model.text.substr(1, model.text.size() - 2) : "";
  const auto known = coefficients.find(kind);
  if (known == coefficients.end())
    refuse_at(name, model.line,
              "lensmodel is " + model.text + "; LENSMODEL_PINHOLE and LENSMODEL_OPENCV4, 5, 8, 12 are understood");
  const Placed size = python_value(text, name, "imagersize");
  const std::vector<Placed> sides = python_list(size, name, "imagersize");
  if (sides.size() != 2) refuse_at(name, size.line, "imagersize must be two numbers");
  const Placed intrinsics = python_value(text, name, "intrinsics");
  const std::vector<Placed> values = python_list(intrinsics, name, "intrinsics");
  if (values.size() != 4 + known->second)
    refuse_at(name, intrinsics.line,
              "intrinsics has " + std::to_string(values.size()) + " values; " + kind + " needs " +
                  std::to_string(4 + known->second));
  std::vector<double> numbers;
  for (std::size_t i = 0; i < values.size(); ++i)
    numbers.push_back(number(name, "intrinsics[" + std::to_string(i) + "]", values[i]));
  CameraModel camera;
  camera.width = pixels(name, "imagersize", sides[0]);
  camera.height = pixels(name, "imagersize", sides[1]);
  camera.fx = numbers[0];
  camera.fy = numbers[1];
  camera.cx = numbers[2];
  camera.cy = numbers[3];
  const Refuse refuse = [name, line = intrinsics.line](const std::string& sentence) {
    refuse_at(name, line, "intrinsics " + sentence);
  };
  set_distortion(camera, {numbers.begin() + 4, numbers.end()}, refuse);
  return {sound(camera, refuse),
          [name, line = size.line](const std::string& sentence) { refuse_at(name, line, "imagersize " + sentence); }};
}

// ---- ViSP XML ------------------------------------------------------------------------------------------------------

/// An element of the small part of XML that ViSP writes: elements and text, no attributes that matter.
struct Element {
  std::string name;
  int line = 0;
  std::string text;
  std::vector<Element> children;
};

class XmlReader {
 public:
  XmlReader(const std::string& text, std::string file) : text_(text), file_(std::move(file)) {}

  Element root() {
    skip_between();
    Element element = read(0);
    return element;
  }

 private:
  [[noreturn]] void refuse(const std::string& sentence) const { refuse_at(file_, line_, sentence); }

  char next() {
    if (place_ >= text_.size()) refuse("the file ends too early");
    if (text_[place_] == '\n') ++line_;
    return text_[place_++];
  }

  [[nodiscard]] bool at(const std::string& word) const { return text_.compare(place_, word.size(), word) == 0; }

  void skip_past(const std::string& word) {
    while (!at(word)) next();
    for (std::size_t i = 0; i < word.size(); ++i) next();
  }

  /// Comments, processing instructions and blanks; definitions of a document type are refused.
  void skip_between() {
    for (;;) {
      if (at("<!--"))
        skip_past("-->");
      else if (at("<?"))
        skip_past("?>");
      else if (at("<!"))
        refuse("document types and CDATA are not read");
      else if (place_ < text_.size() && std::string(" \t\r\n").find(text_[place_]) != std::string::npos)
        next();
      else
        return;
    }
  }

  Element read(int depth) {
    constexpr int deepest = 16;
    if (depth > deepest) refuse("nested deeper than 16 levels");
    if (next() != '<') refuse("an element was expected");
    Element element;
    element.line = line_;
    std::string tag;
    for (char c = next(); c != '>'; c = next()) tag += c;
    const bool closed = !tag.empty() && tag.back() == '/';
    element.name = tag.substr(0, tag.find_first_of(" \t\r\n/"));
    if (element.name.empty()) refuse("an element has no name");
    if (closed) return element;
    for (;;) {
      if (at("<!--")) {
        skip_past("-->");
      } else if (at("</")) {
        skip_past("</");
        std::string end;
        for (char c = next(); c != '>'; c = next()) end += c;
        if (trimmed(end) != element.name) refuse("<" + element.name + "> is closed by </" + trimmed(end) + ">");
        element.text = trimmed(element.text);
        return element;
      } else if (at("<!") || at("<?")) {
        refuse("document types and CDATA are not read");
      } else if (at("<")) {
        element.children.push_back(read(depth + 1));
      } else {
        element.text += next();
      }
    }
  }

  const std::string& text_;
  std::string file_;
  std::size_t place_ = 0;
  int line_ = 1;
};

const Element* child(const Element& parent, const std::string& name) {
  const auto found = std::find_if(parent.children.begin(), parent.children.end(),
                                  [&](const Element& element) { return element.name == name; });
  return found == parent.children.end() ? nullptr : &*found;
}

Placed needed(const Element& parent, const std::string& name, const std::string& file) {
  const Element* found = child(parent, name);
  if (found == nullptr) refuse_at(file, parent.line, "the key " + name + " is missing in <" + parent.name + ">");
  return {found->text, found->line};
}

Read from_visp(const std::string& text, const std::string& name) {
  const Element root = XmlReader(text, name).root();
  std::vector<const Element*> cameras;
  for (const Element& element : root.children)
    if (element.name == "camera") cameras.push_back(&element);
  if (cameras.empty()) refuse_at(name, root.line, "the key camera is missing in <" + root.name + ">");
  if (cameras.size() > 1) refuse_at(name, cameras[1]->line, "a second camera; the file must hold one");
  const Element& element = *cameras.front();
  CameraModel camera;
  const Placed width = needed(element, "image_width", name);
  camera.width = pixels(name, "image_width", width);
  camera.height = pixels(name, "image_height", needed(element, "image_height", name));
  // ViSP writes the same calibration twice; the one with distortion is the better one.
  const Element* chosen = nullptr;
  bool distorted = false;
  for (const Element& model : element.children) {
    if (model.name != "model") continue;
    const Placed type = needed(model, "type", name);
    if (type.text == "perspectiveProjWithDistortion") {
      chosen = &model;
      distorted = true;
    } else if (type.text == "perspectiveProjWithoutDistortion") {
      if (chosen == nullptr) chosen = &model;
    } else {
      refuse_at(name, type.line,
                "type is " + type.text +
                    "; perspectiveProjWithDistortion and perspectiveProjWithoutDistortion are "
                    "understood");
    }
  }
  if (chosen == nullptr) refuse_at(name, element.line, "the key model is missing in <camera>");
  camera.fx = number(name, "px", needed(*chosen, "px", name));
  camera.fy = number(name, "py", needed(*chosen, "py", name));
  camera.cx = number(name, "u0", needed(*chosen, "u0", name));
  camera.cy = number(name, "v0", needed(*chosen, "v0", name));
  // ViSP's kud bends an ideal point as our k1 does; its kdu approximates the way back and is not needed.
  if (distorted) camera.k1 = number(name, "kud", needed(*chosen, "kud", name));
  const Refuse refuse = [name, line = chosen->line](const std::string& sentence) {
    refuse_at(name, line, "model " + sentence);
  };
  return {sound(camera, refuse),
          [name, line = width.line](const std::string& sentence) { refuse_at(name, line, "image_width " + sentence); }};
}

}  // namespace

CameraFile::CameraFile(const CameraModel& camera, Refuse refuse_size)
    : camera_(camera), refuse_size_(std::move(refuse_size)) {}

CameraFile CameraFile::load(const std::filesystem::path& file) {
  std::error_code error;
  if (!std::filesystem::is_regular_file(file, error))
    throw Failure(ExitCode::usage, file.string() + ": there is no such file");
  const auto size = std::filesystem::file_size(file, error);
  if (error || size > largest_file)
    throw Failure(ExitCode::usage, file.string() + ": larger than 16 MiB, so not a camera file");
  std::ifstream stream(file, std::ios::binary);
  const std::string text{std::istreambuf_iterator<char>(stream), std::istreambuf_iterator<char>()};
  if (!stream.is_open()) throw Failure(ExitCode::usage, file.string() + ": cannot be opened");
  for (const char* refused : {"\nverdict: refused", "\nverdict: \"refused\""})
    if (text.find(refused) != std::string::npos)
      std::cerr << file.string() << ": its calibration was refused; what is measured with it is not to be trusted\n";
  return parse(text, file.string());
}

CameraFile CameraFile::parse(const std::string& text, const std::string& name) {
  const auto first = text.find_first_not_of(" \t\r\n\xef\xbb\xbf");
  if (first == std::string::npos) throw Failure(ExitCode::usage, name + ":1: the file is empty");
  if (text.find('\0') != std::string::npos) throw Failure(ExitCode::usage, name + ":1: not a text file");
  Read read;
  if (text[first] == '<')
    read = from_visp(text, name);
  else if (text.find("lensmodel") != std::string::npos)
    read = from_mrcal(text, name);
  else
    read = from_yaml(text, name);
  CameraFile file(read.camera, read.refuse_size);
  file.covariance_ = read.covariance;
  return file;
}

void CameraFile::require_size(int width, int height, const std::string& image) const {
  if (camera_.width == width && camera_.height == height) return;
  refuse_size_("says " + std::to_string(camera_.width) + "x" + std::to_string(camera_.height) + " pixels, but " +
               image + " has " + std::to_string(width) + "x" + std::to_string(height));
}

}  // namespace tagdock
