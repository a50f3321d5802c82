#include "dfr/runtime/fail_safe.h"

#include <algorithm>
#include <cmath>

#include "dfr/core/contract.h"

namespace dfr::runtime {
namespace {

constexpr double kNanoseconds = 1e9;

// Cut if need be, and zero-terminated.
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

const char* Name(Doubt doubt) noexcept {
  switch (doubt) {
    case Doubt::kNone:
      return "none";
    case Doubt::kOperator:
      return "operator";
    case Doubt::kControllerHalted:
      return "controller-halted";
    case Doubt::kNotSeen:
      return "not-seen";
    case Doubt::kStateInvalid:
      return "state-invalid";
    case Doubt::kStateJump:
      return "state-jump";
    case Doubt::kControlInvalid:
      return "control-invalid";
    case Doubt::kCommandRefused:
      return "command-refused";
    case Doubt::kEmergencyStop:
      return "emergency-stop";
    case Doubt::kEmergencyStopSilent:
      return "emergency-stop-silent";
    case Doubt::kArmSilent:
      return "arm-silent";
    case Doubt::kArmInvalid:
      return "arm-invalid";
    case Doubt::kArmOld:
      return "arm-old";
    case Doubt::kArmJump:
      return "arm-jump";
    case Doubt::kArmNotReady:
      return "arm-not-ready";
    case Doubt::kArmNotFollowing:
      return "arm-not-following";
    case Doubt::kSecondCommander:
      return "second-commander";
    case Doubt::kClock:
      return "clock";
    case Doubt::kImageSilent:
      return "image-silent";
    case Doubt::kImageOld:
      return "image-old";
    case Doubt::kImageInvalid:
      return "image-invalid";
    case Doubt::kOverrun:
      return "overrun";
    case Doubt::kRecorder:
      return "recorder";
  }
  return "?";
}

bool IsFault(Doubt doubt) noexcept { return doubt >= Doubt::kEmergencyStop; }

FailSafe::FailSafe(const FailSafeOptions& options)
    : max_period_ns_(std::llround(kNanoseconds * options.max_period_s)),
      calm_ns_(std::llround(kNanoseconds * options.calm_s)) {
  DFR_THROW_UNLESS(options.max_period_s > 0.0 && options.max_period_s <= 10.0,
                   "fail-safe: max_period_s must lie in (0, 10], not " << options.max_period_s);
  DFR_THROW_UNLESS(options.calm_s >= 0.0 && options.calm_s <= 60.0,
                   "fail-safe: calm_s must lie in [0, 60], not " << options.calm_s);
}

void FailSafe::Tick(std::int64_t steady_ns) noexcept {
  const std::int64_t period_ns = steady_ns - now_ns_;
  const bool first = !ticked_;
  ticked_ = true;
  now_ns_ = steady_ns;
  if (!first && (period_ns > max_period_ns_ || period_ns < 0)) Doubted(Doubt::kOverrun);
}

void FailSafe::Doubted(Doubt doubt, std::string_view detail) noexcept {
  if (doubt == Doubt::kNone) return;
  last_doubt_ = doubt;
  last_doubt_ns_ = now_ns_;
  Copy(detail, last_detail_);
  if (state_ == RunState::kFaulted || state_ == RunState::kIdle) return;
  if (IsFault(doubt)) {
    Enter(RunState::kFaulted, doubt, detail);
  } else if (state_ != RunState::kHolding) {
    Enter(RunState::kHolding, doubt, detail);
  }
}

Doubt FailSafe::blocking() const noexcept {
  return last_doubt_ != Doubt::kNone && now_ns_ - last_doubt_ns_ <= calm_ns_ ? last_doubt_
                                                                             : Doubt::kNone;
}

std::string_view FailSafe::blocking_detail() const noexcept {
  return blocking() == Doubt::kNone ? std::string_view() : last_detail_.data();
}

bool FailSafe::Arm() noexcept {
  if (state_ != RunState::kIdle && state_ != RunState::kHolding) return false;
  if (!ticked_ || blocking() != Doubt::kNone) return false;
  Enter(RunState::kArmed, Doubt::kNone, {});
  return true;
}

bool FailSafe::Start() noexcept {
  if (state_ != RunState::kArmed) return false;
  Enter(RunState::kRunning, Doubt::kNone, {});
  return true;
}

void FailSafe::Done() noexcept {
  if (may_move()) Enter(RunState::kIdle, Doubt::kNone, "completed");
}

bool FailSafe::Clear() noexcept {
  if (state_ != RunState::kFaulted || blocking() != Doubt::kNone) return false;
  Enter(RunState::kIdle, Doubt::kNone, "cleared");
  return true;
}

void FailSafe::Recovering(bool recovering) noexcept {
  const RunState wanted = recovering ? RunState::kRecovering : RunState::kRunning;
  if (may_move() && state_ != wanted) Enter(wanted, Doubt::kNone, {});
}

void FailSafe::Enter(RunState to, Doubt doubt, std::string_view detail) noexcept {
  const RunState from = state_;
  state_ = to;
  if (log_size_ == log_.size()) {
    ++lost_;
    return;
  }
  Transition& entry = log_[(log_begin_ + log_size_++) % log_.size()];
  entry = {now_ns_, from, to, doubt, {}};
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
