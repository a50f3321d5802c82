#pragma once

#include <cstdint>

namespace dfr::hardware {

/// Passes a few external messages per second and counts the rest. The caller provides the time.
/// Never allocates.
class WordLimit {
 public:
  /// @param per_second  > 0.
  explicit WordLimit(int per_second = 5) noexcept : per_second_(per_second) {}

  /// Returns true if another message may be shown now.
  bool Passes(std::int64_t steady_ns) noexcept;
  /// Returns the number of messages suppressed since the last nonzero result, once the first of
  /// these messages is a second old; 0 before.
  std::uint64_t TakeLeftOut(std::int64_t steady_ns) noexcept;

 private:
  int per_second_;
  bool any_ = false;
  int shown_ = 0;
  std::int64_t since_ns_ = 0;
  std::int64_t told_ns_ = 0;
  std::uint64_t left_out_ = 0;
};

}  // namespace dfr::hardware
