#pragma once

#include <cstdint>

#include "dfr/runtime/periodic_timer.h"

namespace dfr::test {

/// Time advances during a wait, and on the test's request.
class SteadyHandClock final : public runtime::SteadyClock {
 public:
  [[nodiscard]] std::int64_t Now() noexcept override { return now_ns; }
  void WaitUntil(std::int64_t due_ns) noexcept override {
    if (now_ns < due_ns) now_ns = due_ns + late_ns;
  }

  std::int64_t now_ns = 1'000'000'000'000;
  std::int64_t late_ns = 0;  ///< Delay of a sleeper's wake-up.
};

}  // namespace dfr::test
