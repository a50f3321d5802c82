#pragma once

#include <stdexcept>
#include <string>

namespace dfr::apps {

/// Error of an option's value that is found after the arguments are parsed. RunProgram() exits as
/// after every usage error.
class UsageError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

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
