#include "dfr/dds/emergency_stop.h"

#include <algorithm>
#include <cmath>
#include <type_traits>

#include "dfr/core/contract.h"
#include "stop_datagrams.h"

namespace dfr::dds {

static_assert(std::is_same_v<Origin, internal::StopSenderId>);

EmergencyStopButton::EmergencyStopButton(Participant& participant, const std::string& topic)
    : publisher_(participant, topic, Role::kEmergencyStop),
      datagrams_(std::make_unique<internal::StopSender>(participant.options())) {}

EmergencyStopButton::~EmergencyStopButton() = default;

bool EmergencyStopButton::Beat(std::int64_t wall_ns) noexcept {
  const bool sent = datagrams_->Send(pressed_, wall_ns);
  return publisher_.Write({pressed_}) || sent;
}

void EmergencyStopButton::Press(std::int64_t wall_ns) noexcept {
  pressed_ = true;
  Beat(wall_ns);
}

void EmergencyStopButton::Release(std::int64_t wall_ns) noexcept {
  pressed_ = false;
  Beat(wall_ns);
}

void EmergencyStopJudge::Buttons::Hear(const Origin& who, std::int64_t now_ns) noexcept {
  const auto end = buttons.begin() + size;
  auto button = std::find_if(buttons.begin(), end, [&](const Button& b) { return b.who == who; });
  if (button == end) {
    too_many = too_many || end == buttons.end();
    if (too_many) return;
    button->who = who;
    ++size;
  }
  button->heard_ns = now_ns;
}

void EmergencyStopJudge::Buttons::Forget(std::int64_t before_ns) noexcept {
  const auto end = std::remove_if(buttons.begin(), buttons.begin() + size,
                                  [&](const Button& b) { return b.heard_ns < before_ns; });
  size = static_cast<int>(end - buttons.begin());
  too_many = false;
}

bool EmergencyStopJudge::Buttons::Silent(std::int64_t before_ns) const noexcept {
  return size == 0 || too_many ||
         std::any_of(buttons.begin(), buttons.begin() + size,
                     [&](const Button& b) { return b.heard_ns < before_ns; });
}

EmergencyStopJudge::EmergencyStopJudge(double max_silence_s, bool datagrams)
    : max_silence_ns_(std::llround(1e9 * max_silence_s)), datagrams_(datagrams) {
  DFR_THROW_UNLESS(max_silence_s >= 0.05 && max_silence_s <= 10.0,
                   "emergency stop: max_silence_s must lie in [0.05, 10], not " << max_silence_s);
}

void EmergencyStopJudge::Hear(Way way, const Origin& who, bool pressed,
                              std::int64_t steady_ns) noexcept {
  (way == Way::kDds ? over_dds_ : in_datagrams_).Hear(who, steady_ns);
  latched_ = latched_ || pressed;
}

EmergencyStop EmergencyStopJudge::Check(std::int64_t steady_ns) noexcept {
  now_ns_ = steady_ns;
  // A button has different names on the two paths. Only a difference between the numbers of buttons
  // on the two paths reveals a button that lacks a path.
  const std::int64_t since_ns = now_ns_ - max_silence_ns_;
  const bool dds_silent =
      over_dds_.Silent(since_ns) || (datagrams_ && over_dds_.size < in_datagrams_.size);
  const bool datagrams_silent =
      datagrams_ && (in_datagrams_.Silent(since_ns) || in_datagrams_.size < over_dds_.size);
  only_datagrams_silent_ = datagrams_silent && !dds_silent;
  if (latched_) return EmergencyStop::kPressed;
  return dds_silent || datagrams_silent ? EmergencyStop::kSilent : EmergencyStop::kClear;
}

void EmergencyStopJudge::Acknowledge() noexcept {
  latched_ = false;
  over_dds_.Forget(now_ns_ - max_silence_ns_);
  in_datagrams_.Forget(now_ns_ - max_silence_ns_);
}

EmergencyStopReceiver::EmergencyStopReceiver(Participant& participant, double max_silence_s,
                                             const std::string& topic, bool datagrams)
    : judge_(max_silence_s, datagrams), subscriber_(participant, topic, Role::kEmergencyStop) {
  if (datagrams) listener_ = std::make_unique<internal::StopListener>(participant.options());
}

EmergencyStopReceiver::~EmergencyStopReceiver() = default;

bool EmergencyStopReceiver::clocks_differ() const noexcept {
  return listener_ && listener_->clocks_differ();
}

EmergencyStop EmergencyStopReceiver::Check(std::int64_t steady_ns, std::int64_t wall_ns) noexcept {
  using Way = EmergencyStopJudge::Way;
  Flag flag;
  Origin who;
  while (subscriber_.Take(flag, who)) judge_.Hear(Way::kDds, who, flag.value, steady_ns);
  // The next call receives further datagrams.
  constexpr int kMostDatagrams = 64;
  bool pressed = false;
  for (int n = 0; listener_ && n < kMostDatagrams && listener_->Take(wall_ns, who, pressed); ++n) {
    judge_.Hear(Way::kDatagrams, who, pressed, steady_ns);
  }
  return judge_.Check(steady_ns);
}

}  // namespace dfr::dds
