#include "dfr/runtime/fail_safe.h"

#include <algorithm>
#include <cmath>

#include "dfr/core/contract.h"

namespace dfr::runtime {
namespace {

constexpr double kNanoseconds = 1e9;

// Truncates if necessary, and terminates with zero.
void Copy(std::string_view text, std::array<char, 96>& to) {
  to.fill('\0');
  std::copy_n(text.begin(), std::min(text.size(), to.size() - 1), to.begin());
}

}  // namespace

const char* Name(RunState state) noexcept {
  switch (state) {
    case RunState::kIdle:
      return "idle";
    case RunState::kArmed:
      return "armed";
    case RunState::kRunning:
      return "running";
    case RunState::kRecovering:
      return "recovering";
    case RunState::kHolding:
      return "holding";
    case RunState::kFaulted:
      return "faulted";
  }
  return "?";
}

const char* Name(HoldReason reason) noexcept {
  switch (reason) {
    case HoldReason::kNone:
      return "none";
    case HoldReason::kOperator:
      return "operator";
    case HoldReason::kControllerHalted:
      return "controller-halted";
    case HoldReason::kNotSeen:
      return "not-seen";
    case HoldReason::kStateInvalid:
      return "state-invalid";
    case HoldReason::kStateJump:
      return "state-jump";
    case HoldReason::kControlInvalid:
      return "control-invalid";
    case HoldReason::kCommandRefused:
      return "command-refused";
    case HoldReason::kEmergencyStop:
      return "emergency-stop";
    case HoldReason::kEmergencyStopSilent:
      return "emergency-stop-silent";
    case HoldReason::kArmSilent:
      return "arm-silent";
    case HoldReason::kArmInvalid:
      return "arm-invalid";
    case HoldReason::kArmOld:
      return "arm-old";
    case HoldReason::kArmJump:
      return "arm-jump";
    case HoldReason::kArmNotReady:
      return "arm-not-ready";
    case HoldReason::kArmNotFollowing:
      return "arm-not-following";
    case HoldReason::kSecondCommander:
      return "second-commander";
    case HoldReason::kClock:
      return "clock";
    case HoldReason::kImageSilent:
      return "image-silent";
    case HoldReason::kImageOld:
      return "image-old";
    case HoldReason::kImageInvalid:
      return "image-invalid";
    case HoldReason::kOverrun:
      return "overrun";
    case HoldReason::kRecorder:
      return "recorder";
    case HoldReason::kPlatform:
      return "platform";
  }
  return "?";
}

bool IsFault(HoldReason reason) noexcept { return reason >= HoldReason::kEmergencyStop; }

FailSafe::FailSafe(const FailSafeOptions& options)
    : max_period_ns_(std::llround(kNanoseconds * options.max_period_s)),
      settle_ns_(std::llround(kNanoseconds * options.settle_time_s)) {
  DFR_THROW_UNLESS(options.max_period_s > 0.0 && options.max_period_s <= 10.0,
                   "fail-safe: max_period_s must lie in (0, 10], not " << options.max_period_s);
  DFR_THROW_UNLESS(options.settle_time_s >= 0.0 && options.settle_time_s <= 60.0,
                   "fail-safe: settle_time_s must lie in [0, 60], not " << options.settle_time_s);
}

void FailSafe::Tick(std::int64_t steady_ns) noexcept {
  const std::int64_t period_ns = steady_ns - now_ns_;
  const bool first = !ticked_;
  ticked_ = true;
  now_ns_ = steady_ns;
  if (!first && (period_ns > max_period_ns_ || period_ns < 0)) Hold(HoldReason::kOverrun);
}

void FailSafe::Hold(HoldReason reason, std::string_view detail) noexcept {
  if (reason == HoldReason::kNone) return;
  last_reason_ = reason;
  last_reason_ns_ = now_ns_;
  Copy(detail, last_detail_);
  if (state_ == RunState::kFaulted || state_ == RunState::kIdle) return;
  if (IsFault(reason)) {
    Enter(RunState::kFaulted, reason, detail);
  } else if (state_ != RunState::kHolding) {
    Enter(RunState::kHolding, reason, detail);
  }
}

HoldReason FailSafe::blocking() const noexcept {
  return last_reason_ != HoldReason::kNone && now_ns_ - last_reason_ns_ <= settle_ns_
             ? last_reason_
             : HoldReason::kNone;
}

std::string_view FailSafe::blocking_detail() const noexcept {
  return blocking() == HoldReason::kNone ? std::string_view() : last_detail_.data();
}

bool FailSafe::Arm() noexcept {
  if (state_ != RunState::kIdle && state_ != RunState::kHolding) return false;
  if (!ticked_ || blocking() != HoldReason::kNone) return false;
  Enter(RunState::kArmed, HoldReason::kNone, {});
  return true;
}

bool FailSafe::Start() noexcept {
  if (state_ != RunState::kArmed) return false;
  Enter(RunState::kRunning, HoldReason::kNone, {});
  return true;
}

void FailSafe::Done() noexcept {
  if (may_move()) Enter(RunState::kIdle, HoldReason::kNone, "completed");
}

bool FailSafe::Clear() noexcept {
  if (state_ != RunState::kFaulted || blocking() != HoldReason::kNone) return false;
  Enter(RunState::kIdle, HoldReason::kNone, "cleared");
  return true;
}

void FailSafe::Recovering(bool recovering) noexcept {
  const RunState wanted = recovering ? RunState::kRecovering : RunState::kRunning;
  if (may_move() && state_ != wanted) Enter(wanted, HoldReason::kNone, {});
}

void FailSafe::Enter(RunState to, HoldReason reason, std::string_view detail) noexcept {
  const RunState from = state_;
  state_ = to;
  if (log_size_ == log_.size()) return;
  Transition& entry = log_[(log_begin_ + log_size_++) % log_.size()];
  entry = {now_ns_, from, to, reason, {}};
  Copy(detail, entry.detail);
}

bool FailSafe::Take(Transition& transition) noexcept {
  if (log_size_ == 0) return false;
  transition = log_[log_begin_];
  log_begin_ = (log_begin_ + 1) % log_.size();
  --log_size_;
  return true;
}

}  // namespace dfr::runtime
