#pragma once

#include <cstdint>
#include <functional>
#include <sstream>
#include <string>

#include "check/check.h"

namespace dfr::test {

/// Advances only during waits, and runs an action in each.
class HandMovedClock final : public apps::hardware_app::Clock {
 public:
  std::int64_t SteadyNs() override { return now_ns; }
  std::int64_t WallNs() override { return 1'700'000'000'000'000'000 + now_ns; }
  void Wait(double seconds) override {
    if (waits) waits();
    if (!stands) now_ns += static_cast<std::int64_t>(1e9 * seconds);
  }

  std::int64_t now_ns = 1'000'000'000;
  bool stands = false;          ///< True if no time passes.
  std::function<void()> waits;  ///< Called with each Wait().
};

inline std::string Shown(const apps::hardware_app::DeviceReport& report) {
  std::ostringstream out;
  Print(report, out);
  return out.str();
}

}  // namespace dfr::test
