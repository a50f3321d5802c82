#include "dfr/hardware/psm_status.h"

#include <array>
#include <cstddef>

namespace dfr::hardware {
namespace {

using runtime::HoldReason;

struct Entry {
  PsmStatus status;
  HoldReason reason;
  const char* name;
  const char* remedy;
};

constexpr std::array kEntries = std::to_array<Entry>({
    {PsmStatus::kOk, HoldReason::kNone, "ok", ""},
    {PsmStatus::kNoConsole, HoldReason::kArmSilent, "no program publishes the arm's state",
     "start the console (or dvrk_simulator) with this arm's name, in this DDS domain and within "
     "reach of this kind of discovery"},
    {PsmStatus::kConsoleGone, HoldReason::kArmSilent, "the console has disappeared",
     "start the console again, home the arm and arm again"},
    {PsmStatus::kIncompatible, HoldReason::kArmSilent,
     "the console's quality of service does not match",
     "the console must publish its state reliably, and operating_state transient-local"},
    {PsmStatus::kNoOperatingState, HoldReason::kArmNotReady, "no operating_state has arrived",
     "the console must publish operating_state for this arm (CRTK, dVRK 2.0 or later)"},
    {PsmStatus::kConsoleFault, HoldReason::kArmNotReady, "the console is in FAULT",
     "read the console's messages, remove the cause, then disable, home and arm"},
    {PsmStatus::kConsoleError, HoldReason::kArmNotReady, "the console reported an error",
     "read the console's messages, remove the cause and arm again"},
    {PsmStatus::kDisabled, HoldReason::kArmNotReady, "the arm is DISABLED", "home the arm"},
    {PsmStatus::kPaused, HoldReason::kArmNotReady, "the arm is PAUSED",
     "resume the arm, then arm again"},
    {PsmStatus::kUnknownState, HoldReason::kArmNotReady,
     "the console is in a state that CRTK does not define",
     "use a CRTK console of the Jazzy or Humble generation"},
    {PsmStatus::kNotHomed, HoldReason::kArmNotReady, "the arm is not homed", "home the arm"},
    {PsmStatus::kBusy, HoldReason::kArmNotReady, "the arm is busy with a motion of another client",
     "end the other motion (teleoperation, another client), then arm again"},
    {PsmStatus::kStateSilent, HoldReason::kArmSilent,
     "no measurement or set-point has arrived for too long",
     "check the console and the network, then arm again"},
    {PsmStatus::kStateInvalid, HoldReason::kArmInvalid,
     "measurements or set-points are marked invalid (stamp 0)",
     "the console has no valid pose of the arm: home it"},
    {PsmStatus::kStateOld, HoldReason::kArmOld, "measurements or set-points are too old",
     "set both machines' clocks by NTP or PTP; if they agree, the console or network stalls"},
    {PsmStatus::kStateAhead, HoldReason::kClock,
     "measurements or set-points are stamped in the future",
     "set both machines' clocks by NTP or PTP"},
    {PsmStatus::kStateMalformed, HoldReason::kArmInvalid, "measured_js does not have six joints",
     "check that the arm is a PSM, whose measured_js has yaw, pitch, insertion, roll, wrist pitch "
     "and yaw"},
    {PsmStatus::kStateNotFinite, HoldReason::kArmInvalid,
     "measurements are not finite, or a quaternion is not of unit length",
     "disable and home the arm, and check its encoders and instrument"},
    {PsmStatus::kStateJumped, HoldReason::kArmJump,
     "measurements jumped farther than the arm can move",
     "check the encoders and cables; only one console may publish for this arm"},
    {PsmStatus::kFrameMismatch, HoldReason::kArmJump,
     "local/measured_cp differs from the wrist pose computed from measured_js",
     "the instrument must be the Large Needle Driver 400006 or 420006, and a console with a base "
     "frame for the arm must publish local/measured_cp"},
    {PsmStatus::kBaseMoved, HoldReason::kArmJump, "the reference frame of the poses moves",
     "do not move the camera arm and the setup joints, then arm again"},
    {PsmStatus::kOtherPublisher, HoldReason::kSecondCommander, "others can command the arm",
     "end the other client that publishes on servo_* or move_* of this arm"},
    {PsmStatus::kSecondConsole, HoldReason::kSecondCommander,
     "more than one program publishes the arm's state",
     "end all consoles and simulators of this arm but one; a killed program disappears after a few "
     "seconds"},
    {PsmStatus::kForeignMessage, HoldReason::kSecondCommander,
     "another program told the arm to hold, to be free or to change its state",
     "find the sender of hold, free or state_command, then arm again"},
    {PsmStatus::kNewcomer, HoldReason::kSecondCommander,
     "a participant that may command the arm has just joined",
     "its earlier messages are unknown: check the arm, then arm again"},
    {PsmStatus::kForeignControl, HoldReason::kSecondCommander,
     "the console has obeyed a hold, free or other command of another program",
     "only the console received it: check the arm, find the sender, then arm again"},
    {PsmStatus::kForeignSetpoint, HoldReason::kSecondCommander,
     "the console's set-point differs from those sent to it",
     "end teleoperation and commands inside the console, then arm again"},
    {PsmStatus::kSetpointStays, HoldReason::kArmNotFollowing,
     "the console's set-point does not follow those sent to it",
     "check for other programs that hold the arm and for lost commands, then arm again"},
    {PsmStatus::kTeleoperated, HoldReason::kSecondCommander, "the arm is teleoperated",
     "disable teleoperation at the console, then arm again"},
    {PsmStatus::kClutched, HoldReason::kSecondCommander, "the operator holds the arm's clutch",
     "let go of the clutch, then arm again"},
    {PsmStatus::kToolNotNamed, HoldReason::kArmNotReady, "the console has not named the instrument",
     "a console names it on tool_type once it is engaged: mount it, or choose it at the console"},
    {PsmStatus::kWrongTool, HoldReason::kArmNotReady, "the instrument is not supported",
     "mount a Large Needle Driver, 400006 or 420006; an arm of generation Si needs 420006"},
    {PsmStatus::kToolChanged, HoldReason::kArmNotReady, "the instrument was changed",
     "check the instrument and its calibration, then arm again"},
    {PsmStatus::kNotFollowing, HoldReason::kArmNotFollowing,
     "the arm does not follow its set-point",
     "check for obstacles of the arm, and the console's messages for dropped commands"},
    {PsmStatus::kNotReached, HoldReason::kArmNotFollowing,
     "the arm has not come to rest at its goal",
     "check for obstacles of the arm; its steady error may exceed rest_distance"},
    {PsmStatus::kTickLate, HoldReason::kOverrun, "the control loop was late",
     "give the control loop's thread a real-time priority, or use a less busy machine"},
    {PsmStatus::kSendFailed, HoldReason::kOverrun, "commands cannot be sent",
     "check that the network interface is up and the machine is not overloaded"},
    {PsmStatus::kTimedOut, HoldReason::kArmNotReady,
     "the console did not complete the request in time",
     "read the console's messages; release the emergency stop or power the arm"},
    {PsmStatus::kHeld, HoldReason::kArmNotReady, "held on request", "arm again when it is safe"},
    {PsmStatus::kNotArmed, HoldReason::kArmNotReady, "not armed", "home the arm, then arm"},
    {PsmStatus::kInvalidGoal, HoldReason::kCommandRefused,
     "the goal is not finite, or its duration is negative", "choose another goal"},
    {PsmStatus::kBeyondLimits, HoldReason::kCommandRefused, "beyond a joint's limits",
     "choose another goal"},
    {PsmStatus::kUnreachable, HoldReason::kCommandRefused,
     "the pose is unreachable, or its joint values are ambiguous", "choose another goal"},
    {PsmStatus::kOutsideWorkspace, HoldReason::kCommandRefused, "outside the workspace",
     "choose another goal"},
    {PsmStatus::kTooFast, HoldReason::kCommandRefused, "faster than the speed limits",
     "give the move more time"},
});

constexpr bool InOrder() {
  for (std::size_t i = 0; i < kEntries.size(); ++i) {
    if (static_cast<std::size_t>(kEntries[i].status) != i) return false;
  }
  return true;
}
static_assert(kEntries.size() == static_cast<std::size_t>(PsmStatus::kTooFast) + 1 && InOrder());

const Entry& EntryOf(PsmStatus status) noexcept {
  return kEntries[static_cast<std::size_t>(status)];
}

}  // namespace

const char* Name(PsmStatus status) noexcept { return EntryOf(status).name; }

const char* Remedy(PsmStatus status) noexcept { return EntryOf(status).remedy; }

runtime::HoldReason HoldReasonFor(PsmStatus status) noexcept { return EntryOf(status).reason; }

}  // namespace dfr::hardware
