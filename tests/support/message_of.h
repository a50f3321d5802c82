#pragma once

#include <exception>
#include <string>
#include <utility>

namespace dfr::test {

/// Returns the message of the exception of type E that `call` throws, or "nothing thrown" if `call`
/// returns. Does not catch other exceptions.
template <typename E = std::exception, typename Call>
std::string MessageOf(Call&& call) {
  try {
    std::forward<Call>(call)();
  } catch (const E& e) {
    return e.what();
  }
  return "nothing thrown";
}

}  // namespace dfr::test
