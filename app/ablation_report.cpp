#include "app/ablation_report.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <map>
#include <optional>
#include <sstream>

#include "app/campaign_agreement.h"
#include "app/html.h"
#include "app/print.h"

namespace tagdock {
namespace {

// A sigma of fewer runs than this is not worth a figure.
constexpr int enough = 6;

// A member's name is path-law-board-corners (ablation_set); path and board have no minus in them.
struct Choice {
  std::string path, law, board, corners;
  [[nodiscard]] std::string name() const { return path + "-" + law + "-" + board + "-" + corners; }
};

// From what the paper has to what we have, in the order of the tables.
const std::vector<std::string> paths = {"paper_start", "straight_start"};
const std::vector<std::string> laws = {"open", "centering", "line"};
const std::vector<std::string> corners = {"poor", "paper", "apriltag", "tanh", "best"};
const Choice shipped = {"straight_start", "line", "v_convex_centre", "best"};

std::string told(const std::string& word) {
  static const std::map<std::string, std::string> words = {{"paper_start", "the paper's start (3.45 m, 26 degrees)"},
                                                           {"straight_start", "the straight start (3.45 m, 5 degrees)"},
                                                           {"open", "open loop"},
                                                           {"centering", "ViSP's centering"},
                                                           {"line", "line law"},
                                                           {"one_tag", "one flat tag"},
                                                           {"pair", "two flat tags"},
                                                           {"v_concave", "concave V"},
                                                           {"v_convex", "convex V"},
                                                           {"v_convex_centre", "convex V and centre tag"},
                                                           {"poor", "poor corners"},
                                                           {"paper", "the paper's corners"},
                                                           {"apriltag", "AprilTag's corners"},
                                                           {"tanh", "the paper's fit (tanh)"},
                                                           {"best", "our fit (best)"}};
  const auto found = words.find(word);
  return found == words.end() ? word : found->second;
}

std::optional<Choice> choice_of(const std::string& name) {
  std::vector<std::string> parts;
  std::istringstream stream(name);
  for (std::string part; std::getline(stream, part, '-');) parts.push_back(part);
  if (parts.size() != 4 || std::find(laws.begin(), laws.end(), parts[1]) == laws.end()) return std::nullopt;
  return Choice{parts[0], parts[1], parts[2], parts[3]};
}

const SetResult* find(const std::vector<SetResult>& results, const Choice& choice) {
  const std::string name = choice.name();
  const auto found = std::find_if(results.begin(), results.end(), [&](const auto& one) { return one.name == name; });
  return found == results.end() ? nullptr : &*found;
}

std::string share_words(const Share& share) {
  return print("%.0f %% <small>(%.0f to %.0f)</small>", 100.0 * share.value(), 100.0 * share.low, 100.0 * share.high);
}

std::string sigmas(const Evaluation& one) {
  const Pose2& sigma = one.ended.sigma;
  return print("%.2f, %.2f mm, %.3f&deg;", 1e3 * sigma.x, 1e3 * sigma.y, degrees(sigma.yaw));
}

std::string linked(const SetResult& one, const std::string& words) {
  return "<a href=\"" + html_text(one.name) + "/report.html\">" + words + "</a>";
}

// From white to green by the share inside.
std::string shade(double share) { return print("background:hsl(130,55%%,%.0f%%)", 100.0 - 22.0 * share); }

std::string cell(const SetResult& one) {
  const Evaluation& evaluation = one.evaluation;
  std::string html = "<td style=\"" + shade(evaluation.first_3mm.value()) + "\"><b>" +
                     linked(one, print("%.0f %%", 100.0 * evaluation.first_3mm.value())) +
                     print("</b> <small>(%.0f to %.0f)</small><br>", 100.0 * evaluation.first_3mm.low,
                           100.0 * evaluation.first_3mm.high);
  html += evaluation.ended.runs < enough ? std::string("<small>too few ended for a sigma</small>") : sigmas(evaluation);
  if (evaluation.ended.runs < evaluation.runs)
    html += print("<br><small>%d of %d ended</small>", evaluation.ended.runs, evaluation.runs);
  return html + "</td>";
}

// How much smaller sigma y is after one choice is changed, on the seeds that ended with both.
struct Gain {
  std::string factor;
  Choice before, after;
};

std::vector<Gain> gains() {
  const auto with = [](Choice choice, const std::string& path, const std::string& law, const std::string& board,
                       const std::string& corner) {
    if (!path.empty()) choice.path = path;
    if (!law.empty()) choice.law = law;
    if (!board.empty()) choice.board = board;
    if (!corner.empty()) choice.corners = corner;
    return choice;
  };
  const Choice flat = with(shipped, "", "", "one_tag", "");
  return {
      {"path", with(flat, "paper_start", "open", "", ""), with(flat, "", "open", "", "")},
      {"path", with(shipped, "paper_start", "", "", ""), shipped},
      {"loop", with(flat, "", "open", "", ""), flat},
      {"loop", with(shipped, "", "open", "", ""), shipped},
      {"loop", with(shipped, "paper_start", "open", "", ""), with(shipped, "paper_start", "", "", "")},
      {"law", with(shipped, "", "centering", "", ""), shipped},
      {"board", flat, shipped},
      {"board", with(flat, "", "", "", "tanh"), with(shipped, "", "", "", "tanh")},
      {"board", with(flat, "", "open", "", ""), with(shipped, "", "open", "", "")},
      {"corners", with(shipped, "", "", "", "poor"), shipped},
      {"corners", with(shipped, "", "", "", "apriltag"), shipped},
      {"corners", with(shipped, "", "", "", "tanh"), shipped},
      {"corners", with(flat, "", "", "", "apriltag"), flat},
      {"corners", with(flat, "", "", "", "tanh"), flat},
      {"corners", with(flat, "", "open", "", "apriltag"), with(flat, "", "open", "", "")},
  };
}

std::vector<RunRecord> ended(const SetResult& result) {
  std::vector<RunRecord> records;
  for (const RunRecord& record : result.records)
    if (came_to_end(record)) records.push_back(record);
  return records;
}

std::string worth(const std::vector<SetResult>& results) {
  std::string rows;
  for (const Gain& gain : gains()) {
    const SetResult* before = find(results, gain.before);
    const SetResult* after = find(results, gain.after);
    if (before == nullptr || after == nullptr) continue;
    std::string from, to, rest;
    const auto sort = [&](const std::string& a, const std::string& b) {
      if (a == b) {
        rest += (rest.empty() ? "" : "; ") + told(a);
      } else {
        from = told(a);
        to = told(b);
      }
    };
    sort(gain.before.path, gain.after.path);
    sort(gain.before.law, gain.after.law);
    sort(gain.before.board, gain.after.board);
    sort(gain.before.corners, gain.after.corners);
    const SigmaRatio ratio = sigma_ratios(ended(*before), ended(*after))[1];
    const auto sigma_y = [](const SetResult& one) {
      const Spread& spread = one.evaluation.ended;
      return spread.runs < enough ? print("%d of %d ended", spread.runs, one.evaluation.runs)
                                  : print("%.2f mm <small>(%.2f to %.2f; %d runs)</small>", 1e3 * spread.sigma.y,
                                          1e3 * spread.sigma_low.y, 1e3 * spread.sigma_high.y, spread.runs);
    };
    rows += "<tr><th>" + gain.factor + "</th><td>" + html_text(from + " to " + to) + "</td><td>" + html_text(rest) +
            "</td><td>" + linked(*before, sigma_y(*before)) + "</td><td>" + linked(*after, sigma_y(*after)) +
            "</td><td>" +
            (ratio.pairs < enough
                 ? std::string("not comparable")
                 : print("<b>%.1f times</b> <small>(%.1f to %.1f)</small>", ratio.ratio, ratio.low, ratio.high)) +
            "</td><td>" + share_words(before->evaluation.first_3mm) + "</td><td>" +
            share_words(after->evaluation.first_3mm) + "</td></tr>\n";
  }
  if (rows.empty()) return "";
  return "<h3>What each choice is worth</h3>\n<p>One choice changed, all others kept. Sigma y is of the runs that came "
         "to "
         "their end; how much smaller it gets is by the seeds that ended with both, with the interval of Pitman and "
         "Morgan for pairs. A gain whose interval holds 1 is none that so many runs show. The path's gain and the "
         "loop's are not to be multiplied blindly: from the paper's own start the loop's comes after one "
         "back-off.</p>\n"
         "<div class=\"wide\"><table><tr><th></th><th>changed</th><th>kept</th><th>sigma y before</th><th>sigma y "
         "after</th>"
         "<th>smaller by</th><th>inside before</th><th>inside after</th></tr>\n" +
         rows + "</table></div>\n";
}

std::string best(const std::vector<SetResult>& results) {
  std::vector<const SetResult*> order;
  for (const SetResult& result : results) order.push_back(&result);
  std::stable_sort(order.begin(), order.end(), [](const SetResult* a, const SetResult* b) {
    if (a->evaluation.first_3mm.count != b->evaluation.first_3mm.count)
      return a->evaluation.first_3mm.value() > b->evaluation.first_3mm.value();
    return a->evaluation.ended.sigma.y < b->evaluation.ended.sigma.y;
  });
  const SetResult& top = *order.front();
  const auto alike = std::count_if(order.begin(), order.end(), [&](const SetResult* one) {
    return one->evaluation.first_3mm.high >= top.evaluation.first_3mm.low;
  });
  const auto level = std::count_if(order.begin(), order.end(), [&](const SetResult* one) {
    return one->evaluation.ended.runs >= enough &&
           one->evaluation.first_3mm.value() == top.evaluation.first_3mm.value() &&
           one->evaluation.ended.sigma_low.y <= top.evaluation.ended.sigma_high.y;
  });
  const auto words = [](const SetResult& one) {
    const std::optional<Choice> choice = choice_of(one.name);
    return html_text(told(choice->path) + "; " + told(choice->law) + "; " + told(choice->board) + "; " +
                     told(choice->corners));
  };
  constexpr std::size_t shown = 8;
  std::string html =
      "<h3>The best combinations</h3>\n<p>By share inside at the first attempt, then by sigma y: <b>" + words(top) +
      "</b>. " +
      print(
          "The shares of %d of the %zu combinations cannot be told from the best one's by %d runs each (their 95 %% "
          "intervals meet), and of those with the same share %d have a sigma y whose interval meets the best one's.",
          static_cast<int>(alike), order.size(), top.evaluation.runs, static_cast<int>(level)) +
      "</p>\n<div class=\"wide\"><table><tr><th></th><th>combination</th><th>runs</th><th>inside</th><th>sigma "
      "x</th><th>sigma y</th><th>sigma heading</th><th>wrong claims</th><th>mean time</th></tr>\n";
  const auto row = [&](std::size_t place) {
    const SetResult& one = *order[place];
    const Spread& spread = one.evaluation.ended;
    const auto bounded = [](const char* format, double scale, double value, double low, double high) {
      return print(format, scale * value, scale * low, scale * high);
    };
    constexpr const char* mm = "<td>%.2f mm <small>(%.2f to %.2f)</small></td>";
    html += print("<tr%s><td>%zu</td><td>", one.name == shipped.name() ? " class=\"met\"" : "", place + 1) +
            linked(one, words(one)) + print("</td><td>%d</td><td>", one.evaluation.runs) +
            share_words(one.evaluation.first_3mm) + "</td>" +
            bounded(mm, 1e3, spread.sigma.x, spread.sigma_low.x, spread.sigma_high.x) +
            bounded(mm, 1e3, spread.sigma.y, spread.sigma_low.y, spread.sigma_high.y) +
            bounded("<td>%.3f&deg; <small>(%.3f to %.3f)</small></td>", degrees(1.0), spread.sigma.yaw,
                    spread.sigma_low.yaw, spread.sigma_high.yaw) +
            print("<td>%d</td><td>%.1f s</td></tr>\n", one.evaluation.wrong_claims, one.evaluation.mean_duration_s);
  };
  for (std::size_t i = 0; i < std::min(shown, order.size()); ++i) row(i);
  for (std::size_t i = shown; i < order.size(); ++i)
    if (order[i]->name == shipped.name()) row(i);
  return html + "</table></div>\n<p>Green: what is shipped.</p>\n";
}

}  // namespace

bool is_ablation(const std::vector<SetResult>& results) {
  return !results.empty() &&
         std::all_of(results.begin(), results.end(), [](const SetResult& one) { return choice_of(one.name); });
}

std::string ablation_html(const std::vector<SetResult>& results) {
  if (!is_ablation(results)) return "";
  int least = results.front().evaluation.runs;
  int most = least;
  for (const SetResult& result : results) {
    least = std::min(least, result.evaluation.runs);
    most = std::max(most, result.evaluation.runs);
  }
  // The built-in world takes its name from where the robot starts.
  const std::string scenario = results.front().value("scenario_name");
  const std::string world = scenario.ends_with("_start") ? "the built-in scenario" : "scenario " + html_text(scenario);
  std::string html =
      "<h2>Ablation: path, law, board, corners</h2>\n<p>" +
      (least == most ? print("%d runs of each of %zu combinations", most, results.size())
                     : print("%d to %d runs of each of %zu combinations", least, most, results.size())) +
      ", on the same seeds in the same worlds (" + world +
      "), one attempt each and no refusal for an uncertain pose, so that nothing but the choice decides. <b>Inside</b> "
      "is "
      "the share of all runs that docked inside 3 mm, 3 mm, 0.5 degrees, with its 95 % interval (Clopper and Pearson). "
      "<b>Sigmas</b> are of x, y and heading of the runs that came to the dock and measured there, right or wrong: "
      "where a robot stood that gave up "
      "would "
      "drown them; how many ended stands beside. Their intervals are Bonett's, which do not take the errors for "
      "normal.</p>\n<ul>"
      "<li><b>Path</b>: from the paper's start the way turns by about 59 degrees and leaves no straight to look along; "
      "the straight start nearly does without. With the loop closed, the paper's start needs one back-off, which is "
      "part "
      "of its one attempt.</li>"
      "<li><b>Law</b>: open loop looks from the start alone, then drives by odometry, as the paper does; the others "
      "look "
      "all the way. ViSP's centering points the camera at the board and mends the distance, not the lateral error.</li>"
      "<li><b>Board</b>: of tags of 0.16 m. A flat tag seen head-on looks like its own mirror image.</li>"
      "<li><b>Corners</b>: errors drawn as measured with the renderer for AprilTag's own corners, the paper's fit and "
      "ours; the paper's: 0.10 px and 0.05 px lasting, which explain its pose errors; poor: 0.3 px and 0.2 px "
      "lasting.</li></ul>\n";
  html += worth(results) + best(results) +
          "<h3>Every combination</h3>\n<p>Share inside (95 %), sigma of x, y and "
          "heading, and how many ended, where not all did. Greener is more inside.</p>\n";
  for (const std::string& path : paths)
    for (const std::string& law : laws) {
      std::string rows;
      for (const std::string& board : board_names()) {
        std::string cells;
        bool any = false;
        for (const std::string& method : corners) {
          const SetResult* one = find(results, {path, law, board, method});
          any = any || one != nullptr;
          cells += one == nullptr ? std::string("<td></td>") : cell(*one);
        }
        if (any) rows += "<tr><th>" + html_text(told(board)) + "</th>" + cells + "</tr>\n";
      }
      if (rows.empty()) continue;
      html +=
          "<div class=\"wide\"><table><caption>" + html_text(told(path) + ", " + told(law)) + "</caption><tr><th></th>";
      for (const std::string& method : corners) html += "<th>" + html_text(told(method)) + "</th>";
      html += "</tr>\n" + rows + "</table></div>\n";
    }
  return html;
}

}  // namespace tagdock
