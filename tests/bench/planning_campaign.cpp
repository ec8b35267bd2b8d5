// Campaign for `tagdock plan --batch`: writes queries of every awkward kind, and judges the plans that come back by
// integrating their segments in long double, from the text of the files alone.
//   planning_campaign make N SEED > queries.csv
//   tagdock plan --batch queries.csv --mode M --as A --final-straight L --output plans.csv
//   planning_campaign check queries.csv plans.csv clothoids|arcs forward|both L [VIEW_DEG]
// With VIEW_DEG (and --view-deg at the planner) the board 1 m ahead of each goal must be in view at every millimetre.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iostream>
#include <map>
#include <random>
#include <string>
#include <vector>

#include "tests/planning/endpoint.h"

using namespace tagdock;

namespace {

constexpr double pi = std::numbers::pi;

void line(const char* kind, long number, const Pose2& start, const Pose2& goal, double curvature, double sharpness) {
  std::printf("%s-%ld,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g,%.17g\n", kind, number, start.x, start.y, start.yaw,
              goal.x, goal.y, goal.yaw, curvature, sharpness);
}

void make(long count, unsigned seed) {
  std::mt19937_64 random(seed);
  const auto real = [&](double low, double high) { return std::uniform_real_distribution<double>(low, high)(random); };
  const auto pick = [&](long n) { return static_cast<long>(random() % static_cast<unsigned long>(n)); };
  std::printf("id,sx,sy,sth,gx,gy,gth,kappa_max,sigma_max\n");
  for (long i = 0; i < count; ++i) {
    const double bearing = real(-pi, pi);
    switch (i % 6) {
      case 0:
        line("random", i, {real(-10, 10), real(-10, 10), real(-pi, pi)}, {real(-10, 10), real(-10, 10), real(-pi, pi)},
             1, 1);
        break;
      case 1: {
        const double apart = std::pow(10.0, real(-12, 0));
        const double turn = pick(3) == 0 ? 0.0 : std::copysign(std::pow(10.0, real(-12, 0)), real(-1, 1));
        const Pose2 start{pick(2) == 0 ? 0.0 : real(-5, 5), pick(2) == 0 ? 0.0 : real(-5, 5),
                          pick(2) == 0 ? 0.0 : real(-pi, pi)};
        line("near", i, start,
             {start.x + apart * std::cos(bearing), start.y + apart * std::sin(bearing), start.yaw + turn}, 1, 1);
        break;
      }
      case 2: {
        // Colinear, parallel, U-turn, lane change, equal; headings at exact eighths of a circle.
        const double yaw = 0.25 * pi * static_cast<double>(pick(17) - 8);
        const double steps[] = {0.0, 0.5, 1.0, 2.0, 5.0, -1.0, -3.0};
        const Pose2 step{steps[pick(7)], steps[pick(7)], 0.25 * pi * static_cast<double>(pick(9) - 4)};
        const Pose2 start{static_cast<double>(pick(5) - 2), static_cast<double>(pick(5) - 2), yaw};
        line("degenerate", i, start, start * step, pick(2) == 0 ? 1.0 : 0.5, pick(2) == 0 ? 1.0 : 2.0);
        break;
      }
      case 3: {
        const double range = real(2.0, 5.5);
        const double at = radians(real(-40, 40));
        line("docking", i, {-range * std::cos(at), range * std::sin(at), -at + radians(real(-10, 10))}, {-1, 0, 0},
             1.25, 2.5);
        break;
      }
      case 4: {
        const double radius = std::pow(10.0, real(-6, 6));
        const double ramp = std::pow(10.0, real(-2, 2));
        const double far = std::pow(10.0, real(-3, 3)) * radius;
        const double away = pick(2) == 0 ? 0.0 : std::pow(10.0, real(0, 9)) * radius;
        const Pose2 start{away + far * real(-1, 1), far * real(-1, 1), real(-40, 40)};
        line("scale", i, start, {away + far * real(-1, 1), far * real(-1, 1), real(-40, 40)}, 1 / radius,
             1 / (radius * radius * ramp));
        break;
      }
      default: {
        const char* bad[] = {"nan",   "inf", "-inf", "1e300", "-1e300", "0",  "-1",    "1e-310", "5e-324",
                             "1e400", "-0",  "",     "x",     "1,2",    "1e", "0x1p3", "--1",    "NaN(7)"};
        std::string fields[8] = {"0", "0", "0", "2", "0.5", "0.3", "1", "1"};
        fields[pick(8)] = bad[pick(18)];
        std::printf("malformed-%ld", i);
        for (const std::string& field : fields) std::printf(",%s", field.c_str());
        std::printf("\n");
      }
    }
  }
}

std::vector<std::string> split(const std::string& text) {
  std::vector<std::string> fields(1);
  for (const char c : text) {
    if (c == ',')
      fields.emplace_back();
    else if (c != '\r')
      fields.back() += c;
  }
  return fields;
}

struct Tally {
  long queries = 0;
  std::map<std::string, long> words;
  long double position = 0, heading = 0, relative = 0;
  double curvature = 0, sharpness = 0, jump = 0;  // worst shares of the limit: curvature, sharpness, gap
  long straight = 0, direction = 0, order = 0, not_a_number = 0, lost = 0;
  std::vector<long> times;
};

/// Is the board, 1 m ahead of the goal and 0.4 m wide, in the view of a camera 0.35 m before the axle all along?
bool always_in_view(const Path& path, const Pose2& goal, double view) {
  Pose2 at = path.start;
  for (const Segment& segment : path.segments) {
    const int steps = 1 + static_cast<int>(std::abs(segment.length) / 1e-3);
    for (int i = 0; i <= steps; ++i) {
      const Pose2 pose = pose_along(at, segment, segment.length * i / steps);
      for (const double edge : {-0.2, 0.2}) {
        const double dx = goal.x + std::cos(goal.yaw) - edge * std::sin(goal.yaw) - pose.x - 0.35 * std::cos(pose.yaw);
        const double dy = goal.y + std::sin(goal.yaw) + edge * std::cos(goal.yaw) - pose.y - 0.35 * std::sin(pose.yaw);
        if (std::abs(std::remainder(std::atan2(dy, dx) - pose.yaw, 2.0 * pi)) > 0.5 * view) return false;
      }
    }
    at = pose_along(at, segment, segment.length);
  }
  return true;
}

int check(const char* queries_file, const char* plans_file, bool arcs, bool forward, double final, double view) {
  std::ifstream queries(queries_file);
  std::ifstream plans(plans_file);
  std::string query_line;
  std::string plan_line;
  std::getline(queries, query_line);
  std::getline(plans, plan_line);
  std::map<std::string, Tally> tallies;
  while (std::getline(queries, query_line)) {
    const auto query = split(query_line);
    const std::string kind = query[0].substr(0, query[0].find('-'));
    Tally& tally = tallies[kind];
    ++tally.queries;
    if (!std::getline(plans, plan_line)) {
      ++tally.order;
      continue;
    }
    const auto plan = split(plan_line);
    if (plan.size() < 3 || plan[0] != query[0]) {
      ++tally.order;
      continue;
    }
    ++tally.words[plan[2]];
    tally.times.push_back(std::atol(plan[1].c_str()));
    for (std::size_t i = 3; i < plan.size(); ++i)
      if (plan[i].find("nan") != std::string::npos || plan[i].find("inf") != std::string::npos) ++tally.not_a_number;
    if (plan[2] != "ok") continue;
    const auto number = [](const std::string& text) { return std::strtod(text.c_str(), nullptr); };
    const Pose2 goal{number(query[4]), number(query[5]), number(query[6])};
    const double curvature_limit = number(query[7]);
    const double sharpness_limit = number(query[8]);
    Path path{{number(query[1]), number(query[2]), number(query[3])}, {}};
    double before = 0.0;
    long double driven = 0;
    for (std::size_t i = 9; i + 2 < plan.size(); i += 3) {
      const double span = number(plan[i]);
      const double begin = number(plan[i + 1]);
      const double end = plan[i + 2].empty() ? begin : number(plan[i + 2]);
      const double sharpness = plan[i + 2].empty() ? 0.0 : (end - begin) / span;
      path.segments.push_back({span, begin, sharpness});
      tally.curvature = std::max({tally.curvature, std::abs(begin) / curvature_limit, std::abs(end) / curvature_limit});
      tally.sharpness = std::max(tally.sharpness, std::abs(sharpness) / sharpness_limit);
      if (!arcs) tally.jump = std::max(tally.jump, std::abs(begin - before) / curvature_limit);
      before = end;
      driven += std::abs(span);
      if (forward && !(span > 0.0)) ++tally.direction;
    }
    if (!arcs) tally.jump = std::max(tally.jump, std::abs(before) / curvature_limit);
    if (final > 0.0 && (path.segments.back().curvature != 0.0 || path.segments.back().sharpness != 0.0 ||
                        path.segments.back().length < final))
      ++tally.straight;
    if (view > 0.0 && !always_in_view(path, goal, view)) ++tally.lost;
    const LongPose end = true_end(path);
    const long double off = std::hypot(end.x - goal.x, end.y - goal.y);
    const long double turn = std::fabs(std::atan2(std::sin(end.yaw - goal.yaw), std::cos(end.yaw - goal.yaw)));
    const long double scale =
        driven + std::max({std::abs(path.start.x), std::abs(path.start.y), std::abs(goal.x), std::abs(goal.y)});
    tally.position = std::max(tally.position, off);
    tally.relative = std::max(tally.relative, off / scale);
    tally.heading = std::max(tally.heading, turn);
  }
  bool fine = !std::getline(plans, plan_line);
  for (auto& [kind, tally] : tallies) {
    std::sort(tally.times.begin(), tally.times.end());
    std::printf("%-10s %ld:", kind.c_str(), tally.queries);
    for (const auto& [word, count] : tally.words)
      std::printf(" %s %.2f %%", word.c_str(), 100.0 * static_cast<double>(count) / static_cast<double>(tally.queries));
    std::printf(
        "\n           end error %.2Lg m (%.2Lg of the scale), %.2Lg rad; curvature %.12f, sharpness %.12f, gap %.2g "
        "of the limits\n           final straight %ld, direction %ld, order %ld, not a number %ld, view %ld faults; "
        "time p50 "
        "%.1f us, p99 %.1f us\n",
        tally.position, tally.relative, tally.heading, tally.curvature, tally.sharpness, tally.jump, tally.straight,
        tally.direction, tally.order, tally.not_a_number, tally.lost,
        tally.times.empty() ? 0.0 : 1e-3 * static_cast<double>(tally.times[tally.times.size() / 2]),
        tally.times.empty() ? 0.0 : 1e-3 * static_cast<double>(tally.times[tally.times.size() * 99 / 100]));
    const bool end_fine = (kind == "scale" || tally.position <= 1e-12L) && tally.relative <= 1e-12L;
    fine = fine && end_fine && tally.heading <= 1e-12L && tally.curvature <= 1.0 + 1e-9 &&
           tally.sharpness <= 1.0 + 1e-9 && tally.jump <= 1e-9 && tally.straight == 0 && tally.direction == 0 &&
           tally.order == 0 && tally.not_a_number == 0 && tally.lost == 0;
  }
  std::puts(fine ? "fine" : "FAULTS");
  return fine ? 0 : 1;
}

}  // namespace

int main(int count, char** arguments) {
  if (count == 4 && std::strcmp(arguments[1], "make") == 0) {
    make(std::atol(arguments[2]), static_cast<unsigned>(std::atol(arguments[3])));
    return 0;
  }
  if ((count == 7 || count == 8) && std::strcmp(arguments[1], "check") == 0)
    return check(arguments[2], arguments[3], std::strcmp(arguments[4], "arcs") == 0,
                 std::strcmp(arguments[5], "forward") == 0, std::atof(arguments[6]),
                 count == 8 ? radians(std::atof(arguments[7])) : 0.0);
  std::fputs(
      "planning_campaign make N SEED | check QUERIES PLANS clothoids|arcs forward|both FINAL_STRAIGHT [VIEW_DEG]\n",
      stderr);
  return 2;
}
