#pragma once

#include <atomic>
#include <cstddef>
#include <vector>

namespace dfr::recording::internal {

/// A queue of fixed size from one thread to another, in which elements are filled and read where
/// they lie. Neither side ever waits for the other.
template <typename T>
class SpscRing {
 public:
  /// Copies of `element`, whose own memory is thereby set aside.
  SpscRing(std::size_t size, const T& element) : elements_(size + 1, element) {}

  /// The element to fill before Push(); null while all are waiting. Producer only.
  [[nodiscard]] T* Free() noexcept {
    const std::size_t head = head_.load(std::memory_order_relaxed);
    return After(head) == tail_.load(std::memory_order_acquire) ? nullptr : &elements_[head];
  }
  void Push() noexcept {
    head_.store(After(head_.load(std::memory_order_relaxed)), std::memory_order_release);
  }

  /// The oldest element, to be read before Pop(); null where there is none. Consumer only.
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
