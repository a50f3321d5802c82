#pragma once

#include <atomic>

namespace dfr::hardware::internal {

// A message that stops the arm. It stays wanted until a write succeeds. Want() may be called by any
// thread.
class UntilSent {
 public:
  void Want() noexcept { wanted_.store(true, std::memory_order_release); }
  [[nodiscard]] bool wanted() const noexcept { return wanted_.load(std::memory_order_acquire); }
  // Calls `write` if the message is wanted. Returns false if it failed.
  template <typename Write>
  bool Send(const Write& write) noexcept {
    if (!wanted_.exchange(false, std::memory_order_acq_rel) || write()) return true;
    Want();
    return false;
  }

 private:
  std::atomic<bool> wanted_{false};
};

}  // namespace dfr::hardware::internal
