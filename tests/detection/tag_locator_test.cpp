#include "detection/tag_locator.h"

#include <cstring>
#include <sys/mman.h>
#include <unistd.h>

#include <catch2/catch.hpp>

#include "detection/tag_pattern.h"
#include "planning/pose2.h"
#include "tests/detection/scene_rendering.h"

namespace tagdock {
namespace {

using namespace testing;

constexpr double lens_height = 0.35;

/// The default station seen by the default rig from (x, y) before it, heading off by yaw.
struct Station {
  Rig rig = default_rig();
  Board board = default_board(lens_height);
  Eigen::Isometry3d T_camera_station = Eigen::Isometry3d::Identity();

  explicit Station(const Pose2& T_station_base) {
    Eigen::Isometry3d T = Eigen::Isometry3d::Identity();
    T.translation() << T_station_base.x, T_station_base.y, 0.0;
    T.linear() = Eigen::AngleAxisd(T_station_base.yaw, Eigen::Vector3d::UnitZ()).toRotationMatrix();
    T_camera_station = (T * rig.T_base_camera).inverse();
  }

  [[nodiscard]] Frame frame(std::uint64_t seed) const {
    cv::Mat1d grey(rig.camera.height, rig.camera.width, 120.0);
    for (const BoardTag& tag : board.tags) {
      Scene scene;
      scene.camera = rig.camera;
      scene.family = board.family;
      scene.id = tag.id;
      scene.size = tag.size;
      scene.T_camera_tag = T_camera_station * tag.T_station_tag;
      render_into(grey, scene);
    }
    std::mt19937_64 random(seed);
    return {digitised(grey, 2.0, random), std::chrono::milliseconds(40), 7};
  }
};

TagLocatorConfig by(CornerMethod method) {
  TagLocatorConfig config;
  config.method = method;
  return config;
}

/// Memory that ends the process when somebody reads before or behind it, filled with one byte.
class FencedMemory {
 public:
  FencedMemory(std::size_t size, int filling) : size_((size + page() - 1) / page() * page()) {
    memory_ = static_cast<unsigned char*>(
        ::mmap(nullptr, size_ + 2 * page(), PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0));
    REQUIRE(memory_ != MAP_FAILED);
    std::memset(begin(), filling, size_);
    REQUIRE(::mprotect(memory_, page(), PROT_NONE) == 0);
    REQUIRE(::mprotect(end(), page(), PROT_NONE) == 0);
  }
  ~FencedMemory() { ::munmap(memory_, size_ + 2 * page()); }
  FencedMemory(const FencedMemory&) = delete;
  FencedMemory& operator=(const FencedMemory&) = delete;
  [[nodiscard]] unsigned char* begin() const { return memory_ + page(); }
  [[nodiscard]] unsigned char* end() const { return begin() + size_; }

 private:
  static std::size_t page() { return static_cast<std::size_t>(::sysconf(_SC_PAGESIZE)); }
  std::size_t size_;
  unsigned char* memory_ = nullptr;
};

/// Every number of a sighting, to the last bit.
std::vector<double> numbers(const Sighting& sighting) {
  const BoardSighting& seen = std::get<BoardSighting>(sighting);
  std::vector<double> all{seen.reprojection_rms_px, seen.chi2_per_coordinate, seen.log_odds, double(seen.followed)};
  const auto append = [&all](const auto& matrix) {
    all.insert(all.end(), matrix.data(), matrix.data() + matrix.size());
  };
  append(seen.T_camera_station.matrix());
  append(seen.covariance);
  for (const RefinedTag& tag : seen.tags) {
    for (const Eigen::Vector2d& corner : tag.corners_px) append(corner);
    append(tag.covariance_px2);
    all.insert(all.end(), {double(tag.id), tag.margin, tag.residual_rms, tag.blur_px});
  }
  return all;
}

double distance(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
  return (a.inverse().translation() - b.inverse().translation()).norm();  // between the two lenses
}

}  // namespace

TEST_CASE("a frame gives the station's pose within millimetres by every method, with and without a prediction") {
  // Range 2.6 m, three tags of about 75 px: the notes' position rms at noise 2 is some 0.1 mm for fine corners and
  // 1 mm for the library's own, whose shift no noise explains; three of these are allowed.
  const Station station({-2.95, 0.15, radians(-4.0)});
  const Frame frame = station.frame(41);
  for (const CornerMethod method :
       {CornerMethod::apriltag, CornerMethod::tanh, CornerMethod::filter, CornerMethod::erf, CornerMethod::best})
    for (const bool predicted : {false, true}) {
      CAPTURE(word(method), predicted);
      const TagLocator locator(station.rig, station.board, by(method));
      Eigen::Isometry3d T_predicted = station.T_camera_station;
      T_predicted.translation() += Eigen::Vector3d(0.05, 0.0, 0.1);
      const Sighting sighting = locator.locate(frame, predicted ? std::optional(T_predicted) : std::nullopt);
      REQUIRE(std::holds_alternative<BoardSighting>(sighting));
      const BoardSighting& seen = std::get<BoardSighting>(sighting);
      CHECK(distance(seen.T_camera_station, station.T_camera_station) <
            (method == CornerMethod::apriltag ? 0.005 : 0.001));
      CHECK(seen.tags.size() == 3);
      CHECK(seen.frame_number == 7);
      CHECK(seen.time == std::chrono::milliseconds(40));
      CHECK_FALSE(seen.unrefined);
    }
}

TEST_CASE("a wrong prediction costs time, not the sighting") {
  const Station station({-2.5, 0.0, 0.0});
  const Frame frame = station.frame(42);
  const TagLocator locator(station.rig, station.board, by(CornerMethod::tanh));
  Eigen::Isometry3d beside = station.T_camera_station;
  beside.translation().x() += 1.2;
  Eigen::Isometry3d behind = station.T_camera_station;
  behind.translation().z() = -1.0;
  Eigen::Isometry3d broken = station.T_camera_station;
  broken.translation().x() = std::nan("");
  for (const Eigen::Isometry3d& wrong : {beside, behind, broken}) {
    const Sighting sighting = locator.locate(frame, wrong);
    REQUIRE(std::holds_alternative<BoardSighting>(sighting));
    CHECK(distance(std::get<BoardSighting>(sighting).T_camera_station, station.T_camera_station) < 0.001);
  }
}

TEST_CASE("tags are followed from a prediction that is centimetres and a degree off, to the same pose") {
  const Station station({-2.95, 0.15, radians(-4.0)});
  const Frame frame = station.frame(45);
  const TagLocator locator(station.rig, station.board, by(CornerMethod::best));
  const Sighting searched = locator.locate(frame, std::nullopt);
  REQUIRE(std::holds_alternative<BoardSighting>(searched));
  CHECK_FALSE(std::get<BoardSighting>(searched).followed);
  for (const Eigen::Vector3d& shift :
       {Eigen::Vector3d(0.0, 0.0, 0.0), Eigen::Vector3d(0.02, 0.005, 0.05), Eigen::Vector3d(-0.015, -0.01, -0.08)}) {
    Eigen::Isometry3d T_predicted = station.T_camera_station;
    T_predicted.translation() += shift;
    T_predicted.linear() = Eigen::AngleAxisd(radians(20.0) * shift.x(), Eigen::Vector3d::UnitY()).toRotationMatrix() *
                           T_predicted.linear();
    const Sighting sighting = locator.locate(frame, T_predicted);
    REQUIRE(std::holds_alternative<BoardSighting>(sighting));
    const BoardSighting& seen = std::get<BoardSighting>(sighting);
    CAPTURE(shift.transpose());
    CHECK(seen.followed);
    CHECK(seen.tags.size() == station.board.tags.size());
    // Another start of the same fit, with a few other pixels: half of the 0.1 mm that noise makes.
    CHECK(distance(seen.T_camera_station, std::get<BoardSighting>(searched).T_camera_station) < 5e-5);
  }
}

TEST_CASE("a pose from the pixels of all tags is that of their corners to a part of its sigma, and as sure") {
  const Station station({-2.0, 0.1, radians(3.0)});
  const TagLocator by_corners(station.rig, station.board, by(CornerMethod::best));
  TagLocatorConfig config = by(CornerMethod::best);
  config.joint = true;
  const TagLocator by_pixels(station.rig, station.board, config);
  double nees = 0.0;
  const int count = 6;
  for (int i = 0; i < count; ++i) {
    const Frame frame = station.frame(60 + static_cast<std::uint64_t>(i));
    const Sighting first = by_corners.locate(frame, station.T_camera_station);
    const Sighting second = by_pixels.locate(frame, station.T_camera_station);
    REQUIRE(std::holds_alternative<BoardSighting>(first));
    REQUIRE(std::holds_alternative<BoardSighting>(second));
    const BoardSighting& corners = std::get<BoardSighting>(first);
    const BoardSighting& pixels = std::get<BoardSighting>(second);
    CHECK(corners.source == PoseSource::corners);
    CHECK(pixels.source == PoseSource::pixels);
    const auto error = [](const Eigen::Isometry3d& a, const Eigen::Isometry3d& b) {
      const Eigen::Isometry3d off = a * b.inverse();
      const Eigen::AngleAxisd turn(off.linear());
      Eigen::Matrix<double, 6, 1> motion;
      motion << off.translation(), turn.angle() * turn.axis();
      return motion;
    };
    const auto apart = error(pixels.T_camera_station, corners.T_camera_station);
    // Both are the minimum of the same pixels' misfit but for the common blur: less than half a sigma.
    CHECK(apart.dot(corners.covariance.ldlt().solve(apart)) / 6.0 < 0.25);
    const auto off = error(pixels.T_camera_station, station.T_camera_station);
    nees += off.dot(pixels.covariance.ldlt().solve(off)) / 6.0 / count;
    CHECK(pixels.covariance.trace() < 1.5 * corners.covariance.trace());
    CHECK(corners.covariance.trace() < 1.5 * pixels.covariance.trace());
  }
  // Six times six coordinates scatter by 0.24; the floor's three are truer here than the prior says.
  CHECK(nees > 0.2);
  CHECK(nees < 1.8);
}

TEST_CASE("a pose is not taken from the pixels where the tags contradict the board, or one of them is not fitted") {
  const Station station({-2.0, 0.1, radians(3.0)});
  const Frame frame = station.frame(66);
  TagLocatorConfig config;
  config.joint = true;
  // One tag hangs a millimetre beside its surveyed place: about half a pixel, a hundred sigmas.
  Board surveyed = station.board;
  surveyed.tags[2].T_station_tag.translation().y() += 0.001;
  const Sighting sighting = TagLocator(station.rig, surveyed, config).locate(frame, station.T_camera_station);
  REQUIRE(std::holds_alternative<BoardSighting>(sighting));
  CHECK(std::get<BoardSighting>(sighting).source == PoseSource::corners_contradict_board);
  config.method = CornerMethod::tanh;
  const Sighting by_sides = TagLocator(station.rig, station.board, config).locate(frame, station.T_camera_station);
  REQUIRE(std::holds_alternative<BoardSighting>(by_sides));
  CHECK(std::get<BoardSighting>(by_sides).source == PoseSource::corners);
  // A black and white square across half of a tag's code: its pattern is not what was decoded.
  config.method = CornerMethod::best;
  Frame spoiled = frame;
  spoiled.gray = frame.gray.clone();
  const RefinedTag& tag = std::get<BoardSighting>(sighting).tags[1];
  const Eigen::Vector2d middle = 0.5 * (tag.corners_px[0] + tag.corners_px[2]);
  const int reach = static_cast<int>(0.5 * (tag.corners_px[1] - tag.corners_px[0]).norm());
  for (int y = -reach; y < reach; ++y)
    for (int x = -reach; x < reach; ++x)
      if ((x / 2 + y / 2) % 2 == 0)
        spoiled.gray(static_cast<int>(middle.y()) + y, static_cast<int>(middle.x()) + x) = 255;
  const Sighting half_seen = TagLocator(station.rig, station.board, config).locate(spoiled, std::nullopt);
  REQUIRE(std::holds_alternative<BoardSighting>(half_seen));
  const BoardSighting& seen = std::get<BoardSighting>(half_seen);
  CAPTURE(word(seen.source), seen.tags.size());
  CHECK((seen.tags.size() == 2 || seen.source == PoseSource::corners_tag_unfitted));
}

TEST_CASE("tags of every family are followed") {
  for (const std::string family :
       {"tag36h11", "tag25h9", "tag16h5", "tagStandard41h12", "tagStandard52h13", "tagCircle21h7", "tagCircle49h12"}) {
    CAPTURE(family);
    Station station({-2.2, 0.1, radians(3.0)});
    station.board.family = family;
    const TagPattern pattern = tag_pattern(family, 1);
    for (std::size_t i = 0; i < station.board.tags.size(); ++i) {
      station.board.tags[i].id = static_cast<int>(i) + 1;
      station.board.tags[i].size *= 1.25 * pattern.border_cells / pattern.cells;  // prints that do not overlap
    }
    const TagLocator locator(station.rig, station.board, by(CornerMethod::best));
    Eigen::Isometry3d T_predicted = station.T_camera_station;
    T_predicted.translation() += Eigen::Vector3d(0.004, -0.003, 0.02);
    const Sighting sighting = locator.locate(station.frame(47), T_predicted);
    REQUIRE(std::holds_alternative<BoardSighting>(sighting));
    CHECK(std::get<BoardSighting>(sighting).followed);
    CHECK(distance(std::get<BoardSighting>(sighting).T_camera_station, station.T_camera_station) < 0.001);
  }
}

TEST_CASE("a tag with another code is not followed") {
  Station station({-2.5, 0.0, 0.0});
  const TagLocator locator(station.rig, station.board, by(CornerMethod::tanh));
  Station other = station;
  other.board.tags[1].id += 50;
  const Sighting sighting = locator.locate(other.frame(46), station.T_camera_station);
  REQUIRE(std::holds_alternative<BoardSighting>(sighting));
  CHECK_FALSE(std::get<BoardSighting>(sighting).followed);
  CHECK(std::get<BoardSighting>(sighting).tags.size() == 2);
}

TEST_CASE("nothing, other tags and a doubled tag are told apart") {
  Station station({-2.5, 0.0, 0.0});
  const TagLocator locator(station.rig, station.board, by(CornerMethod::tanh));
  const auto reason = [&](const Frame& frame) {
    const Sighting sighting = locator.locate(frame, std::nullopt);
    REQUIRE(std::holds_alternative<Unseen>(sighting));
    return std::get<Unseen>(sighting);
  };
  CHECK(reason({cv::Mat1b(station.rig.camera.height, station.rig.camera.width, uchar{120}), {}, 1}) == Unseen::no_tag);
  Station others = station;
  for (BoardTag& tag : others.board.tags) tag.id += 50;
  CHECK(reason(others.frame(43)) == Unseen::other_tags);
  Station twice = station;
  twice.board.tags[2].id = twice.board.tags[0].id;
  CHECK(reason(twice.frame(44)) == Unseen::duplicate_tag);
}

TEST_CASE("a frame of another size than the rig's camera, and an impossible board, are set-up errors") {
  const Station station({-2.5, 0.0, 0.0});
  const TagLocator locator(station.rig, station.board, by(CornerMethod::tanh));
  CHECK_THROWS_WITH(locator.locate({cv::Mat1b(480, 640, uchar{0}), {}, 1}, std::nullopt), Catch::Contains("640x480"));
  Board twice = station.board;
  twice.tags[1].id = twice.tags[0].id;
  CHECK_THROWS_WITH(TagLocator(station.rig, twice, {}), Catch::Contains("twice"));
  CHECK_THROWS_WITH(TagLocator(station.rig, Board{}, {}), Catch::Contains("no tags"));
}

TEST_CASE("the words of corner methods lead back to the methods") {
  for (const CornerMethod method :
       {CornerMethod::apriltag, CornerMethod::tanh, CornerMethod::filter, CornerMethod::erf, CornerMethod::best})
    CHECK(corner_method(std::string(word(method))) == method);
  CHECK_FALSE(corner_method("fast").has_value());
}

TEST_CASE("where a picture lies in memory and what is around it changes no bit of a sighting") {
  // A live picture lies in memory that is shared with the camera's process, a replayed one in the heap.
  const Station station({-2.5, 0.1, radians(3.0)});
  const Frame heap = station.frame(45);
  const std::size_t size = heap.gray.total();
  Eigen::Isometry3d near = station.T_camera_station;
  near.translation() += Eigen::Vector3d(0.02, 0.0, 0.03);
  Eigen::Isometry3d beside = station.T_camera_station;  // nothing is followed from here, a region is searched
  beside.translation() += Eigen::Vector3d(0.4, 0.0, 0.4);
  const std::vector<std::optional<Eigen::Isometry3d>> predictions{std::nullopt, near, beside};
  for (const CornerMethod method : {CornerMethod::apriltag, CornerMethod::filter, CornerMethod::best}) {
    const TagLocator locator(station.rig, station.board, by(method));
    for (std::size_t p = 0; p < predictions.size(); ++p) {
      const std::vector<double> wanted = numbers(locator.locate(heap, predictions[p]));
      for (const int filling : {0, 255}) {
        const FencedMemory memory(size + 64, filling);
        for (unsigned char* place : {memory.begin(), memory.begin() + 1, memory.begin() + 24, memory.end() - size}) {
          CAPTURE(word(method), p, filling, place - memory.begin());
          std::memcpy(place, heap.gray.data, size);
          const Frame there{cv::Mat1b(heap.gray.rows, heap.gray.cols, place), heap.time, heap.number};
          const std::vector<double> seen = numbers(locator.locate(there, predictions[p]));
          CHECK((seen.size() == wanted.size() &&
                 std::memcmp(seen.data(), wanted.data(), wanted.size() * sizeof(double)) == 0));
          std::memset(place, filling, size);
        }
      }
    }
  }
}

}  // namespace tagdock
