// Corners of rendered tags by every method: first a table of errors on the same images, then CPU times.
//   corner_bench [tags] [benchmark options]      tags a condition, 60 if not given
#include <algorithm>
#include <cstdio>
#include <cstdlib>
#include <map>
#include <random>
#include <string>
#include <vector>

#include <benchmark/benchmark.h>

#include "detection/blur_filter.h"
#include "detection/tag_locator.h"
#include "detection/tag_pose.h"
#include "tests/detection/scene_rendering.h"

namespace tagdock {
namespace {

using namespace testing;

struct Example {
  cv::Mat1b gray;
  Corners corners_px;
  TagDetection coarse;
};

struct Condition {
  std::string name;
  double side_px = 100.0;
  double tilt_deg = 30.0;
  double psf_px = 0.7;
  double noise = 2.0;
};

const std::vector<Condition> conditions{{"base: 100 px, contrast 160, noise 2, tilt 30, PSF 0.7"},
                                        {"PSF 0.4", 100.0, 30.0, 0.4, 2.0},
                                        {"PSF 0.4, noise 0.5", 100.0, 30.0, 0.4, 0.5},
                                        {"PSF 1.5", 100.0, 30.0, 1.5, 2.0},
                                        {"40 px", 40.0, 30.0, 0.7, 2.0},
                                        {"tilt 60", 100.0, 60.0, 0.7, 2.0},
                                        {"160 px, tilt 0", 160.0, 0.0, 0.7, 2.0}};

constexpr CornerMethod methods[] = {CornerMethod::apriltag, CornerMethod::tanh, CornerMethod::filter, CornerMethod::erf,
                                    CornerMethod::best};

/// Tags that AprilTag finds at decimation 2, as the dock loop does.
std::vector<Example> examples(const Condition& condition, int count, std::uint64_t seed) {
  std::mt19937_64 random(seed);
  const TagDetector detector{TagDetectorConfig{}};
  std::vector<Example> made;
  for (int i = 0; i < 4 * count && static_cast<int>(made.size()) < count; ++i) {
    Scene scene = base_scene(random, condition.side_px, condition.tilt_deg);
    scene.psf_px = condition.psf_px;
    const Rendering seen = render(scene);
    const cv::Mat1b gray = digitised(seen.grey, condition.noise, random);
    const auto found = detector.detect(gray);
    if (found.size() == 1) made.push_back({gray, seen.corners_px, found[0]});
  }
  return made;
}

void print_errors(int count) {
  std::printf("rms corner error a coordinate [px], %d tags a condition, the same images for all\n", count);
  std::printf("%-55s", "condition");
  for (const CornerMethod method : methods) std::printf("%11s", word(method).data());
  std::printf("   apriltag/tanh  refused  filter's kernels\n");
  for (const Condition& condition : conditions) {
    const std::vector<Example> tags = examples(condition, count, 20260101);
    std::map<CornerMethod, CornerError> errors;
    std::map<std::string, int> kernels;
    int refused = 0;
    for (const Example& tag : tags) {
      for (const CornerMethod method : methods) {
        const Refinement refined = refine(tag.gray, "tag36h11", tag.coarse, method, std::nullopt);
        if (const RefinedTag* good = std::get_if<RefinedTag>(&refined))
          errors[method].add(good->corners_px, tag.corners_px);
        else
          ++refused;
      }
      ++kernels[std::string(word(choose_blur(look_at_edges(tag.gray, tag.coarse.corners_px, tag.coarse.modules))))];
    }
    std::printf("%-55s", condition.name.c_str());
    for (const CornerMethod method : methods) std::printf("%11.4f", errors[method].rms_px());
    std::printf("%16.1f%9d ", errors[CornerMethod::apriltag].rms_px() / errors[CornerMethod::tanh].rms_px(), refused);
    for (const auto& [kernel, times] : kernels) std::printf(" %s:%d", kernel.c_str(), times);
    std::printf("\n");
  }
}

void refinement(benchmark::State& state, CornerMethod method) {
  const std::vector<Example> tags = examples(conditions[0], 16, 7);
  std::size_t i = 0;
  for (auto _ : state) {
    const Example& tag = tags[i++ % tags.size()];
    benchmark::DoNotOptimize(refine(tag.gray, "tag36h11", tag.coarse, method, std::nullopt));
  }
}

void detection(benchmark::State& state) {
  const std::vector<Example> tags = examples(conditions[0], 4, 7);
  TagDetectorConfig config;
  config.decimate = static_cast<int>(state.range(0));
  const TagDetector detector(config);
  for (auto _ : state) benchmark::DoNotOptimize(detector.detect(tags[0].gray));
}

void both_poses(benchmark::State& state) {
  const std::vector<Example> tags = examples(conditions[0], 4, 7);
  const Scene scene;
  const auto tag =
      std::get<RefinedTag>(refine(tags[0].gray, "tag36h11", tags[0].coarse, CornerMethod::tanh, std::nullopt));
  for (auto _ : state) benchmark::DoNotOptimize(tag_poses(tag, scene.size, scene.camera));
}

}  // namespace
}  // namespace tagdock

int main(int argc, char** argv) {
  using namespace tagdock;
  benchmark::Initialize(&argc, argv);
  print_errors(argc > 1 ? std::max(1, std::atoi(argv[1])) : 60);
  for (const CornerMethod method : methods)
    benchmark::RegisterBenchmark(("refine/" + std::string(word(method))).c_str(), refinement, method)
        ->Unit(benchmark::kMillisecond);
  benchmark::RegisterBenchmark("detect/320x320/decimate", detection)->Arg(1)->Arg(2)->Unit(benchmark::kMillisecond);
  benchmark::RegisterBenchmark("poses/one_tag", both_poses)->Unit(benchmark::kMillisecond);
  benchmark::RunSpecifiedBenchmarks();
}
