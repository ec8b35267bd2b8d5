#include "app/nearest_word.h"

#include <algorithm>
#include <cstddef>

namespace tagdock {
namespace {

// Number of single-letter changes between two words.
std::size_t distance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = row[0];
    row[0] = i;
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t change = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, change});
    }
  }
  return row[b.size()];
}

}  // namespace

std::string nearest_word(std::string_view word, const std::vector<std::string>& known) {
  std::size_t least = 4;  // farther words are no help
  std::string nearest;
  for (const std::string& one : known)
    if (const std::size_t changes = distance(word, one); changes < least) {
      least = changes;
      nearest = one;
    }
  return nearest;
}

}  // namespace tagdock
