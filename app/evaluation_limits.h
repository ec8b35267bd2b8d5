#pragma once

#include <string>

#include "app/evaluation_report.h"

namespace tagdock {

/// Campaigns that give the limits their figures; null where a report has none.
struct LimitEvidence {
  bool simulated = true;                   ///< otherwise real dockings that a tracker watched
  const Evaluation* paper = nullptr;       ///< the paper's strategy from its own start: open loop, one flat tag
  const Evaluation* straight = nullptr;    ///< the straight start, open loop, one flat tag
  const Evaluation* board = nullptr;       ///< the same with the servo's board
  const Evaluation* loop = nullptr;        ///< the same with the loop closed
  const Evaluation* own_start = nullptr;   ///< the servo from the paper's own start
  const Evaluation* servo = nullptr;       ///< the servo in the default scenario
  const Evaluation* scrub_half = nullptr;  ///< the servo with castor scrub 1.5 times
  const Evaluation* scrub_twice = nullptr;
};

/// What every report must say that its figures do not (notes on docking, 10), as a list under a heading; with the
/// report's own figures where it has them.
std::string html_limits(const LimitEvidence& evidence);

/// "Of the 80 times in sigma y the straighter path gives 3.5, the board 1.0, closing the loop 23"; empty without
/// figures.
std::string gain_words(const LimitEvidence& evidence);

}  // namespace tagdock
