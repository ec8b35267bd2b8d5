// A ViSP program that finds tags and their poses in an image. It is written against ViSP's interface alone; the one
// change is the name of the detector's class, tagdock::VispTagDetector in the place of vpDetectorAprilTag.
//   visp_tag_pose IMAGE TAG_SIZE PX PY U0 V0
#include <cstdlib>
#include <iostream>
#include <vector>

#include <visp3/core/vpCameraParameters.h>
#include <visp3/core/vpException.h>
#include <visp3/core/vpImage.h>
#include <visp3/core/vpPoseVector.h>
#include <visp3/io/vpImageIo.h>

#include "detection/visp_tag_detector.h"

int main(int argc, char** argv) {
  if (argc != 7) {
    std::cerr << "usage: visp_tag_pose IMAGE TAG_SIZE PX PY U0 V0\n";
    return 2;
  }
  try {
    vpImage<unsigned char> image;
    vpImageIo::read(image, argv[1]);
    const vpCameraParameters camera(std::atof(argv[3]), std::atof(argv[4]), std::atof(argv[5]), std::atof(argv[6]));

    tagdock::VispTagDetector detector(vpDetectorAprilTag::TAG_36h11);
    detector.setAprilTagQuadDecimate(1.0F);
    std::vector<vpHomogeneousMatrix> poses;
    detector.detect(image, std::atof(argv[2]), camera, poses);
    for (std::size_t i = 0; i < detector.getNbObjects(); ++i) {
      std::cout << detector.getMessage(i) << "\n";
      for (const vpImagePoint& corner : detector.getPolygon(i))
        std::cout << "  corner u " << corner.get_u() << " v " << corner.get_v() << "\n";
      std::cout << "  pose " << vpPoseVector(poses[i]).t() << "\n";
    }
    return detector.getNbObjects() > 0 ? 0 : 1;
  } catch (const vpException& error) {
    std::cerr << error.what() << "\n";
    return 2;
  }
}
