#include "detection/visp_tag_detector.h"

#include <cmath>
#include <limits>

#include <catch2/catch.hpp>
#include <visp3/core/vpException.h>
#include <visp3/core/vpMeterPixelConversion.h>
#include <visp3/core/vpPoint.h>

#include "tests/detection/scene_rendering.h"

namespace tagdock {
namespace {

using namespace testing;

struct Shown {
  Scene scene;
  Corners corners_px;
  vpImage<unsigned char> image;
  vpCameraParameters camera;
};

Shown shown(double k1 = 0.0) {
  Shown made;
  made.scene.id = 42;
  made.scene.camera.k1 = k1;
  made.scene.T_camera_tag = pose_seen(made.scene.camera, made.scene.size, 110.0, {166.3, 150.8}, 0.5, 0.7, 0.4);
  const Rendering seen = render(made.scene);
  made.corners_px = seen.corners_px;
  std::mt19937_64 random(51);
  const cv::Mat1b gray = digitised(seen.grey, 2.0, random);
  made.image.resize(static_cast<unsigned>(gray.rows), static_cast<unsigned>(gray.cols));
  std::copy(gray.begin(), gray.end(), made.image.bitmap);
  if (k1 == 0.0)
    made.camera.initPersProjWithoutDistortion(800.0, 800.0, 159.5, 159.5);
  else
    made.camera.initPersProjWithDistortion(800.0, 800.0, 159.5, 159.5, k1, -k1);
  return made;
}

double rotation_between(const vpHomogeneousMatrix& a, const vpHomogeneousMatrix& b) {
  double trace = 0.0;
  for (unsigned int i = 0; i < 3; ++i)
    for (unsigned int j = 0; j < 3; ++j) trace += a[i][j] * b[i][j];
  return std::acos(std::min(1.0, 0.5 * (trace - 1.0)));
}

double distance(const vpHomogeneousMatrix& a, const vpHomogeneousMatrix& b) {
  return std::hypot(a[0][3] - b[0][3], a[1][3] - b[1][3], a[2][3] - b[2][3]);
}

}  // namespace

TEST_CASE("used through ViSP's base class, polygons are refined and in ViSP's pixels and order") {
  const Shown seen = shown();
  VispTagDetector ours;
  vpDetectorBase& base = ours;
  REQUIRE(base.detect(seen.image));
  REQUIRE(base.getNbObjects() == 1);
  CHECK(base.getMessage(0) == "36h11 id: 42");
  const std::vector<vpImagePoint>& polygon = base.getPolygon(0);
  REQUIRE(polygon.size() == 4);
  vpDetectorAprilTag theirs;
  REQUIRE(theirs.detect(seen.image));
  CHECK(theirs.getMessage(0) == base.getMessage(0));
  for (int i = 0; i < 4; ++i) {
    // Truth in our order is top left first; ViSP's polygon starts at the bottom left and runs the other way.
    CHECK(polygon[i].get_u() == Approx(seen.corners_px[3 - i].x()).margin(0.03));  // five sigma of a fine corner
    CHECK(polygon[i].get_v() == Approx(seen.corners_px[3 - i].y()).margin(0.03));
    // ViSP's own polygon lies half a pixel away, and a few tenths more.
    CHECK(theirs.getPolygon(0)[i].get_u() == Approx(polygon[i].get_u() + 0.5).margin(0.4));
    CHECK(theirs.getPolygon(0)[i].get_v() == Approx(polygon[i].get_v() + 0.5).margin(0.4));
  }
  double u = 0.0;
  for (const Eigen::Vector2d& corner : seen.corners_px) u += 0.25 * corner.x();
  CHECK(base.getCog(0).get_u() == Approx(u).margin(0.03));
  CHECK(base.getBBox(0).getWidth() > 90.0);
  CHECK(ours.getTagsId() == std::vector<int>{42});
  CHECK(ours.getTagsCorners()[0][2].get_u() == polygon[2].get_u());
  REQUIRE(ours.getRefinedTags().size() == 1);
  CHECK(ours.getRefinedTags()[0].covariance_px2(0, 0) > 0.0);
}

TEST_CASE("poses are ViSP's frame, agree with ViSP's projection, and are finer than ViSP's") {
  for (const bool aligned : {false, true}) {
    const Shown seen = shown();
    VispTagDetector ours;
    ours.setZAlignedWithCameraAxis(aligned);
    vpDetectorAprilTag theirs;
    theirs.setZAlignedWithCameraAxis(aligned);
    std::vector<vpHomogeneousMatrix> our_poses, our_second, their_poses;
    std::vector<double> errors, errors2;
    REQUIRE(ours.detect(seen.image, seen.scene.size, seen.camera, our_poses, &our_second, &errors, &errors2));
    REQUIRE(theirs.detect(seen.image, seen.scene.size, seen.camera, their_poses));
    REQUIRE(our_poses.size() == 1);
    REQUIRE(our_second.size() == 1);
    CAPTURE(aligned);
    CHECK(rotation_between(our_poses[0], their_poses[0]) < 0.03);  // ViSP's half pixel and corners: a degree or so
    CHECK(errors[0] < errors2[0]);
    CHECK(rotation_between(our_poses[0], our_second[0]) > 0.5);  // turned over by twice the tilt
    const std::vector<TagPose> both = ours.getTagPoses(0, seen.scene.size, seen.camera);
    REQUIRE(both.size() == 2);
    CHECK(both[0].chi2 < both[1].chi2);
    CHECK(both[0].covariance.diagonal().minCoeff() > 0.0);
    CHECK((both[0].T_camera_tag.translation() - seen.scene.T_camera_tag.translation()).norm() < 0.001);
    CHECK(ours.getTagPoses(1, seen.scene.size, seen.camera).empty());

    vpHomogeneousMatrix truth;
    for (unsigned int row = 0; row < 3; ++row)
      for (unsigned int column = 0; column < 4; ++column)
        truth[row][column] =
            seen.scene.T_camera_tag(row, column) * (!aligned && (column == 1 || column == 2) ? -1.0 : 1.0);
    CHECK(rotation_between(our_poses[0], truth) < 0.005);
    CHECK(distance(our_poses[0], truth) < 0.001);  // at 1.16 m
    CHECK(distance(our_poses[0], truth) < distance(their_poses[0], truth));

    // ViSP's own points and projection lead from the pose back to the polygon.
    const std::map<int, double> sizes{{-1, seen.scene.size}};
    const auto points = ours.getTagsPoints3D(ours.getTagsId(), sizes);
    for (std::size_t i = 0; i < 4; ++i) {
      vpPoint point = points[0][i];
      point.changeFrame(our_poses[0]);
      point.project();
      double u = 0.0;
      double v = 0.0;
      vpMeterPixelConversion::convertPoint(seen.camera, point.get_x(), point.get_y(), u, v);
      CHECK(u == Approx(ours.getPolygon(0)[i].get_u()).margin(0.03));
      CHECK(v == Approx(ours.getPolygon(0)[i].get_v()).margin(0.03));
    }
    vpHomogeneousMatrix again;
    CHECK(ours.getPose(0, seen.scene.size, seen.camera, again));
    CHECK(distance(again, our_poses[0]) == 0.0);
    CHECK_FALSE(ours.getPose(1, seen.scene.size, seen.camera, again));
  }
}

TEST_CASE("ViSP's distortion is undone") {
  const Shown seen = shown(-0.4);
  VispTagDetector ours;
  std::vector<vpHomogeneousMatrix> poses;
  REQUIRE(ours.detect(seen.image, seen.scene.size, seen.camera, poses));
  const Eigen::Vector3d t = seen.scene.T_camera_tag.translation();
  CHECK(std::hypot(poses[0][0][3] - t.x(), poses[0][1][3] - t.y(), poses[0][2][3] - t.z()) < 0.001);
}

TEST_CASE("what makes ViSP's detector abort or lie is refused") {
  const Shown seen = shown();
  VispTagDetector ours;
  std::vector<vpHomogeneousMatrix> poses;
  for (const double size : {0.0, -0.16, std::nan(""), std::numeric_limits<double>::infinity()})
    CHECK_THROWS_AS(ours.detect(seen.image, size, seen.camera, poses), vpException);
  const vpCameraParameters broken(std::nan(""), 800.0, 160.0, 160.0);
  CHECK_THROWS_AS(ours.detect(seen.image, 0.16, broken, poses), vpException);
  CHECK_THROWS_AS(VispTagDetector(vpDetectorAprilTag::TAG_36h10), vpException);
  for (const unsigned int side : {1U, 2U, 3U}) CHECK_FALSE(ours.detect(vpImage<unsigned char>(side, side, 0)));
  CHECK_FALSE(ours.detect(vpImage<unsigned char>()));
  CHECK(ours.getNbObjects() == 0);
  CHECK(ours.getTagsId().empty());
}

TEST_CASE("a copy keeps what was found and finds by itself") {
  const Shown seen = shown();
  VispTagDetector first;
  first.setCornerMethod(CornerMethod::tanh);
  REQUIRE(first.detect(seen.image));
  VispTagDetector copy(first);
  CHECK(copy.getNbObjects() == 1);
  CHECK(copy.getTagsId() == first.getTagsId());
  VispTagDetector assigned;
  assigned = first;
  CHECK(assigned.getNbObjects() == 1);
  REQUIRE(assigned.detect(seen.image));
  CHECK(assigned.getPolygon(0)[0].get_u() == first.getPolygon(0)[0].get_u());
  CHECK(assigned.getRefinedTags()[0].terms.starts_with("tanh"));
}

}  // namespace tagdock
