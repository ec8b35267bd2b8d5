// The hand-eye rows of the table in the issue: medians, 95 % and claims over seeds. hand_eye_bench [seeds] [words of a
// row's name].
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <map>
#include <string>
#include <vector>

#include "planning/pose2.h"
#include "tests/calibration/synthetic_drive.h"

using namespace tagdock;
using namespace tagdock::testing;

namespace {

double quantile(std::vector<double> values, double share) {
  std::sort(values.begin(), values.end());
  return values[std::min(values.size() - 1, static_cast<std::size_t>(share * static_cast<double>(values.size())))];
}

std::string wanted;

void row(const std::string& name, Drive how, int seeds) {
  if (name.find(wanted) == std::string::npos) return;
  std::vector<double> xy, rotation, radius, track, claim_xy, claim_rotation, seconds, visp_xy, chi2, corner_scale,
      motion_scale, tilt;
  std::map<std::string, int> words;
  int refused = 0;
  int visp_failed = 0;
  for (int seed = 1; seed <= seeds; ++seed) {
    how.seed = static_cast<std::uint64_t>(seed);
    const DriveData data = drive(how);
    const std::clock_t begin = std::clock();
    const HandEyeResult result = calibrate_hand_eye(data.problem);
    seconds.push_back(static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC);
    const HandEyeError error = error_of(result, data.truth);
    xy.push_back(1000.0 * error.xy);
    rotation.push_back(degrees(error.rotation));
    radius.push_back(1000.0 * error.radius);
    track.push_back(1000.0 * error.track);
    claim_xy.push_back(error.xy / result.xy_sigma);
    claim_rotation.push_back(error.rotation / result.rotation_sigma);
    chi2.push_back(result.chi2_per_residual);
    corner_scale.push_back(result.corner_scale);
    motion_scale.push_back(result.motion_scale);
    tilt.push_back(degrees(result.floor_tilt_sigma));
    std::string list;
    for (const Unobservable& open : result.unobservable) list += " " + open.word;
    ++words[list];
    refused += result.complaints.empty() ? 0 : 1;
    if (result.visp.solved)
      visp_xy.push_back(
          1000.0 * (result.visp.T_base_camera.translation() - data.truth.T_base_camera.translation()).head<2>().norm());
    else
      ++visp_failed;
  }
  std::printf("%-34s xy %.2f / %.2f mm  rot %.4f / %.4f deg  claims %.2f %.2f", name.c_str(), quantile(xy, 0.5),
              quantile(xy, 0.95), quantile(rotation, 0.5), quantile(rotation, 0.95), quantile(claim_xy, 0.5),
              quantile(claim_rotation, 0.5));
  if (how.by_wheels)
    std::printf("  radius %.2f / %.2f track %.2f / %.2f permille", quantile(radius, 0.5), quantile(radius, 0.95),
                quantile(track, 0.5), quantile(track, 0.95));
  std::printf("  scales %.2f %.2f tilt %.4f", quantile(corner_scale, 0.5), quantile(motion_scale, 0.5),
              quantile(tilt, 0.5));
  std::printf("  chi2 %.2f  %.2f s  refused %d/%d", quantile(chi2, 0.5), quantile(seconds, 0.5), refused, seeds);
  if (!visp_xy.empty()) std::printf("  ViSP xy %.2f / %.2f", quantile(visp_xy, 0.5), quantile(visp_xy, 0.95));
  std::printf("  ViSP failed %d ", visp_failed);
  for (const auto& [list, count] : words) std::printf(" [%d x%s]", count, list.c_str());
  std::printf("\n");
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  const int seeds = argc > 1 ? std::atoi(argv[1]) : 20;
  if (argc > 2) wanted = argv[2];
  std::printf("median / 95 %% over %d seeds\n", seeds);
  using Way = Drive::Way;
  using Sees = Drive::Sees;
  row("tracker, 13 on an arc, tag", {.way = Way::arc}, seeds);
  row("tracker, 13 on an arc, tag, 10 frames", {.way = Way::arc, .frames = 10}, seeds);
  row("tracker, 13 on an arc, camera 0.5 px off", {.way = Way::arc, .sees = Sees::grid, .camera_error = 1.0}, seeds);
  row("tracker, 13 sweep, tag", {.way = Way::sweep}, seeds);
  row("tracker, 13 on an arc, grid", {.way = Way::arc, .sees = Sees::grid}, seeds);
  row("tracker, 30 wide, tag", {.way = Way::wide, .stops = 30}, seeds);
  row("tracker, 13 arc, tag, surveyed", {.way = Way::arc, .surveyed = true}, seeds);
  row("wheels, 30 wide, tag", {.way = Way::wide, .stops = 30, .by_wheels = true}, seeds);
  row("wheels, 40 zigzag, tag", {.way = Way::zigzag, .stops = 40, .by_wheels = true}, seeds);
  row("wheels, 40 zigzag, tag, 10 frames", {.way = Way::zigzag, .stops = 40, .frames = 10, .by_wheels = true}, seeds);
  row("wheels, 40 zigzag, grid", {.way = Way::zigzag, .sees = Sees::grid, .stops = 40, .by_wheels = true}, seeds);
  row("wheels, 30 sweep, tag", {.way = Way::sweep, .stops = 30, .by_wheels = true}, seeds);
  row("wheels, 30 sweep, tag, 10 frames", {.way = Way::sweep, .stops = 30, .frames = 10, .by_wheels = true}, seeds);
  row("wheels, 30 sweep, grid", {.way = Way::sweep, .sees = Sees::grid, .stops = 30, .by_wheels = true}, seeds);
  row("wheels, 30 wide, tag, no frontal", {.way = Way::wide, .stops = 30, .by_wheels = true, .leave_out_frontal = true},
      seeds);
  row("tracker, 30 wide, tag, no frontal", {.way = Way::wide, .stops = 30, .leave_out_frontal = true}, seeds);
  row("wheels, 30 wide, grid", {.way = Way::wide, .sees = Sees::grid, .stops = 30, .by_wheels = true}, seeds);
  row("wheels, 13 arc, tag, height", {.way = Way::arc, .by_wheels = true, .height_by_tape = true}, seeds);
  row("wheels, 30 wide, tag, outliers", {.way = Way::wide, .stops = 30, .by_wheels = true, .outliers = 0.03}, seeds);
  row("tracker, straight, tag", {.way = Way::straight}, seeds);
  row("tracker, straight, grid", {.way = Way::straight, .sees = Sees::grid}, seeds);
  row("tracker, spin, tag", {.way = Way::spin}, seeds);
  row("tracker, spin, grid", {.way = Way::spin, .sees = Sees::grid}, seeds);
  row("wheels, straight, tag", {.way = Way::straight, .by_wheels = true}, seeds);
  row("wheels, straight, grid, height",
      {.way = Way::straight, .sees = Sees::grid, .by_wheels = true, .height_by_tape = true}, seeds);
  row("wheels, spin, tag", {.way = Way::spin, .by_wheels = true}, seeds);
  row("wheels, spin, grid", {.way = Way::spin, .sees = Sees::grid, .by_wheels = true}, seeds);
  return 0;
}
