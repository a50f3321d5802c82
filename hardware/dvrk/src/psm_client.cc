#include "dfr/hardware/psm_client.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "psm_client_internal.h"

namespace dfr::hardware {
namespace {

using internal::Finite;
using internal::InFirstPlace;
using internal::kCommandTime;
using internal::Seconds;
using internal::Transform;
using kinematics::Psm;
using kinematics::PsmJoints;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kTipSpeed = 1.0;  // m/s, upper bound on the wrist's speed

// Returns the twist of the wrist in the frame in which `base` is given: m/s, then rad/s.
Eigen::Matrix<double, 6, 1> Twist(const Eigen::Isometry3d& base, const PsmJoints& joints,
                                  const PsmJoints& velocity) noexcept {
  Eigen::Matrix<double, 6, 1> twist;
  const Eigen::Matrix<double, 6, 1> local = Psm::Twist(joints, velocity);
  twist << base.linear() * local.head<3>(), base.linear() * local.tail<3>();
  return twist;
}

}  // namespace

PsmClient::PsmClient(const PsmClientOptions& options)
    : options_(options),
      motion_(options.limits, options.profile),
      rest_(options.rest),
      recent_(kCommandTime + options.watchdog.max_age_s),
      recent_jaw_(kCommandTime + options.watchdog.max_age_s),
      js_watchdog_(options.watchdog),
      cp_watchdog_(options.watchdog),
      local_watchdog_(options.watchdog),
      setpoint_watchdog_(options.watchdog),
      jaw_watchdog_(options.watchdog),
      age_s_(kNan) {
  options.Check();
}

PsmStatus PsmClient::status() const noexcept {
  return phase_ == PsmPhase::kHolding ? cause_ : hold_reason_;
}

void PsmClient::Take(const PsmInput& input) noexcept {
  const bool armed = phase_ == PsmPhase::kArmed;
  jumped_ = erred_ = switched_off_ = false;
  lapse_ = PsmStatus::kOk;
  if (input.measured_js) {
    PsmJointSample next = *input.measured_js;
    const double dt = std::max(0.0, Seconds(next.stamp.nanoseconds() - js_.stamp.nanoseconds()));
    if (!next.has_velocity) {
      next.velocity = any_js_ && dt > 0.0 ? PsmJoints((next.position - js_.position) / dt)
                                          : PsmJoints(PsmJoints::Zero());
    }
    const bool comparable =
        any_js_ && js_.well_formed && next.well_formed && js_.stamp.valid() && next.stamp.valid();
    if (armed && comparable) {
      const PsmJoints most = options_.jump_noise + dt * options_.jump_speed;
      jumped_ = ((next.position - js_.position).cwiseAbs().array() > most.array()).any();
    }
    js_ = next;
    any_js_ = true;
    ++num_samples_;
    js_arrival_ns_ = now_ns_;
    js_watchdog_.Arrived(next.stamp, now_ns_);
    // A sample without valid data does not indicate rest.
    if (!next.well_formed || !next.stamp.valid() || !next.position.allFinite() ||
        !next.velocity.allFinite()) {
      rest_.Forget();
    } else {
      const PsmJoints& setpoint =
          armed || !any_setpoint_ ? motion_.setpoint() : setpoint_js_.position;
      rest_.Sample(next.position, next.velocity, setpoint, Seconds(now_ns_));
    }
  }
  if (input.measured_cp) {
    const PsmPoseSample& next = *input.measured_cp;
    if (armed && any_cp_ && cp_.stamp.valid() && next.stamp.valid()) {
      const double dt = std::max(0.0, Seconds(next.stamp.nanoseconds() - cp_.stamp.nanoseconds()));
      jumped_ = jumped_ || (next.position_m - cp_.position_m).norm() >
                               options_.jump_distance_m + kTipSpeed * dt;
    }
    cp_ = next;
    any_cp_ = true;
    cp_arrival_ns_ = now_ns_;
    cp_watchdog_.Arrived(next.stamp, now_ns_);
  }
  if (input.local_measured_cp) {
    local_cp_ = *input.local_measured_cp;
    any_local_ = true;
    local_arrival_ns_ = now_ns_;
    local_watchdog_.Arrived(local_cp_.stamp, now_ns_);
  }
  if (input.measured_cp || input.local_measured_cp) Pair();
  if (input.setpoint_js && input.setpoint_js->well_formed &&
      input.setpoint_js->position.allFinite()) {
    setpoint_arrival_ns_ = now_ns_;
    setpoint_watchdog_.Arrived(input.setpoint_js->stamp, now_ns_);
    if (input.setpoint_js->stamp.valid()) {
      setpoint_js_ = *input.setpoint_js;
      any_setpoint_ = true;
    }
  }
  if (input.jaw_measured) jaw_measured_ = *input.jaw_measured;
  if (input.jaw_setpoint && std::isfinite(input.jaw_setpoint->angle)) {
    jaw_arrival_ns_ = now_ns_;
    jaw_watchdog_.Arrived(input.jaw_setpoint->stamp, now_ns_);
    if (input.jaw_setpoint->stamp.valid()) {
      jaw_setpoint_ = *input.jaw_setpoint;
      any_jaw_setpoint_ = true;
    }
  }
  if (input.operating_state) {
    if (any_operating_ && input.operating_state->lapses != operating_.lapses) {
      lapse_ = input.operating_state->last_lapse;
    }
    switched_off_ = any_operating_ && operating_.state != PsmConsoleState::kDisabled &&
                    input.operating_state->state == PsmConsoleState::kDisabled;
    operating_ = *input.operating_state;
    any_operating_ = true;
    statements_.Unsettle();
  }
  if (input.newcomers > 0) {
    newcomer_ns_ = now_ns_;
    any_newcomer_ = true;
  }
  had_publisher_ = had_publisher_ || input.state_publishers > 0 || any_js_;
  erred_ = input.errors > 0;
  others_control_ = !statements_.Take(input.pose_controls, input.other_controls, now_ns_);
  age_s_ = any_js_ ? Seconds(wall_ns_ - js_.stamp.nanoseconds()) : kNan;
}

// Computes the arm's base in the frame of measured_cp from measured_cp and local/measured_cp. Their
// stamps may differ by 3 ms, because a console stamps each message separately. An arm at the
// default speed limit moves only 0.15 mm in this time.
void PsmClient::Pair() noexcept {
  constexpr std::int64_t kOneMomentNs = 3'000'000;
  if (!any_cp_ || !any_local_ || !cp_.stamp.valid() || !local_cp_.stamp.valid() ||
      std::abs(cp_.stamp.nanoseconds() - local_cp_.stamp.nanoseconds()) > kOneMomentNs ||
      !Finite(cp_) || !Finite(local_cp_)) {
    return;
  }
  base_now_ = Transform(cp_) * Transform(local_cp_).inverse();
  paired_ns_ = now_ns_;
}

void PsmClient::HoldBecause(PsmStatus cause, PsmOutput& output) noexcept {
  // A console that powers up or homes ignores `hold`.
  if (homing() && operating_.state != PsmConsoleState::kFault) {
    output.request = PsmRequest::kDisable;
  }
  phase_ = PsmPhase::kHolding;
  cause_ = cause;
  request_ = PsmRequest::kNone;
  motion_.Rest(motion_.setpoint());
  jaw_moving_ = false;
  statements_.Held(now_ns_);
  output.hold = true;
}

bool PsmClient::homing() const noexcept {
  return phase_ == PsmPhase::kRequested && request_sent_ &&
         (request_ == PsmRequest::kHome || request_ == PsmRequest::kEnable);
}

void PsmClient::Pursue(const PsmInput& input, double dt, PsmOutput& output) noexcept {
  const bool homing = request_ == PsmRequest::kHome;
  const bool homes = homing || request_ == PsmRequest::kEnable;
  if (request_sent_) {
    const bool enabled = any_operating_ && operating_.state == PsmConsoleState::kEnabled;
    bool done = false;
    switch (request_) {
      case PsmRequest::kHome:
        done = enabled && operating_.homed && !operating_.busy;
        break;
      case PsmRequest::kEnable:
        done = enabled;
        break;
      default:
        done = true;
        break;
    }
    if (done) {
      request_ = PsmRequest::kNone;
      phase_ = PsmPhase::kIdle;
      return;
    }
    if (any_operating_ && operating_.state == PsmConsoleState::kFault) {
      HoldBecause(PsmStatus::kConsoleFault, output);
      return;
    }
  }
  if (const PsmStatus doubt = HomingHoldReason(input, dt); doubt != PsmStatus::kOk) {
    HoldBecause(doubt, output);
    return;
  }
  const double timeout_s = homing ? options_.home_timeout_s : options_.enable_timeout_s;
  if (Seconds(now_ns_ - request_start_ns_) > timeout_s) {
    HoldBecause(had_publisher_ ? PsmStatus::kTimedOut : PsmStatus::kNoConsole, output);
    return;
  }
  // A console that has not been discovered, or has not discovered this client, receives nothing.
  if (input.command_subscribers == 0) return;
  if (!request_sent_ && homes && Discovering()) return;
  const bool idle = !any_operating_ || (!operating_.busy &&
                                        (!homing || operating_.state != PsmConsoleState::kEnabled));
  if (!request_sent_ || (idle && Seconds(now_ns_ - request_sent_ns_) > options_.repeat_request_s)) {
    output.hold = hold_first_;
    if (hold_first_) statements_.Held(now_ns_);
    hold_first_ = false;
    output.request = request_;
    request_sent_ = true;
    request_sent_ns_ = now_ns_;
  }
}

PsmOutput PsmClient::Step(const PsmInput& input, std::int64_t steady_ns,
                          std::int64_t wall_ns) noexcept {
  PsmOutput output;
  const double dt = stepped_ ? std::max(0.0, Seconds(steady_ns - now_ns_)) : 0.0;
  now_ns_ = steady_ns;
  wall_ns_ = wall_ns;
  if (!stepped_) request_start_ns_ = steady_ns;  // for a request made before the first step
  stepped_ = true;
  Take(input);
  hold_reason_ = FindHoldReason(input);
  at_rest_ = hold_reason_ == PsmStatus::kOk && !moving() && rest_.At(Seconds(now_ns_));
  // The jaw's moves do not count.
  if (motion_.moving() || (hold_reason_ == PsmStatus::kOk && rest_.At(Seconds(now_ns_)))) {
    restless_ns_ = now_ns_;
  }

  if (hold_wanted_) {
    hold_wanted_ = false;
    const PsmStatus cause = phase_ == PsmPhase::kHolding ? cause_ : PsmStatus::kHeld;
    HoldBecause(cause, output);
    return output;
  }
  if (phase_ == PsmPhase::kRequested) {
    Pursue(input, dt, output);
    return output;
  }
  if (phase_ != PsmPhase::kArmed) return output;

  PsmStatus cause = hold_reason_;
  if (cause == PsmStatus::kOk) cause = lapse_;
  if (cause == PsmStatus::kOk && options_.sole_commander && input.foreign_messages > 0) {
    cause = PsmStatus::kForeignMessage;
  }
  if (cause == PsmStatus::kOk && options_.sole_commander && input.newcomers > 0) {
    cause = PsmStatus::kNewcomer;
  }
  if (cause == PsmStatus::kOk && options_.sole_commander && others_control_) {
    cause = PsmStatus::kForeignControl;
  }
  if (cause == PsmStatus::kOk && options_.sole_commander && input.goals_reached > 0) {
    cause = PsmStatus::kBusy;
  }
  if (cause == PsmStatus::kOk && input.tool_changes > 0) cause = PsmStatus::kToolChanged;
  if (cause == PsmStatus::kOk && erred_) cause = PsmStatus::kConsoleError;
  if (cause == PsmStatus::kOk && dt > options_.max_tick_gap_s) cause = PsmStatus::kTickLate;
  if (cause == PsmStatus::kOk && input.send_failed) cause = PsmStatus::kSendFailed;
  if (!jaw_known_ && any_jaw_setpoint_) {
    jaw_known_ = true;
    recent_jaw_.Start(InFirstPlace(jaw_setpoint_.angle), Seconds(now_ns_));
  }
  if (cause == PsmStatus::kOk) cause = FollowHoldReason();
  if (cause != PsmStatus::kOk) {
    HoldBecause(cause, output);
    return output;
  }
  agreed_ = setpoint_js_.position;

  if (statements_.awaits()) return output;
  if (!sends_) since_ns_ = now_ns_;
  sends_ = true;
  const double step_s = std::min(dt, options_.longest_step_s);
  if (motion_.moving()) {
    motion_.Advance(step_s);
    rest_.Forget();
    at_rest_ = false;
  }
  recent_.Add(motion_.setpoint(), Seconds(now_ns_));
  statements_.Unsettle();
  output.servo = true;
  output.servo_cp = base_ * Psm::Forward(motion_.setpoint());
  output.twist = Twist(base_, motion_.setpoint(), motion_.velocity());
  // The jaw's set-point changes no control once the console has obeyed the first pose.
  if (jaw_ours_ && Seconds(now_ns_ - since_ns_) >= kCommandTime) {
    const double most = jaw_speed_ * step_s;
    const double way = jaw_goal_ - jaw_;
    jaw_moving_ = jaw_moving_ && std::abs(way) > most;
    jaw_ = jaw_moving_ ? jaw_ + std::copysign(most, way) : jaw_goal_;
    recent_jaw_.Add(InFirstPlace(jaw_), Seconds(now_ns_));
    output.servo_jaw = true;
    output.jaw = jaw_;
  }
  return output;
}

PsmStatus PsmClient::Request(PsmRequest request) noexcept {
  if (request == PsmRequest::kNone) return PsmStatus::kInvalidGoal;
  if (request != PsmRequest::kDisable && any_operating_ &&
      operating_.state == PsmConsoleState::kFault) {
    return PsmStatus::kConsoleFault;
  }
  hold_first_ = phase_ == PsmPhase::kArmed;
  phase_ = PsmPhase::kRequested;
  motion_.Rest(motion_.setpoint());
  jaw_moving_ = jaw_ours_ = false;
  request_ = request;
  request_sent_ = false;
  request_start_ns_ = now_ns_;
  statements_.Unsettle();
  return PsmStatus::kOk;
}

PsmStatus PsmClient::Armable() const noexcept {
  if (phase_ == PsmPhase::kArmed) return PsmStatus::kOk;
  if (phase_ == PsmPhase::kRequested) return PsmStatus::kBusy;
  if (hold_wanted_) return PsmStatus::kHeld;
  if (hold_reason_ != PsmStatus::kOk) return hold_reason_;
  if (!any_setpoint_) return PsmStatus::kStateSilent;
  if (!FrameAgrees()) return PsmStatus::kFrameMismatch;
  const PsmJoints lag = (js_.position - setpoint_js_.position).cwiseAbs();
  return (lag.array() > options_.max_lag.array()).any() ? PsmStatus::kNotFollowing : PsmStatus::kOk;
}

PsmStatus PsmClient::Arm() noexcept {
  const PsmStatus status = Armable();
  if (status != PsmStatus::kOk || phase_ == PsmPhase::kArmed) return status;
  base_ = base_now_;
  motion_.Rest(setpoint_js_.position);
  recent_.Start(setpoint_js_.position, Seconds(now_ns_));
  rest_.Forget();
  at_rest_ = false;
  restless_ns_ = now_ns_;
  agreed_ = setpoint_js_.position;
  statements_.Armed();
  jaw_ours_ = jaw_moving_ = jaw_known_ = sends_ = false;
  cause_ = PsmStatus::kOk;
  phase_ = PsmPhase::kArmed;
  return PsmStatus::kOk;
}

PsmStatus PsmClient::MoveTo(const PsmJoints& goal, double duration_s) noexcept {
  if (phase_ != PsmPhase::kArmed || hold_wanted_) return PsmStatus::kNotArmed;
  const PsmStatus status = motion_.Start(goal, duration_s);
  if (status != PsmStatus::kOk) return status;
  rest_.Forget();
  at_rest_ = false;
  restless_ns_ = now_ns_;
  return PsmStatus::kOk;
}

PsmStatus PsmClient::MoveJaw(double angle, double duration_s) noexcept {
  if (phase_ != PsmPhase::kArmed || hold_wanted_) return PsmStatus::kNotArmed;
  if (!std::isfinite(angle) || !(duration_s >= 0.0) || !std::isfinite(duration_s)) {
    return PsmStatus::kInvalidGoal;
  }
  if (angle < options_.limits.jaw_lower || angle > options_.limits.jaw_upper) {
    return PsmStatus::kBeyondLimits;
  }
  const PsmStatus jaw = jaw_ours_ ? PsmStatus::kOk : JawHoldReason();
  if (jaw != PsmStatus::kOk) return jaw;
  const double from = jaw_ours_ ? jaw_ : jaw_setpoint_.angle;
  const double way = std::abs(angle - from);
  if (way > (1.0 + 1e-9) * duration_s * options_.limits.max_jaw_speed) return PsmStatus::kTooFast;
  jaw_ = from;
  jaw_goal_ = angle;
  jaw_speed_ = way > 0.0 ? way / duration_s : 0.0;
  jaw_moving_ = way > 0.0;
  jaw_ours_ = true;
  at_rest_ = false;
  return PsmStatus::kOk;
}

}  // namespace dfr::hardware
