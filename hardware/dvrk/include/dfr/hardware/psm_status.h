#pragma once

#include "dfr/runtime/fail_safe.h"

namespace dfr::hardware {

/// Reasons that prevent a PSM's motion or cause a command to be refused.
enum class PsmStatus {
  kOk,
  // State of the console.
  kNoConsole,         ///< No publisher of the arm's state has been found yet.
  kConsoleGone,       ///< The console's publishers have left.
  kIncompatible,      ///< Publishers exist, but their quality of service does not match.
  kNoOperatingState,  ///< Measurements arrive, but no operating state arrives.
  kConsoleFault,      ///< The console is in FAULT.
  kConsoleError,      ///< The console reported an error while this client controlled the arm.
  kDisabled,          ///< The arm is DISABLED.
  kPaused,            ///< The arm is PAUSED.
  kUnknownState,      ///< An operating state not defined by CRTK.
  kNotHomed,          ///< The state is ENABLED, but is_homed is false.
  kBusy,              ///< is_busy: the arm is homing, or moves for another client.
  // Measurements.
  kStateSilent,     ///< No measurement or set-point has arrived for too long.
  kStateInvalid,    ///< The stamp is zero, as consoles stamp invalid data.
  kStateOld,        ///< The stamp is too old: messages are delayed, or the console is frozen.
  kStateAhead,      ///< The stamp is in the future: a clock jumped, or the clocks differ.
  kStateMalformed,  ///< The message does not have six joints.
  kStateNotFinite,  ///< A value is NaN or infinite, or a quaternion is not of unit length.
  kStateJumped,     ///< The change between two samples exceeds the arm's speed.
  kFrameMismatch,   ///< local/measured_cp differs from the wrist pose computed from measured_js.
  kBaseMoved,       ///< The frame of measured_cp moves because of the camera or a setup joint.
  // Commands and their effect.
  kOtherPublisher,   ///< Another program publishes on the arm's command topics.
  kSecondConsole,    ///< There are several publishers of the arm's state.
  kForeignMessage,   ///< Another program told the arm to hold, be free or change its state.
  kNewcomer,         ///< A participant joined, or began to publish on a command topic.
  kForeignControl,   ///< The console states that a command of another program controls the arm.
  kForeignSetpoint,  ///< The console's set-point differs from the set-points sent to it.
  kSetpointStays,    ///< The console's set-point does not follow the set-points sent to it.
  kTeleoperated,     ///< Teleoperation is enabled in the console.
  kClutched,         ///< The operator holds the arm's clutch.
  kToolNotNamed,     ///< The console has not named the instrument.
  kWrongTool,        ///< An instrument whose kinematics are unknown.
  kToolChanged,      ///< The instrument was changed.
  kNotFollowing,     ///< The measured arm is too far from its set-point.
  kNotReached,       ///< The move ended, but the arm did not come to rest at its goal.
  kTickLate,         ///< The caller's loop was late.
  kSendFailed,       ///< Commands cannot be sent fast enough.
  kTimedOut,         ///< A state command had no effect in time.
  kHeld,             ///< Hold() was called.
  // Reasons for a refused command; nothing was sent.
  kNotArmed,          ///< Requires Arm() first.
  kInvalidGoal,       ///< A non-finite entry, or a negative duration.
  kBeyondLimits,      ///< A joint would exceed its limits.
  kUnreachable,       ///< The goal, or a pose during the move, has no unique joint values.
  kOutsideWorkspace,  ///< The jaw tips would leave the workspace, at the goal or during the move.
  kTooFast,           ///< The duration is too short for the speed limits.
};

/// Returns a short description in lower case, without a full stop.
[[nodiscard]] const char* Name(PsmStatus status) noexcept;

/// Returns the remedy for the user; empty for kOk.
[[nodiscard]] const char* Remedy(PsmStatus status) noexcept;

/// Returns the reason for which a robot with this arm holds; kNone for kOk.
[[nodiscard]] runtime::HoldReason HoldReasonFor(PsmStatus status) noexcept;

}  // namespace dfr::hardware
