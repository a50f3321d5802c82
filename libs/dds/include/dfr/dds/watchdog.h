#pragma once

#include <cstdint>

#include "dfr/dds/messages.h"

namespace dfr::dds {

/// Limits of a Watchdog. The defaults suit measured state at 100 Hz.
struct WatchdogOptions {
  double max_age_s = 0.05;      ///< Maximum time from a sample's stamp to now, > 0.
  double max_silence_s = 0.05;  ///< Maximum time from a sample's arrival to now, > 0.
  double max_ahead_s = 0.01;    ///< Maximum time from now to a stamp in the future, >= 0.
};

enum class Freshness {
  kFresh,
  kNever,         ///< Nothing has arrived yet.
  kInvalidStamp,  ///< The last sample is stamped zero, as consoles stamp invalid data.
  kSilent,        ///< No sample has arrived for more than max_silence_s.
  kOld,           ///< Arriving samples are too old: delayed in transit, or the sender is frozen.
  kAhead,         ///< Stamped in the future: a clock jumped, or the machines' clocks differ.
};

/// Monitors a stream of stamped samples. Checks the age of the newest stamp, because a sender can
/// repeat an old sample, and the time since the last arrival, because a network can fail silently.
/// Consoles offer no DDS deadline or liveliness that could be monitored.
///
/// Uses two clocks: `wall_ns` is the system time, as in stamps; `steady_ns` is a monotonic clock,
/// so a change of the system time cannot hide silence. Never allocates or throws.
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
