#pragma once

#include <algorithm>
#include <cstdint>
#include <functional>
#include <utility>

#include "check/findings.h"
#include "dfr/dds/emergency_stop.h"

namespace dfr::apps::hardware_app {

inline constexpr double kStopSilence = 0.1;  ///< s

/// Decides whether a device may be moved: the emergency stop is connected and released, and the
/// user has not interrupted. A permit that was granted ends with the first refusal.
class Permit {
 public:
  Permit(const CheckOptions& options, StopState stop)
      : options_(&options), stop_(std::move(stop)) {}

  /// Waits for the emergency stop. Returns false and reports the reason if nothing may move.
  /// @param tick  called before each look; may be empty.
  [[nodiscard]] bool Granted(DeviceReport& report, const std::function<void()>& tick = {}) {
    Say(*options_, "looking for the emergency stop");
    granted_ = ended_ = false;
    (void)Within(*options_->clock, std::min(options_->find_s, 5.0), [&] {
      if (tick) tick();
      return MayMove() || Interrupted(*options_);
    });
    granted_ = MayMove();
    if (!granted_) Tell(report);
    return granted_;
  }
  [[nodiscard]] bool MayMove() {
    if (ended_ || Interrupted(*options_)) return false;
    if (options_->without_stop) return true;
    found_ = stop_(options_->clock->SteadyNs());
    const bool clear = found_.state == dds::EmergencyStop::kClear;
    ended_ = granted_ && !clear;
    return clear;
  }
  void Tell(DeviceReport& report) const {
    if (Interrupted(*options_)) {
      Wrong(report, "interrupted: nothing is moved further", "");
    } else if (found_.state == dds::EmergencyStop::kPressed) {
      Wrong(report, "the emergency stop is pressed, or was pressed during the check",
            "release it, and run this check again");
    } else if (found_.only_datagrams_silent) {
      Wrong(report, "the emergency stop is heard over DDS, but not by datagram",
            "check that both machines' clocks agree and no firewall drops UDP broadcasts; if "
            "broadcasts cannot pass, give --no-datagrams");
    } else if (ended_) {
      Wrong(report, "the emergency stop became silent: nothing is moved further",
            "check that `hardware stop` is still running and the network loses no messages");
    } else {
      Wrong(report, "no emergency stop was found, and nothing is moved without one",
            "run `hardware stop` in this domain, or give --without-stop in a simulation");
    }
  }

 private:
  const CheckOptions* options_;
  StopState stop_;
  StopLook found_ = dds::EmergencyStop::kSilent;
  bool granted_ = false;
  bool ended_ = false;
};

}  // namespace dfr::apps::hardware_app
