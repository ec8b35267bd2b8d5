#include "planning/keep_out.h"

#include <catch2/catch.hpp>

#include "planning/docking_plan.h"

using namespace tagdock;

namespace {

Polygon box(double x_low, double y_low, double x_high, double y_high) {
  return {{x_low, y_low}, {x_high, y_low}, {x_high, y_high}, {x_low, y_high}};
}

}  // namespace

TEST_CASE("clearance is the distance of outlines and zero where they overlap, one inside the other included") {
  const Footprint robot{0.4, 0.4, 0.6};
  CHECK(clearance({}, robot, box(1.0, -1.0, 2.0, 1.0)) == Approx(0.6));
  CHECK(clearance({}, robot, box(-1.0, 0.5, 1.0, 0.6)) == Approx(0.2));
  CHECK(clearance({0.0, 0.0, radians(90.0)}, robot, box(-1.0, 0.5, 1.0, 0.6)) == Approx(0.1));
  CHECK(clearance({}, robot, box(0.7, 0.7, 2.0, 2.0)) == Approx(0.5));  // corner to corner: 0.3, 0.4
  CHECK(clearance({}, robot, box(-0.1, -0.1, 0.1, 0.1)) == 0.0);
  CHECK(clearance({}, robot, box(-5.0, -5.0, 5.0, 5.0)) == 0.0);
  CHECK(clearance({}, robot, box(-0.1, -5.0, 0.1, 5.0)) == 0.0);
}

TEST_CASE("a plan keeps its room to what must not be touched, or the refusal says so") {
  DockingPlanConfig config;
  config.limits = {1.25, 2.5};
  config.list_candidates = false;
  const Pose2 start{-5.0, 0.8, 0.0};
  const Pose2 goal{-1.0, 0.0, 0.0};
  const DockingPlanResult free = plan_docking(start, goal, config);
  REQUIRE(std::holds_alternative<DockingPlan>(free));
  // A post right beside the free path's way: on the middle of its outline's left side.
  const Pose2 middle = point_at(std::get<DockingPlan>(free).path, 2.0).pose * Pose2{0.0, 0.31, 0.0};
  config.keep_out.polygons = {box(middle.x - 0.02, middle.y - 0.02, middle.x + 0.02, middle.y + 0.02)};
  CHECK_FALSE(keeps_clear(std::get<DockingPlan>(free).path, config.keep_out));
  const DockingPlanResult around = plan_docking(start, goal, config);
  REQUIRE(std::holds_alternative<DockingPlan>(around));
  const auto& plan = std::get<DockingPlan>(around);
  double least = 1.0;
  for (double driven = 0.0; driven <= plan.length; driven += 1e-3)
    least = std::min(
        least, clearance(point_at(plan.path, driven).pose, config.keep_out.footprint, config.keep_out.polygons[0]));
  CHECK(least >= config.keep_out.margin - 1e-3);  // m; the step that the check may take

  config.keep_out.polygons = {box(-2.5, -3.0, -2.0, 3.0)};
  const DockingPlanResult walled = plan_docking(start, goal, config);
  REQUIRE(std::holds_alternative<PlanRefusal>(walled));
  CHECK(word(std::get<PlanRefusal>(walled).reason) == "keep_out");
}

TEST_CASE("a dock may be touched on the last part of the way only") {
  const Path path{{-3.0, 0.0, 0.0}, {{2.0, 0.0, 0.0}}};
  KeepOut dock;
  dock.polygons = {box(-0.65, -0.5, 0.0, 0.5)};  // the nose ends 5 cm inside
  CHECK_FALSE(keeps_clear(path, dock));
  dock.contact_within = 0.2;
  CHECK(keeps_clear(path, dock));
  dock.contact_within = 0.05;
  CHECK_FALSE(keeps_clear(path, dock));
}
