#pragma once

#include <iostream>
#include <string>
#include <vector>

namespace tagdock {

/// What `tagdock detect` is asked; the same work serves the replay of plain images.
struct DetectOptions {
  std::vector<std::string> images;
  std::string list;
  std::string root;
  std::string camera;
  std::string family = "tag36h11";
  double tag_size = 0.0;
  std::string sizes;
  std::string method = "best";
  int decimate = 1;
  int max_hamming = 1;
  std::string output;
  std::string annotate;
  std::string explain;      ///< an image; its tags get a page each
  std::string pages = ".";  ///< folder for these
  bool json = false;
};

/// Writes one HTML page for each tag of one image, on how it was fitted. Throws as detect_images.
int explain_image(const DetectOptions& options);

/// Looks for tags in images, one after the other, and writes them as CSV or JSON and as pictures.
/// Throws Failure(usage) for options, lists and camera files that make no sense.
/// @param out  where CSV or JSON go without options.output
/// @return  the exit code: 2 if an image could not be read, after all the others
int detect_images(const DetectOptions& options, std::ostream& out = std::cout);

}  // namespace tagdock
