#pragma once

#include <math.h>  // lgamma_r

namespace dfr::core {

/// Returns log Gamma(x) for x > 0. Concurrent calls are safe, whereas glibc's std::lgamma() writes
/// to a global variable.
[[nodiscard]] inline double LogGamma(double x) noexcept {
  int sign = 0;
  return ::lgamma_r(x, &sign);
}

}  // namespace dfr::core
