#pragma once

namespace dfr::hardware {

/// What stands between a client and a PSM's motion, and why a command was refused.
enum class PsmStatus {
  kOk,
  // The console as a whole.
  kNoConsole,         ///< Nobody publishes the arm's state, and nobody has.
  kConsoleGone,       ///< Its publishers have left.
  kIncompatible,      ///< Publishers are there, but their quality of service does not match.
  kNoOperatingState,  ///< Measurements come, the operating state has not.
  kConsoleFault,      ///< FAULT.
  kConsoleError,      ///< It reported an error while the arm was ours.
  kDisabled,          ///< DISABLED.
  kPaused,            ///< PAUSED.
  kUnknownState,      ///< An operating state that CRTK does not have.
  kNotHomed,          ///< ENABLED, but is_homed is false.
  kBusy,              ///< is_busy: homing, or another client's move, is under way.
  // What it measures.
  kStateSilent,     ///< Nothing has arrived for too long.
  kStateInvalid,    ///< Stamped zero, a console's mark for invalid data.
  kStateOld,        ///< Stamped too long ago: delayed, or the console is frozen.
  kStateAhead,      ///< Stamped in the future: a clock has jumped, or the clocks differ.
  kStateMalformed,  ///< Not six joints.
  kStateNotFinite,  ///< NaN or infinite, or a quaternion of another length than 1.
  kStateJumped,     ///< Farther from one sample to the next than the arm can move.
  kFrameMismatch,   ///< local/measured_cp is not where measured_js puts the wrist.
  kBaseMoved,       ///< The frame of measured_cp moves: the camera, or a setup joint.
  // Who commands, and whether it helps.
  kOtherPublisher,   ///< Someone else publishes on the arm's command topics.
  kSecondConsole,    ///< More than one publishes the arm's state.
  kForeignWord,      ///< Someone else told the arm to hold, to be free or to change its state.
  kNewcomer,         ///< Someone joined the network, or began to publish what commands the arm.
  kForeignSetpoint,  ///< The console's set-point is none of those that were sent to it.
  kTeleoperated,     ///< A teleoperation inside the console is enabled.
  kClutched,         ///< The operator holds the arm's clutch.
  kWrongTool,        ///< Another instrument than those whose kinematics are known.
  kToolChanged,      ///< The instrument was changed.
  kNotFollowing,     ///< The arm is too far from its set-point.
  kNotReached,       ///< The move has ended, but the arm has not come to rest at its goal.
  kTickLate,         ///< The caller's loop stood still for too long.
  kSendFailed,       ///< Commands cannot be sent as fast as they are made.
  kTimedOut,         ///< A state command had no effect in time.
  kHeld,             ///< Hold() was called.
  // Why a command was refused; nothing was sent.
  kNotArmed,          ///< Arm() comes first.
  kInvalidGoal,       ///< A non-finite entry, or a negative duration.
  kBeyondLimits,      ///< A joint would leave its limits.
  kUnreachable,       ///< No joint values for the pose, or the pose does not tell which.
  kOutsideWorkspace,  ///< The jaw tips would leave the workspace, on the way or at the end.
  kTooFast,           ///< The duration is too short for the speed limits.
};

/// In plain words, lower case, without a full stop.
[[nodiscard]] const char* Name(PsmStatus status) noexcept;

/// What the user can do about it; empty for kOk.
[[nodiscard]] const char* Remedy(PsmStatus status) noexcept;

}  // namespace dfr::hardware
