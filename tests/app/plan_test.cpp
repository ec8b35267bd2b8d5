#include <filesystem>
#include <fstream>
#include <sstream>
#include <unistd.h>

#include <catch2/catch.hpp>
#include <nlohmann/json.hpp>

#include "app/failure.h"
#include "app/verbs.h"
#include "tests/planning/endpoint.h"

using namespace tagdock;

namespace {

/// A folder for one test, gone afterwards.
struct Folder {
  std::filesystem::path path =
      std::filesystem::temp_directory_path() / ("tagdock_plan_test_" + std::to_string(getpid()));
  Folder() { std::filesystem::create_directories(path); }
  ~Folder() { std::filesystem::remove_all(path); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  [[nodiscard]] std::string file(const std::string& name) const { return (path / name).string(); }
  [[nodiscard]] std::string write(const std::string& name, const std::string& text) const {
    std::ofstream(file(name)) << text;
    return file(name);
  }
};

int run(std::vector<std::string> arguments) {
  CLI::App program("test");
  Action action;
  add_plan(program, action);
  arguments.insert(arguments.begin(), "plan");
  std::reverse(arguments.begin(), arguments.end());
  program.parse(arguments);
  return action();
}

std::vector<std::vector<std::string>> rows(const std::string& file) {
  std::ifstream in(file);
  std::vector<std::vector<std::string>> result;
  for (std::string line; std::getline(in, line);) {
    std::vector<std::string> fields(1);
    for (const char c : line) {
      if (c == ',')
        fields.emplace_back();
      else
        fields.back() += c;
    }
    result.push_back(fields);
  }
  return result;
}

/// The path as a reader of the file gets it: length, curv_start, curv_end per segment.
Path path_of(const std::vector<std::string>& row) {
  Path path{{std::stod(row[3]), std::stod(row[4]), std::stod(row[5])}, {}};
  for (std::size_t i = 9; i + 2 < row.size(); i += 3) {
    const double length = std::stod(row[i]);
    const double begin = std::stod(row[i + 1]);
    const double sharpness = row[i + 2].empty() ? 0.0 : (std::stod(row[i + 2]) - begin) / length;
    path.segments.push_back({length, begin, sharpness});
  }
  return path;
}

constexpr const char* queries =
    "id,sx,sy,sth,gx,gy,gth,kappa_max,sigma_max\r\n"
    "a,-3.45,0.5,-0.2,-1,0,0,1.25,2.5\n"
    "b,0,0,0,0,0,0,1,1\n"
    "c,nan,0,0,1,0,0,1,1\n"
    "d,0,0,0,1,0,0,0,1\n"
    "\n"
    "e,0,0,0,1,0,inf,1,1\n"
    "f,0,0,0,1e300,0,0,1,1\n"
    "g,0,0,0,0.1,1,0.3,1,1\n"
    "h,0,zero,0,0.1,1,0.3,1,1\n"
    "i,0,0\n"
    "j,0,0,0,1,0,0,1,1e-400\n"
    "k,0,0,0,1,0,0,1,\n"
    "l,0,0,0,1,0,0,1,1,1\n"
    "m,0,0,0,0.5,2,3.141592653589793,1,1\n";

}  // namespace

TEST_CASE("a file of queries is answered line by line, each with a word, and the paths in it end at their goals") {
  const Folder folder;
  const std::string in = folder.write("queries.csv", queries);
  const std::string out = folder.file("plans.csv");
  const std::string kind = GENERATE(std::string("clothoids"), std::string("arcs"));
  CHECK(run({"--batch", in, "--as", kind, "--output", out}) == 2);  // four lines are not numbers
  const auto answers = rows(out);
  REQUIRE(answers.size() == 14);
  const std::vector<std::string> words = {"status",     "ok",        "already_there", "not_finite", "bad_limit",
                                          "not_finite", "too_large", "no_room",       "malformed",  "malformed",
                                          "bad_limit",  "malformed", "malformed",     "no_room"};
  for (std::size_t i = 0; i < answers.size(); ++i) {
    CAPTURE(i, answers[i][0]);
    CHECK(answers[i][2] == words[i]);
    for (const std::string& field : answers[i]) CHECK(field.find("nan") == std::string::npos);
  }
  CHECK(answers[1][0] == "a");
  CHECK(end_error(path_of(answers[1]), {-1.0, 0.0, 0.0}).position < 1e-12);
  CHECK(end_error(path_of(answers[1]), {-1.0, 0.0, 0.0}).heading < 1e-12);

  CHECK(run({"--batch", in, "--as", kind, "--mode", "reeds-shepp", "--output", out}) == 2);
  const auto both = rows(out);
  REQUIRE(both.size() == 14);
  REQUIRE(both[7][2] == "ok");
  CHECK(end_error(path_of(both[7]), {0.1, 1.0, 0.3}).position < 1e-12);
  CHECK(end_error(path_of(both[7]), {0.1, 1.0, 0.3}).heading < 1e-12);
}

TEST_CASE("a plan is explained by its words, its time and what odometry alone would make of it") {
  const Folder folder;
  const std::string out = folder.file("plan.json");
  CHECK(run({"--from", "-4.5,0.6,-10", "--to", "-1,0,0", "--max-curvature", "1.25", "--final-straight", "0.3", "--as",
             "arcs", "--period-length", "0.006", "--view-deg", "70", "--json", "--output", out}) == 0);
  std::ifstream file(out);
  const nlohmann::json plan = nlohmann::json::parse(file);
  CHECK(plan["reeds_shepp"].size() == 48);
  CHECK(plan["predicted_sigma"]["across"].get<double>() > 0.0);
  CHECK(plan["time_law"]["segments"].size() == plan["segments"].size());
  const double period = plan["period_length"].get<double>();
  for (const auto& segment : plan["segments"]) {
    const double periods = segment["length"].get<double>() / period;
    CHECK(std::abs(periods - std::round(periods)) < 1e-9);
  }
}

TEST_CASE("a dock is left in reverse, straight first, and its contact is allowed there only") {
  const Folder folder;
  const std::string out = folder.file("plan.csv");
  const std::vector<std::string> leave = {"--from",    "-1,0,0",     "--to",
                                          "-4,0.4,-8", "--reverse",  "--initial-straight",
                                          "0.4",       "--keep-out", "-0.62,-0.5,0,-0.5,0,0.5,-0.62,0.5",
                                          "--output",  out};
  CHECK(run(leave) == 1);  // the robot stands 2 cm in what must not be touched
  std::vector<std::string> allowed = leave;
  allowed.insert(allowed.end(), {"--contact-within", "0.2"});
  CHECK(run(allowed) == 0);
  const Path path = path_of(rows(out)[1]);
  for (const Segment& segment : path.segments) CHECK(segment.length < 0.0);
  CHECK(path.segments.front().length <= -0.4);
  CHECK(end_error(path, {-4.0, 0.4, radians(-8.0)}).position < 1e-12);
}

TEST_CASE("one plan is drawn, and one that cannot be is refused with exit code 1") {
  const Folder folder;
  CHECK(run({"--from", "-3.45,0.5,-12", "--to", "-1,0,0", "--final-straight", "0.3", "--as", "arcs", "--arc-steps", "4",
             "--svg", folder.file("plan.svg"), "--output", folder.file("plan.csv")}) == 0);
  std::stringstream svg;
  svg << std::ifstream(folder.file("plan.svg")).rdbuf();
  CHECK(svg.str().starts_with("<svg"));
  CHECK(svg.str().find("nan") == std::string::npos);
  for (const char* part :
       {"curvature [1/m]", "bearing of the board", "speed [m/s]", "clip-path", "towards the wall", "</svg>"})
    CHECK(svg.str().find(part) != std::string::npos);
  const auto answer = rows(folder.file("plan.csv"));
  REQUIRE(answer.size() == 2);
  CHECK(path_of(answer[1]).segments.back().length >= 0.3);
  CHECK(run({"--from", "-1.5,0.5,0", "--to", "-1,0,0", "--output", folder.file("no.csv")}) == 1);
}

TEST_CASE("with a robot the plan says how sure its camera is at start and goal, and refuses where it could not dock") {
  const Folder folder;
  const auto planned = [&](std::vector<std::string> more) {
    std::vector<std::string> all = {
        "--from", "-3.8,0.3,0", "--to", "-1.35,0,0", "--json", "--output", folder.file("plan.json")};
    all.insert(all.end(), more.begin(), more.end());
    const int code = run(all);
    std::ifstream in(folder.file("plan.json"));
    return std::pair(code, nlohmann::json::parse(in));
  };
  const auto [plain_code, plain] = planned({});
  CHECK(plain_code == 0);
  CHECK_FALSE(plain.contains("measured_sigma"));
  // The default robot: 1 m before its board the shipped map has its first column, and there it is surest.
  const auto [code, sure] = planned({"--sensor-errors", "shipped"});
  CHECK(code == 0);
  CHECK(sure["status"] == "ok");
  const auto& sigma = sure["measured_sigma"];
  CHECK(sigma["goal"]["x"].get<double>() == Approx(1.808e-6).epsilon(1e-3));
  CHECK(sigma["goal"]["y"].get<double>() == Approx(4.665e-6).epsilon(1e-3));
  CHECK(sigma["goal"]["yaw"].get<double>() == Approx(0.0002571 * 3.14159265 / 180.0).epsilon(1e-3));
  CHECK(sigma["start"]["y"].get<double>() > 10.0 * sigma["goal"]["y"].get<double>());
  // Where nothing was measured, nothing is claimed.
  CHECK(planned({"--sensor-errors", "shipped", "--board", "20,0,0"}).second["measured_sigma"]["goal"].is_null());
  CHECK(planned({"--sensor-errors", "none"}).second["measured_sigma"]["goal"].is_null());

  // A camera that tells y by 5 mm only at the dock, and yaw by a degree from the start.
  std::ostringstream map;
  map << "method: best\nframes: 6\ntags: 3\ntag_size_m: 0.16\nimage_width: 1280\nfocal_length_px: 1229.17\n"
         "distance_m: [0.9, 5.5]\nbearing_deg: [0, 60]\nplace: [0, 1]\nrows:\n";
  for (const char* place : {"0", "1"})
    for (const char* bearing : {"0", "60"})
      map << "  - place: " << place << "\n    bearing_deg: " << bearing
          << "\n    along_mm: [1, 1]\n    across_mm: [5, 5]\n    heading_deg: [0.1, 1]\n";
  const std::string config =
      folder.write("poor.yaml", "detection: {sensor_errors: " + folder.write("poor_map.yaml", map.str()) + "}\n");
  const auto [refused_code, refused] = planned({"--config", config});
  CHECK(refused_code == 1);
  CHECK(refused["status"] == "unsure_at_dock");
  CHECK(refused["sentence"].get<std::string>().find(", 5 mm") != std::string::npos);
  CHECK_FALSE(refused.contains("segments"));
  CHECK(refused["warning"].get<std::string>().find("the robot drives off with") != std::string::npos);
  // A way out of the dock asks nothing of its end.
  CHECK(run({"--from", "-1.35,0,0", "--to", "-3,0,0", "--reverse", "--config", config, "--output",
             folder.file("out.csv")}) == 0);
}

TEST_CASE("a wrong command line or file is a usage failure that names what is wrong") {
  const Folder folder;
  const auto sentence = [](const std::vector<std::string>& arguments) -> std::string {
    try {
      run(arguments);
    } catch (const Failure& failure) {
      CHECK(failure.code() == ExitCode::usage);
      return failure.what();
    }
    return "no failure";
  };
  CHECK(sentence({"--from", "1,2", "--to", "0,0,0"}).find("--from is \"1,2\"") == 0);
  CHECK(sentence({"--from", "1,2,x", "--to", "0,0,0"}).find("three numbers") != std::string::npos);
  CHECK(sentence({}).find("--batch") != std::string::npos);
  CHECK(sentence({"--batch", folder.file("none.csv")}).find("cannot read") == 0);
  CHECK(sentence({"--batch", folder.write("empty.csv", "")}).find("is empty") != std::string::npos);
  CHECK(sentence({"--batch", folder.write("columns.csv", "id,sx,sy\n")}).find("\"sth\" is missing") !=
        std::string::npos);
  const std::vector<std::string> there = {"--from", "0,0,0", "--to", "1,0,0"};
  const auto with = [&](std::vector<std::string> more) {
    more.insert(more.begin(), there.begin(), there.end());
    return sentence(more);
  };
  CHECK(with({"--wheel-jerk", "0"}).find("--wheel-jerk is 0") == 0);
  CHECK(with({"--tag", "0,0,0"}).find("--tag needs --view-deg") == 0);
  CHECK(with({"--period-length", "0.01"}).find("--period-length needs --as arcs") == 0);
  CHECK(with({"--reverse", "--mode", "dubins"}).find("--reverse needs") == 0);
  CHECK(with({"--view-deg", "60", "--incidence-deg", "50", "20"}).find("incidence") != std::string::npos);
  CHECK(sentence({"--from", "0,0,0", "--to", "1,0,0", "--final-straight", "-1"}).find("--final-straight") == 0);
  CHECK(sentence({"--from", "0,0,0", "--to", "1,0,0", "--output", folder.file("no/such/folder.csv")})
            .find("cannot write") == 0);
}
