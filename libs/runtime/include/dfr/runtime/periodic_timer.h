#pragma once

#include <cstdint>
#include <memory>
#include <string>

namespace dfr::runtime {

/// Returns the time of a monotonic clock, ns (CLOCK_MONOTONIC).
[[nodiscard]] std::int64_t SteadyNow() noexcept;
/// Returns the system time, ns since the Unix epoch.
[[nodiscard]] std::int64_t WallNow() noexcept;

/// Steady clock used by PeriodicTimer.
class SteadyClock {
 public:
  virtual ~SteadyClock() = default;

  /// Returns the monotonic time, ns.
  [[nodiscard]] virtual std::int64_t Now() noexcept = 0;
  /// Returns at `due_ns` or later; immediately if it has passed.
  virtual void WaitUntil(std::int64_t due_ns) noexcept = 0;
};

/// Returns a SteadyClock that uses SteadyNow(). Thread-safe.
[[nodiscard]] SteadyClock& MachineClock() noexcept;

/// Wakes a loop at equal intervals and records the jitter of each period. One object belongs to one
/// thread. Only the constructor allocates or throws.
class PeriodicTimer {
 public:
  /// The first period ends `period_s` from now. `clock` must outlive this object.
  /// @throws std::invalid_argument unless `period_s` lies in [0.0001, 10].
  explicit PeriodicTimer(double period_s, SteadyClock& clock = MachineClock());
  ~PeriodicTimer();
  PeriodicTimer(const PeriodicTimer&) = delete;
  PeriodicTimer& operator=(const PeriodicTimer&) = delete;

  /// Sleeps until the current period ends. Skips periods that have already passed: a delayed loop
  /// does not run faster afterwards.
  void Wait() noexcept;

  /// Returns the number of calls of Wait().
  [[nodiscard]] std::int64_t periods() const noexcept { return periods_; }
  /// Returns the number of skipped periods.
  [[nodiscard]] std::int64_t missed() const noexcept { return missed_; }
  /// Returns the given quantile of | time between two wake-ups - period |, s, with a resolution of
  /// 1 us and a maximum of 0.02 s. @pre 0 <= quantile <= 1
  [[nodiscard]] double Jitter(double quantile) const noexcept;
  /// Returns the maximum jitter, s.
  [[nodiscard]] double worst() const noexcept { return worst_s_; }

 private:
  SteadyClock* clock_;
  std::int64_t period_ns_;
  std::int64_t due_ns_;
  std::int64_t last_ns_;
  std::int64_t periods_ = 0;
  std::int64_t missed_ = 0;
  double worst_s_ = 0.0;
  std::unique_ptr<std::int64_t[]> histogram_;
};

/// Requests real-time scheduling for the calling thread (SCHED_FIFO at `priority` in [1, 99]) and
/// locks the memory of the process against paging. Threads created afterwards inherit the
/// scheduling. Returns an empty string if both were granted, otherwise a description of the refusal
/// and of the missing permission. The program works without either.
[[nodiscard]] std::string AskForRealTime(int priority);
/// Returns the calling thread to normal scheduling, for non-urgent work in a real-time process.
void GiveUpRealTime() noexcept;

}  // namespace dfr::runtime
