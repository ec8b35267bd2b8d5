#pragma once

#include <memory>
#include <string>
#include <vector>

#include <visp3/core/vpCameraParameters.h>
#include <visp3/core/vpHomogeneousMatrix.h>
#include <visp3/core/vpImage.h>
#include <visp3/detection/vpDetectorAprilTag.h>

#include "detection/refined_tag.h"
#include "detection/tag_locator.h"
#include "detection/tag_pose.h"

namespace tagdock {

/// vpDetectorAprilTag with refined corners: put its name in the place of ViSP's and a ViSP program gets fine polygons
/// and poses.
///
/// Pixels. ViSP's image points, like its projection (u = u0 + px x), have the centre of the first pixel at (0, 0), and
/// so have ours. ViSP's own detector hands on AprilTag's pixels, half a pixel larger in u and v, and so leans against
/// ViSP's own projection; this one does not. A principal point that was shifted by half a pixel to make up for it must
/// not be shifted here.
///
/// Order and frame are ViSP's: polygons run bottom left, bottom right, top right, top left; the object frame has x
/// right, y up, z out of the tag, or x right, y down, z into the wall after setZAlignedWithCameraAxis(true).
///
/// Of vpDetectorBase everything holds true of the refined tags: getNbObjects, getPolygon, getCog, getBBox, getMessage.
/// What vpDetectorAprilTag does not declare virtual (the computing detect, getPose, getTagsCorners, getTagsId and the
/// setters) is replaced by name: through a reference to vpDetectorAprilTag itself these would still be ViSP's.
/// Without effect are the pose estimation method (every pose is refined under the corners' covariance), number of
/// threads, quad sigma, decode sharpening and edge refinement.
class VispTagDetector : public vpDetectorAprilTag {
 public:
  /// Throws vpException for a family that is not known (36h10, 36artoolkit, 25h7, custom48h12).
  explicit VispTagDetector(const vpAprilTagFamily& family = TAG_36h11,
                           const vpPoseEstimationMethod& pose_method = HOMOGRAPHY_VIRTUAL_VS,
                           CornerMethod method = CornerMethod::best);
  VispTagDetector(const VispTagDetector& other);
  VispTagDetector& operator=(const VispTagDetector& other);
  ~VispTagDetector() override;

  /// Finds and refines; without a camera the lens is taken not to bend.
  /// @return  whether there is a tag
  bool detect(const vpImage<unsigned char>& image) override;

  /// The same with the lens modelled, and poses. A tag that no pose explains is left out of everything, so poses and
  /// polygons have the same index.
  /// @param size            side of the black square [m]
  /// @param poses2          the second pose of a flat tag; the first one again where there is none
  /// @param errors, errors2 sum of squared reprojection errors in the plane z = 1, as vpPose::computeResidual; errors2
  ///                        is the largest double where there is no second pose
  /// Throws vpException for a size that is not positive and for a camera that cannot be.
  bool detect(const vpImage<unsigned char>& image, double size, const vpCameraParameters& camera,
              std::vector<vpHomogeneousMatrix>& poses, std::vector<vpHomogeneousMatrix>* poses2 = nullptr,
              std::vector<double>* errors = nullptr, std::vector<double>* errors2 = nullptr);

  /// The pose of one of the tags found last; false if there is none.
  bool getPose(std::size_t index, double size, const vpCameraParameters& camera, vpHomogeneousMatrix& pose,
               vpHomogeneousMatrix* pose2 = nullptr, double* error = nullptr, double* error2 = nullptr);

  [[nodiscard]] std::vector<std::vector<vpImagePoint>> getTagsCorners() const;
  [[nodiscard]] std::vector<int> getTagsId() const;

  void setAprilTagFamily(const vpAprilTagFamily& family);
  /// Rounded to a whole number from 1 to 4.
  void setAprilTagQuadDecimate(float decimate);
  void setZAlignedWithCameraAxis(bool aligned);

  /// Beyond ViSP: the method that makes the corners, and the tags with their covariances, in the order of the polygons.
  void setCornerMethod(CornerMethod method);
  [[nodiscard]] const std::vector<RefinedTag>& getRefinedTags() const;
  /// Both poses of one of the tags found last, the likelier first, with covariances and chi-squares; in our tag frame
  /// (x right, y down, z into the wall) whatever setZAlignedWithCameraAxis says. Empty if there is none.
  [[nodiscard]] std::vector<TagPose> getTagPoses(std::size_t index, double size,
                                                 const vpCameraParameters& camera) const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace tagdock
