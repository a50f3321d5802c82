#pragma once

#include <cstddef>
#include <stdexcept>
#include <string>
#include <string_view>

namespace dfr::core {

/// An error with its remedy. what() is "problem; remedy", or the problem alone if no remedy is
/// known.
class Error : public std::runtime_error {
 public:
  explicit Error(const std::string& problem, std::string_view remedy = {})
      : std::runtime_error(remedy.empty() ? problem : problem + "; " + std::string(remedy)),
        problem_size_(problem.size()) {}

  /// The problem, with the name of the file or device. Valid as long as this object exists.
  [[nodiscard]] std::string_view problem() const noexcept {
    return std::string_view(what()).substr(0, problem_size_);
  }
  /// The action that the user can take; empty if unknown.
  [[nodiscard]] std::string_view remedy() const noexcept {
    const std::string_view all = what();
    return all.size() == problem_size_ ? std::string_view() : all.substr(problem_size_ + 2);
  }

 private:
  std::size_t problem_size_;  // stored instead of two strings, whose copies could throw
};

}  // namespace dfr::core
