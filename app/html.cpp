#include "app/html.h"

namespace tagdock {

std::string html_head(const std::string& title) {
  return "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>" + html_text(title) +
         "</title><style>body{font:15px/1.5 sans-serif;max-width:1320px;margin:2em auto;padding:0 1em;color:#222}"
         "table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #bbb;padding:4px 8px;text-align:left;"
         "vertical-align:top}th{background:#eef2f7}td.number{text-align:right;white-space:nowrap}"
         "small{color:#666;white-space:nowrap}svg{display:block;width:100%;height:auto;margin:1em 0}"
         "pre{background:#f5f5f5;padding:1em;overflow:auto;max-height:30em}tr.met td{background:#eef7ee}"
         "tr.missed td{background:#fbeeee}.partial{background:#fff3cd;border-left:8px solid #b7791f;padding:.6em 1em}"
         "</style></head><body>\n<h1>" +
         html_text(title) + "</h1>\n";
}

std::string html_text(const std::string& text) {
  std::string result;
  for (const char letter : text) {
    if (letter == '&')
      result += "&amp;";
    else if (letter == '<')
      result += "&lt;";
    else if (letter == '>')
      result += "&gt;";
    else if (letter == '"')
      result += "&quot;";
    else
      result += letter;
  }
  return result;
}

std::string html_limits() {
  return "<h2>What these figures do not say</h2><ul>\n"
         "<li>They are of a simulator; no robot of 710 kg was driven. Its drive and floor are fitted to five numbers "
         "of "
         "the paper, whose camera, lens, tag size and number of runs are not known; the friction coupling behind the "
         "fit "
         "is a hypothesis.</li>\n"
         "<li>The fit leaves a residual: in the reference simulation sigma x comes out 17 % high, sigma y 9 % and "
         "sigma "
         "of the heading 6 % low.</li>\n"
         "<li>The straight start is not the paper's start. What the straighter path gives and what closing the loop "
         "gives are told apart; from the paper's own start the servo has to back off once.</li>\n"
         "<li>Of industrial vendors only MiR's figures are cited, from its data sheet; how they were measured is not "
         "known.</li>\n"
         "<li>One flat tag is a degraded mode. The window of 25 to 75 degrees is the paper's rule for flat tags.</li>\n"
         "<li>Biases of hand-eye, board and camera do not show in repeatability. Teaching the docking pose cancels "
         "most "
         "of them, not all.</li>\n"
         "<li>Without images, corners have drawn errors: no dirt, no light, no false tag.</li>\n"
         "<li>Obstacle inputs, watchdogs and STOP are not safety functions.</li></ul>\n";
}

}  // namespace tagdock
