#include "app/accuracy_map.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>

#include "app/print.h"
#include "app/sensor_error_file.h"
#include "app/simulation/draws.h"
#include "servo/pose_filter.h"

namespace tagdock {
namespace {

constexpr double far_off = radians(3.0);

// Pose of the lens as a planar point with heading: at a distance and bearing, turned so that the board's centre is at
// its place in the image (positive places are left of the middle).
Pose2 lens_at(const AccuracyCell& cell, const Rig& rig) {
  const double half_view = 0.5 * horizontal_view(rig.camera);
  const double off_axis = std::atan(cell.place * std::tan(half_view));
  return {-cell.distance * std::cos(cell.bearing), -cell.distance * std::sin(cell.bearing), cell.bearing - off_axis};
}

Eigen::Isometry3d shaken_view(const Pose2& lens, const AccuracyMapWish& wish, Draws& draws) {
  Eigen::Isometry3d T_station_camera = Eigen::Isometry3d::Identity();
  T_station_camera.translation() << lens.x, lens.y,
      wish.rig.T_base_camera.translation().z() + wish.chassis.height_sigma * draws.normal();
  T_station_camera.linear() = (Eigen::AngleAxisd(lens.yaw, Eigen::Vector3d::UnitZ()) *
                               Eigen::AngleAxisd(wish.chassis.pitch_sigma * draws.normal(), Eigen::Vector3d::UnitY()) *
                               Eigen::AngleAxisd(wish.chassis.roll_sigma * draws.normal(), Eigen::Vector3d::UnitX()))
                                  .toRotationMatrix() *
                              wish.rig.T_base_camera.linear();
  return T_station_camera;
}

// Errors along and across the line of sight, and their claimed covariance.
struct Seen {
  Eigen::Vector3d error;
  Eigen::Vector3d claimed_variance;
};

Seen seen_from(const BoardSighting& board, const Pose2& lens, double bearing, const Rig& rig) {
  const PlanarSighting planar = planar_sighting(rig, board.time, board.T_camera_station, board.covariance, 0.0);
  const Pose2 ahead = camera_point(rig);
  const Pose2 found = planar.T_station_base * ahead;
  // The camera point moves with the axle's heading, too.
  Eigen::Matrix3d by_base = Eigen::Matrix3d::Identity();
  by_base(0, 2) = -std::sin(found.yaw) * ahead.x - std::cos(found.yaw) * ahead.y;
  by_base(1, 2) = std::cos(found.yaw) * ahead.x - std::sin(found.yaw) * ahead.y;
  Eigen::Matrix3d to_sight = Eigen::Matrix3d::Identity();
  to_sight.topLeftCorner<2, 2>() << std::cos(bearing), std::sin(bearing), -std::sin(bearing), std::cos(bearing);
  const Eigen::Matrix3d turn = to_sight * by_base;
  return {to_sight * Eigen::Vector3d(found.x - lens.x, found.y - lens.y, wrap_angle(found.yaw - lens.yaw)),
          (turn * planar.covariance * turn.transpose()).diagonal()};
}

void measure(AccuracyCell& cell, const AccuracyMapWish& wish, const Renderer& renderer, const TagLocator& locator,
             Draws& draws) {
  const Pose2 lens = lens_at(cell, wish.rig);
  std::vector<Seen> seen;
  cell.frames = wish.frames;
  for (int i = 0; i < wish.frames; ++i) {
    Exposure exposure;
    exposure.T_station_camera = {shaken_view(lens, wish, draws)};
    if (i == 0)
      for (const TrueTag& tag : renderer.true_tags(exposure)) cell.tags_in_view += tag.fully_visible ? 1 : 0;
    if (cell.tags_in_view == 0) return;
    const auto noise_seed = static_cast<std::uint64_t>(1e9 * (1.0 + draws.even()));
    const Sighting sighting =
        locator.locate({renderer.render(exposure, noise_seed, RenderedRows::with_tags).gray, {}, 0}, std::nullopt);
    const BoardSighting* board = std::get_if<BoardSighting>(&sighting);
    if (board == nullptr) continue;
    ++cell.seen;
    const Seen one = seen_from(*board, lens, cell.bearing, wish.rig);
    if (std::abs(one.error.z()) > far_off)
      ++cell.mirrored;
    else
      seen.push_back(one);
  }
  if (seen.empty()) return;
  const auto count = static_cast<double>(seen.size());
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  Eigen::Vector3d claimed = Eigen::Vector3d::Zero();
  for (const Seen& one : seen) {
    mean += one.error / count;
    claimed += one.claimed_variance / count;
  }
  Eigen::Vector3d variance = Eigen::Vector3d::Zero();
  for (const Seen& one : seen) variance += (one.error - mean).cwiseAbs2() / std::max(1.0, count - 1.0);
  const Eigen::Vector3d sigma = variance.cwiseSqrt();
  const Eigen::Vector3d told = claimed.cwiseSqrt();
  cell.mean = {mean.x(), mean.y(), mean.z()};
  cell.sigma = {sigma.x(), sigma.y(), sigma.z()};
  cell.claimed = {told.x(), told.y(), told.z()};
}

bool is_known(const AccuracyCell& cell) { return cell.seen > cell.mirrored; }

const AccuracyCell* find(const std::vector<AccuracyCell>& cells, double distance, double bearing, double place) {
  const auto found = std::find_if(cells.begin(), cells.end(), [&](const AccuracyCell& cell) {
    return cell.distance == distance && cell.bearing == bearing && cell.place == place;
  });
  return found == cells.end() ? nullptr : &*found;
}

// Every value of a coordinate once, rising.
std::vector<double> values_of(const std::vector<AccuracyCell>& cells, double AccuracyCell::*coordinate) {
  std::vector<double> values;
  for (const AccuracyCell& cell : cells) values.push_back(cell.*coordinate);
  std::sort(values.begin(), values.end());
  values.erase(std::unique(values.begin(), values.end()), values.end());
  return values;
}

struct Quantity {
  const char* title;
  double Pose2::*member;
  double factor;  // to the unit that is shown
  double good, bad;
};
constexpr std::array<Quantity, 3> quantities = {
    {{"along the line of sight [mm]", &Pose2::x, 1e3, 0.002, 10.0},
     {"across the line of sight [mm]", &Pose2::y, 1e3, 0.005, 30.0},
     {"heading [degrees]", &Pose2::yaw, 180.0 / 3.14159265358979323846, 0.0002, 1.0}}};

// From green over yellow to red by the logarithm.
std::string colour(double value, double good, double bad) {
  const double share = std::clamp(std::log(value / good) / std::log(bad / good), 0.0, 1.0);
  return print("hsl(%.0f,70%%,78%%)", 120.0 * (1.0 - share));
}

}  // namespace

Pose2 AccuracyCell::rms() const {
  return {std::hypot(mean.x, sigma.x), std::hypot(mean.y, sigma.y), std::hypot(mean.yaw, sigma.yaw)};
}

std::vector<AccuracyCell> measure_accuracy(const AccuracyMapWish& wish,
                                           const std::function<void(int done, int wanted)>& progress) {
  std::vector<double> bearings = wish.bearings;
  if (bearings.empty())
    for (const double degree : {0.0, 5.0, 10.0, 20.0, 30.0, 45.0, 60.0}) bearings.push_back(radians(degree));
  std::vector<AccuracyCell> cells;
  for (const double place : wish.places)
    for (const double bearing : bearings)
      for (const double distance : wish.distances) {
        AccuracyCell cell;
        cell.distance = distance;
        cell.bearing = bearing;
        cell.place = place;
        cells.push_back(cell);
      }
  Scene scene;
  scene.board = wish.board;
  const Renderer renderer(scene, wish.rig.camera, wish.sensor);
  const TagLocator locator(wish.rig, wish.board, wish.locator);
  for (std::size_t i = 0; i < cells.size(); ++i) {
    Draws draws(wish.seed, i);
    measure(cells[i], wish, renderer, locator, draws);
    progress(static_cast<int>(i) + 1, static_cast<int>(cells.size()));
  }
  return cells;
}

std::string accuracy_csv(const std::vector<AccuracyCell>& cells) {
  std::string text =
      "distance,bearing,place,tags_in_view,frames,seen,mirrored,mean_along,mean_across,mean_yaw,sigma_along,"
      "sigma_across,sigma_yaw,claimed_along,claimed_across,claimed_yaw\n";
  for (const AccuracyCell& cell : cells)
    text += print("%.17g,%.17g,%.17g,%d,%d,%d,%d", cell.distance, cell.bearing, cell.place, cell.tags_in_view,
                  cell.frames, cell.seen, cell.mirrored) +
            print(",%.17g,%.17g,%.17g,%.17g,%.17g,%.17g", cell.mean.x, cell.mean.y, cell.mean.yaw, cell.sigma.x,
                  cell.sigma.y, cell.sigma.yaw) +
            print(",%.17g,%.17g,%.17g\n", cell.claimed.x, cell.claimed.y, cell.claimed.yaw);
  return text;
}

std::string accuracy_yaml(const AccuracyMapWish& wish, const std::vector<AccuracyCell>& cells) {
  SensorErrorFile file;
  file.method = word(wish.locator.method);
  file.frames = wish.frames;
  file.tags = static_cast<int>(wish.board.tags.size());
  file.tag_size = wish.board.tags.front().size;
  file.image_width = wish.rig.camera.width;
  file.focal_length_px = wish.rig.camera.fx;
  SensorErrors& errors = file.errors;
  errors.distances = values_of(cells, &AccuracyCell::distance);
  errors.bearings = values_of(cells, &AccuracyCell::bearing);
  errors.places = values_of(cells, &AccuracyCell::place);
  for (const double place : errors.places)
    for (const double bearing : errors.bearings)
      for (const double distance : errors.distances) {
        const AccuracyCell* cell = find(cells, distance, bearing, place);
        if (cell == nullptr || !is_known(*cell)) {
          errors.cells.emplace_back();
          continue;
        }
        const Pose2 rms = cell->rms();
        errors.cells.push_back(SensorErrors::Sigma{rms.x, rms.y, rms.yaw});
      }
  return to_yaml(file);
}

std::string accuracy_html(const AccuracyMapWish& wish, const std::vector<AccuracyCell>& cells,
                          const std::string& title) {
  const std::vector<double> distances = values_of(cells, &AccuracyCell::distance);
  const std::vector<double> bearings = values_of(cells, &AccuracyCell::bearing);
  std::string html =
      "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><title>" + title +
      "</title><style>body{font:15px/1.5 sans-serif;max-width:1320px;margin:2em auto;padding:0 1em;color:#222}"
      "table{border-collapse:collapse;margin:0.5em 1.5em 1.5em 0;display:inline-table}td,th{border:1px solid "
      "#bbb;padding:4px 9px;text-align:right}th{background:#eef2f7}caption{text-align:left;font-weight:bold}"
      "td.none{color:#999;background:#f4f4f4}</style></head><body>\n<h1>" +
      title + "</h1>\n<p>" +
      print(
          "One frame, %s corners, %d tags, %d pixels wide, %d frames a cell. Root mean square error of the camera "
          "point and heading; the chassis shakes, calibration and survey are exact. Rows: bearing of the lens off "
          "the board's normal. Columns: distance from the lens to the board's centre.",
          std::string(word(wish.locator.method)).c_str(), static_cast<int>(wish.board.tags.size()),
          wish.rig.camera.width, wish.frames) +
      "</p>\n";
  for (const double place : values_of(cells, &AccuracyCell::place)) {
    html += place == 0.0 ? "<h2>Board in the middle of the image</h2>\n"
                         : print("<h2>Board at %.0f %% of the way to the image's left edge</h2>\n", 100.0 * place);
    for (const Quantity& quantity : quantities) {
      html += "<table><caption>" + std::string(quantity.title) + "</caption><tr><th></th>";
      for (const double distance : distances) html += print("<th>%.1f m</th>", distance);
      html += "</tr>\n";
      for (const double bearing : bearings) {
        html += print("<tr><th>%.0f&deg;</th>", degrees(bearing));
        for (const double distance : distances) {
          const AccuracyCell* cell = find(cells, distance, bearing, place);
          if (cell == nullptr || !is_known(*cell)) {
            html += cell != nullptr && cell->tags_in_view == 0 ? "<td class=\"none\">out of view</td>"
                                                               : "<td class=\"none\">no pose</td>";
            continue;
          }
          const double value = quantity.factor * (cell->rms().*quantity.member);
          html += "<td style=\"background:" + colour(value, quantity.good, quantity.bad) + "\">" + print("%.2g", value);
          if (cell->mirrored > 0) html += print(" <b>(%d of %d mirrored)</b>", cell->mirrored, cell->seen);
          html += "</td>";
        }
        html += "</tr>\n";
      }
      html += "</table>\n";
    }
  }
  return html + "</body></html>\n";
}

}  // namespace tagdock
