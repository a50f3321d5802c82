#pragma once

#include <ctime>

namespace dfr::bench {

/// Returns the CPU time of this process, s.
[[nodiscard]] inline double CpuSeconds() {
  timespec now{};
  clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}

}  // namespace dfr::bench
