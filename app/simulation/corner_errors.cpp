#include "app/simulation/corner_errors.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <map>

#include "app/yaml_file.h"

namespace tagdock {
namespace {

const std::map<std::string, CornerErrors>& known() {
  static const std::map<std::string, CornerErrors> errors = {
      {"paper", {{1.0, 1000.0}, {0.10, 0.10}, {0.05, 0.05}, 0.1, 1.0, false}},
      {"poor", {{1.0, 1000.0}, {0.30, 0.30}, {0.20, 0.20}, 0.1, 1.0, false}},
      // Measured, see data/corner_errors: `tagdock evaluate corner-errors` writes those files.
      {"tanh",
       {{32.215, 45.406, 62.719, 87.232, 121.51, 174.33},
        {0.0097176, 0.0077494, 0.0062844, 0.0052014, 0.0042355, 0.0033102},
        {0.030496, 0.030426, 0.029743, 0.030069, 0.030403, 0.031039},
        0.0016559,
        1.2165,
        true}},
      {"apriltag",
       {{32.215, 45.406, 62.719, 87.232, 121.51, 174.33},
        {0.038619, 0.026965, 0.034111, 0.03218, 0.043804, 0.034866},
        {0.094258, 0.097961, 0.09299, 0.093746, 0.095986, 0.12622},
        0.010173,
        2.8818,
        true}},
      {"best",
       {{32.215, 45.406, 62.719, 87.232, 121.51, 174.33},
        {0.0056133, 0.0045349, 0.0037565, 0.0030895, 0.0027218, 0.0022756},
        {0.00094714, 0.0012486, 0.00073734, 0.00089289, 0.00077607, 0.00088029},
        0.0007725,
        1.0099,
        true}},
  };
  return errors;
}

std::string list_of(const std::vector<double>& values) {
  std::string text;
  for (const double value : values) {
    char number[32];
    std::snprintf(number, sizeof number, "%.5g", value);
    text += (text.empty() ? "[" : ", ") + std::string(number);
  }
  return text + "]";
}

CornerErrors read_corner_errors(const std::string& file) {
  YamlMap map = YamlMap::load(file);
  CornerErrors errors;
  errors.side_px = map.numbers("side_px", 1, 100);
  errors.noise_px = map.numbers("noise_px", 1, 100);
  errors.bias_px = map.numbers("bias_px", 1, 100);
  errors.noise_per_blur_px = map.number("noise_per_blur_px", 0.0, 10.0);
  errors.claimed_share = map.number("claimed_share", 0.01, 100.0);
  map.read("bias_follows_pixels", errors.bias_follows_pixels);
  map.finish();
  const auto positive = [](const std::vector<double>& values) {
    return std::all_of(values.begin(), values.end(), [](double value) { return value > 0.0; });
  };
  if (!positive(errors.side_px) || !std::is_sorted(errors.side_px.begin(), errors.side_px.end()))
    map.refuse("side_px", "must be positive and rising");
  if (!positive(errors.noise_px)) map.refuse("noise_px", "must be positive");
  if (std::any_of(errors.bias_px.begin(), errors.bias_px.end(), [](double value) { return value < 0.0; }))
    map.refuse("bias_px", "must not be negative");
  if (errors.noise_px.size() != errors.side_px.size()) map.refuse("noise_px", "must have as many values as side_px");
  if (errors.bias_px.size() != errors.side_px.size()) map.refuse("bias_px", "must have as many values as side_px");
  return errors;
}

}  // namespace

double CornerErrors::at(const std::vector<double>& values, double side) const {
  if (side <= side_px.front()) return values.front();
  if (side >= side_px.back()) return values.back();
  const auto above = static_cast<std::size_t>(std::upper_bound(side_px.begin(), side_px.end(), side) - side_px.begin());
  const double share = std::log(side / side_px[above - 1]) / std::log(side_px[above] / side_px[above - 1]);
  return values[above - 1] + share * (values[above] - values[above - 1]);
}

const std::vector<std::string>& corner_error_names() {
  static const std::vector<std::string> names = [] {
    std::vector<std::string> all;
    for (const auto& [name, errors] : known()) all.push_back(name);
    return all;
  }();
  return names;
}

CornerErrors corner_errors(const std::string& word) {
  const auto found = known().find(word);
  return found != known().end() ? found->second : read_corner_errors(word);
}

std::string to_yaml(const CornerErrors& errors) {
  char numbers[96];
  std::snprintf(numbers, sizeof numbers, "noise_per_blur_px: %.5g\nclaimed_share: %.5g\n", errors.noise_per_blur_px,
                errors.claimed_share);
  return "side_px: " + list_of(errors.side_px) + "\nnoise_px: " + list_of(errors.noise_px) +
         "\nbias_px: " + list_of(errors.bias_px) + "\n" + numbers +
         "bias_follows_pixels: " + (errors.bias_follows_pixels ? "true\n" : "false\n");
}

}  // namespace tagdock
