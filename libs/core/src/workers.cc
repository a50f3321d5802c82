#include "dfr/core/workers.h"

#include <algorithm>
#include <exception>
#include <system_error>
#include <utility>

#include "dfr/core/contract.h"

namespace dfr::core {

Workers::Workers(int threads)
    : wanted_(threads > 0 ? static_cast<std::size_t>(threads)
                          : std::max<std::size_t>(1, std::thread::hardware_concurrency())) {
  DFR_THROW_UNLESS(threads >= 0, "threads must not be negative: " << threads);
}

Workers::~Workers() {
  {
    const std::scoped_lock lock(mutex_);
    ending_ = true;
  }
  begin_.notify_all();
  for (std::thread& helper : helpers_) helper.join();
}

void Workers::Run(std::size_t count, const std::function<void(std::size_t)>& job) {
  if (wanted_ == 1 || count <= 1) {
    for (std::size_t i = 0; i < count; ++i) job(i);
    return;
  }
  try {
    while (helpers_.size() + 1 < std::min(wanted_, count)) {
      helpers_.emplace_back([this] { Help(); });
    }
  } catch (const std::system_error&) {
    // The system provides no more threads: the existing threads do all jobs.
  }
  std::unique_lock lock(mutex_);
  job_ = &job;
  next_ = 0;
  count_ = count;
  begin_.notify_all();
  Work(lock);
  end_.wait(lock, [this] { return running_ == 0; });
  job_ = nullptr;
  if (failure_) std::rethrow_exception(std::exchange(failure_, nullptr));
}

void Workers::Help() {
  std::unique_lock lock(mutex_);
  while (true) {
    begin_.wait(lock, [this] { return ending_ || next_ < count_; });
    if (ending_) return;
    Work(lock);
  }
}

void Workers::Work(std::unique_lock<std::mutex>& lock) {
  ++running_;
  while (next_ < count_) {
    const std::size_t i = next_++;
    const auto& job = *job_;
    lock.unlock();
    std::exception_ptr failure;
    try {
      job(i);
    } catch (...) {
      failure = std::current_exception();
    }
    lock.lock();
    if (failure) {
      if (!failure_) failure_ = failure;
      next_ = count_;
    }
  }
  if (--running_ == 0) end_.notify_all();
}

}  // namespace dfr::core
