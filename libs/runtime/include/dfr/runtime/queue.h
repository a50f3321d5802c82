#pragma once

#include <array>
#include <atomic>
#include <cstddef>

namespace dfr::runtime {

/// Passes all values in order from one thread to another. Neither side waits or allocates.
template <typename T, std::size_t kCapacity>
class Queue {
 public:
  /// Returns false if the queue is full.
  bool Put(const T& value) noexcept {
    const std::size_t end = end_.load(std::memory_order_relaxed);
    if (end - begin_.load(std::memory_order_acquire) == kCapacity) return false;
    slots_[end % kCapacity] = value;
    end_.store(end + 1, std::memory_order_release);
    return true;
  }
  /// Returns false, with `value` unchanged, if the queue is empty.
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

}  // namespace dfr::runtime
