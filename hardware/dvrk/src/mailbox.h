#pragma once

#include <array>
#include <atomic>
#include <cstddef>
#include <type_traits>

namespace dfr::hardware::internal {

/// The newest value from one thread to one other (three slots, of which each thread has one).
/// Neither side ever waits or allocates.
template <typename T>
class Newest {
  static_assert(std::is_copy_assignable_v<T>);

 public:
  void Put(const T& value) noexcept {
    slots_[writing_] = value;
    writing_ = shared_.exchange(writing_ | kFresh, std::memory_order_acq_rel) & kIndex;
  }
  /// False, with `value` unchanged, if nothing was put since the last call.
  bool Take(T& value) noexcept {
    if ((shared_.load(std::memory_order_relaxed) & kFresh) == 0) return false;
    reading_ = shared_.exchange(reading_, std::memory_order_acq_rel) & kIndex;
    value = slots_[reading_];
    return true;
  }

 private:
  static constexpr unsigned kIndex = 3;
  static constexpr unsigned kFresh = 4;
  std::array<T, 3> slots_{};
  unsigned writing_ = 0;
  unsigned reading_ = 2;
  std::atomic<unsigned> shared_{1};
};

/// All values, in order, from one thread to one other. Neither side ever waits or allocates.
template <typename T, std::size_t kCapacity>
class Queue {
 public:
  /// False if it is full.
  bool Put(const T& value) noexcept {
    const std::size_t end = end_.load(std::memory_order_relaxed);
    if (end - begin_.load(std::memory_order_acquire) == kCapacity) return false;
    slots_[end % kCapacity] = value;
    end_.store(end + 1, std::memory_order_release);
    return true;
  }
  /// False, with `value` unchanged, if it is empty.
  bool Take(T& value) noexcept {
    const std::size_t begin = begin_.load(std::memory_order_relaxed);
    if (begin == end_.load(std::memory_order_acquire)) return false;
    value = slots_[begin % kCapacity];
    begin_.store(begin + 1, std::memory_order_release);
    return true;
  }

 private:
  std::array<T, kCapacity> slots_{};
  std::atomic<std::size_t> begin_{0};
  std::atomic<std::size_t> end_{0};
};

}  // namespace dfr::hardware::internal
