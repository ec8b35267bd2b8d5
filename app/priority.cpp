#include "app/priority.h"

#include <sys/resource.h>

namespace tagdock {

bool prefer_this_thread() {
  constexpr int before_others = -10;
  // On Linux the priority of "process 0" is that of the calling thread.
  return ::setpriority(PRIO_PROCESS, 0, before_others) == 0;
}

}  // namespace tagdock
