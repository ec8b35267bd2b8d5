#include "app/html.h"

namespace tagdock {

std::string html_head(const std::string& title) {
  return "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>" + html_text(title) +
         "</title><style>body{font:15px/1.5 sans-serif;max-width:1320px;margin:2em auto;padding:0 1em;color:#222}"
         "table{border-collapse:collapse;margin:1em 0}td,th{border:1px solid #bbb;padding:4px 8px;text-align:left;"
         "vertical-align:top}th{background:#eef2f7}td.number{text-align:right;white-space:nowrap}"
         ".wide{overflow-x:auto}.wide td,.wide th{padding:2px "
         "6px}caption{text-align:left;font-weight:bold;padding:.4em 0}"
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

}  // namespace tagdock
