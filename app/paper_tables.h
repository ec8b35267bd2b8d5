#pragma once

#include <cstdint>
#include <string>

#include <CLI/CLI.hpp>

#include "app/verbs.h"

namespace tagdock {

struct PaperTableOptions {
  int images = 40;         ///< rendered ones for each axis of rotation
  std::uint64_t seed = 1;  ///< of places, ids and noise
  std::string folder;      ///< real images with reference.csv (table 2 only)
  std::string camera;      ///< file, for real images
  double tag_size = 0.0;   ///< m, for real images
  std::string family = "tag36h11";
  bool json = false;
};

/// Prints the paper's Table 1 (simulation) or 2 (robot arm) beside the same figures of our methods, all on the same
/// images: mean and standard deviation of the corners' distances from where the pose puts them (reprojection) and, for
/// rendered images, from where they truly are (position).
/// Our reading (the paper states neither camera nor distances): a 0.16 m tag on the axis of a lens of 1400 px, 1.4 to
/// 6.7 m away, turned -75 to 75 degrees about y or 0 to 90 about z; Table 1 sharp (0.5 px), without noise, white
/// around; Table 2 with blur 0.8 px, noise, vignetting and a calibration that is a little wrong.
int print_paper_table(int table, const PaperTableOptions& options);

/// Adds `paper-table1` and `paper-table2` to the verb evaluate.
void add_paper_tables(CLI::App& evaluate, Action& action);

}  // namespace tagdock
