#include "dfr/dds/emergency_stop.h"

#include <algorithm>
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

void EmergencyStopReceiver::Hear(const Origin& who) noexcept {
  const auto end = buttons_.begin() + num_buttons_;
  auto button = std::find_if(buttons_.begin(), end, [&](const Button& b) { return b.who == who; });
  if (button == end) {
    too_many_ = too_many_ || end == buttons_.end();
    if (too_many_) return;
    button->who = who;
    ++num_buttons_;
  }
  button->heard_ns = now_ns_;
}

EmergencyStop EmergencyStopReceiver::Check(std::int64_t steady_ns) noexcept {
  now_ns_ = steady_ns;
  Flag flag;
  Origin who;
  while (subscriber_.Take(flag, who)) {
    Hear(who);
    latched_ = latched_ || flag.value;
  }
  if (latched_) return EmergencyStop::kPressed;
  const bool silent =
      std::any_of(buttons_.begin(), buttons_.begin() + num_buttons_,
                  [&](const Button& b) { return now_ns_ - b.heard_ns > max_silence_ns_; });
  return num_buttons_ == 0 || silent || too_many_ ? EmergencyStop::kSilent : EmergencyStop::kClear;
}

void EmergencyStopReceiver::Acknowledge() noexcept {
  latched_ = too_many_ = false;
  const auto end =
      std::remove_if(buttons_.begin(), buttons_.begin() + num_buttons_,
                     [&](const Button& b) { return now_ns_ - b.heard_ns > max_silence_ns_; });
  num_buttons_ = static_cast<int>(end - buttons_.begin());
}

}  // namespace dfr::dds
