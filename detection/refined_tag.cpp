#include "detection/refined_tag.h"

namespace tagdock {

std::string_view word(Unrefined reason) {
  switch (reason) {
    case Unrefined::too_few_pixels:
      return "too_few_pixels";
    case Unrefined::left_the_edge:
      return "left_the_edge";
    case Unrefined::did_not_converge:
      return "did_not_converge";
    case Unrefined::not_a_quadrilateral:
      return "not_a_quadrilateral";
    case Unrefined::other_pattern:
      return "other_pattern";
  }
  return "unknown";
}

}  // namespace tagdock
