#include "app/evaluation_limits.h"

#include <cstdio>

#include "app/html.h"
#include "app/print.h"

namespace tagdock {
namespace {

// Of the paper (its section 4.3): measured, what the drive and floor of the simulator are fitted to.
constexpr double paper_sigma_x = 9.6e-3;   // m
constexpr double paper_sigma_y = 25.7e-3;  // m
constexpr double paper_sigma_yaw_deg = 1.11;

std::string more_or_less(double ratio) {
  const double percent = 100.0 * (ratio - 1.0);
  return print("%.0f %% %s", percent < 0.0 ? -percent : percent, percent < 0.0 ? "low" : "high");
}

// How well a scenario is mastered, in its own figures.
std::string mastered(const Evaluation& one) {
  return print("%.1f %% of %d runs end inside 3 mm, 3 mm, 0.5 degrees (95 %%: %.1f to %.1f), %d claimed it wrongly",
               100.0 * one.all_3mm.value(), one.runs, 100.0 * one.all_3mm.low, 100.0 * one.all_3mm.high,
               one.wrong_claims);
}

}  // namespace

std::string gain_words(const LimitEvidence& evidence) {
  if (evidence.paper == nullptr || evidence.straight == nullptr || evidence.board == nullptr ||
      evidence.loop == nullptr)
    return "";
  const double first = evidence.paper->sigma.y;
  const double path = evidence.straight->sigma.y;
  const double board = evidence.board->sigma.y;
  const double loop = evidence.loop->sigma.y;
  if (!(path > 0.0 && board > 0.0 && loop > 0.0)) return "";
  return print(
      "Of the %.0f times in sigma y, the straighter path gives %.1f times, the board %.1f times and closing the "
      "loop %.0f times",
      first / loop, first / path, path / board, board / loop);
}

std::string html_limits(const LimitEvidence& evidence) {
  std::string html = "<h2>What these figures do not say</h2><ul>\n";
  const auto item = [&](const std::string& words) { html += "<li>" + html_text(words) + "</li>\n"; };
  if (!evidence.simulated) {
    item(
        "They are of as many dockings as were recorded, of one robot at one station; what the tracker errs, and what "
        "is fitted rather than surveyed between its frame, its body and the station, is in them.");
    item("Biases of hand-eye, board and camera do not show in repeatability.");
    item("Obstacle inputs, watchdogs and STOP are not safety functions.");
    return html + "</ul>\n";
  }
  item(
      "They are of a simulator; no robot of 710 kg was driven. Its drive and floor are fitted to five numbers of the "
      "paper (offset, heading and three sigmas); the paper's camera, lens, tag size and number of runs are not known, "
      "so "
      "the model's are assumptions, and the friction coupling behind the fit is a hypothesis.");
  item(
      evidence.paper != nullptr
          ? print(
                "The fit leaves a residual: here the paper's strategy comes out with sigma x %s, sigma y %s and sigma "
                "of the heading %s against what the paper measured (%d runs).",
                more_or_less(evidence.paper->sigma.x / paper_sigma_x).c_str(),
                more_or_less(evidence.paper->sigma.y / paper_sigma_y).c_str(),
                more_or_less(degrees(evidence.paper->sigma.yaw) / paper_sigma_yaw_deg).c_str(), evidence.paper->runs)
          : "The fit leaves a residual against what the paper measured; a campaign of the paper's strategy (--strategy "
            "paper or both) shows it.");
  const std::string gain = gain_words(evidence);
  item(
      "The straight start is not the paper's start, so what the straighter path gives and what closing the loop gives "
      "are told apart. " +
      (gain.empty() ? "This report has not both; `tagdock evaluate --strategy both` makes them." : gain + "."));
  item("From the paper's own start no straight is left to look along, so the servo has to back off once" +
       (evidence.own_start != nullptr
            ? print(": there it takes %.1f s on average (%.1f s at most in 99 %%) with sigma y %.2f mm, and %s.",
                    evidence.own_start->mean_duration_s, evidence.own_start->p99_duration_s,
                    1e3 * evidence.own_start->sigma.y, mastered(*evidence.own_start).c_str())
            : std::string(", which takes longer (--start paper shows it).")));
  if (evidence.servo != nullptr && evidence.servo->mean_duration_s > 14.0)
    item(
        print("The 14 s that MiR states for its VL marker are not beaten: the servo takes %.1f s on average, %.1f s at "
              "most in 99 %%.",
              evidence.servo->mean_duration_s, evidence.servo->p99_duration_s));
  else if (evidence.servo == nullptr)
    item(
        "The 14 s that MiR states for its VL marker are to be compared with the servo's time, which this report does "
        "not have.");
  item("Of industrial vendors only MiR's figures are cited, from its data sheet; how they were measured is not known.");
  if (evidence.scrub_half != nullptr && evidence.scrub_twice != nullptr)
    item("Castors that scrub more than the fitted ones: at 1.5 times " + mastered(*evidence.scrub_half) +
         "; at 2 times " + mastered(*evidence.scrub_twice) +
         ". Reversed castors need the castor run-in or a back-off.");
  else
    item(
        "Castors that scrub more than the fitted ones are harder (scenarios castor_scrub_1.5 and castor_scrub_2, not "
        "in "
        "this report); reversed castors need the castor run-in or a back-off.");
  item("One flat tag is a degraded mode. The window of 25 to 75 degrees is the paper's rule for flat tags.");
  item(
      "Biases of hand-eye, board and camera do not show in repeatability. Teaching the docking pose cancels most of "
      "them, not all.");
  item("Without images, corners have drawn errors: no dirt, no light, no false tag.");
  item(
      "The paper's Table 2 (robot arm) can be repeated only with images of one's own; what `evaluate paper-table2` "
      "renders is a set of ours with the full camera model.");
  item("Obstacle inputs, watchdogs and STOP are not safety functions.");
  return html + "</ul>\n";
}

}  // namespace tagdock
