#pragma once

#include <cstdint>

namespace dfr::core {

/// What reading a file may cost: a reader asks before it allocates or computes what the file asks
/// for, so that a small file cannot ask for much. The cost is bounded by the size of the file:
/// kAllowance + kPerByte bytes for each of its bytes.
class ReadBudget {
 public:
  static constexpr std::uint64_t kAllowance = std::uint64_t{64} << 20;
  static constexpr std::uint64_t kPerByte = 128;

  explicit constexpr ReadBudget(std::uint64_t file_bytes) noexcept
      : left_(file_bytes > (UINT64_MAX - kAllowance) / kPerByte
                  ? UINT64_MAX
                  : kAllowance + kPerByte * file_bytes) {}

  /// Takes `count` times `bytes_each`. False where that is more than is left; nothing is taken
  /// then, and the file is to be refused.
  [[nodiscard]] constexpr bool Take(std::uint64_t count, std::uint64_t bytes_each) noexcept {
    if (bytes_each > 0 && count > left_ / bytes_each) return false;
    left_ -= count * bytes_each;
    return true;
  }

  [[nodiscard]] constexpr std::uint64_t left() const noexcept { return left_; }

 private:
  std::uint64_t left_;
};

}  // namespace dfr::core
