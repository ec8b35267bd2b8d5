#include "app/camera_writer.h"

#include <sstream>
#include <vector>

#include "app/calibration_result.h"
#include "app/failure.h"

namespace tagdock {
namespace {

std::string list(const std::vector<double>& values) {
  std::ostringstream text;
  text.precision(17);
  for (std::size_t i = 0; i < values.size(); ++i) {
    std::ostringstream one;
    one.precision(17);
    one << values[i];
    std::string digits = one.str();
    // YAML 1.1 takes a number with an exponent and without a point for a word; "0" alone is an integer to OpenCV.
    if (digits.find('.') == std::string::npos && digits.find("inf") == std::string::npos) {
      const std::size_t exponent = digits.find('e');
      digits.insert(exponent == std::string::npos ? digits.size() : exponent, ".0");
    }
    text << (i > 0 ? ", " : "") << digits;
  }
  return text.str();
}

bool rational(const CameraModel& c) { return c.k4 != 0.0 || c.k5 != 0.0 || c.k6 != 0.0; }

std::vector<double> dist_of(const CameraModel& c) {
  std::vector<double> dist{c.k1, c.k2, c.p1, c.p2, c.k3};
  if (rational(c)) dist.insert(dist.end(), {c.k4, c.k5, c.k6});
  return dist;
}

std::string ros(const CameraModel& c) {
  const std::vector<double> dist = dist_of(c);
  std::ostringstream text;
  text << "image_width: " << c.width << "\nimage_height: " << c.height
       << "\ncamera_name: camera\ncamera_matrix:\n  rows: 3\n  cols: 3\n  data: ["
       << list({c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1})
       << "]\ndistortion_model: " << (rational(c) ? "rational_polynomial" : "plumb_bob")
       << "\ndistortion_coefficients:\n  rows: 1\n  cols: " << dist.size() << "\n  data: [" << list(dist)
       << "]\nrectification_matrix:\n  rows: 3\n  cols: 3\n  data: [" << list({1, 0, 0, 0, 1, 0, 0, 0, 1})
       << "]\nprojection_matrix:\n  rows: 3\n  cols: 4\n  data: ["
       << list({c.fx, 0, c.cx, 0, 0, c.fy, c.cy, 0, 0, 0, 1, 0}) << "]\n";
  return text.str();
}

std::string opencv(const CameraModel& c) {
  const std::vector<double> dist = dist_of(c);
  std::ostringstream text;
  text << "%YAML:1.0\n---\nimage_width: " << c.width << "\nimage_height: " << c.height
       << "\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n   dt: d\n   data: [ "
       << list({c.fx, 0, c.cx, 0, c.fy, c.cy, 0, 0, 1})
       << " ]\ndistortion_coefficients: !!opencv-matrix\n   rows: 1\n   cols: " << dist.size()
       << "\n   dt: d\n   data: [ " << list(dist) << " ]\n";
  return text.str();
}

std::string kalibr(const CameraModel& c) {
  std::ostringstream text;
  text << "cam0:\n  camera_model: pinhole\n  intrinsics: [" << list({c.fx, c.fy, c.cx, c.cy})
       << "]\n  distortion_model: radtan\n  distortion_coeffs: [" << list({c.k1, c.k2, c.p1, c.p2})
       << "]\n  resolution: [" << c.width << ", " << c.height << "]\n  rostopic: /camera/image_raw\n";
  return text.str();
}

std::string mrcal(const CameraModel& c) {
  std::vector<double> values{c.fx, c.fy, c.cx, c.cy};
  const std::vector<double> dist = dist_of(c);
  values.insert(values.end(), dist.begin(), dist.end());
  std::ostringstream text;
  text << "# written by tagdock\n{\n    'lensmodel':  '" << (rational(c) ? "LENSMODEL_OPENCV8" : "LENSMODEL_OPENCV5")
       << "',\n    'intrinsics': [ " << list(values)
       << " ],\n    'extrinsics': [ 0, 0, 0, 0, 0, 0 ],\n    'imagersize': [ " << c.width << ", " << c.height
       << " ]\n}\n";
  return text.str();
}

std::string visp(const CameraModel& c) {
  std::ostringstream text;
  text.precision(17);
  const auto model = [&](bool distorted) {
    text << "    <model>\n      <type>perspectiveProjWith" << (distorted ? "" : "out")
         << "Distortion</type>\n      <px>" << c.fx << "</px>\n      <py>" << c.fy << "</py>\n      <u0>" << c.cx
         << "</u0>\n      <v0>" << c.cy << "</v0>\n";
    if (distorted) text << "      <kud>" << c.k1 << "</kud>\n      <kdu>" << visp_kdu(c) << "</kdu>\n";
    text << "    </model>\n";
  };
  text << "<?xml version=\"1.0\"?>\n<root>\n  <camera>\n    <name>camera</name>\n    <image_width>" << c.width
       << "</image_width>\n    <image_height>" << c.height << "</image_height>\n";
  model(false);
  model(true);
  text << "  </camera>\n</root>\n";
  return text.str();
}

struct Format {
  const char* word;
  const char* extension;
  LensTerms terms;
  std::string (*write)(const CameraModel&);
};

std::string tagdock_rig(const CameraModel& c) {
  nlohmann::ordered_json block;
  block["camera"] = camera_block(c);
  return to_yaml(block);
}

constexpr Format formats[] = {{"ros", ".ros.yaml", LensTerms::all, ros},
                              {"opencv", ".opencv.yaml", LensTerms::all, opencv},
                              {"kalibr", ".kalibr.yaml", LensTerms::brown4, kalibr},
                              {"mrcal", ".cameramodel", LensTerms::all, mrcal},
                              {"visp", ".visp.xml", LensTerms::radial1, visp},
                              {"tagdock", ".tagdock.yaml", LensTerms::all, tagdock_rig}};

const Format& format_of(const std::string& word) {
  std::string known;
  for (const Format& format : formats) {
    if (word == format.word) return format;
    known += std::string(" ") + format.word;
  }
  throw Failure(ExitCode::usage, "--format " + word + " is unknown; known are" + known);
}

}  // namespace

CameraText camera_text(const CameraModel& camera, const std::string& format) {
  const Format& chosen = format_of(format);
  CameraText result;
  result.held = poorer_lens(camera, chosen.terms);
  result.text = chosen.write(result.held);
  result.loss = loss_between(camera, result.held);
  return result;
}

std::string camera_extension(const std::string& format) { return format_of(format).extension; }

}  // namespace tagdock
