#pragma once

#include <condition_variable>
#include <cstddef>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace dfr::kernel::internal {

/// Threads that share the work of one fit, begun when there is some to share. What they compute
/// must not depend on who computes it.
class Workers {
 public:
  /// @param threads how many work at a time, with the one that calls Run(); 0: one per core.
  /// @throws std::invalid_argument if it is negative.
  explicit Workers(int threads);
  ~Workers();
  Workers(const Workers&) = delete;
  Workers& operator=(const Workers&) = delete;

  /// How many work at a time.
  [[nodiscard]] std::size_t size() const noexcept { return wanted_; }

  /// job(0), ..., job(count - 1), each once, in no order and on any thread; returns when all are
  /// done. The first exception is thrown again here; what had not begun by then is left out.
  void Run(std::size_t count, const std::function<void(std::size_t)>& job);

 private:
  void Help();
  void Work(std::unique_lock<std::mutex>& lock);

  std::size_t wanted_;
  std::mutex mutex_;
  std::condition_variable begin_;
  std::condition_variable end_;
  const std::function<void(std::size_t)>* job_ = nullptr;
  std::size_t next_ = 0;
  std::size_t count_ = 0;
  std::size_t running_ = 0;
  bool ending_ = false;
  std::exception_ptr failure_;
  std::vector<std::thread> helpers_;
};

}  // namespace dfr::kernel::internal
