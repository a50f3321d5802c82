#include "dfr/hardware/psm_client.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <span>

#include "dfr/core/contract.h"

namespace dfr::hardware {
namespace {

using dds::Freshness;
using kinematics::Psm;
using kinematics::PsmJoints;

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kCommandTime = 0.15;  // s, from a command to its set-point at the console
constexpr double kTipSpeed = 1.0;      // m/s, upper bound of the wrist's speed

bool Positive(const PsmJoints& q) { return q.allFinite() && (q.array() > 0.0).all(); }
bool Positive(double value) { return value > 0.0 && value < 1e6; }

double Seconds(std::int64_t ns) noexcept { return 1e-9 * static_cast<double>(ns); }

PsmStatus FromFreshness(Freshness freshness) noexcept {
  switch (freshness) {
    case Freshness::kFresh:
      return PsmStatus::kOk;
    case Freshness::kNever:
    case Freshness::kSilent:
      return PsmStatus::kStateSilent;
    case Freshness::kInvalidStamp:
      return PsmStatus::kStateInvalid;
    case Freshness::kOld:
      return PsmStatus::kStateOld;
    case Freshness::kAhead:
      return PsmStatus::kStateAhead;
  }
  return PsmStatus::kStateSilent;
}

PsmJoints InFirstPlace(double value) noexcept {
  PsmJoints joints = PsmJoints::Zero();
  joints[0] = value;
  return joints;
}

Eigen::Isometry3d Transform(const PsmPoseSample& pose) noexcept {
  Eigen::Isometry3d transform = Eigen::Isometry3d::Identity();
  transform.translation() = pose.position_m;
  transform.linear() = pose.orientation.normalized().toRotationMatrix();
  return transform;
}

// Returns true if the poses agree within a distance, m, and an angle, rad.
bool Near(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b, double distance_m,
          double angle) noexcept {
  return (a.translation() - b.translation()).norm() <= distance_m &&
         Eigen::Quaterniond(a.linear()).angularDistance(Eigen::Quaterniond(b.linear())) <= angle;
}

// Returns the twist of the wrist in the frame of `base`: m/s, then rad/s.
Eigen::Matrix<double, 6, 1> Twist(const Eigen::Isometry3d& base, const PsmJoints& joints,
                                  const PsmJoints& velocity) noexcept {
  Eigen::Matrix<double, 6, 1> twist = Eigen::Matrix<double, 6, 1>::Zero();
  if (velocity.isZero(0.0)) return twist;
  constexpr double kHalf = 5e-4;  // s: central difference, to 1e-7 of the speed
  const Eigen::Isometry3d before = base * Psm::Forward(joints - kHalf * velocity);
  const Eigen::Isometry3d after = base * Psm::Forward(joints + kHalf * velocity);
  const Eigen::AngleAxisd turn(after.linear() * before.linear().transpose());
  twist << (after.translation() - before.translation()) / (2.0 * kHalf),
      turn.angle() / (2.0 * kHalf) * turn.axis();
  return twist;
}

bool Finite(const PsmPoseSample& pose) noexcept {
  // A quaternion that is not of unit length is no orientation.
  constexpr double kRounding = 1e-3;
  return pose.position_m.allFinite() && std::abs(pose.orientation.norm() - 1.0) <= kRounding;
}

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
    case PsmRequest::kPause:
      return "pause";
    case PsmRequest::kResume:
      return "resume";
    case PsmRequest::kHome:
      return "home";
    case PsmRequest::kUnhome:
      return "unhome";
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
  // Before the homed check, because a homing arm is not homed.
  if (state.busy) return PsmStatus::kBusy;
  return state.homed ? PsmStatus::kOk : PsmStatus::kNotHomed;
}

void PsmClientOptions::Check() const {
  limits.Check();
  rest.Check();
  DFR_THROW_UNLESS(Positive(longest_step_s), "longest_step_s must be positive");
  DFR_THROW_UNLESS(Positive(max_tick_gap_s), "max_tick_gap_s must be positive");
  DFR_THROW_UNLESS(Positive(max_lag), "max_lag must be positive and finite");
  DFR_THROW_UNLESS(Positive(max_setpoint_error), "max_setpoint_error must be positive and finite");
  DFR_THROW_UNLESS(Positive(max_jaw_setpoint_error),
                   "max_jaw_setpoint_error must be positive and finite");
  DFR_THROW_UNLESS(discovery_s >= 0.0 && discovery_s < 1e3, "discovery_s must lie in [0, 1000)");
  DFR_THROW_UNLESS(Positive(reach_timeout_s), "reach_timeout_s must be positive");
  DFR_THROW_UNLESS(Positive(jump_speed), "jump_speed must be positive and finite");
  DFR_THROW_UNLESS(jump_noise.allFinite() && (jump_noise.array() >= 0.0).all(),
                   "jump_noise must be finite and not negative");
  DFR_THROW_UNLESS(Positive(jump_distance_m), "jump_distance_m must be positive");
  DFR_THROW_UNLESS(Positive(max_frame_distance_m), "max_frame_distance_m must be positive");
  DFR_THROW_UNLESS(Positive(max_frame_angle), "max_frame_angle must be positive");
  DFR_THROW_UNLESS(Positive(enable_timeout_s), "enable_timeout_s must be positive");
  DFR_THROW_UNLESS(Positive(home_timeout_s), "home_timeout_s must be positive");
  DFR_THROW_UNLESS(Positive(repeat_request_s), "repeat_request_s must be positive");
}

PsmClient::PsmClient(const PsmClientOptions& options)
    : options_(options),
      motion_(options.limits, options.profile),
      rest_(options.rest),
      recent_(kCommandTime + options.watchdog.max_age_s),
      recent_jaw_(kCommandTime + options.watchdog.max_age_s),
      js_watchdog_(options.watchdog),
      cp_watchdog_(options.watchdog),
      local_watchdog_(options.watchdog),
      age_s_(kNan) {
  options.Check();
}

PsmStatus PsmClient::status() const noexcept {
  return phase_ == PsmPhase::kHolding ? cause_ : hold_reason_;
}

void PsmClient::Take(const PsmInput& input) noexcept {
  const bool armed = phase_ == PsmPhase::kArmed;
  jumped_ = erred_ = false;
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
    // During a move, or without valid data, no sample indicates rest.
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
  if (input.setpoint_js && input.setpoint_js->well_formed && input.setpoint_js->stamp.valid() &&
      input.setpoint_js->position.allFinite()) {
    setpoint_js_ = *input.setpoint_js;
    any_setpoint_ = true;
    setpoint_arrival_ns_ = now_ns_;
  }
  if (input.jaw_measured) jaw_measured_ = *input.jaw_measured;
  if (input.jaw_setpoint && input.jaw_setpoint->stamp.valid() &&
      std::isfinite(input.jaw_setpoint->angle)) {
    jaw_setpoint_ = *input.jaw_setpoint;
    any_jaw_setpoint_ = true;
  }
  if (input.operating_state) {
    if (any_operating_ && input.operating_state->lapses != operating_.lapses) {
      lapse_ = input.operating_state->last_lapse;
    }
    operating_ = *input.operating_state;
    any_operating_ = true;
  }
  if (input.newcomers > 0) {
    newcomer_ns_ = now_ns_;
    any_newcomer_ = true;
  }
  had_publisher_ = had_publisher_ || input.state_publishers > 0 || any_js_;
  erred_ = input.errors > 0;
  age_s_ = any_js_ ? Seconds(wall_ns_ - js_.stamp.nanoseconds()) : kNan;
}

PsmStatus PsmClient::MeasurementHoldReason() const noexcept {
  struct Stream {
    const dds::Watchdog& watchdog;
    const dds::Stamp& stamp;
    std::int64_t arrival_ns;
  };
  const std::array<Stream, 3> streams = {
      Stream{js_watchdog_, js_.stamp, js_arrival_ns_},
      Stream{cp_watchdog_, cp_.stamp, cp_arrival_ns_},
      Stream{local_watchdog_, local_cp_.stamp, local_arrival_ns_}};  // not on every console
  for (const Stream& stream : std::span(streams).first(any_local_ ? 3U : 2U)) {
    const PsmStatus status = FromFreshness(stream.watchdog.Check(wall_ns_, now_ns_));
    // The sample was recent on arrival; only its successor is missing.
    const std::int64_t waited_ns = now_ns_ - stream.arrival_ns;
    if (status == PsmStatus::kStateOld && wall_ns_ - stream.stamp.nanoseconds() < 2 * waited_ns) {
      return PsmStatus::kStateSilent;
    }
    if (status != PsmStatus::kOk) return status;
  }
  // An old set-point shows neither interference by others nor a pose for arming.
  if (any_setpoint_ && Seconds(now_ns_ - setpoint_arrival_ns_) > options_.watchdog.max_silence_s) {
    return PsmStatus::kStateSilent;
  }
  if (!js_.well_formed) return PsmStatus::kStateMalformed;
  if (!js_.position.allFinite() || !js_.velocity.allFinite() || !Finite(cp_) ||
      (any_local_ && !Finite(local_cp_))) {
    return PsmStatus::kStateNotFinite;
  }
  return jumped_ ? PsmStatus::kStateJumped : PsmStatus::kOk;
}

PsmStatus PsmClient::FindHoldReason(const PsmInput& input) const noexcept {
  const bool silent = js_watchdog_.Check(wall_ns_, now_ns_) == Freshness::kSilent;
  if (input.state_publishers == 0 && (!any_js_ || silent)) {
    if (input.incompatible > 0) return PsmStatus::kIncompatible;
    return had_publisher_ ? PsmStatus::kConsoleGone : PsmStatus::kNoConsole;
  }
  if (silent) return PsmStatus::kStateSilent;
  if (input.state_publishers > 1) return PsmStatus::kSecondConsole;
  if (!any_operating_) return PsmStatus::kNoOperatingState;
  const PsmStatus ready = Readiness(operating_);
  if (ready != PsmStatus::kOk) return ready;
  const PsmStatus measured = MeasurementHoldReason();
  if (measured != PsmStatus::kOk) return measured;
  const PsmStatus others = CommandHoldReason(input);
  if (others != PsmStatus::kOk) return others;
  return phase_ != PsmPhase::kArmed && Discovering() ? PsmStatus::kNewcomer : PsmStatus::kOk;
}

bool PsmClient::Discovering() const noexcept {
  return options_.sole_commander && any_newcomer_ &&
         Seconds(now_ns_ - newcomer_ns_) < options_.discovery_s;
}

// Another client commands the arm, or may do so.
PsmStatus PsmClient::CommandHoldReason(const PsmInput& input) const noexcept {
  if (input.wrong_tool) return PsmStatus::kWrongTool;
  if (input.clutched) return PsmStatus::kClutched;
  if (!options_.sole_commander) return PsmStatus::kOk;
  if (input.teleoperated) return PsmStatus::kTeleoperated;
  return input.other_publishers > 0 ? PsmStatus::kOtherPublisher : PsmStatus::kOk;
}

PsmStatus PsmClient::FollowHoldReason() const noexcept {
  if (options_.sole_commander &&
      !recent_.Contain(setpoint_js_.position, options_.max_setpoint_error)) {
    constexpr double kStill = 0.1;
    const PsmJoints moved = (setpoint_js_.position - agreed_).cwiseAbs();
    return (moved.array() <= kStill * options_.max_setpoint_error.array()).all()
               ? PsmStatus::kSetpointStays
               : PsmStatus::kForeignSetpoint;
  }
  if (options_.sole_commander && !JawIsOurs()) return PsmStatus::kForeignSetpoint;
  if (BaseMoved()) return PsmStatus::kBaseMoved;
  const PsmJoints lag = (js_.position - motion_.setpoint()).cwiseAbs();
  if ((lag.array() > options_.max_lag.array()).any()) return PsmStatus::kNotFollowing;
  if (Seconds(now_ns_ - restless_ns_) > options_.reach_timeout_s) {
    return PsmStatus::kNotReached;
  }
  return PsmStatus::kOk;
}

// The console states each change of control. After arming, our first set-point changes it once. A
// statement before that one may be about what was before.
bool PsmClient::ControlIsOurs(const PsmInput& input) noexcept {
  const bool settling = !pose_control_ && Seconds(now_ns_ - armed_ns_) < kCommandTime;
  const bool others = input.other_controls > 0 && !settling;
  const bool again = input.pose_controls > (pose_control_ ? 0 : 1);
  pose_control_ = pose_control_ || input.pose_controls > 0;
  return !others && !again;
}

// Returns true if a jaw without a command of ours stays still.
bool PsmClient::JawIsOurs() const noexcept {
  return !jaw_known_ || recent_jaw_.Contain(InFirstPlace(jaw_setpoint_.angle),
                                            InFirstPlace(options_.max_jaw_setpoint_error));
}

// Computes the arm's base in the frame of the first pose from two simultaneous poses. A console
// stamps each message separately; between the stamps the wrist moves at most a tenth of a
// millimetre.
void PsmClient::Pair() noexcept {
  constexpr std::int64_t kOneMomentNs = 3'000'000;
  if (!any_cp_ || !any_local_ || !cp_.stamp.valid() || !local_cp_.stamp.valid() ||
      std::abs(cp_.stamp.nanoseconds() - local_cp_.stamp.nanoseconds()) > kOneMomentNs ||
      !Finite(cp_) || !Finite(local_cp_)) {
    return;
  }
  base_now_ = Transform(cp_) * Transform(local_cp_).inverse();
  paired_ = true;
}

bool PsmClient::FrameAgrees() const noexcept {
  const Eigen::Isometry3d measured = Transform(any_local_ ? local_cp_ : cp_);
  return measured.matrix().allFinite() &&
         Near(Psm::Forward(js_.position), measured, options_.max_frame_distance_m,
              options_.max_frame_angle);
}

bool PsmClient::BaseMoved() const noexcept {
  return !Near(base_, base_now_, options_.max_frame_distance_m, options_.max_frame_angle);
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
  output.hold = true;
}

// During power-up and homing the arm measures nothing, but its messages are still checked.
PsmStatus PsmClient::HomingHoldReason(const PsmInput& input, double dt) const noexcept {
  if (!homing() && request_ != PsmRequest::kHome && request_ != PsmRequest::kEnable) {
    return PsmStatus::kOk;
  }
  // While homing, no tool is known until it is engaged.
  const PsmStatus others = CommandHoldReason(input);
  if (others != PsmStatus::kOk && others != PsmStatus::kWrongTool) return others;
  if (!homing()) return PsmStatus::kOk;
  if (options_.sole_commander && input.foreign_words > 0) return PsmStatus::kForeignWord;
  if (options_.sole_commander && input.newcomers > 0) return PsmStatus::kNewcomer;
  if (hold_reason_ == PsmStatus::kConsoleGone || hold_reason_ == PsmStatus::kSecondConsole ||
      hold_reason_ == PsmStatus::kStateSilent || hold_reason_ == PsmStatus::kUnknownState ||
      hold_reason_ == PsmStatus::kPaused) {
    return hold_reason_;
  }
  return dt > options_.max_tick_gap_s ? PsmStatus::kTickLate : PsmStatus::kOk;
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
      case PsmRequest::kResume:
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
  if (at_rest_ || motion_.moving()) restless_ns_ = now_ns_;

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
  if (cause == PsmStatus::kOk && options_.sole_commander && input.foreign_words > 0) {
    cause = PsmStatus::kForeignWord;
  }
  if (cause == PsmStatus::kOk && options_.sole_commander && input.newcomers > 0) {
    cause = PsmStatus::kNewcomer;
  }
  const bool ours = ControlIsOurs(input);
  if (cause == PsmStatus::kOk && options_.sole_commander && !ours) {
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

  const double step_s = std::min(dt, options_.longest_step_s);
  if (motion_.moving()) {
    motion_.Advance(step_s);
    rest_.Forget();
    at_rest_ = false;
  }
  recent_.Add(motion_.setpoint(), Seconds(now_ns_));
  output.servo = true;
  output.servo_cp = base_ * Psm::Forward(motion_.setpoint());
  output.twist = Twist(base_, motion_.setpoint(), motion_.velocity());
  if (jaw_ours_) {
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
  const bool always = request == PsmRequest::kDisable || request == PsmRequest::kUnhome;
  if (!always && any_operating_ && operating_.state == PsmConsoleState::kFault) {
    return PsmStatus::kConsoleFault;
  }
  hold_first_ = phase_ == PsmPhase::kArmed;
  phase_ = PsmPhase::kRequested;
  motion_.Rest(motion_.setpoint());
  jaw_moving_ = jaw_ours_ = false;
  request_ = request;
  request_sent_ = false;
  request_start_ns_ = now_ns_;
  return PsmStatus::kOk;
}

PsmStatus PsmClient::Armable() const noexcept {
  if (phase_ == PsmPhase::kArmed) return PsmStatus::kOk;
  if (phase_ == PsmPhase::kRequested) return PsmStatus::kBusy;
  if (hold_wanted_) return PsmStatus::kHeld;
  if (hold_reason_ != PsmStatus::kOk) return hold_reason_;
  if (!any_setpoint_) return PsmStatus::kStateSilent;
  if (any_local_ && !paired_) return PsmStatus::kStateSilent;
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
  restless_ns_ = armed_ns_ = now_ns_;
  agreed_ = setpoint_js_.position;
  pose_control_ = false;
  jaw_ours_ = jaw_moving_ = jaw_known_ = false;
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

PsmStatus PsmClient::MoveTo(const Eigen::Isometry3d& goal, double duration_s) noexcept {
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
  if (!jaw_ours_ && !any_jaw_setpoint_) return PsmStatus::kStateSilent;
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
