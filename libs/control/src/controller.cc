#include "dfr/control/controller.h"

#include <algorithm>
#include <cassert>

#include "dfr/core/matrix.h"

namespace dfr::control {

const char* Name(Mode mode) noexcept {
  switch (mode) {
    case Mode::kPolicy:
      return "policy";
    case Mode::kProbe:
      return "probe";
    case Mode::kRecovery:
      return "recovery";
    case Mode::kHalt:
      return "halt";
  }
  return "unknown";
}

const char* Name(HaltCause cause) noexcept {
  switch (cause) {
    case HaltCause::kNone:
      return "none";
    case HaltCause::kNotReset:
      return "not-reset";
    case HaltCause::kTimeUp:
      return "time-up";
    case HaltCause::kStateInvalid:
      return "state-invalid";
    case HaltCause::kBadQuaternion:
      return "quaternion-invalid";
    case HaltCause::kControlInvalid:
      return "control-invalid";
    case HaltCause::kSupportInvalid:
      return "support-invalid";
    case HaltCause::kOutsideSupport:
      return "outside-support";
    case HaltCause::kEarlyStopping:
      return "early-stopping";
    case HaltCause::kIterationLimit:
      return "iteration-limit";
    case HaltCause::kNoDirection:
      return "no-direction";
    case HaltCause::kNoProgress:
      return "no-progress";
    case HaltCause::kViolated:
      return "assumption-violated";
    case HaltCause::kControlLimit:
      return "control-limit";
    case HaltCause::kPlantRefused:
      return "plant-refused";
    case HaltCause::kPlantFault:
      return "plant-fault";
    case HaltCause::kStepSkipped:
      return "step-skipped";
    case HaltCause::kStopRequested:
      return "stop-requested";
  }
  return "unknown";
}

void Controller::Reset(std::uint64_t seed) noexcept {
  cause_ = HaltCause::kNone;
  last_ = Step{};
  DoReset(seed);
}

void Controller::Stop(HaltCause cause) noexcept {
  assert(cause != HaltCause::kNone);
  if (cause_ == HaltCause::kNone) cause_ = cause;
}

Step Controller::Next(std::span<const double> x, std::span<double> u) noexcept {
  if (cause_ == HaltCause::kNone) {
    if (static_cast<int>(x.size()) != state_dim() || !core::AllFinite(x)) {
      cause_ = HaltCause::kStateInvalid;
    } else if (static_cast<int>(u.size()) != control_dim()) {
      cause_ = HaltCause::kControlInvalid;
    } else {
      last_ = DoNext(x, u);
      if (last_.mode == Mode::kHalt) {
        assert(last_.cause != HaltCause::kNone);
        cause_ = last_.cause;
      } else if (!core::AllFinite(u)) {
        cause_ = HaltCause::kControlInvalid;
      }
    }
  }
  if (cause_ != HaltCause::kNone) {
    if (last_.mode != Mode::kHalt) {
      // The values of the previous step do not apply to the state at which the controller stopped.
      const Step none;
      last_.log_threshold = none.log_threshold;
      last_.log_learned = none.log_learned;
      last_.certified = false;
    }
    last_.mode = Mode::kHalt;
    last_.cause = cause_;
    std::fill(u.begin(), u.end(), 0.0);
  }
  return last_;
}

}  // namespace dfr::control
