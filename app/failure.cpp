#include "app/failure.h"

namespace tagdock {

Failure::Failure(ExitCode code, const std::string& sentence) : std::runtime_error(sentence), code_(code) {}

}  // namespace tagdock
