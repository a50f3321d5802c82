#pragma once

#include <array>
#include <atomic>
#include <cstdint>
#include <type_traits>

namespace dfr::runtime {

/// Passes the newest value from one thread to another without blocking either (a triple buffer):
/// Put() never blocks the writer, and Take() returns complete values only. If several values are
/// put between two calls of Take(), only the newest is kept.
///
/// One thread calls Put() and another calls Take(). Neither call locks. Neither allocates unless
/// copying a T does.
template <typename T>
class Latest {
  static_assert(std::is_copy_assignable_v<T>);

 public:
  void Put(const T& value) noexcept {
    slots_[back_] = value;
    back_ = shared_.exchange(back_ | kFresh, std::memory_order_acq_rel) & kIndex;
  }

  /// Returns false, with `value` unchanged, if no value was put since the last call.
  bool Take(T& value) noexcept {
    if ((shared_.load(std::memory_order_relaxed) & kFresh) == 0) return false;
    front_ = shared_.exchange(front_, std::memory_order_acq_rel) & kIndex;
    value = slots_[front_];
    return true;
  }

 private:
  static constexpr std::uint8_t kIndex = 3;
  static constexpr std::uint8_t kFresh = 4;

  std::array<T, 3> slots_{};
  std::uint8_t back_ = 0;                 // slot that the writer fills next
  std::atomic<std::uint8_t> shared_ = 1;  // index of the middle slot, and whether it is fresh
  std::uint8_t front_ = 2;                // slot that the reader read last
};

}  // namespace dfr::runtime
