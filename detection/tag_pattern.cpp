#include "detection/tag_pattern.h"

#include <memory>
#include <stdexcept>

#include <apriltag/apriltag.h>
#include <apriltag/tag16h5.h>
#include <apriltag/tag25h9.h>
#include <apriltag/tag36h11.h>
#include <apriltag/tagCircle21h7.h>
#include <apriltag/tagCircle49h12.h>
#include <apriltag/tagStandard41h12.h>
#include <apriltag/tagStandard52h13.h>

namespace tagdock {
namespace {

using Family = std::unique_ptr<apriltag_family_t, void (*)(apriltag_family_t*)>;

/// The library's table of a family: built once and kept, for it is only read.
const apriltag_family_t* family_table(const std::string& name) {
  // The library fills a table in microseconds to a millisecond; one static each, so that only what is used is built.
  if (name == "tag36h11") {
    static const Family family(tag36h11_create(), tag36h11_destroy);
    return family.get();
  }
  if (name == "tag25h9") {
    static const Family family(tag25h9_create(), tag25h9_destroy);
    return family.get();
  }
  if (name == "tag16h5") {
    static const Family family(tag16h5_create(), tag16h5_destroy);
    return family.get();
  }
  if (name == "tagStandard41h12") {
    static const Family family(tagStandard41h12_create(), tagStandard41h12_destroy);
    return family.get();
  }
  if (name == "tagStandard52h13") {
    static const Family family(tagStandard52h13_create(), tagStandard52h13_destroy);
    return family.get();
  }
  if (name == "tagCircle21h7") {
    static const Family family(tagCircle21h7_create(), tagCircle21h7_destroy);
    return family.get();
  }
  if (name == "tagCircle49h12") {
    static const Family family(tagCircle49h12_create(), tagCircle49h12_destroy);
    return family.get();
  }
  return nullptr;
}

}  // namespace

TagPattern tag_pattern(const std::string& family, int id) {
  const apriltag_family_t* const table = family_table(family);
  if (table == nullptr) throw std::invalid_argument("tag family '" + family + "' is not known");
  if (id < 0 || id >= static_cast<int>(table->ncodes))
    throw std::invalid_argument("tag family " + family + " has ids 0 to " + std::to_string(table->ncodes - 1) +
                                ", not " + std::to_string(id));
  TagPattern pattern;
  pattern.cells = table->total_width;
  pattern.border_cells = table->width_at_border;
  pattern.cell.assign(static_cast<std::size_t>(pattern.cells * pattern.cells), TagPattern::unknown);
  const auto set = [&](int column, int row, TagPattern::Cell value) {
    pattern.cell[static_cast<std::size_t>(row * pattern.cells + column)] = value;
  };
  // The square whose outline is found has one ring of cells just inside and one just outside of it, unlike each other.
  const int first = (pattern.cells - pattern.border_cells) / 2;
  const int last = first + pattern.border_cells - 1;
  const auto ring = [&](int from, int to, TagPattern::Cell value) {
    for (int k = from; k <= to; ++k) {
      set(k, from, value);
      set(k, to, value);
      set(from, k, value);
      set(to, k, value);
    }
  };
  ring(first - 1, last + 1, table->reversed_border ? TagPattern::black : TagPattern::white);
  ring(first, last, table->reversed_border ? TagPattern::white : TagPattern::black);
  const std::uint64_t code = table->codes[id];
  for (std::uint32_t bit = 0; bit < table->nbits; ++bit) {
    const bool is_white = (code >> (table->nbits - bit - 1)) & 1U;
    // Places outside of the outline are negative, though the library's type has no sign.
    set(static_cast<int>(table->bit_x[bit]) + first, static_cast<int>(table->bit_y[bit]) + first,
        is_white ? TagPattern::white : TagPattern::black);
  }
  return pattern;
}

}  // namespace tagdock
