#pragma once

#include <atomic>
#include <cstddef>
#include <vector>

namespace dfr::recording::internal {

/// Fixed-size queue from one thread to another. Elements are written and read in place. Neither
/// side waits for the other.
template <typename T>
class SpscRing {
 public:
  /// Fills the queue with copies of `element`, to preallocate their memory.
  SpscRing(std::size_t size, const T& element) : elements_(size + 1, element) {}

  /// Returns the element to fill before Push(); nullptr if the queue is full. Producer only.
  [[nodiscard]] T* Free() noexcept {
    const std::size_t head = head_.load(std::memory_order_relaxed);
    return After(head) == tail_.load(std::memory_order_acquire) ? nullptr : &elements_[head];
  }
  void Push() noexcept {
    head_.store(After(head_.load(std::memory_order_relaxed)), std::memory_order_release);
  }

  /// Returns the oldest element, to read before Pop(); nullptr if the queue is empty. Consumer
  /// only.
  [[nodiscard]] const T* Front() const noexcept {
    const std::size_t tail = tail_.load(std::memory_order_relaxed);
    return tail == head_.load(std::memory_order_acquire) ? nullptr : &elements_[tail];
  }
  void Pop() noexcept {
    tail_.store(After(tail_.load(std::memory_order_relaxed)), std::memory_order_release);
  }

 private:
  [[nodiscard]] std::size_t After(std::size_t i) const noexcept {
    return i + 1 == elements_.size() ? 0 : i + 1;
  }

  std::vector<T> elements_;
  std::atomic<std::size_t> head_{0};
  std::atomic<std::size_t> tail_{0};
};

}  // namespace dfr::recording::internal
