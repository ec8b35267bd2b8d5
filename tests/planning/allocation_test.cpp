// Counts every allocation of this program: what a query in the loop takes from the heap.
#include <cstdlib>
#include <new>
#include <random>

#include <catch2/catch.hpp>

#include "planning/docking_plan.h"

namespace {

long allocations = 0;

}  // namespace

void* operator new(std::size_t size) {
  ++allocations;
  if (void* memory = std::malloc(size > 0 ? size : 1)) return memory;
  throw std::bad_alloc();
}
void* operator new[](std::size_t size) { return ::operator new(size); }
void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
  ++allocations;
  return std::malloc(size > 0 ? size : 1);
}
void* operator new[](std::size_t size, const std::nothrow_t& nothrow) noexcept { return ::operator new(size, nothrow); }
void operator delete(void* memory) noexcept { std::free(memory); }
void operator delete[](void* memory) noexcept { std::free(memory); }
void operator delete(void* memory, std::size_t) noexcept { std::free(memory); }
void operator delete[](void* memory, std::size_t) noexcept { std::free(memory); }
void operator delete(void* memory, const std::nothrow_t&) noexcept { std::free(memory); }
void operator delete[](void* memory, const std::nothrow_t&) noexcept { std::free(memory); }

using namespace tagdock;

namespace {

/// Asks 400 docking questions twice with one planner; gives what the second round allocated.
long allocated_in_second_round(const DockingPlanConfig& config, int mode) {
  DockingPlanner planner;
  long before = 0;
  int answered = 0;
  int refused = 0;
  for (int round = 0; round < 2; ++round) {
    before = allocations;
    std::mt19937 random(404);
    std::uniform_real_distribution<double> range(2.0, 5.5);
    std::uniform_real_distribution<double> bearing(radians(-40.0), radians(40.0));
    for (int i = 0; i < 400; ++i) {
      const double r = range(random);
      const double b = bearing(random);
      const Pose2 start{-r * std::cos(b), r * std::sin(b), i % 50 == 0 ? std::nan("") : -b};
      const Pose2 goal = i % 50 == 1 ? start : Pose2{-1.0, 0.0, 0.0};
      const DockingPlanResult& result =
          mode == 0 ? planner.plan(start, goal, config)
                    : planner.manoeuvre(start, goal, config, mode == 1 ? Driving::forward : Driving::both);
      answered += std::holds_alternative<DockingPlan>(result) ? 1 : 0;
      refused += std::holds_alternative<PlanRefusal>(result) ? 1 : 0;
    }
  }
  CHECK(answered > 100);
  CHECK(refused >= 16);
  return allocations - before;
}

}  // namespace

TEST_CASE("after the first answers a planner takes nothing from the heap, whatever it answers") {
  DockingPlanConfig config;
  config.limits = {1.25, 2.5};
  config.list_candidates = false;
  config.find_cures = false;
  for (const bool arcs : {true, false}) {
    config.arcs = arcs;
    CHECK(allocated_in_second_round(config, 0) == 0);
    CHECK(allocated_in_second_round(config, 1) == 0);
    CHECK(allocated_in_second_round(config, 2) == 0);
  }
  config.view = ViewWish{};
  config.view->horizontal_view = radians(75.0);
  config.view->tags = {{0.0, 0.13, radians(-30.0)}, {0.0, -0.13, radians(30.0)}};
  config.keep_out.polygons = {{{-2.0, 1.2}, {-1.5, 1.2}, {-1.5, 1.5}}};
  CHECK(allocated_in_second_round(config, 0) == 0);
  config.arcs = true;
  config.period_length = 0.006;
  CHECK(allocated_in_second_round(config, 0) == 0);

  // What the count is worth: candidates do allocate.
  config.list_candidates = true;
  CHECK(allocated_in_second_round(config, 0) > 0);
}
