#pragma once

#include <cstdint>
#include <string>

namespace dfr::hardware {

/// Lets through a few texts of others a second, and counts the rest. Time is what the caller says
/// it is. Never allocates.
class WordLimit {
 public:
  /// @param per_second  > 0.
  explicit WordLimit(int per_second = 5) noexcept : per_second_(per_second) {}

  /// Whether one more may be shown now.
  bool Passes(std::int64_t steady_ns) noexcept;
  /// How many were left out since the last call that said so; 0 until a second has passed since
  /// then, and where there were none.
  std::uint64_t TakeLeftOut(std::int64_t steady_ns) noexcept;

 private:
  int per_second_;
  bool any_ = false;
  int shown_ = 0;
  std::int64_t since_ns_ = 0;
  std::int64_t told_ns_ = 0;
  std::uint64_t left_out_ = 0;
};

/// Text of others as it may be shown at a terminal: control characters are question marks.
void MakePrintable(char* text) noexcept;
[[nodiscard]] std::string Printable(std::string text);

}  // namespace dfr::hardware
