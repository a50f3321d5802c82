#pragma once

#include <cstdint>
#include <memory>
#include <string>

namespace dfr::runtime {

/// Nanoseconds on a clock that never goes back (CLOCK_MONOTONIC).
[[nodiscard]] std::int64_t SteadyNow() noexcept;
/// Nanoseconds since the Unix epoch, by the system's clock.
[[nodiscard]] std::int64_t WallNow() noexcept;

/// A steady clock, by which a PeriodicTimer waits.
class SteadyClock {
 public:
  virtual ~SteadyClock() = default;

  /// ns. Never goes back.
  [[nodiscard]] virtual std::int64_t Now() noexcept = 0;
  /// Returns at `due_ns` or later, and at once where that is over.
  virtual void WaitUntil(std::int64_t due_ns) noexcept = 0;
};

/// SteadyNow() as a SteadyClock, for any number of threads.
[[nodiscard]] SteadyClock& MachineClock() noexcept;

/// Wakes a loop at equal times and keeps book of how late each period was. One object belongs to
/// one thread. Only the constructor allocates or throws.
class PeriodicTimer {
 public:
  /// The first period ends `period_s` from now. `clock` must outlive this.
  /// @throws std::invalid_argument unless `period_s` lies in [0.0001, 10].
  explicit PeriodicTimer(double period_s, SteadyClock& clock = MachineClock());
  ~PeriodicTimer();
  PeriodicTimer(const PeriodicTimer&) = delete;
  PeriodicTimer& operator=(const PeriodicTimer&) = delete;

  /// Sleeps until the present period ends. Periods that are over already are left out, so that a
  /// loop that was held up does not hurry afterwards.
  void Wait() noexcept;

  /// Periods so far.
  [[nodiscard]] std::int64_t periods() const noexcept { return periods_; }
  /// Periods that were left out.
  [[nodiscard]] std::int64_t missed() const noexcept { return missed_; }
  /// The quantile of | time between two wake-ups - period |, s; to 1 us, and at most 0.02 s.
  /// @pre 0 <= quantile <= 1
  [[nodiscard]] double Jitter(double quantile) const noexcept;
  /// The largest of all, s.
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

/// Asks the system to favour the calling thread: SCHED_FIFO at `priority` in [1, 99], and the
/// process's memory locked against paging. Empty if both were granted; else in words what was not,
/// and which right is missing. The program works all the same.
/// Threads that it makes from then on are favoured, too.
[[nodiscard]] std::string AskForRealTime(int priority);
/// The calling thread is scheduled as usual again: for work that may wait, in a favoured process.
void GiveUpRealTime() noexcept;

}  // namespace dfr::runtime
