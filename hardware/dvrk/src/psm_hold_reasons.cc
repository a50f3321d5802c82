// Reasons for which a PsmClient holds.
#include <cstdint>

#include "dfr/hardware/psm_client.h"
#include "psm_client_internal.h"

namespace dfr::hardware {
namespace {

using dds::Freshness;
using internal::Finite;
using internal::InFirstPlace;
using internal::Seconds;
using internal::Transform;
using kinematics::Psm;
using kinematics::PsmJoints;

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

// Returns true if the poses agree within a distance, m, and an angle, rad.
bool Near(const Eigen::Isometry3d& a, const Eigen::Isometry3d& b, double distance_m,
          double angle) noexcept {
  return (a.translation() - b.translation()).norm() <= distance_m &&
         Eigen::Quaterniond(a.linear()).angularDistance(Eigen::Quaterniond(b.linear())) <= angle;
}

}  // namespace

PsmStatus PsmClient::StampHoldReason(const dds::Watchdog& watchdog, const dds::Stamp& stamp,
                                     std::int64_t arrival_ns) const noexcept {
  const PsmStatus status = FromFreshness(watchdog.Check(wall_ns_, now_ns_));
  // The sample was recent on arrival; only its successor is missing.
  const std::int64_t waited_ns = now_ns_ - arrival_ns;
  const bool waits =
      status == PsmStatus::kStateOld && wall_ns_ - stamp.nanoseconds() < 2 * waited_ns;
  return waits ? PsmStatus::kStateSilent : status;
}

PsmStatus PsmClient::MeasurementHoldReason() const noexcept {
  PsmStatus status = StampHoldReason(js_watchdog_, js_.stamp, js_arrival_ns_);
  if (status != PsmStatus::kOk) return status;
  status = StampHoldReason(cp_watchdog_, cp_.stamp, cp_arrival_ns_);
  if (status != PsmStatus::kOk) return status;
  // Not every console publishes local/measured_cp.
  if (any_local_) status = StampHoldReason(local_watchdog_, local_cp_.stamp, local_arrival_ns_);
  if (status != PsmStatus::kOk) return status;
  if (!js_.well_formed) return PsmStatus::kStateMalformed;
  if (!js_.position.allFinite() || !js_.velocity.allFinite() || !Finite(cp_) ||
      (any_local_ && !Finite(local_cp_))) {
    return PsmStatus::kStateNotFinite;
  }
  // Without two poses of the same moment a motion of the base remains unnoticed.
  if (any_local_ && Seconds(now_ns_ - paired_ns_) > options_.watchdog.max_silence_s) {
    return PsmStatus::kStateSilent;
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
  // An old set-point neither reveals commands of others nor gives the pose for arming.
  const PsmStatus setpoint =
      any_setpoint_ ? StampHoldReason(setpoint_watchdog_, setpoint_js_.stamp, setpoint_arrival_ns_)
                    : PsmStatus::kOk;
  if (setpoint != PsmStatus::kOk) return setpoint;
  if (input.instrument == PsmInstrument::kNotNamed) return PsmStatus::kToolNotNamed;
  if (input.instrument == PsmInstrument::kOther) return PsmStatus::kWrongTool;
  const PsmStatus others = CommandHoldReason(input);
  if (others != PsmStatus::kOk) return others;
  return phase_ != PsmPhase::kArmed && Discovering() ? PsmStatus::kNewcomer : PsmStatus::kOk;
}

bool PsmClient::Discovering() const noexcept {
  return options_.sole_commander && any_newcomer_ &&
         Seconds(now_ns_ - newcomer_ns_) < options_.discovery_s;
}

// Returns kOk unless others can command the arm: by clutch, teleoperation or a command topic.
PsmStatus PsmClient::CommandHoldReason(const PsmInput& input) const noexcept {
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
  // An old set-point of the jaw does not reveal commands of others.
  const PsmStatus jaw = jaw_ours_ ? JawHoldReason() : PsmStatus::kOk;
  if (jaw != PsmStatus::kOk) return jaw;
  if (BaseMoved()) return PsmStatus::kBaseMoved;
  const PsmJoints lag = (js_.position - motion_.setpoint()).cwiseAbs();
  if ((lag.array() > options_.max_lag.array()).any()) return PsmStatus::kNotFollowing;
  if (Seconds(now_ns_ - restless_ns_) > options_.reach_timeout_s) {
    return PsmStatus::kNotReached;
  }
  return PsmStatus::kOk;
}

// Returns true if this client sent the jaw's set-point or, before its first one, if the set-point
// has not moved.
bool PsmClient::JawIsOurs() const noexcept {
  return !jaw_known_ || recent_jaw_.Contain(InFirstPlace(jaw_setpoint_.angle),
                                            InFirstPlace(options_.max_jaw_setpoint_error));
}

PsmStatus PsmClient::JawHoldReason() const noexcept {
  if (!any_jaw_setpoint_) return PsmStatus::kStateSilent;
  return StampHoldReason(jaw_watchdog_, jaw_setpoint_.stamp, jaw_arrival_ns_);
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

// During power-up and homing there are no valid measurements. Checks the console's messages and
// whether others command the arm.
PsmStatus PsmClient::HomingHoldReason(const PsmInput& input, double dt) const noexcept {
  if (!homing() && request_ != PsmRequest::kHome && request_ != PsmRequest::kEnable) {
    return PsmStatus::kOk;
  }
  const PsmStatus others = CommandHoldReason(input);  // no instrument is named until it is engaged
  if (others != PsmStatus::kOk) return others;
  if (!homing()) return PsmStatus::kOk;
  if (options_.sole_commander && input.foreign_messages > 0) return PsmStatus::kForeignMessage;
  if (options_.sole_commander && input.newcomers > 0) return PsmStatus::kNewcomer;
  if (hold_reason_ == PsmStatus::kConsoleGone || hold_reason_ == PsmStatus::kSecondConsole ||
      hold_reason_ == PsmStatus::kStateSilent || hold_reason_ == PsmStatus::kUnknownState ||
      hold_reason_ == PsmStatus::kPaused) {
    return hold_reason_;
  }
  // An operator or another program has switched the arm off. A repeated request would power up the
  // arm again.
  if (switched_off_) return PsmStatus::kDisabled;
  if (input.send_failed) return PsmStatus::kSendFailed;
  return dt > options_.max_tick_gap_s ? PsmStatus::kTickLate : PsmStatus::kOk;
}

}  // namespace dfr::hardware
