#pragma once

#include <string>

namespace dfr::core {

/// What printf() prints, as a string of any length. The compiler checks the arguments. Not for the
/// control loop: it allocates.
[[nodiscard, gnu::format(printf, 1, 2)]] std::string Format(const char* format, ...);

}  // namespace dfr::core
