#pragma once

#include <condition_variable>
#include <cstddef>
#include <exception>
#include <functional>
#include <mutex>
#include <thread>
#include <vector>

namespace dfr::core {

/// Threads that share the work of one fit, started on demand. The result of a job must not depend
/// on the thread that runs it.
class Workers {
 public:
  /// @param threads  number of threads, including the one that calls Run(); 0: one per core.
  /// @throws std::invalid_argument if it is negative.
  explicit Workers(int threads);
  ~Workers();
  Workers(const Workers&) = delete;
  Workers& operator=(const Workers&) = delete;

  /// Number of threads.
  [[nodiscard]] std::size_t size() const noexcept { return wanted_; }

  /// Calls job(0), ..., job(count - 1) once each, in any order on any thread. Returns when all are
  /// done. Rethrows the first exception and skips jobs that have not started. Not reentrant.
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

}  // namespace dfr::core
