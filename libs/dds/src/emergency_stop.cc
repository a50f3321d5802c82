#include "dfr/dds/emergency_stop.h"

#include <cmath>

#include "dfr/core/contract.h"

namespace dfr::dds {

EmergencyStopButton::EmergencyStopButton(Participant& participant, const std::string& topic)
    : publisher_(participant, topic, Role::kEmergencyStop) {}

bool EmergencyStopButton::Beat() noexcept { return publisher_.Write({pressed_}); }

void EmergencyStopButton::Press() noexcept {
  pressed_ = true;
  Beat();
}

void EmergencyStopButton::Release() noexcept {
  pressed_ = false;
  Beat();
}

EmergencyStopReceiver::EmergencyStopReceiver(Participant& participant, double max_silence_s,
                                             const std::string& topic)
    : subscriber_(participant, topic, Role::kEmergencyStop),
      max_silence_ns_(std::llround(1e9 * max_silence_s)) {
  DFR_THROW_UNLESS(max_silence_s >= 0.05 && max_silence_s <= 10.0,
                   "emergency stop: max_silence_s must lie in [0.05, 10], not " << max_silence_s);
}

EmergencyStop EmergencyStopReceiver::Check(std::int64_t steady_ns) noexcept {
  Flag flag;
  while (subscriber_.Take(flag)) {
    any_ = true;
    heard_ns_ = steady_ns;
    latched_ = latched_ || flag.value;
  }
  if (latched_) return EmergencyStop::kPressed;
  return any_ && steady_ns - heard_ns_ <= max_silence_ns_ ? EmergencyStop::kClear
                                                          : EmergencyStop::kSilent;
}

}  // namespace dfr::dds
