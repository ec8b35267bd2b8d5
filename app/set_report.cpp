#include "app/set_report.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <optional>
#include <sstream>

#include "app/evaluation_figures.h"
#include "app/html.h"

namespace tagdock {
namespace {

template <typename... Values>
std::string print(const char* format, Values... values) {
  char text[640];
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

// The first campaign of a scenario and strategy.
const SetResult* find(const std::vector<SetResult>& results, const std::string& scenario, const std::string& strategy) {
  const auto found = std::find_if(results.begin(), results.end(), [&](const SetResult& one) {
    return one.value("scenario_name") == scenario && one.value("strategy") == strategy;
  });
  return found == results.end() ? nullptr : &*found;
}

FigureData figure_data(const SetResult& result, const std::string& name, const std::string& colour) {
  return {name, colour, result.records, result.traces, std::atof(result.value("focal_length_px").c_str()), 0.16};
}

std::string gains(const std::vector<SetResult>& results) {
  const SetResult* paper = find(results, "paper_start-paper");
  const SetResult* straight = find(results, "straight_start-paper");
  const SetResult* board = find(results, "straight_start-paper-v_convex_centre");
  const SetResult* servo = find(results, "straight_start", "servo");
  if (paper == nullptr || straight == nullptr || board == nullptr || servo == nullptr) return "";
  const auto row = [](const std::string& what, const SetResult* one, const SetResult* before) {
    const double y = one->evaluation.sigma.y;
    return "<tr><td>" + what + "</td>" +
           print("<td>%d</td><td>%.2f mm</td><td>%.2f mm</td><td>%.3f deg</td>", one->evaluation.runs,
                 1e3 * one->evaluation.sigma.x, 1e3 * y, degrees(one->evaluation.sigma.yaw)) +
           (before == nullptr ? std::string("<td></td>")
                              : print("<td>%.1f times</td>", before->evaluation.sigma.y / y)) +
           "</tr>\n";
  };
  return "<h2>Where the gain comes from</h2>\n<table><tr><th></th><th>runs</th><th>sigma x</th><th>sigma "
         "y</th><th>sigma "
         "heading</th><th>gain in sigma y</th></tr>\n" +
         row("the paper's path, open loop, one flat tag", paper, nullptr) +
         row("the straight path (3.45 m, 5 degrees), open loop, one flat tag", straight, paper) +
         row("the same with the servo's board", board, straight) +
         row("the same start, loop closed on what the camera sees", servo, board) +
         "</table>\n<p>The path's gain and the loop's are not to be mixed: the straight start is not the paper's. Both "
         "open "
         "loops have the paper's corner noise (0.10 px and 0.05 px lasting) and the large image; the closed loop has "
         "the "
         "measured corners of the default rig, and a taught docking pose.</p>\n";
}

std::string faults(const std::vector<SetResult>& results) {
  std::string rows;
  for (const SetResult& result : results) {
    const Evaluation& one = result.evaluation;
    if (one.faults == 0 || result.value("strategy") == "paper") continue;
    rows += "<tr><td>" + html_text(result.name) + "</td>" +
            print("<td>%d</td><td>%.0f ms</td><td>%.0f ms</td><td>%d</td><td>", one.faults, one.fault_to_zero_ms,
                  one.fault_to_stand_ms, one.wrong_claims);
    for (const auto& [reason, count] : one.reasons) rows += print("%d: ", count) + html_text(reason) + "<br>";
    rows += "</td></tr>\n";
  }
  if (rows.empty()) return "";
  return "<h2>Where something breaks on the way</h2><p>Times are the longest of all runs, from the last good input. A "
         "frame counts from mid-exposure: its latency and 250 ms beyond it may pass before the robot is held; odometry "
         "may be 100 ms old; a robot without commands stops by itself after 200 ms. Each is sampled by the control "
         "cycle of 20 ms. The paper's strategy has no watchdog and is left out here.</p>\n"
         "<table><tr><th>campaign</th><th>runs</th><th>zero command after</th><th>wheels stand after</th><th>wrong "
         "claims</th><th>reasons</th></tr>\n" +
         rows + "</table>\n";
}

// What an ablation comes to: for each path and law a table of boards and corner methods. Its names are
// path-law-board-corners (ablation_set); path and board have no minus in them.
struct AblationName {
  std::string path, law, board, corners;
};

std::optional<AblationName> ablation_name(const std::string& name) {
  std::vector<std::string> parts;
  std::istringstream stream(name);
  for (std::string part; std::getline(stream, part, '-');) parts.push_back(part);
  if (parts.size() != 4) return std::nullopt;
  const bool law = parts[1] == "open" || parts[1] == "centering" || parts[1] == "line";
  return law ? std::optional(AblationName{parts[0], parts[1], parts[2], parts[3]}) : std::nullopt;
}

std::string ablation(const std::vector<SetResult>& results) {
  std::vector<std::string> groups, boards, corners;
  const auto note = [](std::vector<std::string>& list, const std::string& word) {
    if (std::find(list.begin(), list.end(), word) == list.end()) list.push_back(word);
  };
  for (const SetResult& result : results) {
    const auto name = ablation_name(result.name);
    if (!name) return "";
    note(groups, name->path + "-" + name->law);
    note(boards, name->board);
    note(corners, name->corners);
  }
  if (boards.size() < 2 || corners.size() < 2) return "";
  std::string html =
      "<h2>Ablation: path, law, board, corners</h2>\n<p>Sigma y and share inside 3 mm, 3 mm, 0.5 degrees, after one "
      "attempt, with no refusal for an uncertain pose. A run that failed counts where it ended. \"open\" looks only "
      "from "
      "the start and drives by odometry; an AprilTag corner there mistakes a flat tag seen head-on for its mirror "
      "image, which makes the largest figures.</p>\n";
  for (const std::string& group : groups) {
    html += "<table><caption>" + html_text(group) + "</caption><tr><th></th>";
    for (const std::string& method : corners) html += "<th>" + html_text(method) + "</th>";
    html += "<th>apriltag / best</th></tr>\n";
    for (const std::string& board : boards) {
      html += "<tr><th>" + html_text(board) + "</th>";
      const auto of = [&](const std::string& method) { return find(results, group + "-" + board + "-" + method); };
      for (const std::string& method : corners) {
        const SetResult* one = of(method);
        html += one == nullptr ? std::string("<td></td>")
                               : print("<td>%.2f mm, %.0f %%</td>", 1e3 * one->evaluation.sigma.y,
                                       100.0 * one->evaluation.first_3mm.value());
      }
      const SetResult* library = of("apriltag");
      const SetResult* ours = of("best");
      html += library == nullptr || ours == nullptr || ours->evaluation.sigma.y <= 0.0
                  ? std::string("<td></td>")
                  : print("<td>%.1f times</td>", library->evaluation.sigma.y / ours->evaluation.sigma.y);
      html += "</tr>\n";
    }
    html += "</table>\n";
  }
  return html;
}

std::string campaigns(const std::vector<SetResult>& results) {
  std::string html =
      "<h2>All campaigns</h2>\n<table><tr><th>campaign</th><th>runs</th><th>mean offset</th><th>mean "
      "heading</th><th>sigma x</th><th>sigma y</th><th>sigma heading</th><th>in 3 mm, 0.5 deg at first "
      "<small>(95 %)</small></th><th>with retries</th><th>in 10 mm, 1 deg</th><th>reliability shown at confidence "
      "0.95</th><th>wrong claims</th><th>failed, and said so</th><th>mean, p99 time</th><th>NEES x, y, "
      "heading</th></tr>\n";
  for (const SetResult& result : results) {
    const Evaluation& one = result.evaluation;
    html +=
        "<tr><td><a href=\"" + result.name + "/report.html\">" + html_text(result.name) + "</a></td>" +
        print("<td>%d</td><td>%.1f mm</td><td>%+.2f deg</td><td>%.2f mm</td><td>%.2f mm</td><td>%.3f deg</td>",
              one.runs, 1e3 * std::hypot(one.mean.x, one.mean.y), degrees(one.mean.yaw), 1e3 * one.sigma.x,
              1e3 * one.sigma.y, degrees(one.sigma.yaw)) +
        "<td>" + share_with_bounds(one.first_3mm) + "</td><td>" + share_with_bounds(one.all_3mm) + "</td><td>" +
        share_with_bounds(one.all_10mm) + "</td>" +
        print("<td>%.4f</td><td>%d</td><td>%d</td><td>%.1f, %.1f s</td>",
              shown_reliability(one.runs - one.all_3mm.count, one.runs), one.wrong_claims, one.failed,
              one.mean_duration_s, one.p99_duration_s) +
        (one.with_sigma > 0 ? print("<td>%.2f, %.2f, %.2f</td>", one.normalised.x, one.normalised.y, one.normalised.yaw)
                            : std::string("<td></td>")) +
        "</tr>\n";
  }
  return html + "</table>\n";
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

std::string html_of_part(const std::vector<SetResult>& results) {
  int have = 0;
  int wanted = 0;
  bool known = true;
  std::vector<std::string> sentences;
  std::string shard;
  for (const SetResult& result : results) {
    have += result.evaluation.runs;
    wanted += result.wanted;
    known = known && result.wanted > 0;
    sentences.insert(sentences.end(), result.missing.begin(), result.missing.end());
    if (result.share.shards > 1)
      shard = print("shard %d of %d (counted from 0)", result.share.shard, result.share.shards);
  }
  if (sentences.empty() && shard.empty()) return "";
  std::string html = "<div class=\"partial\"><b>Partial: " + std::to_string(have) + " of " +
                     (known ? std::to_string(wanted) : std::string("an unknown number of")) + " runs.</b> ";
  html += shard.empty() ? "Joined although runs are missing; the figures are of those that are there."
                        : "This is " + shard + "; join it with the others by <code>tagdock evaluate --join</code>.";
  if (!sentences.empty()) html += "<ul>";
  constexpr std::size_t most = 20;
  for (std::size_t i = 0; i < std::min(most, sentences.size()); ++i) html += "<li>" + html_text(sentences[i]) + "</li>";
  if (sentences.size() > most) html += print("<li>and %zu more</li>", sentences.size() - most);
  return html + (sentences.empty() ? "</div>\n" : "</ul></div>\n");
}

nlohmann::ordered_json json_of_part(const SetResult& result) {
  if (result.missing.empty() && result.share.shards <= 1) return nullptr;
  nlohmann::ordered_json json;
  json["runs"] = result.evaluation.runs;
  json["of"] = result.wanted > 0 ? nlohmann::ordered_json(result.wanted) : nlohmann::ordered_json(nullptr);
  if (result.share.shards > 1)
    json["shard"] = std::to_string(result.share.shard) + "/" + std::to_string(result.share.shards);
  if (!result.missing.empty()) json["missing"] = result.missing;
  return json;
}

std::string set_to_html(const std::vector<SetResult>& results) {
  std::string html = html_head("tagdock evaluate") + html_of_part(results);
  html +=
      "<p>Errors are of the camera point and heading against the docking pose, as the simulator knows them; x is "
      "towards "
      "the wall (minus the paper's z). Every run counts in every figure. The same seeds everywhere. Intervals are "
      "those "
      "of Clopper and Pearson, 95 %. In terms of ASTM F3499-21, reliability is what so many runs with so many failures "
      "show at a confidence of 0.95, inside 3 mm, 3 mm, 0.5 degrees, with retries.</p>\n";
  const SetResult* paper = find(results, "paper_start", "paper");
  if (paper == nullptr) paper = find(results, "default", "paper");
  const SetResult* servo = find(results, "default", "servo");
  if (servo == nullptr) servo = find(results, "straight_start", "servo");
  const std::string compared = ablation(results);
  if (!compared.empty()) paper = servo = nullptr;  // none of its members stands for its strategy
  std::vector<FigureData> data;
  std::string rows;
  if (paper != nullptr) {
    data.push_back(figure_data(*paper, "paper's strategy", "#c53030"));
    rows += html_row(paper->evaluation, "the paper's strategy, simulated (" + paper->name + ")");
  }
  if (servo != nullptr) {
    data.push_back(figure_data(*servo, "servo", "#2b6cb0"));
    rows += html_row(servo->evaluation, "servo, simulated (" + servo->name + ")");
  }
  if (!rows.empty()) html += "<h2>Against the paper and MiR</h2>\n" + html_against_others(rows);
  html += gains(results);
  if (paper != nullptr && servo != nullptr) {
    html +=
        "<h2>The paper's figures made anew</h2>\n<p>Figure 5 is without slip, so that what is seen is the "
        "controller's. Figure 8's sightings have drawn corner errors unless the campaign had images; the paper's "
        "strategy has the corner noise that explains its pose errors, and looks only from its start.</p>\n";
    html += figure_5() + figure_8(data) + figure_9(data);
    for (const FigureData& one : data) html += figure_10_start(one);
    for (const FigureData& one : data) html += figure_10(one);
  }
  html += compared + faults(results) + campaigns(results) + html_limits();
  return html + "</body></html>\n";
}

}  // namespace tagdock
