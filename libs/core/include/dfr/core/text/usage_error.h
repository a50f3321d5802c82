#pragma once

#include <stdexcept>

namespace dfr::core {

/// Error of an argument's value that is found after the arguments are parsed. Programs exit with 2,
/// as after every usage error.
class UsageError : public std::invalid_argument {
 public:
  using std::invalid_argument::invalid_argument;
};

}  // namespace dfr::core
