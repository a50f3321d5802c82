#include "dfr/dds/watchdog.h"

#include <cmath>

#include "dfr/core/contract.h"

namespace dfr::dds {
namespace {

std::int64_t Nanoseconds(double seconds) { return std::llround(1e9 * seconds); }

bool Within(double seconds, double least) { return seconds >= least && seconds < 1e9; }

}  // namespace

Watchdog::Watchdog(const WatchdogOptions& options) {
  DFR_THROW_UNLESS(Within(options.max_age_s, 1e-9),
                   "max_age_s must be positive, not " << options.max_age_s);
  DFR_THROW_UNLESS(Within(options.max_silence_s, 1e-9),
                   "max_silence_s must be positive, not " << options.max_silence_s);
  DFR_THROW_UNLESS(Within(options.max_ahead_s, 0.0),
                   "max_ahead_s must not be negative: " << options.max_ahead_s);
  max_age_ns_ = Nanoseconds(options.max_age_s);
  max_silence_ns_ = Nanoseconds(options.max_silence_s);
  max_ahead_ns_ = Nanoseconds(options.max_ahead_s);
}

void Watchdog::Arrived(const Stamp& stamp, std::int64_t steady_ns) noexcept {
  any_ = true;
  stamp_ = stamp;
  arrival_ns_ = steady_ns;
}

Freshness Watchdog::Check(std::int64_t wall_ns, std::int64_t steady_ns) const noexcept {
  if (!any_) return Freshness::kNever;
  if (steady_ns - arrival_ns_ > max_silence_ns_) return Freshness::kSilent;
  if (!stamp_.valid()) return Freshness::kInvalidStamp;
  const std::int64_t age_ns = wall_ns - stamp_.nanoseconds();
  if (age_ns > max_age_ns_) return Freshness::kOld;
  if (-age_ns > max_ahead_ns_) return Freshness::kAhead;
  return Freshness::kFresh;
}

}  // namespace dfr::dds
