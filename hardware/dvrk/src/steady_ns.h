#pragma once

#include <chrono>
#include <cstdint>

namespace dfr::hardware::internal {

/// Returns the time of this machine's monotonic clock.
[[nodiscard]] inline std::int64_t SteadyNs() noexcept {
  return std::chrono::duration_cast<std::chrono::nanoseconds>(
             std::chrono::steady_clock::now().time_since_epoch())
      .count();
}

}  // namespace dfr::hardware::internal
