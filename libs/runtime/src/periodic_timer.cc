#include "dfr/runtime/periodic_timer.h"

#include <pthread.h>
#include <sched.h>
#include <sys/mman.h>
#include <time.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>

#include "dfr/core/contract.h"

namespace dfr::runtime {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr std::int64_t kBucket = 1'000;  // ns
constexpr std::int64_t kBuckets = 20'000;

std::int64_t Now(clockid_t clock) noexcept {
  timespec now{};
  clock_gettime(clock, &now);
  return static_cast<std::int64_t>(now.tv_sec) * kSecond + now.tv_nsec;
}

class Machine final : public SteadyClock {
 public:
  std::int64_t Now() noexcept override { return SteadyNow(); }
  void WaitUntil(std::int64_t due_ns) noexcept override {
    const timespec due{static_cast<time_t>(due_ns / kSecond),
                       static_cast<decltype(timespec::tv_nsec)>(due_ns % kSecond)};
    while (clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, &due, nullptr) == EINTR) {
    }
  }
};

}  // namespace

std::int64_t SteadyNow() noexcept { return Now(CLOCK_MONOTONIC); }
std::int64_t WallNow() noexcept { return Now(CLOCK_REALTIME); }

SteadyClock& MachineClock() noexcept {
  static Machine machine;
  return machine;
}

PeriodicTimer::PeriodicTimer(double period_s, SteadyClock& clock)
    : clock_(&clock),
      period_ns_(std::llround(1e9 * period_s)),
      histogram_(std::make_unique<std::int64_t[]>(kBuckets + 1)) {
  DFR_THROW_UNLESS(period_s >= 1e-4 && period_s <= 10.0,
                   "a period must lie in [0.0001, 10] s, not " << period_s);
  last_ns_ = clock_->Now();
  due_ns_ = last_ns_ + period_ns_;
}

PeriodicTimer::~PeriodicTimer() = default;

void PeriodicTimer::Wait() noexcept {
  clock_->WaitUntil(due_ns_);
  const std::int64_t now = clock_->Now();
  const std::int64_t off = std::abs(now - last_ns_ - period_ns_);
  last_ns_ = now;
  ++periods_;
  ++histogram_[static_cast<std::size_t>(std::min(off / kBucket, kBuckets))];
  worst_s_ = std::max(worst_s_, 1e-9 * static_cast<double>(off));
  const std::int64_t late = (now - due_ns_) / period_ns_;
  missed_ += late;
  due_ns_ += (late + 1) * period_ns_;
}

double PeriodicTimer::Jitter(double quantile) const noexcept {
  const auto wanted =
      static_cast<std::int64_t>(std::ceil(quantile * static_cast<double>(periods_)));
  std::int64_t seen = 0;
  for (std::int64_t i = 0; i <= kBuckets; ++i) {
    seen += histogram_[static_cast<std::size_t>(i)];
    // Upper edge of the bucket: never below the true value.
    if (seen >= wanted && seen > 0) return 1e-9 * static_cast<double>((i + 1) * kBucket);
  }
  return 0.0;
}

std::string AskForRealTime(int priority) {
  std::string refused;
  sched_param parameters{};
  parameters.sched_priority = priority;
  if (const int error = pthread_setschedparam(pthread_self(), SCHED_FIFO, &parameters);
      error != 0) {
    refused = std::string("no real-time scheduling (") + std::strerror(error) +
              "): allow it with 'ulimit -r 99', in /etc/security/limits.conf or with CAP_SYS_NICE";
  }
  if (mlockall(MCL_CURRENT | MCL_FUTURE) != 0) {
    if (!refused.empty()) refused += "; ";
    refused += std::string("memory may be paged out (") + std::strerror(errno) +
               "): allow locking it with 'ulimit -l unlimited'";
  }
  return refused;
}

void GiveUpRealTime() noexcept {
  const sched_param parameters{};
  pthread_setschedparam(pthread_self(), SCHED_OTHER, &parameters);
}

}  // namespace dfr::runtime
