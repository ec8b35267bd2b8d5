#pragma once

#include <string>
#include <string_view>
#include <vector>

namespace tagdock {

/// The word that was probably meant by one that is not known: the nearest by changes of single letters.
/// @return  empty if none is nearer than four changes
std::string nearest_word(std::string_view word, const std::vector<std::string>& known);

}  // namespace tagdock
