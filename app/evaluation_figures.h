#pragma once

#include <string>
#include <vector>

#include "app/campaign_run.h"
#include "app/distance_looks.h"
#include "app/run_trace.h"

namespace tagdock {

/// The figures of the paper made anew from campaigns, as SVG.

/// A campaign as the figures take it.
struct FigureData {
  std::string name;
  std::string style;  ///< colour of its curves and bars, for example "#2b6cb0"
  std::vector<RunRecord> records;
  std::vector<RunTrace> traces;  ///< of some of its runs
  std::vector<DistanceLook> looks;
  double focal_length_px = 0.0;  ///< of the camera
  double tag_edge = 0.16;        ///< m
};

/// Fig. 5: the way of the odometry controller along the paper's path with damping 0.2 and 0.075, default and dynamic
/// rate, simulated without slip and with a dead time at which 0.2 swings.
std::string figure_5();

/// Fig. 8: reprojection error over distance, from robots that stand and, dotted, as the runs drove; and the distance
/// error of eq. (7), Z = f T / d, when the width d is wrong by twice that error, with the errors really made (95 %)
/// dashed. With a caption in HTML; empty where nothing was seen.
std::string figure_8(const std::vector<FigureData>& data);

/// Fig. 9: the ways from above, thin each and thick their mean.
std::string figure_9(const std::vector<FigureData>& data);

/// Fig. 10, lower half: where the dockings ended; errors in x, y and heading of one campaign, in three histograms.
std::string figure_10(const FigureData& data);

/// Fig. 10, upper half: where the robot stood first and where its camera said it stood, run by run, and the difference
/// of the two. With a caption in HTML; empty where that is not recorded.
std::string figure_10_start(const FigureData& data);

}  // namespace tagdock
