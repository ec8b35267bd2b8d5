#pragma once

namespace tagdock {

/// Puts the calling thread before others of this machine, and with it the threads and processes that it starts from now
/// on: a robot that moves must not wait for a compiler. Does nothing where that is not allowed (neither root nor
/// CAP_SYS_NICE, `ulimit -e` 0).
/// @return whether it was allowed
bool prefer_this_thread();

}  // namespace tagdock
