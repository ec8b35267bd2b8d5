#include "app/set_report.h"

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>

#include "app/ablation_report.h"
#include "app/campaign_agreement.h"
#include "app/evaluation_figures.h"
#include "app/html.h"
#include "app/print.h"

namespace tagdock {
namespace {

std::string share(const Share& one) { return print("%.1f %%", 100.0 * one.value()); }

std::string share_with_bounds(const Share& one) {
  return print("%.1f %% <small>(%.1f to %.1f)</small>", 100.0 * one.value(), 100.0 * one.low, 100.0 * one.high);
}

// A sigma in mm with its interval.
std::string sigma_cell(double sigma, double low, double high) {
  return std::isfinite(high) ? print("%.2f mm <small>(%.2f to %.2f)</small>", 1e3 * sigma, 1e3 * low, 1e3 * high)
                             : print("%.2f mm", 1e3 * sigma);
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

// The campaigns that tell apart what the path, the board and the loop give: all from one scenario but for the start.
struct Steps {
  const SetResult* paper = nullptr;      ///< its own start, open loop, one flat tag
  const SetResult* straight = nullptr;   ///< the straight start, the same
  const SetResult* board = nullptr;      ///< with the servo's board
  const SetResult* servo = nullptr;      ///< with the loop closed
  const SetResult* own_start = nullptr;  ///< the loop closed, from the paper's start
};

Steps steps_of(const std::vector<SetResult>& results) {
  Steps steps;
  for (const char* name : {"paper_start-paper", "default-paper"})
    if (steps.paper == nullptr) steps.paper = find(results, name);
  steps.straight = find(results, "straight_start-paper");
  steps.board = find(results, "straight_start-paper-v_convex_centre");
  steps.servo = find(results, "straight_start", "servo");
  steps.own_start = find(results, "paper_start", "servo");
  if (!is_ablation(results)) return steps;
  steps.paper = find(results, "paper_start-open-one_tag-best");
  steps.straight = find(results, "straight_start-open-one_tag-best");
  steps.board = find(results, "straight_start-open-v_convex_centre-best");
  steps.servo = find(results, "straight_start-line-v_convex_centre-best");
  steps.own_start = find(results, "paper_start-line-v_convex_centre-best");
  return steps;
}

std::string gains(const std::vector<SetResult>& results) {
  const Steps steps = steps_of(results);
  if (is_ablation(results) || steps.paper == nullptr || steps.straight == nullptr || steps.board == nullptr ||
      steps.servo == nullptr)
    return "";
  const auto row = [](const std::string& what, const SetResult* one, const SetResult* before) {
    const Evaluation& all = one->evaluation;
    std::string gain = "<td></td>";
    if (before != nullptr) {
      const SigmaRatio ratio = sigma_ratios(before->records, one->records)[1];
      gain = print("<td><b>%.1f times</b> <small>(%.1f to %.1f)</small></td>", ratio.ratio, ratio.low, ratio.high);
    }
    return "<tr><td>" + what + "</td>" + print("<td>%d</td>", all.runs) + "<td>" +
           sigma_cell(all.sigma.x, all.sigma_low.x, all.sigma_high.x) + "</td><td>" +
           sigma_cell(all.sigma.y, all.sigma_low.y, all.sigma_high.y) +
           print("</td><td>%.3f&deg;</td>", degrees(all.sigma.yaw)) + gain + "<td>" + share_with_bounds(all.first_3mm) +
           print("</td><td>%.1f s</td></tr>\n", all.mean_duration_s);
  };
  std::string html =
      "<h2>Where the gain comes from</h2>\n<div class=\"wide\"><table><tr><th></th><th>runs</th><th>sigma "
      "x</th><th>sigma "
      "y</th><th>sigma heading</th><th>sigma y smaller than a row above by</th><th>inside 3 mm, 0.5 deg at "
      "first</th><th>mean time</th></tr>\n" +
      row("the paper's path, open loop, one flat tag", steps.paper, nullptr) +
      row("the straight path (3.45 m, 5 degrees), open loop, one flat tag", steps.straight, steps.paper) +
      row("the same with the servo's board", steps.board, steps.straight) +
      row("the same start, loop closed on what the camera sees", steps.servo, steps.board);
  if (steps.own_start != nullptr)
    html += row("the paper's own start, loop closed, with a back-off (against the first row)", steps.own_start,
                steps.paper);
  html +=
      "</table></div>\n<p>" + html_text(gain_words(evidence_of(results))) +
      ". The path's gain and the loop's are not to be mixed: the straight start is not the paper's. The open loops "
      "have "
      "the paper's corner noise (0.10 px and 0.05 px lasting) and the large image; the closed loops have the measured "
      "corners of the default rig, and a taught docking pose. Intervals are 95 %.</p>\n";
  return html;
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

// A name that may break after each of its parts, where a column is narrow.
std::string linked(const SetResult& result) {
  std::string words;
  for (const char letter : result.name) words += letter == '-' ? "-<wbr>" : html_text(std::string(1, letter));
  return "<a href=\"" + html_text(result.name) + "/report.html\">" + words + "</a>";
}

// Two tables, so that each fits a page: how near, and how sure.
std::string campaigns(const std::vector<SetResult>& results) {
  std::string near =
      "<div class=\"wide\"><table><caption>How near, all runs, wherever they ended</caption><tr><th>campaign</th><th>"
      "runs</th><th>mean x</th><th>mean y</th><th>mean heading</th><th>sigma x</th><th>sigma y</th><th>sigma "
      "heading</th><th>95 % of |x|, |y|, |heading|</th></tr>\n";
  std::string sure =
      "<div class=\"wide\"><table><caption>How sure, and how fast</caption><tr><th>campaign</th><th>in 3 mm, 0.5 deg "
      "at "
      "first</th><th>with retries</th><th>in 10 mm, 1 deg</th><th>reliability</th><th>wrong "
      "claims</th><th>failed, and said so</th><th>mean, p99 time</th><th>errs / says x, y, heading</th></tr>\n";
  for (const SetResult& result : results) {
    const Evaluation& one = result.evaluation;
    near += "<tr><td>" + linked(result) +
            print("</td><td>%d</td><td>%+.1f mm</td><td>%+.1f mm</td><td>%+.2f&deg;</td><td>", one.runs,
                  1e3 * one.mean.x, 1e3 * one.mean.y, degrees(one.mean.yaw)) +
            sigma_cell(one.sigma.x, one.sigma_low.x, one.sigma_high.x) + "</td><td>" +
            sigma_cell(one.sigma.y, one.sigma_low.y, one.sigma_high.y) +
            print("</td><td>%.3f&deg;</td><td>%.2f, %.2f mm, %.2f&deg;</td></tr>\n", degrees(one.sigma.yaw),
                  1e3 * one.p95.x, 1e3 * one.p95.y, degrees(one.p95.yaw));
    sure += "<tr><td>" + linked(result) + "</td><td>" + share_with_bounds(one.first_3mm) + "</td><td>" +
            share_with_bounds(one.all_3mm) + "</td><td>" + share_with_bounds(one.all_10mm) + "</td>" +
            print("<td>%.4f</td><td>%d</td><td>%d</td><td>%.1f, %.1f s</td>",
                  shown_reliability(one.runs - one.all_3mm.count, one.runs), one.wrong_claims, one.failed,
                  one.mean_duration_s, one.p99_duration_s) +
            (one.with_sigma > 0 ? print("<td>%.2f, %.2f, %.2f</td>", std::sqrt(one.normalised.x),
                                        std::sqrt(one.normalised.y), std::sqrt(one.normalised.yaw))
                                : std::string("<td></td>")) +
            "</tr>\n";
  }
  const std::string tables = near + "</table></div>\n" + sure + "</table></div>\n";
  const std::string words =
      "<p>Reliability: what so many runs with so many failures show at a confidence of 0.95, inside 3 mm, 3 mm, 0.5 "
      "degrees, with retries. A wrong claim says docked (or arrived) and is outside of that. Errs / says: the root "
      "mean "
      "square of the robot's own error over the sigma that it states with its fix (the root of NEES); 1 errs as it "
      "says, less is cautious and costs retries at worst, more is too sure of itself.</p>\n";
  if (!is_ablation(results)) return "<h2>All campaigns</h2>\n" + words + tables;
  return "<h2>All campaigns</h2>\n" + words + "<details><summary>All " + std::to_string(results.size()) +
         " combinations in figures</summary>" + tables + "</details>\n";
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

FigureData figure_data(const SetResult& result, const std::string& name, const std::string& colour) {
  FigureData data;
  data.name = name;
  data.style = colour;
  data.records = result.records;
  data.traces = result.traces;
  data.looks = result.looks;
  data.focal_length_px = std::atof(result.value("focal_length_px").c_str());
  return data;
}

LimitEvidence evidence_of(const std::vector<SetResult>& results) {
  LimitEvidence evidence;
  const auto figures = [](const SetResult* one) { return one == nullptr ? nullptr : &one->evaluation; };
  const Steps steps = steps_of(results);
  evidence.paper = figures(steps.paper);
  evidence.straight = figures(steps.straight);
  evidence.board = figures(steps.board);
  evidence.loop = figures(steps.servo);
  evidence.own_start = figures(steps.own_start);
  evidence.servo = figures(find(results, "default", "servo"));
  if (evidence.servo == nullptr) evidence.servo = evidence.loop;
  evidence.scrub_half = figures(find(results, "castor_scrub_1.5", "servo"));
  evidence.scrub_twice = figures(find(results, "castor_scrub_2", "servo"));
  if (results.size() != 1 || !results.front().name.empty()) return evidence;
  // A campaign alone: what it is itself.
  const SetResult& only = results.front();
  const bool usual = only.value("scenario_name") == "paper_start" || only.value("start") == "paper";
  if (only.value("strategy") == "paper" && usual) evidence.paper = &only.evaluation;
  if (only.value("strategy") == "servo" && usual) evidence.own_start = &only.evaluation;
  return evidence;
}

std::string html_of_part(const std::vector<SetResult>& results, const std::vector<std::string>& never_ran) {
  int have = 0;
  int wanted = 0;
  bool known = never_ran.empty();
  std::vector<std::string> sentences = never_ran;
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

std::string set_to_html(const std::vector<SetResult>& results, const std::vector<std::string>& never_ran) {
  std::string html = html_head("tagdock evaluate") + html_of_part(results, never_ran);
  html +=
      "<p>Errors are of the camera point and heading against the docking pose, as the simulator knows them; x is "
      "towards "
      "the wall (minus the paper's z). Every run counts in every figure. The same seeds everywhere. Intervals are "
      "those "
      "of Clopper and Pearson for shares and of Bonett for sigmas, 95 %. Reliability is meant as in ASTM "
      "F3499-21.</p>\n";
  const bool compared = is_ablation(results);
  const SetResult* paper = find(results, "paper_start", "paper");
  if (paper == nullptr) paper = find(results, "default", "paper");
  const SetResult* servo = find(results, "default", "servo");
  if (servo == nullptr) servo = find(results, "straight_start", "servo");
  if (compared) paper = servo = nullptr;  // none of its members stands for its strategy
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
        "controller's.</p>\n";
    html += figure_5() + figure_8(data) + figure_9(data);
    for (const FigureData& one : data) html += figure_10_start(one);
    for (const FigureData& one : data) html += figure_10(one);
  }
  html += ablation_html(results) + faults(results) + campaigns(results) + html_limits(evidence_of(results));
  return html + "</body></html>\n";
}

}  // namespace tagdock
