#include "dfr/core/contract.h"
#include "dfr/hardware/psm_client.h"

namespace dfr::hardware {
namespace {

using kinematics::PsmJoints;

bool Positive(const PsmJoints& q) { return q.allFinite() && (q.array() > 0.0).all(); }
bool Positive(double value) { return value > 0.0 && value < 1e6; }

}  // namespace

const char* Name(PsmPhase phase) noexcept {
  switch (phase) {
    case PsmPhase::kIdle:
      return "idle";
    case PsmPhase::kRequested:
      return "waiting for the console";
    case PsmPhase::kArmed:
      return "armed";
    case PsmPhase::kHolding:
      return "holding";
  }
  return "unknown";
}

const char* Name(PsmRequest request) noexcept {
  switch (request) {
    case PsmRequest::kNone:
      return "";
    case PsmRequest::kEnable:
      return "enable";
    case PsmRequest::kDisable:
      return "disable";
    case PsmRequest::kHome:
      return "home";
  }
  return "";
}

const char* Name(PsmConsoleState state) noexcept {
  switch (state) {
    case PsmConsoleState::kUnknown:
      return "unknown";
    case PsmConsoleState::kDisabled:
      return "DISABLED";
    case PsmConsoleState::kEnabled:
      return "ENABLED";
    case PsmConsoleState::kPaused:
      return "PAUSED";
    case PsmConsoleState::kFault:
      return "FAULT";
  }
  return "unknown";
}

PsmStatus Readiness(const PsmOperatingState& state) noexcept {
  switch (state.state) {
    case PsmConsoleState::kUnknown:
      return PsmStatus::kUnknownState;
    case PsmConsoleState::kDisabled:
      return PsmStatus::kDisabled;
    case PsmConsoleState::kPaused:
      return PsmStatus::kPaused;
    case PsmConsoleState::kFault:
      return PsmStatus::kConsoleFault;
    case PsmConsoleState::kEnabled:
      break;
  }
  // Precedes the homed check, because a homing arm is not homed.
  if (state.busy) return PsmStatus::kBusy;
  return state.homed ? PsmStatus::kOk : PsmStatus::kNotHomed;
}

void PsmClientOptions::Check() const {
  limits.Check();
  rest.Check();
  DFR_THROW_UNLESS(Positive(longest_step_s),
                   "longest_step_s must be positive, not " << longest_step_s);
  DFR_THROW_UNLESS(Positive(max_tick_gap_s),
                   "max_tick_gap_s must be positive, not " << max_tick_gap_s);
  DFR_THROW_UNLESS(Positive(max_lag), "max_lag must be positive and finite");
  DFR_THROW_UNLESS(Positive(max_setpoint_error), "max_setpoint_error must be positive and finite");
  DFR_THROW_UNLESS(Positive(max_jaw_setpoint_error),
                   "max_jaw_setpoint_error must be positive and finite");
  DFR_THROW_UNLESS(discovery_s >= 0.0 && discovery_s < 1e3, "discovery_s must lie in [0, 1000)");
  DFR_THROW_UNLESS(Positive(reach_timeout_s),
                   "reach_timeout_s must be positive, not " << reach_timeout_s);
  DFR_THROW_UNLESS(Positive(jump_speed), "jump_speed must be positive and finite");
  DFR_THROW_UNLESS(jump_noise.allFinite() && (jump_noise.array() >= 0.0).all(),
                   "jump_noise must be finite and not negative");
  DFR_THROW_UNLESS(Positive(jump_distance_m),
                   "jump_distance_m must be positive, not " << jump_distance_m);
  DFR_THROW_UNLESS(Positive(max_frame_distance_m),
                   "max_frame_distance_m must be positive, not " << max_frame_distance_m);
  DFR_THROW_UNLESS(Positive(max_frame_angle),
                   "max_frame_angle must be positive, not " << max_frame_angle);
  DFR_THROW_UNLESS(Positive(enable_timeout_s),
                   "enable_timeout_s must be positive, not " << enable_timeout_s);
  DFR_THROW_UNLESS(Positive(home_timeout_s),
                   "home_timeout_s must be positive, not " << home_timeout_s);
  DFR_THROW_UNLESS(Positive(repeat_request_s),
                   "repeat_request_s must be positive, not " << repeat_request_s);
}

}  // namespace dfr::hardware
