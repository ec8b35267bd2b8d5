#include "app/set_report.h"

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace tagdock {
namespace {

template <typename... Values>
std::string print(const char* format, Values... values) {
  char text[512];
  std::snprintf(text, sizeof text, format, values...);
  return text;
}

std::string share(const Share& one) { return print("%.1f %%", 100.0 * one.value()); }

std::string share_with_bounds(const Share& one) {
  return print("%.1f %% <small>(%.1f to %.1f)</small>", 100.0 * one.value(), 100.0 * one.low, 100.0 * one.high);
}

const SetResult* find(const std::vector<SetResult>& results, const std::string& name) {
  const auto found = std::find_if(results.begin(), results.end(), [&](const auto& one) { return one.name == name; });
  return found == results.end() ? nullptr : &*found;
}

}  // namespace

std::string set_summary(const std::vector<SetResult>& results) {
  std::size_t width = 8;
  for (const SetResult& result : results) width = std::max(width, result.name.size());
  std::string text =
      print("%-*s %5s %8s %7s %7s %7s %7s %7s %7s %7s %6s %6s %6s\n", static_cast<int>(width), "campaign", "runs",
            "mean mm", "deg", "sx mm", "sy mm", "syaw", "3mm 1st", "3 mm", "10 mm", "wrong", "failed", "s");
  for (const SetResult& result : results) {
    const Evaluation& one = result.evaluation;
    text += print("%-*s %5d %8.1f %+7.2f %7.2f %7.2f %7.3f %7s %7s %7s %6d %6d %6.1f\n", static_cast<int>(width),
                  result.name.c_str(), one.runs, 1e3 * std::hypot(one.mean.x, one.mean.y), degrees(one.mean.yaw),
                  1e3 * one.sigma.x, 1e3 * one.sigma.y, degrees(one.sigma.yaw), share(one.first_3mm).c_str(),
                  share(one.all_3mm).c_str(), share(one.all_10mm).c_str(), one.wrong_claims, one.failed,
                  one.mean_duration_s);
  }
  return text;
}

std::string set_to_html(const std::vector<SetResult>& results) {
  std::string html =
      "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>tagdock evaluate</title>"
      "<style>body{font:15px/1.5 sans-serif;max-width:1320px;margin:2em auto;padding:0 1em;color:#222}"
      "table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #bbb;padding:4px 8px;text-align:left}"
      "th{background:#eef2f7}small{color:#666}</style></head><body>\n<h1>tagdock evaluate: all campaigns</h1>\n"
      "<table><tr><th>campaign</th><th>runs</th><th>mean offset</th><th>mean heading</th><th>sigma x</th><th>sigma "
      "y</th><th>sigma heading</th><th>in 3 mm, 0.5 deg at first</th><th>with retries</th><th>in 10 mm, 1 "
      "deg</th><th>wrong claims</th><th>failed, and said so</th><th>mean time</th></tr>\n";
  for (const SetResult& result : results) {
    const Evaluation& one = result.evaluation;
    html += "<tr><td><a href=\"" + result.name + "/report.html\">" + result.name + "</a></td>" +
            print("<td>%d</td><td>%.1f mm</td><td>%+.2f deg</td><td>%.2f mm</td><td>%.2f mm</td><td>%.2f deg</td>",
                  one.runs, 1e3 * std::hypot(one.mean.x, one.mean.y), degrees(one.mean.yaw), 1e3 * one.sigma.x,
                  1e3 * one.sigma.y, degrees(one.sigma.yaw)) +
            "<td>" + share_with_bounds(one.first_3mm) + "</td><td>" + share_with_bounds(one.all_3mm) + "</td><td>" +
            share_with_bounds(one.all_10mm) + "</td>" +
            print("<td>%d</td><td>%d</td><td>%.1f s</td></tr>\n", one.wrong_claims, one.failed, one.mean_duration_s);
  }
  html += "</table>\n";
  const SetResult* paper = find(results, "paper_start-paper");
  const SetResult* straight = find(results, "straight_start-paper");
  const SetResult* servo = find(results, "straight_start-servo-default");
  if (paper != nullptr && straight != nullptr && servo != nullptr) {
    const auto y = [](const SetResult* one) { return 1e3 * one->evaluation.sigma.y; };
    html += print(
        "<h2>Where the gain comes from</h2><p>Sigma y: %.1f mm on the paper's path, open loop; %.2f mm on the straight "
        "path, open loop; %.2f mm with the loop closed. The straighter path alone gives %.1f times, closing the loop "
        "%.1f times.</p>\n",
        y(paper), y(straight), y(servo), y(paper) / y(straight), y(straight) / y(servo));
  }
  return html + "</body></html>\n";
}

}  // namespace tagdock
