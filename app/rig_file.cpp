#include "app/rig_file.h"

#include <initializer_list>
#include <set>
#include <string_view>

namespace tagdock {
namespace {

// What `calibrate` writes beside the values: for judges and for people, not for the docking.
constexpr const char* judged_keys[] = {
    "projection_sigma_px",   "rejected_views", "T_base_cam_sigma", "unobservable", "camera_covariance",
    "T_base_cam_covariance", "quality",        "version",          "verdict"};

void visit(Fields& fields, CameraModel& camera) {
  fields.integer("width", camera.width, 1, 65536);
  fields.integer("height", camera.height, 1, 65536);
  fields.number("fx", camera.fx, 1.0, 1e6);
  fields.number("fy", camera.fy, 1.0, 1e6);
  fields.number("cx", camera.cx, -1e5, 1e5);
  fields.number("cy", camera.cy, -1e5, 1e5);
  std::vector<double> dist = {camera.k1, camera.k2, camera.p1, camera.p2, camera.k3};
  if (camera.k4 != 0.0 || camera.k5 != 0.0 || camera.k6 != 0.0)
    dist.insert(dist.end(), {camera.k4, camera.k5, camera.k6});
  fields.numbers("dist", dist, 5, 8);
  set_distortion(camera, dist);
}

// In a configuration what is missing keeps its default; a file about one instrument or board has nothing to default to.
void need(YamlMap map, std::initializer_list<std::string_view> keys) {
  for (const std::string_view key : keys)
    if (!map.has(key)) map.refuse(key, "is missing");
}

}  // namespace

void set_distortion(CameraModel& camera, std::vector<double> dist) {
  dist.resize(8, 0.0);
  camera.k1 = dist[0];
  camera.k2 = dist[1];
  camera.p1 = dist[2];
  camera.p2 = dist[3];
  camera.k3 = dist[4];
  camera.k4 = dist[5];
  camera.k5 = dist[6];
  camera.k6 = dist[7];
}

void visit(Fields& fields, Rig& rig) {
  fields.group("camera", [&](Fields& inner) { visit(inner, rig.camera); });
  fields.transform("T_base_cam", rig.T_base_camera);
  fields.group("odometry", [&](Fields& inner) {
    inner.number("r_left", rig.odometry.r_left, 0.005, 2.0);
    inner.number("r_right", rig.odometry.r_right, 0.005, 2.0);
    inner.number("track", rig.odometry.track, 0.05, 10.0);
  });
}

void visit(Fields& fields, Board& board) {
  fields.word(
      "family", board.family,
      {"tag36h11", "tag25h9", "tag16h5", "tagStandard41h12", "tagStandard52h13", "tagCircle21h7", "tagCircle49h12"});
  fields.list(
      "tags", board.tags.size(), [&](std::size_t count) { board.tags.assign(count, BoardTag{}); },
      [&](Fields& inner, std::size_t i) {
        BoardTag& tag = board.tags[i];
        inner.integer("id", tag.id, 0, 100000);
        inner.number("size", tag.size, 0.01, 2.0);
        inner.transform("T_station_tag", tag.T_station_tag);
      });
  std::set<int> ids;
  for (const BoardTag& tag : board.tags) {
    fields.require(tag.size > 0.0, "tags", "has a tag without its size (m)");
    fields.require(ids.insert(tag.id).second, "tags", "has the id " + std::to_string(tag.id) + " twice");
  }
  fields.require(!board.tags.empty(), "tags", "is empty; a board needs at least one tag");
}

Rig read_rig(const std::filesystem::path& file) {
  YamlMap map = YamlMap::load(file);
  for (const std::string_view key : {"camera", "T_base_cam"})
    if (!map.has(key)) map.refuse(key, "is missing; a rig file has camera, T_base_cam and odometry");
  need(map.map("camera"), {"width", "height", "fx", "fy", "cx", "cy", "dist"});
  need(map.map("T_base_cam"), {"t", "q_xyzw"});
  for (const char* key : judged_keys) (void)map.has(key);
  if (map.has("verdict") && map.text("verdict") == "refused")
    map.refuse("verdict", "is refused; this calibration says of itself that it is not good enough to dock with");
  // Measured against a tracker, a rig has no wheels: `calibrate` leaves them out and tells its uncertainty.
  if (!map.has("T_base_cam_sigma") && !map.has("T_base_cam_covariance")) need(map, {"odometry"});
  if (map.has("odometry")) need(map.map("odometry"), {"r_left", "r_right", "track"});
  bool height_known = true;
  map.read("height_known", height_known);
  if (!height_known)
    map.refuse(
        "height_known",
        "is false: a planar drive leaves the lens' height open, so the one in T_base_cam is an arbitrary number; "
        "measure it above the floor by tape and give it to `tagdock calibrate hand-eye --camera-height`");
  Rig rig;
  FieldReader reader(map);
  visit(reader, rig);
  map.finish();
  return rig;
}

Board read_board(const std::filesystem::path& file) {
  YamlMap map = YamlMap::load(file);
  for (const char* key : {"quality", "reference"}) (void)map.has(key);  // for people and judges
  if (map.has("verdict") && map.text("verdict") == "refused")
    map.refuse("verdict", "is refused; this survey says of itself that it is not good enough to dock with");
  double over_drawn_x = 1.0;
  double over_drawn_y = 1.0;
  map.read("measured_over_drawn_x", over_drawn_x, 0.9, 1.1);
  map.read("measured_over_drawn_y", over_drawn_y, 0.9, 1.1);
  constexpr double most_stretch = 0.003;  // a tag of 0.16 m is then 0.5 mm wider than high: 3 mm of range at a metre
  if (std::abs(over_drawn_x / over_drawn_y - 1.0) > most_stretch)
    map.refuse("measured_over_drawn_x",
               "and measured_over_drawn_y differ by more than 3 per mille: tags of this print are no squares; print it "
               "anew");
  Board board;
  FieldReader reader(map);
  visit(reader, board);
  for (BoardTag& tag : board.tags) {
    tag.size *= std::sqrt(over_drawn_x * over_drawn_y);
    // Plates are cut at printed marks, so they stand as far apart as their print is wide; how high is not printed.
    tag.T_station_tag.translation().head<2>() *= over_drawn_x;
  }
  for (const YamlMap& tag : map.maps("tags")) {
    need(tag, {"id", "size", "T_station_tag"});
    need(YamlMap(tag).map("T_station_tag"), {"t", "q_xyzw"});
  }
  map.finish();
  return board;
}

std::string drawn_board_text(Board board) {
  FieldWriter writer;
  visit(writer, board);
  return "# As it was drawn, in m; measure the two rulers on the sheets and put measured over printed length here.\n"
         "measured_over_drawn_x: 1\nmeasured_over_drawn_y: 1\n" +
         writer.text();
}

}  // namespace tagdock
