#pragma once

#include <stdexcept>
#include <string>

#include "dfr/core/text/usage_error.h"

namespace dfr::apps {

using core::UsageError;

/// Returns `read()`, which reads the value of `option`.
/// @throws UsageError naming the option if read() throws std::invalid_argument.
template <typename Read>
auto ValueOf(const std::string& option, Read read) {
  try {
    return read();
  } catch (const std::invalid_argument& e) {
    throw UsageError(option + ": " + e.what());
  }
}

}  // namespace dfr::apps
