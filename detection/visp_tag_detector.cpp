#include "detection/visp_tag_detector.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <optional>
#include <stdexcept>
#include <utility>

#include <visp3/core/vpDisplay.h>
#include <visp3/core/vpException.h>

#include "detection/tag_pose.h"

namespace tagdock {
namespace {

struct FamilyWords {
  vpDetectorAprilTag::vpAprilTagFamily visp;
  const char* ours;
  const char* message;  ///< what ViSP writes before the id
};

constexpr FamilyWords family_words[] = {{vpDetectorAprilTag::TAG_36h11, "tag36h11", "36h11"},
                                        {vpDetectorAprilTag::TAG_25h9, "tag25h9", "25h9"},
                                        {vpDetectorAprilTag::TAG_16h5, "tag16h5", "16h5"},
                                        {vpDetectorAprilTag::TAG_CIRCLE21h7, "tagCircle21h7", "Circle21h7"},
                                        {vpDetectorAprilTag::TAG_CIRCLE49h12, "tagCircle49h12", "Circle49h12"},
                                        {vpDetectorAprilTag::TAG_STANDARD41h12, "tagStandard41h12", "Standard41h12"},
                                        {vpDetectorAprilTag::TAG_STANDARD52h13, "tagStandard52h13", "Standard52h13"}};

const FamilyWords& words_of(vpDetectorAprilTag::vpAprilTagFamily family) {
  for (const FamilyWords& words : family_words)
    if (words.visp == family) return words;
  throw vpException(vpException::badValue, "this AprilTag family is not detected");
}

/// ViSP's polygon starts at the bottom left and runs counter-clockwise.
std::vector<vpImagePoint> polygon(const Corners& corners) {
  std::vector<vpImagePoint> points;
  for (int i = 3; i >= 0; --i) points.emplace_back(corners[i].y(), corners[i].x());
  return points;
}

/// ViSP's distortion bends as our k1 does. Throws vpException for a camera that cannot be.
CameraModel model_of(const vpCameraParameters& camera, int width, int height) {
  if (camera.get_projModel() == vpCameraParameters::ProjWithKannalaBrandtDistortion)
    throw vpException(vpException::badValue, "fisheye cameras are not modelled");
  CameraModel model{width, height, camera.get_px(), camera.get_py(), camera.get_u0(), camera.get_v0()};
  if (camera.get_projModel() == vpCameraParameters::perspectiveProjWithDistortion) model.k1 = camera.get_kud();
  try {
    check(model);
  } catch (const std::invalid_argument& error) {
    throw vpException(vpException::badValue, error.what());
  }
  return model;
}

vpHomogeneousMatrix in_visp(const Eigen::Isometry3d& T_camera_tag, bool aligned) {
  Eigen::Matrix4d matrix = T_camera_tag.matrix();
  if (!aligned) matrix.block<3, 2>(0, 1) *= -1.0;  // a half turn about x
  vpHomogeneousMatrix result;
  for (unsigned int row = 0; row < 4; ++row)
    for (unsigned int column = 0; column < 4; ++column) result[row][column] = matrix(row, column);
  return result;
}

/// Sum of squared errors in the plane z = 1.
double residual(const RefinedTag& tag, double size, const CameraModel& camera, const Eigen::Isometry3d& T_camera_tag) {
  const TagPoints points = tag_corners(size);
  double sum = 0.0;
  for (int i = 0; i < 4; ++i)
    if (const auto seen = unproject(camera, tag.corners_px[i]))
      sum += ((T_camera_tag * points[i]).hnormalized() - *seen).squaredNorm();
  return sum;
}

std::string message(vpDetectorAprilTag::vpAprilTagFamily family, int id) {
  return std::string(words_of(family).message) + " id: " + std::to_string(id);
}

}  // namespace

struct VispTagDetector::State {
  TagDetectorConfig config;
  CornerMethod method = CornerMethod::best;
  bool aligned = false;
  std::optional<TagDetector> detector;  ///< made when first needed: its tables take up to a second
  std::vector<RefinedTag> tags;
  int width = 1;
  int height = 1;

  /// A copy finds tags by a detector of its own.
  [[nodiscard]] std::unique_ptr<State> copy() const {
    auto made = std::make_unique<State>();
    made->config = config;
    made->method = method;
    made->aligned = aligned;
    made->tags = tags;
    made->width = width;
    made->height = height;
    return made;
  }

  void find(const vpImage<unsigned char>& image, const std::optional<CameraModel>& camera) {
    tags.clear();
    width = static_cast<int>(image.getWidth());
    height = static_cast<int>(image.getHeight());
    if (width < 1 || height < 1) return;
    if (!detector) detector.emplace(config);
    const cv::Mat1b gray(height, width, image.bitmap);  // rows of a vpImage follow each other without gaps
    for (const TagDetection& detection : detector->detect(gray)) {
      Refinement refined = refine(gray, config.family, detection, method, camera);
      if (std::holds_alternative<Unrefined>(refined))
        refined = refine(gray, config.family, detection, CornerMethod::apriltag, camera);
      tags.push_back(std::get<RefinedTag>(refined));
    }
  }
};

VispTagDetector::VispTagDetector(const vpAprilTagFamily& family, const vpPoseEstimationMethod& pose_method,
                                 CornerMethod method)
    : vpDetectorAprilTag(family, pose_method), state_(std::make_unique<State>()) {
  state_->config.family = words_of(family).ours;
  state_->method = method;
}

VispTagDetector::VispTagDetector(const VispTagDetector& other)
    : vpDetectorAprilTag(other), state_(other.state_->copy()) {}

VispTagDetector& VispTagDetector::operator=(const VispTagDetector& other) {
  if (this == &other) return *this;
  vpDetectorAprilTag::operator=(other);
  // ViSP's own assignment leaves the results of vpDetectorBase where they are.
  m_polygon = other.m_polygon;
  m_message = other.m_message;
  m_nb_objects = other.m_nb_objects;
  state_ = other.state_->copy();
  return *this;
}

VispTagDetector::~VispTagDetector() = default;

bool VispTagDetector::detect(const vpImage<unsigned char>& image) {
  state_->find(image, std::nullopt);
  m_polygon.clear();
  m_message.clear();
  for (const RefinedTag& tag : state_->tags) {
    m_polygon.push_back(polygon(tag.corners_px));
    m_message.push_back(message(m_tagFamily, tag.id));
  }
  m_nb_objects = m_polygon.size();
  if (m_displayTag)
    for (const std::vector<vpImagePoint>& corners : m_polygon)
      for (std::size_t i = 0; i < 4; ++i) {
        const vpColor sides[] = {vpColor::red, vpColor::green, vpColor::blue, vpColor::yellow};
        const vpColor& colour = m_displayTagColor == vpColor::none ? sides[i] : m_displayTagColor;
        vpDisplay::displayLine(image, corners[i], corners[(i + 1) % 4], colour, m_displayTagThickness);
      }
  return m_nb_objects > 0;
}

bool VispTagDetector::detect(const vpImage<unsigned char>& image, double size, const vpCameraParameters& camera,
                             std::vector<vpHomogeneousMatrix>& poses, std::vector<vpHomogeneousMatrix>* poses2,
                             std::vector<double>* errors, std::vector<double>* errors2) {
  if (!(std::isfinite(size) && size > 0.0)) throw vpException(vpException::badValue, "the tag's size must be positive");
  poses.clear();
  if (poses2 != nullptr) poses2->clear();
  if (errors != nullptr) errors->clear();
  if (errors2 != nullptr) errors2->clear();
  m_polygon.clear();
  m_message.clear();
  m_nb_objects = 0;
  const int width = std::max(1, static_cast<int>(image.getWidth()));
  const int height = std::max(1, static_cast<int>(image.getHeight()));
  state_->find(image, model_of(camera, width, height));
  std::vector<RefinedTag> posed;
  std::swap(posed, state_->tags);
  for (const RefinedTag& tag : posed) {
    state_->tags.push_back(tag);
    vpHomogeneousMatrix pose;
    vpHomogeneousMatrix pose2;
    double error = 0.0;
    double error2 = 0.0;
    if (!getPose(state_->tags.size() - 1, size, camera, pose, &pose2, &error, &error2)) {
      state_->tags.pop_back();
      continue;
    }
    poses.push_back(pose);
    if (poses2 != nullptr) poses2->push_back(pose2);
    if (errors != nullptr) errors->push_back(error);
    if (errors2 != nullptr) errors2->push_back(error2);
    m_polygon.push_back(polygon(tag.corners_px));
    m_message.push_back(message(m_tagFamily, tag.id));
    if (m_displayTag)
      vpDisplay::displayFrame(image, pose, camera, 0.5 * size, m_displayTagColor, m_displayTagThickness);
  }
  m_nb_objects = m_polygon.size();
  return m_nb_objects > 0;
}

bool VispTagDetector::getPose(std::size_t index, double size, const vpCameraParameters& camera,
                              vpHomogeneousMatrix& pose, vpHomogeneousMatrix* pose2, double* error, double* error2) {
  if (!(std::isfinite(size) && size > 0.0)) throw vpException(vpException::badValue, "the tag's size must be positive");
  if (index >= state_->tags.size()) return false;
  const RefinedTag& tag = state_->tags[index];
  const CameraModel model = model_of(camera, std::max(1, state_->width), std::max(1, state_->height));
  const std::vector<TagPose> found = getTagPoses(index, size, camera);
  if (found.empty()) return false;
  const bool two = found.size() > 1;
  pose = in_visp(found[0].T_camera_tag, state_->aligned);
  if (pose2 != nullptr) *pose2 = two ? in_visp(found[1].T_camera_tag, state_->aligned) : pose;
  if (error != nullptr) *error = residual(tag, size, model, found[0].T_camera_tag);
  if (error2 != nullptr)
    *error2 = two ? residual(tag, size, model, found[1].T_camera_tag) : std::numeric_limits<double>::max();
  return true;
}

std::vector<std::vector<vpImagePoint>> VispTagDetector::getTagsCorners() const { return m_polygon; }

std::vector<int> VispTagDetector::getTagsId() const {
  std::vector<int> ids;
  for (const RefinedTag& tag : state_->tags) ids.push_back(tag.id);
  return ids;
}

void VispTagDetector::setAprilTagFamily(const vpAprilTagFamily& family) {
  state_->config.family = words_of(family).ours;
  vpDetectorAprilTag::setAprilTagFamily(family);
  state_->detector.reset();
}

void VispTagDetector::setAprilTagQuadDecimate(float decimate) {
  if (!std::isfinite(decimate)) throw vpException(vpException::badValue, "the decimation must be a number");
  vpDetectorAprilTag::setAprilTagQuadDecimate(decimate);
  state_->config.decimate = static_cast<int>(std::clamp(std::round(decimate), 1.0F, 4.0F));
  state_->detector.reset();
}

void VispTagDetector::setZAlignedWithCameraAxis(bool aligned) {
  vpDetectorAprilTag::setZAlignedWithCameraAxis(aligned);
  state_->aligned = aligned;
}

void VispTagDetector::setCornerMethod(CornerMethod method) { state_->method = method; }

const std::vector<RefinedTag>& VispTagDetector::getRefinedTags() const { return state_->tags; }

std::vector<TagPose> VispTagDetector::getTagPoses(std::size_t index, double size,
                                                  const vpCameraParameters& camera) const {
  if (!(std::isfinite(size) && size > 0.0)) throw vpException(vpException::badValue, "the tag's size must be positive");
  if (index >= state_->tags.size()) return {};
  return tag_poses(state_->tags[index], size,
                   model_of(camera, std::max(1, state_->width), std::max(1, state_->height)));
}

}  // namespace tagdock
