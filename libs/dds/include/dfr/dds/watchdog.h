#pragma once

#include <cstdint>

#include "dfr/dds/messages.h"

namespace dfr::dds {

/// Limits of a Watchdog. Defaults are those of measured state at 100 Hz.
struct WatchdogOptions {
  double max_age_s = 0.05;      ///< From a sample's stamp to now, > 0.
  double max_silence_s = 0.05;  ///< From a sample's arrival to now, > 0.
  double max_ahead_s = 0.01;    ///< By how much a stamp may lie in the future, >= 0.
};

enum class Freshness {
  kFresh,
  kNever,         ///< Nothing has arrived yet.
  kInvalidStamp,  ///< The last sample is stamped zero, the console's mark for invalid data.
  kSilent,        ///< Nothing has arrived for too long.
  kOld,           ///< What arrives is too old: delayed on its way, or the sender is frozen.
  kAhead,         ///< Stamped in the future: a clock has jumped, or the machines' clocks differ.
};

[[nodiscard]] const char* Name(Freshness freshness) noexcept;

/// Whether a stream of stamped samples can still be relied on: looks at the age of the newest
/// sample's stamp and at how long ago it came, because a network can be silent and a sender can
/// repeat an old sample forever. A console makes no promises that DDS could watch.
///
/// Two clocks: `wall_ns` is the system's, as stamps are; `steady_ns` one that never jumps, so that
/// setting the clock cannot hide silence. Never allocates or throws.
class Watchdog {
 public:
  /// @throws std::invalid_argument naming the limit that is out of range.
  explicit Watchdog(const WatchdogOptions& options);

  void Arrived(const Stamp& stamp, std::int64_t steady_ns) noexcept;
  [[nodiscard]] Freshness Check(std::int64_t wall_ns, std::int64_t steady_ns) const noexcept;

 private:
  std::int64_t max_age_ns_;
  std::int64_t max_silence_ns_;
  std::int64_t max_ahead_ns_;
  bool any_ = false;
  Stamp stamp_;
  std::int64_t arrival_ns_ = 0;
};

}  // namespace dfr::dds
