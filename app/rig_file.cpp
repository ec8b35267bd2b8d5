#include "app/rig_file.h"

#include <set>
#include <stdexcept>

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

}  // namespace

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
  for (const std::string_view key : {"width", "height", "fx", "fy", "cx", "cy", "dist"})
    if (YamlMap camera = map.map("camera"); !camera.has(key)) camera.refuse(key, "is missing");
  for (const char* key : judged_keys) (void)map.has(key);
  if (map.has("verdict") && map.text("verdict") == "refused")
    map.refuse("verdict", "is refused; this calibration says of itself that it is not good enough to dock with");
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
  Board board;
  FieldReader reader(map);
  visit(reader, board);
  map.finish();
  return board;
}

}  // namespace tagdock
