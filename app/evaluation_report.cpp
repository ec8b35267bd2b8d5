#include "app/evaluation_report.h"

#include <algorithm>
#include <array>
#include <cctype>
#include <cmath>
#include <cstdio>
#include <limits>
#include <map>

#include "app/docking_report.h"
#include "app/html.h"

namespace tagdock {
namespace {

// Probability of at most `count` of `of` at a chance `p`, from logarithms so that nothing underflows.
double binomial_at_most(int count, int of, double p) {
  if (p <= 0.0) return 1.0;
  if (p >= 1.0) return count >= of ? 1.0 : 0.0;
  double sum = 0.0;
  for (int k = 0; k <= count; ++k)
    sum += std::exp(std::lgamma(of + 1.0) - std::lgamma(k + 1.0) - std::lgamma(of - k + 1.0) + k * std::log(p) +
                    (of - k) * std::log1p(-p));
  return std::min(1.0, sum);
}

// The chance at which at most `count` of `of` has the given probability; falls as the chance rises.
double chance_where(int count, int of, double probability) {
  double low = 0.0;
  double high = 1.0;
  for (int i = 0; i < 60; ++i) {
    const double middle = 0.5 * (low + high);
    (binomial_at_most(count, of, middle) > probability ? low : high) = middle;
  }
  return 0.5 * (low + high);
}

// The value below which a chi-squared of so many degrees of freedom stays at a normal's quantile z (Wilson, Hilferty).
double chi_squared_quantile(double freedom, double z) {
  const double part = 2.0 / (9.0 * freedom);
  return freedom * std::pow(1.0 - part + z * std::sqrt(part), 3);
}

Spread spread_of(const std::vector<Pose2>& errors) {
  Spread result;
  result.runs = static_cast<int>(errors.size());
  for (double Pose2::*const part : {&Pose2::x, &Pose2::y, &Pose2::yaw}) {
    std::vector<double> values;
    double mean = 0.0;
    for (const Pose2& error : errors) {
      values.push_back(error.*part);
      mean += error.*part / result.runs;
    }
    double sum = 0.0;
    for (const double value : values) sum += (value - mean) * (value - mean);
    result.mean.*part = mean;
    result.sigma.*part = result.runs > 1 ? std::sqrt(sum / (result.runs - 1)) : 0.0;
    const SigmaBounds bounds = sigma_bounds(values);
    result.sigma_low.*part = bounds.low * result.sigma.*part;
    result.sigma_high.*part = bounds.high * result.sigma.*part;
  }
  return result;
}

bool inside(const Pose2& error, double place, double yaw_deg) {
  return std::abs(error.x) <= place && std::abs(error.y) <= place && std::abs(error.yaw) <= radians(yaw_deg);
}

bool claims_success(const RunRecord& record) { return record.result == "docked" || record.result == "arrived"; }

// "silent for 201 ms" and "silent for 205 ms" are one reason.
std::string without_figures(const std::string& reason) {
  std::string words;
  for (std::size_t i = 0; i < reason.size(); ++i) {
    const bool digit = std::isdigit(static_cast<unsigned char>(reason[i])) != 0;
    const bool point = reason[i] == '.' && !words.empty() && words.back() == '#' && i + 1 < reason.size() &&
                       std::isdigit(static_cast<unsigned char>(reason[i + 1])) != 0;
    if (!digit && !point)
      words += reason[i];
    else if (words.empty() || words.back() != '#')
      words += '#';
  }
  return words;
}

std::string percent(const Share& share) {
  char text[96];
  std::snprintf(text, sizeof text, "%.1f %% (%d of %d; 95 %%: %.1f to %.1f %%)", 100.0 * share.value(), share.count,
                share.of, 100.0 * share.low, 100.0 * share.high);
  return text;
}

nlohmann::ordered_json json_of(const Share& share) {
  return {{"count", share.count}, {"of", share.of}, {"rate", share.value()}, {"low", share.low}, {"high", share.high}};
}

nlohmann::ordered_json json_of(const Pose2& pose) { return {{"x", pose.x}, {"y", pose.y}, {"yaw", pose.yaw}}; }

}  // namespace

bool came_to_end(const RunRecord& record) { return claims_success(record) || record.sigma.has_value(); }

Share share_of(int count, int of, double confidence) {
  Share share{count, of, 0.0, 1.0};
  if (of == 0) return share;
  const double tail = 0.5 * (1.0 - confidence);
  if (count > 0) share.low = chance_where(count - 1, of, 1.0 - tail);
  if (count < of) share.high = chance_where(count, of, tail);
  return share;
}

SigmaBounds sigma_bounds(const std::vector<double>& values) {
  constexpr double z = 1.959964;
  constexpr std::size_t least = 6;
  SigmaBounds bounds{0.0, std::numeric_limits<double>::infinity()};
  if (values.size() < least) return bounds;
  const auto count = static_cast<double>(values.size());
  std::vector<double> sorted = values;
  std::sort(sorted.begin(), sorted.end());
  // The kurtosis about a mean without the outermost values.
  const auto cut = static_cast<std::size_t>(count * 0.5 / std::sqrt(count - 4.0));
  double mean = 0.0;
  double trimmed = 0.0;
  for (std::size_t i = 0; i < sorted.size(); ++i) {
    mean += sorted[i] / count;
    if (i >= cut && i + cut < sorted.size()) trimmed += sorted[i] / (count - 2.0 * static_cast<double>(cut));
  }
  double square = 0.0;
  double fourth = 0.0;
  for (const double value : sorted) {
    square += std::pow(value - mean, 2);
    fourth += std::pow(value - trimmed, 4);
  }
  if (!(square > 0.0)) return {1.0, 1.0};
  const double kurtosis = count * fourth / (square * square);
  const double error = std::sqrt(std::max(0.0, (kurtosis - (count - 3.0) / count) / (count - 1.0)));
  const double corrected = count / (count - z);
  bounds.low = std::sqrt(corrected * std::exp(-z * corrected * error));
  bounds.high = std::sqrt(corrected * std::exp(z * corrected * error));
  return bounds;
}

double shown_reliability(int failures, int runs, double confidence) {
  if (runs == 0 || failures >= runs) return 0.0;
  return 1.0 - chance_where(failures, runs, 1.0 - confidence);
}

std::string fault_words(const Evaluation& evaluation) {
  const auto longest = [](double ms) {
    char text[48];
    std::snprintf(text, sizeof text, "%.0f ms", ms);
    return std::isfinite(ms) ? std::string(text) : std::string("never");
  };
  return "in " + std::to_string(evaluation.faults) +
         " runs; from the last good input (a frame's mid-exposure) at most " + longest(evaluation.fault_to_zero_ms) +
         " to a zero command, " + longest(evaluation.fault_to_stand_ms) + " until the wheels stood";
}

Evaluation evaluate(const std::vector<RunRecord>& records) {
  constexpr double never = std::numeric_limits<double>::infinity();
  Evaluation result;
  result.runs = static_cast<int>(records.size());
  if (records.empty()) return result;
  std::array<std::vector<double>, 3> sizes;
  std::vector<Pose2> errors;
  std::vector<Pose2> ended;
  std::vector<double> durations;
  std::map<std::string, int> reasons;
  int first = 0;
  int all = 0;
  int near = 0;
  Eigen::Vector3d squares = Eigen::Vector3d::Zero();
  for (const RunRecord& record : records) {
    const Pose2& error = record.true_error;
    errors.push_back(error);
    if (came_to_end(record)) ended.push_back(error);
    sizes[0].push_back(std::abs(error.x));
    sizes[1].push_back(std::abs(error.y));
    sizes[2].push_back(std::abs(error.yaw));
    durations.push_back(record.duration_s);
    result.mean_duration_s += record.duration_s / result.runs;
    result.mean_attempts += static_cast<double>(record.attempts) / result.runs;
    const bool good = inside(error, 0.003, 0.5);
    const bool close = inside(error, 0.010, 1.0);
    if (claims_success(record)) {
      all += good ? 1 : 0;
      first += good && record.attempts == 1 ? 1 : 0;
      near += close ? 1 : 0;
      result.wrong_claims += good ? 0 : 1;
      result.outside_without_word += close ? 0 : 1;
    } else {
      ++result.failed;
      ++reasons[without_figures(record.reason)];
    }
    if (!record.fault.empty()) {
      ++result.faults;
      result.fault_to_zero_ms = std::max(result.fault_to_zero_ms, record.fault_to_zero_ms.value_or(never));
      result.fault_to_stand_ms = std::max(result.fault_to_stand_ms, record.fault_to_stand_ms.value_or(never));
    }
    if (record.sigma && record.estimated) {
      ++result.with_sigma;
      squares += Eigen::Vector3d(std::pow((record.estimated->x - error.x) / record.sigma->x, 2),
                                 std::pow((record.estimated->y - error.y) / record.sigma->y, 2),
                                 std::pow(wrap_angle(record.estimated->yaw - error.yaw) / record.sigma->yaw, 2));
    }
  }
  if (result.with_sigma > 0) squares /= result.with_sigma;
  result.normalised = {squares.x(), squares.y(), squares.z()};
  const Spread spread = spread_of(errors);
  result.mean = spread.mean;
  result.sigma = spread.sigma;
  result.sigma_low = spread.sigma_low;
  result.sigma_high = spread.sigma_high;
  result.p95 = {quantile(sizes[0], 0.95), quantile(sizes[1], 0.95), quantile(sizes[2], 0.95)};
  result.ended = spread_of(ended);
  result.first_3mm = share_of(first, result.runs);
  result.all_3mm = share_of(all, result.runs);
  result.all_10mm = share_of(near, result.runs);
  result.p99_duration_s = quantile(durations, 0.99);
  result.reasons.assign(reasons.begin(), reasons.end());
  std::sort(result.reasons.begin(), result.reasons.end(),
            [](const auto& a, const auto& b) { return a.second > b.second; });
  return result;
}

nlohmann::ordered_json to_json(const Evaluation& evaluation, const RunSettings& settings) {
  nlohmann::ordered_json json;
  json["schema"] = "tagdock-evaluation/1";
  json["strategy"] = settings.strategy == Strategy::servo ? "servo" : "paper";
  json["scenario"] = settings.scenario.name;
  json["start"] = settings.start_name;
  json["rig"] = settings.rig_name;
  json["board"] = settings.board_name;
  json["corners"] = settings.corners_name;
  json["images"] = settings.images ? "on" : "off";
  json["runs"] = evaluation.runs;
  json["mean"] = json_of(evaluation.mean);
  json["mean_offset_m"] = std::hypot(evaluation.mean.x, evaluation.mean.y);
  json["sigma"] = json_of(evaluation.sigma);
  json["sigma_95"] = {{"low", json_of(evaluation.sigma_low)}, {"high", json_of(evaluation.sigma_high)}};
  json["p95_abs"] = json_of(evaluation.p95);
  // Of the runs that came to the dock and measured there: `sigma` has also where the others were left.
  json["ended"] = {
      {"runs", evaluation.ended.runs},
      {"mean", json_of(evaluation.ended.mean)},
      {"sigma", json_of(evaluation.ended.sigma)},
      {"sigma_95", {{"low", json_of(evaluation.ended.sigma_low)}, {"high", json_of(evaluation.ended.sigma_high)}}}};
  json["first_attempt_3mm_05deg"] = json_of(evaluation.first_3mm);
  json["success_3mm_05deg"] = json_of(evaluation.all_3mm);
  json["success_10mm_1deg"] = json_of(evaluation.all_10mm);
  json["reliability_shown_95"] = shown_reliability(evaluation.runs - evaluation.all_3mm.count, evaluation.runs);
  json["failed"] = evaluation.failed;
  json["wrong_claims"] = evaluation.wrong_claims;
  json["outside_without_word"] = evaluation.outside_without_word;
  json["duration_s"] = {{"mean", evaluation.mean_duration_s}, {"p99", evaluation.p99_duration_s}};
  json["mean_attempts"] = evaluation.mean_attempts;
  json["normalised_error_squared"] =
      evaluation.with_sigma > 0 ? json_of(evaluation.normalised) : nlohmann::ordered_json(nullptr);
  if (evaluation.faults > 0)
    json["faults"] = {{"runs", evaluation.faults},
                      {"longest_to_zero_ms", evaluation.fault_to_zero_ms},
                      {"longest_to_stand_ms", evaluation.fault_to_stand_ms}};
  json["reasons"] = nlohmann::ordered_json::object();
  for (const auto& [reason, count] : evaluation.reasons) json["reasons"][reason] = count;
  return json;
}

std::string sigma_words(double sigma, double low, double high, double scale, const char* unit, int decimals) {
  char text[96];
  if (std::isfinite(high))
    std::snprintf(text, sizeof text, "%.*f %s (%.*f to %.*f)", decimals, scale * sigma, unit, decimals, scale * low,
                  decimals, scale * high);
  else
    std::snprintf(text, sizeof text, "%.*f %s (too few runs to bound)", decimals, scale * sigma, unit);
  return text;
}

std::string fix_words(const Evaluation& evaluation) {
  if (evaluation.with_sigma == 0) return "";
  const double count = evaluation.with_sigma;
  const double least = chi_squared_quantile(count, -1.959964) / count;
  const double most = chi_squared_quantile(count, 1.959964) / count;
  char text[640];
  std::snprintf(text, sizeof text,
                "After %d dockings the robot said where it stands, and how sure it is (1 sigma). The error of that "
                "statement against the truth, in units of its sigma, is squared and averaged (NEES): 1 means that it "
                "errs as much as it says; for %d runs %.2f to %.2f cannot be told from 1. Below, it is cautious: "
                "it errs less than it says, and may refuse or try again where it need not. Above, it is too sure of "
                "itself, and may claim what is not true.",
                evaluation.with_sigma, evaluation.with_sigma, least, most);
  std::string words = text;
  const std::pair<const char*, double> axes[] = {
      {"x", evaluation.normalised.x}, {"y", evaluation.normalised.y}, {"heading", evaluation.normalised.yaw}};
  for (const auto& [name, value] : axes) {
    std::snprintf(text, sizeof text, " %s: NEES %.2f, it errs %.2f times what it says (%s).",
                  std::string(name) == "heading" ? "Heading" : name, value, std::sqrt(value),
                  value < least  ? "cautious"
                  : value > most ? "too sure"
                                 : "as it says");
    words += text;
  }
  return words;
}

std::string summary(const Evaluation& evaluation) {
  if (evaluation.runs == 0) return "no runs (fewer than shards)\n";
  char text[640];
  std::snprintf(text, sizeof text,
                "%d runs\nmean  x %+.2f mm  y %+.2f mm  yaw %+.3f deg  (offset %.1f mm)\n"
                "sigma x %.2f mm   y %.2f mm   yaw %.3f deg\n",
                evaluation.runs, 1e3 * evaluation.mean.x, 1e3 * evaluation.mean.y, degrees(evaluation.mean.yaw),
                1e3 * std::hypot(evaluation.mean.x, evaluation.mean.y), 1e3 * evaluation.sigma.x,
                1e3 * evaluation.sigma.y, degrees(evaluation.sigma.yaw));
  std::string result = text;
  result += "inside 3 mm, 3 mm, 0.5 deg, first attempt: " + percent(evaluation.first_3mm) + "\n";
  result += "inside 3 mm, 3 mm, 0.5 deg, with retries:  " + percent(evaluation.all_3mm) + "\n";
  result += "inside 10 mm, 10 mm, 1 deg:                " + percent(evaluation.all_10mm) + "\n";
  std::snprintf(text, sizeof text,
                "wrong claims: %d (outside 10 mm, 1 deg: %d); failed and said so: %d\n"
                "time: mean %.1f s, p99 %.1f s; attempts: mean %.2f\n",
                evaluation.wrong_claims, evaluation.outside_without_word, evaluation.failed, evaluation.mean_duration_s,
                evaluation.p99_duration_s, evaluation.mean_attempts);
  result += text;
  if (evaluation.with_sigma > 0) {
    std::snprintf(
        text, sizeof text,
        "error of the robot's own fix over the sigma it states: x %.2f  y %.2f  yaw %.2f (as stated: 1; less: "
        "cautious)\n",
        std::sqrt(evaluation.normalised.x), std::sqrt(evaluation.normalised.y), std::sqrt(evaluation.normalised.yaw));
    result += text;
  }
  if (evaluation.faults > 0) result += "something broke " + fault_words(evaluation) + "\n";
  for (const auto& [reason, count] : evaluation.reasons) result += "  " + std::to_string(count) + "x " + reason + "\n";
  return result;
}

std::string html_against_others(const std::string& rows) {
  return "<table><tr><th></th><th>mean offset</th><th>mean heading</th><th>sigma x</th><th>sigma y</th><th>sigma "
         "heading</th><th>95 % of |x|, |y|, |heading|</th></tr>\n" +
         rows +
         "<tr><td>Richter et al., measured on a 710 kg robot</td><td>45 mm</td><td>0.4 deg</td><td>9.6 mm</td><td>25.7 "
         "mm</td><td>1.11 deg</td><td></td></tr>\n"
         "<tr><td>MiR250 with VL marker, its maker's specification</td><td></td><td></td><td></td><td></td><td></td>"
         "<td>3 mm, 3 mm, 0.5 deg; at most 14 s</td></tr></table>\n";
}

std::string html_row(const Evaluation& evaluation, const std::string& name) {
  char row[512];
  std::snprintf(row, sizeof row,
                "<td>%.1f mm</td><td>%+.2f deg</td><td>%.2f mm</td><td>%.2f mm</td><td>%.3f "
                "deg</td><td>%.2f mm, %.2f mm, %.2f deg</td></tr>\n",
                1e3 * std::hypot(evaluation.mean.x, evaluation.mean.y), degrees(evaluation.mean.yaw),
                1e3 * evaluation.sigma.x, 1e3 * evaluation.sigma.y, degrees(evaluation.sigma.yaw),
                1e3 * evaluation.p95.x, 1e3 * evaluation.p95.y, degrees(evaluation.p95.yaw));
  return "<tr><td>" + html_text(name) + "</td>" + row;
}

std::string to_html(const Evaluation& evaluation, const FigureData& data, const CampaignPage& page) {
  char row[512];
  std::string html = html_head(page.title) + page.first;
  html += "<p>" + std::to_string(evaluation.runs) +
          " runs. Errors are of the camera point and heading against the docking pose, " + html_text(page.truth) +
          "; x is towards the wall (minus the paper's z).</p>\n";
  html += html_against_others(html_row(evaluation, "this campaign")) + "<table>";
  const auto add = [&](const std::string& what, const std::string& value) {
    html += "<tr><th>" + what + "</th><td>" + html_text(value) + "</td></tr>\n";
  };
  add("sigma x, y, heading, and their 95 % intervals",
      sigma_words(evaluation.sigma.x, evaluation.sigma_low.x, evaluation.sigma_high.x, 1e3, "mm", 2) + "; " +
          sigma_words(evaluation.sigma.y, evaluation.sigma_low.y, evaluation.sigma_high.y, 1e3, "mm", 2) + "; " +
          sigma_words(evaluation.sigma.yaw, evaluation.sigma_low.yaw, evaluation.sigma_high.yaw, degrees(1.0), "deg",
                      3));
  add("inside 3 mm, 3 mm, 0.5 deg at the first attempt", percent(evaluation.first_3mm));
  add("the same, with retries", percent(evaluation.all_3mm));
  add("inside 10 mm, 10 mm, 1 deg", percent(evaluation.all_10mm));
  add("claimed success, outside 3 mm, 3 mm, 0.5 deg", std::to_string(evaluation.wrong_claims));
  add("failed, and said so", std::to_string(evaluation.failed));
  std::snprintf(row, sizeof row, "%.4f with a confidence of 0.95 (%d of %d inside 3 mm, 3 mm, 0.5 deg)",
                shown_reliability(evaluation.runs - evaluation.all_3mm.count, evaluation.runs),
                evaluation.all_3mm.count, evaluation.runs);
  add("reliability shown, in the terms of ASTM F3499-21", row);
  std::snprintf(row, sizeof row, "mean %.1f s, p99 %.1f s; attempts: mean %.2f", evaluation.mean_duration_s,
                evaluation.p99_duration_s, evaluation.mean_attempts);
  add("time", row);
  if (evaluation.with_sigma > 0) add("does the robot know how well it stands", fix_words(evaluation));
  if (evaluation.faults > 0) add("something broke on the way", fault_words(evaluation));
  for (const auto& [reason, count] : evaluation.reasons)
    add("failed: " + html_text(reason), std::to_string(count) + (count == 1 ? " run" : " runs"));
  html += "</table>\n" + figure_10(data) + figure_10_start(data);
  if (!data.traces.empty()) html += figure_9({data}) + figure_8({data});
  return html + page.limits + "<h2>Campaign</h2><pre>" + html_text(page.campaign) + "</pre></body></html>\n";
}

}  // namespace tagdock
