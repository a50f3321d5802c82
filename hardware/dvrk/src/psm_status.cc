#include "dfr/hardware/psm_status.h"

namespace dfr::hardware {

const char* Name(PsmStatus status) noexcept {
  switch (status) {
    case PsmStatus::kOk:
      return "ok";
    case PsmStatus::kNoConsole:
      return "no program publishes the arm's state";
    case PsmStatus::kConsoleGone:
      return "the console has disappeared";
    case PsmStatus::kIncompatible:
      return "the console's quality of service does not match";
    case PsmStatus::kNoOperatingState:
      return "no operating_state has come";
    case PsmStatus::kConsoleFault:
      return "the console is in FAULT";
    case PsmStatus::kConsoleError:
      return "the console reported an error";
    case PsmStatus::kDisabled:
      return "the arm is DISABLED";
    case PsmStatus::kPaused:
      return "the arm is PAUSED";
    case PsmStatus::kUnknownState:
      return "the console is in a state that CRTK does not have";
    case PsmStatus::kNotHomed:
      return "the arm is not homed";
    case PsmStatus::kBusy:
      return "the arm is busy with a motion that is not ours";
    case PsmStatus::kStateSilent:
      return "no measurement or set-point has come for too long";
    case PsmStatus::kStateInvalid:
      return "measurements are marked invalid (stamp 0)";
    case PsmStatus::kStateOld:
      return "measurements are too old";
    case PsmStatus::kStateAhead:
      return "measurements are stamped in the future";
    case PsmStatus::kStateMalformed:
      return "measured_js does not have six joints";
    case PsmStatus::kStateNotFinite:
      return "measurements are not finite, or a quaternion has another length than 1";
    case PsmStatus::kStateJumped:
      return "measurements jumped farther than the arm can move";
    case PsmStatus::kFrameMismatch:
      return "local/measured_cp is not where measured_js puts the wrist";
    case PsmStatus::kBaseMoved:
      return "the frame that poses are relative to moves";
    case PsmStatus::kOtherPublisher:
      return "someone else can command the arm";
    case PsmStatus::kSecondConsole:
      return "more than one program publishes the arm's state";
    case PsmStatus::kForeignWord:
      return "someone else told the arm to hold, to be free or to change its state";
    case PsmStatus::kNewcomer:
      return "someone who may command the arm has just joined";
    case PsmStatus::kForeignControl:
      return "the console has obeyed a hold, free or other command of someone else";
    case PsmStatus::kForeignSetpoint:
      return "the console moves its set-point where it was not sent";
    case PsmStatus::kSetpointStays:
      return "the console's set-point does not follow what it is sent";
    case PsmStatus::kTeleoperated:
      return "the arm is teleoperated";
    case PsmStatus::kClutched:
      return "the operator holds the arm's clutch";
    case PsmStatus::kWrongTool:
      return "the arm has another instrument";
    case PsmStatus::kToolChanged:
      return "the instrument was changed";
    case PsmStatus::kNotFollowing:
      return "the arm does not follow its set-point";
    case PsmStatus::kNotReached:
      return "the arm has not come to rest at its goal";
    case PsmStatus::kTickLate:
      return "the control loop stood still for too long";
    case PsmStatus::kSendFailed:
      return "commands cannot be sent";
    case PsmStatus::kTimedOut:
      return "the console did not do what it was asked in time";
    case PsmStatus::kHeld:
      return "held on request";
    case PsmStatus::kNotArmed:
      return "not armed";
    case PsmStatus::kInvalidGoal:
      return "the goal is not finite, or its duration negative";
    case PsmStatus::kBeyondLimits:
      return "beyond a joint's limits";
    case PsmStatus::kUnreachable:
      return "the pose cannot be reached, or leaves open how";
    case PsmStatus::kOutsideWorkspace:
      return "outside the workspace";
    case PsmStatus::kTooFast:
      return "faster than the speed limits";
  }
  return "unknown";
}

const char* Remedy(PsmStatus status) noexcept {
  switch (status) {
    case PsmStatus::kOk:
      return "";
    case PsmStatus::kNoConsole:
      return "is the console (or dvrk_simulator) running, with this arm's name, in this DDS domain "
             "and within reach of this kind of discovery?";
    case PsmStatus::kConsoleGone:
      return "start the console again, home the arm and arm again";
    case PsmStatus::kIncompatible:
      return "the console must publish its state reliably, and operating_state transient-local";
    case PsmStatus::kNoOperatingState:
      return "does the console publish operating_state for this arm (CRTK, dVRK 2.0 or later)?";
    case PsmStatus::kConsoleFault:
      return "read the console's messages, remove the cause, then disable, home and arm";
    case PsmStatus::kConsoleError:
      return "read the console's messages, remove the cause and arm again";
    case PsmStatus::kDisabled:
      return "home the arm";
    case PsmStatus::kPaused:
      return "resume the arm, then arm again";
    case PsmStatus::kUnknownState:
      return "is this a CRTK console of the Jazzy or Humble generation?";
    case PsmStatus::kNotHomed:
      return "home the arm";
    case PsmStatus::kBusy:
      return "end the other motion (teleoperation, another client), then arm again";
    case PsmStatus::kStateSilent:
      return "is the console alive and the network sound? then arm again";
    case PsmStatus::kStateInvalid:
      return "the console has no valid pose of the arm: home it";
    case PsmStatus::kStateOld:
      return "set both machines' clocks by NTP or PTP; if they agree, the console or network "
             "stalls";
    case PsmStatus::kStateAhead:
      return "set both machines' clocks by NTP or PTP";
    case PsmStatus::kStateMalformed:
      return "is this a PSM? its measured_js has yaw, pitch, insertion, roll, wrist pitch and yaw";
    case PsmStatus::kStateNotFinite:
      return "the console measures nonsense: disable, home, and check encoders and instrument";
    case PsmStatus::kStateJumped:
      return "check encoders, cables and that only one console publishes for this arm";
    case PsmStatus::kFrameMismatch:
      return "the instrument must be the Large Needle Driver 400006 or 420006, and a console with "
             "a "
             "base frame for the arm must publish local/measured_cp";
    case PsmStatus::kBaseMoved:
      return "leave camera arm and setup joints where they are, then arm again";
    case PsmStatus::kOtherPublisher:
      return "end the other client that publishes on servo_*, move_* of this arm";
    case PsmStatus::kSecondConsole:
      return "end all consoles and simulators of this arm but one; one that was killed is "
             "forgotten "
             "after some seconds";
    case PsmStatus::kForeignWord:
      return "ask who sent hold, free or state_command, then arm again";
    case PsmStatus::kNewcomer:
      return "what was said before it was found is not known: look at the arm, then arm again";
    case PsmStatus::kForeignControl:
      return "only the console has heard it: look at the arm, ask who sent it, then arm again";
    case PsmStatus::kForeignSetpoint:
      return "is the arm teleoperated, or commanded inside the console? end that, then arm again";
    case PsmStatus::kSetpointStays:
      return "does someone hold the arm, or are commands lost on the way? then arm again";
    case PsmStatus::kTeleoperated:
      return "disable teleoperation at the console, then arm again";
    case PsmStatus::kClutched:
      return "let go of the clutch, then arm again";
    case PsmStatus::kWrongTool:
      return "put in a Large Needle Driver, 400006 or 420006; on an arm of generation Si 420006";
    case PsmStatus::kToolChanged:
      return "check the instrument and its calibration, then arm again";
    case PsmStatus::kNotFollowing:
      return "is something in the arm's way, or does the console drop commands? see its messages";
    case PsmStatus::kNotReached:
      return "is something in the arm's way? the arm's steady error may exceed rest_distance";
    case PsmStatus::kTickLate:
      return "give the control loop's thread a real-time priority, or a machine less busy";
    case PsmStatus::kSendFailed:
      return "is the network interface up? the machine may be overloaded";
    case PsmStatus::kTimedOut:
      return "read the console's messages; press the emergency stop's release or power the arm";
    case PsmStatus::kHeld:
      return "arm again when it is safe";
    case PsmStatus::kNotArmed:
      return "home the arm, then arm";
    case PsmStatus::kInvalidGoal:
    case PsmStatus::kBeyondLimits:
    case PsmStatus::kUnreachable:
    case PsmStatus::kOutsideWorkspace:
      return "choose another goal";
    case PsmStatus::kTooFast:
      return "give the move more time";
  }
  return "";
}

}  // namespace dfr::hardware
