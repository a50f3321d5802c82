#pragma once

#include <cstdint>

namespace dfr::core {

/// Limit on the cost of reading a file. A reader takes from the budget before each allocation or
/// computation whose size comes from the file: a small file cannot cause a large cost. The limit is
/// kAllowance bytes plus kPerByte bytes for each byte of the file.
class ReadBudget {
 public:
  static constexpr std::uint64_t kAllowance = std::uint64_t{64} << 20;
  static constexpr std::uint64_t kPerByte = 128;

  explicit constexpr ReadBudget(std::uint64_t file_bytes) noexcept
      : left_(file_bytes > (UINT64_MAX - kAllowance) / kPerByte
                  ? UINT64_MAX
                  : kAllowance + kPerByte * file_bytes) {}

  /// Takes `count` times `bytes_each`. Returns false and takes nothing if this product exceeds
  /// left(); the caller must then reject the file.
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
