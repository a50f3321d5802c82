#pragma once

#include <string>

namespace dfr::core {

/// Returns the output of printf() as a string of any length. The compiler checks the arguments.
/// Allocates: not for the control loop.
[[nodiscard, gnu::format(printf, 1, 2)]] std::string Format(const char* format, ...);

}  // namespace dfr::core
